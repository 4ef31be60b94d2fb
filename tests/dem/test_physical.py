"""Physical parameters: the filter is the Kalman filter it says it is, and flights that steer give their truth back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_are

from mavdem import Flight
from mavdem.dem import physical
from mavdem.dem.graybox.coloured import FIRST_ORDER, SMOOTH
from mavdem.dem.graybox.parameters import (
    MAX_WIND_SHARE,
    WINDS,
    _Data,
    _fitted,
    _Parameters,
    _steady_covariance,
    delayed,
)
from sitl_scenarios.dynamics import euler
from sitl_scenarios.files import load
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

DT, LAG, DAMPING = 0.01, 0.04, 2.0
MOTORS = np.array([-0.06, 0.06, 0.06, -0.06])
FINE = 10


def flown(
    seed: int, steering: float, samples: int = 700, wind: float = 1.0, commanded: np.ndarray | None = None
) -> Flight:
    """An axis whose controller answers the rate it measures, with turbulence (rad/s²) and with steering (rad/s).

    The last samples have motors that are ``commanded`` (H, 4), whatever the vehicle does.
    """
    rng = np.random.default_rng(seed)
    keeps = np.exp(-DT / FINE / 0.5)
    reference = steering * np.sign(np.sin(2 * np.pi * np.arange(samples) * DT / 1.3))
    angle = rate = torque = drift = 0.0
    commands, outputs, command = np.zeros((samples, 4)), np.empty((samples, 2)), np.zeros(4)
    for k in range(samples):
        measured = rate + 0.005 * rng.standard_normal()
        outputs[k] = angle, measured
        wanted = 12 * (reference[k] - 3 * angle - measured)
        commands[k] = wanted * MOTORS / (MOTORS @ MOTORS) + rng.standard_normal(4)
        if commanded is not None and k >= samples - len(commanded):
            commands[k] = commanded[k - samples]
        for step in range(FINE):
            command = commands[k] if step >= 5 else commands[max(k - 1, 0)]
            torque += DT / FINE / LAG * (MOTORS @ command - torque)
            drift = keeps * drift + np.sqrt(1 - keeps**2) * wind * rng.standard_normal()
            rate += DT / FINE * (torque - DAMPING * rate + drift)
            angle += DT / FINE * rate
    return Flight(DT * np.arange(samples), 1500 + commands, outputs)


def scenario(name: str, seed: int) -> tuple[Flight, np.ndarray, float]:
    """A window of a flight of ``sitl_scenarios``, and the motors' effect and lag that are true of it."""
    plan = load(name)
    motion = fly(plan.model_copy(update={"seed": plan.seed + seed, "duration": 25.0}))
    known = truth(plan, motion)
    time = np.arange(1000, 1700) * DT
    roll = np.array([euler(attitude)[0] for attitude in motion.known_attitude.tolist()])
    outputs = [np.interp(time, motion.time, column) for column in (roll, motion.known_rates[:, 0])]
    inputs = [np.interp(time, motion.time, column) for column in motion.outputs.T]
    return Flight(time, np.column_stack(inputs), np.column_stack(outputs)), known["roll_B"][1], float(known["lag"][0])


@pytest.mark.parametrize(
    ("noise", "autocorrelation"),
    [(FIRST_ORDER, lambda tau: np.exp(-tau)), (SMOOTH, lambda tau: np.exp(-(tau**2) / 4))],
    ids=["first order", "smooth"],
)
def test_noise_has_the_autocorrelation_it_is_named_for(noise, autocorrelation):
    P = solve_continuous_lyapunov(noise.A, -noise.drive)
    for tau in (0.0, 0.5, 1.0, 2.0, 4.0):
        assert noise.C @ expm(noise.A * tau) @ P @ noise.C == pytest.approx(autocorrelation(tau), abs=2e-3)


def test_the_filter_settles_where_the_riccati_equation_says():
    rng = np.random.default_rng(0)
    F = np.stack([np.diag([1.02, 0.9, 0.5]) + 0.1 * rng.standard_normal((3, 3)) for _ in range(4)])
    root = rng.standard_normal((4, 3, 3))
    process, noise = root @ np.swapaxes(root, 1, 2), rng.uniform(0.1, 2.0, 4)
    C = np.eye(3)[:1]
    for own, *of in zip(_steady_covariance(F, process, noise), F, process, noise, strict=True):
        np.testing.assert_allclose(own, solve_discrete_are(of[0].T, C.T, of[1], of[2] * np.eye(1)), rtol=1e-7)


@pytest.mark.parametrize("wind", WINDS, ids=len)
def test_innovations_of_its_own_model_are_white_and_of_the_variance_it_says(wind):
    view, rng, samples = _Parameters(1, wind), np.random.default_rng(3), 4000
    theta = view.prior[0].copy()
    theta[:2] = 3.0, 1.5
    transition, _, _ = view.filters(theta[None], DT)
    n = transition.state.shape[-1]
    # The states' covariance over a step, from many fine ones.
    A, drive = np.zeros((n, n)), np.zeros((n, n))
    A[0, 0], A[0, 1], A[1, 1], start = -theta[1], 1.0, -np.exp(-theta[2]), 2
    for each, log_size, log_time in zip(wind, theta[4:-2:2], theta[5:-2:2], strict=True):
        of = slice(start, start + len(each.A))
        A[of, of], drive[of, of] = each.A / np.exp(log_time), each.drive / np.exp(log_time)
        A[0, of] = each.C * np.exp(log_size)
        start = of.stop
    stationary = solve_continuous_lyapunov(A, -drive)
    process = stationary - transition.state[0] @ stationary @ transition.state[0].T
    values, vectors = np.linalg.eigh(process)
    # The symmetric root: the signs of single eigenvectors differ between processors, and the noise with them.
    root = vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T
    inputs = rng.standard_normal((samples, 1))
    before, after = delayed(inputs, theta[3] / DT)
    state, rates = np.zeros(n), np.zeros(samples)
    for k in range(samples - 1):
        known = transition.input_now[0] @ before[k] + transition.input_next[0] @ after[k]
        state = transition.state[0] @ state + known + root @ rng.standard_normal(n)
        rates[k + 1] = state[0]
    measured = rates + np.exp(theta[-2]) * rng.standard_normal(samples)
    errors, variance = view.innovations(theta[None], _Data(((inputs, measured),), DT))
    number = errors.shape[1]
    assert errors[0].var() / variance[0] == pytest.approx(1.0, abs=4 * np.sqrt(2 / number))
    for lag in (1, 2, 5, 20):
        assert abs(np.mean(errors[0, lag:] * errors[0, :-lag])) / variance[0] < 4 / np.sqrt(number)


@pytest.mark.parametrize("steps", [-0.4, 0.0, 0.3, 1.0, 1.7, 3.2])
def test_no_command_helps_to_predict_the_sample_that_it_answers(steps):
    inputs = np.arange(20.0)[:, None]
    before, after = delayed(inputs, steps)
    now = np.arange(19)
    assert np.all(before[:, 0] <= now)
    assert np.all(after[:, 0] <= now)
    np.testing.assert_allclose(after[5:, 0], np.minimum(now + 1 - steps, now)[5:])


@pytest.mark.slow
def test_intervals_hold_the_truth_in_closed_loop_without_what_a_linear_model_does_not_know():
    deviations = []
    for seed in range(16):
        flight = flown(seed, steering=1.0)
        inputs, rate = flight.inputs - flight.inputs.mean(axis=0), flight.outputs[:, 1] - flight.outputs[:, 1].mean()
        _, best = _fitted(_Parameters(4, WINDS[0]), _Data(((inputs, rate),), DT))
        covariance = np.linalg.inv(best.curvature)
        true = np.append(MOTORS, DAMPING)
        deviations.append((best.at[:5] - true) / np.sqrt(np.diag(covariance)[:5]))
    # 80 numbers of about unit variance: their mean square lies below this in 99.9 % of cases.
    assert np.mean(np.square(deviations)) < 1.6


def test_motors_come_out_with_their_signs_where_the_flight_steers():
    reading = physical(flown(0, steering=1.0))
    assert reading.identifiable
    assert reading.caution is None
    half, of_damping, of_lag = reading.interval(0.99)
    assert np.all(np.abs(reading.motors - MOTORS) < half)
    assert abs(reading.damping - DAMPING) < of_damping
    assert abs(reading.lag - LAG) < of_lag


def test_nothing_is_identifiable_where_motors_only_react_to_the_wind():
    reading = physical(flown(0, steering=0.0, wind=3.0))
    assert reading.wind_share > MAX_WIND_SHARE
    assert np.isnan(np.append(*reading.interval()[:2])).all()
    assert "not identifiable" in str(reading.caution)


def test_gaps_are_not_filtered_across():
    flight = flown(1, steering=1.0)
    whole, apart = physical(flight), physical([flight[:350], flight[350:]])
    np.testing.assert_allclose(apart.motors @ MOTORS, whole.motors @ MOTORS, rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "told"), [("iris_multisine", True), ("iris_doublets", True), ("iris_gusts", False)])
def test_simulated_flights_are_identifiable_where_they_steer_and_then_truly(name, told):
    for seed in range(2):
        flight, motors, lag = scenario(name, seed)
        reading = physical(flight)
        assert reading.identifiable == told
        if told:
            way = motors / np.linalg.norm(motors)
            sd = np.sqrt(way @ reading.covariance[:4, :4] @ way)
            assert abs(reading.motors @ way - np.linalg.norm(motors)) < 3 * sd
            assert abs(reading.lag - lag) < 3 * np.sqrt(reading.covariance[-1, -1])


def test_what_cannot_be_read_is_said():
    flight = flown(0, steering=1.0)
    with pytest.raises(ValueError, match="derivative of another"):
        physical(Flight(flight.time, flight.inputs, flight.outputs[:, 1:]))
    with pytest.raises(ValueError, match="all inputs are constant"):
        physical(Flight(flight.time, 0 * flight.inputs, flight.outputs))
    with pytest.raises(ValueError, match="at least 200 samples"):
        physical(flight[:150])
    with pytest.raises(ValueError, match="level"):
        physical(flight).interval(1.5)
