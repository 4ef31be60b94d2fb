"""Wind torque of recorded and live flights: smoother and bands against exact ones, gusts, and simulated wind."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark
from simulated import MOTORS, in_closed_loop, simulated
from test_model import joint
from test_physical import TRUE

from mavdem.confidence import coverage_factor
from mavdem.dem.engine.kalman import LinearGaussianModel
from mavdem.dem.online.memory import SampleMemory
from mavdem.dem.record import Record
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPhysical, ParameterDoubt
from mavdem.plant import physical
from mavdem.plant.gusts import detect_gusts
from mavdem.plant.identifiability import OmissionErrors
from mavdem.plant.online_wind_torque import (
    DELAY_SECONDS,
    FILTER_SECONDS,
    OnlineWindTorque,
    fit_wind_torque_smoother,
)
from mavdem.plant.parameters import Physical, combined_with_earlier_flight
from mavdem.plant.sampled_plant import (
    FIRST_ORDER,
    WindComponent,
    delayed_inputs,
    gaussian_kernel_noise,
    sampled_plant,
)
from mavdem.plant.wind_torque import _sharp_step, estimate_wind_torque
from sitl_scenarios.turbulence import gaussian_noise

DT = 0.01
TURBULENCE = ((FIRST_ORDER, 1.5, 0.3), (gaussian_kernel_noise(8), 0.7, 0.06))


@mark.slow
@mark.parametrize("damping", [-0.5, 2.0])
@mark.parametrize(
    "components", [TURBULENCE[:1], TURBULENCE, (TURBULENCE[1], TURBULENCE[1])], ids="123"
)
def test_the_smoother_is_the_posterior_of_the_joint_gaussian(components, damping):
    rng = default_rng(0)
    commands = rng.standard_normal(90)
    rate = 0.2 * rng.standard_normal(90)
    noise = 0.02
    plant = sampled_plant(damping, 0.05, components, 0.02)
    rate_filter = plant.rate_filter(noise)
    smoothed = plant.smooth_wind_torque(rate_filter, commands, 0.7, rate)
    smoothed_variance = rate_filter.smoothed_variance(len(rate), plant.wind_output)
    early, late = delayed_inputs(commands[:, None], 0.7)
    input_matrix = np.column_stack([plant.transition.Gamma0[:, 0], plant.transition.Gamma1[:, 0]])
    n = len(plant.wind_output)
    measures_rate = np.eye(1, n)
    no_effect = np.zeros(n)
    model = LinearGaussianModel(
        plant.transition.Phi,
        input_matrix,
        no_effect,
        measures_rate,
        np.zeros(1),
        plant.Q,
        np.array([[noise**2]]),
    )
    initial_state = no_effect.copy()
    initial_state[:2] = rate[0], commands[0]
    inputs = np.append(np.column_stack([early, late]), [[0.0, 0.0]], axis=0)[:90]
    steady = plant.rate_filter(noise).P
    means, covariances, _ = joint(model, initial_state, inputs, rate[:, None], steady)
    mean = means @ plant.wind_output
    variance = np.einsum("i,titj,j->t", plant.wind_output, covariances, plant.wind_output)
    assert_allclose(smoothed.mean, mean, atol=1e-8 * abs(mean).max())
    assert_allclose(smoothed_variance, variance, atol=1e-8 * variance.max())


@mark.slow
def test_a_steady_difference_of_motors_balances_wind_and_their_mean_is_no_torque():
    flight = in_closed_loop(2, steering=0.0, samples=1500)

    def torque(input_shift, plant):
        shifted_flight = replace(flight, inputs=flight.inputs + input_shift)
        return estimate_wind_torque(plant, Record.from_flights(shifted_flight)).torque

    torque_change = torque(20 * np.sign(MOTORS), TRUE) - torque(np.zeros(4), TRUE)
    assert_allclose(torque_change, -20 * abs(MOTORS).sum(), atol=1e-6)
    uneven_plant = TRUE._replace(effect=MOTORS * [1.1, 1.0, 1.0, 1.0])
    assert_allclose(
        torque(np.zeros(4), uneven_plant), torque(np.full(4, 137.0), uneven_plant), atol=1e-6
    )


def test_the_bands_include_the_uncertainty_of_the_motors_effect():
    """The band of the mean includes it, too: motors that differ steadily balance a steady wind."""
    flight = in_closed_loop(4, steering=0.0, samples=1500)
    record = Record.from_flights(replace(flight, inputs=flight.inputs + 12 * np.sign(MOTORS)))
    uncertain = TRUE._replace(covariance=np.zeros((7, 7)))
    uncertain.covariance[:4, :4] = 0.2**2 * np.outer(MOTORS, MOTORS)
    by_exact_plant = estimate_wind_torque(TRUE, record)
    by_uncertain_plant = estimate_wind_torque(uncertain, record)
    half_width_of_mean = 1.645 * 0.2 * abs(by_exact_plant.mean)
    assert by_uncertain_plant.mean_band == approx(half_width_of_mean, rel=0.05)
    assert np.all(by_uncertain_plant.band >= by_exact_plant.band)


def test_wind_weaker_than_the_errors_is_not_resolved():
    flight = in_closed_loop(6, steering=0.0, samples=2000, wind=0.02)
    plant = TRUE._replace(components=(WindComponent(FIRST_ORDER, 0.02, 0.02),))
    torque = estimate_wind_torque(plant, Record.from_flights(flight))
    assert not torque.resolved
    assert torque.reason.code is NoPhysical.WIND_TORQUE_NOT_RESOLVED
    assert torque.gusts == ()


def turbulence(seed, samples):
    return gaussian_noise(0.05, DT, samples, default_rng(seed))


def record_of(samples):
    return Record(np.zeros((samples, 1)), np.zeros((samples, 2)), DT, (samples,))


@mark.slow
def test_the_rate_of_false_gusts_in_turbulence_is_the_stated_one():
    samples = 600_000
    no_band = np.zeros(samples)
    detection = detect_gusts(turbulence(0, samples), no_band, record_of(samples))
    expected_count = detection.false_per_minute * samples * DT / 60
    assert 5 < expected_count < 100
    # A count with that mean is within these bounds in more than 99.9 % of cases.
    assert abs(len(detection.gusts) - expected_count) < 3.5 * np.sqrt(expected_count)


def test_a_gust_in_turbulence_is_detected_with_its_start_length_and_size():
    torque = turbulence(1, 6000)
    torque[3000:3080] += 8.0 * np.sin(np.pi * np.arange(80) / 80)
    gusts = detect_gusts(torque, np.zeros(6000), record_of(6000)).gusts
    (gust,) = [gust for gust in gusts if 29.0 < gust.start < 32.0]
    assert gust.start == approx(30.2, abs=0.2)
    assert gust.start == gust.sample * DT
    assert gust.length == approx(0.6, abs=0.25)
    assert gust.size == approx(8.0, abs=2.0)
    # No gust exceeds a wide band of uncertainty.
    assert detect_gusts(torque, np.full(6000, 10.0), record_of(6000)).gusts == ()


def test_a_gust_lasts_as_long_as_the_estimate_resolves_and_returns_to_its_level():
    torque = turbulence(3, 6000)
    torque[3000:3003] += 12.0  # 30 ms
    torque[4000:] += 20.0  # a step stays
    (short,) = detect_gusts(torque, np.zeros(6000), record_of(6000)).gusts
    assert short.start == approx(30.0, abs=0.2)
    assert detect_gusts(torque, np.zeros(6000), record_of(6000), min_duration=0.05).gusts == ()


@mark.slow
def test_a_lasting_step_of_the_motors_is_no_wind():
    """From 30 s on the motors balance the torque of a weak one: it is no gust, and adds nothing to the wind's size."""
    flight = in_closed_loop(5, steering=0.0, samples=6000, wind=0.5)
    plant = TRUE._replace(components=(WindComponent(FIRST_ORDER, 0.5, 0.5),))
    inputs = flight.inputs + np.outer(np.arange(6000) >= 3000, 20 * np.sign(MOTORS))
    record = Record(inputs, flight.outputs, DT, (6000,), begins=(7.0,))
    with_detected_step = estimate_wind_torque(plant, record)
    with_given_step = estimate_wind_torque(plant, record, [3000])
    for torque in (with_detected_step, with_given_step):
        assert torque.sd == approx(0.5, rel=0.2)
        assert not [gust for gust in torque.gusts if 28.0 < gust.start < 32.0]
    sample, size = with_detected_step.step
    assert sample == approx(3000, abs=50)
    assert size == approx(-20 * abs(MOTORS).sum(), rel=0.1)
    assert with_given_step.step is None
    assert estimate_wind_torque(plant, Record.from_flights(flight)).step is None


@mark.slow
def test_the_torque_of_a_weak_motor_is_no_wind():
    """Its loss and its recovery, 20 s later, are no gusts, and the strength of the wind is that of the rest."""
    flight = in_closed_loop(5, steering=0.0, samples=6000, wind=0.5)
    plant = TRUE._replace(components=(WindComponent(FIRST_ORDER, 0.5, 0.5),))
    sample = np.arange(6000)
    is_weak = (sample >= 2000) & (sample < 4000)
    inputs = flight.inputs + np.outer(is_weak, 20 * np.sign(MOTORS))
    record = Record(inputs, flight.outputs, DT, (6000,), begins=(7.0,))
    is_left_out = (sample >= 1900) & (sample <= 4100)
    torque = estimate_wind_torque(plant, record, [2000], is_left_out)
    assert_array_equal(np.isnan(torque.torque), is_left_out)
    assert torque.left_out == approx(22.0, abs=0.05)
    assert torque.sd == approx(0.5, rel=0.25)
    assert not [gust for gust in torque.gusts if 18.0 < gust.start < 42.0 or abs(gust.size) > 5.0]
    assert np.isfinite(torque.spectrum.density).all()
    assert torque.resolved


def test_no_wind_torque_is_resolved_of_a_weak_motor_throughout_or_a_short_flight():
    flight = in_closed_loop(5, steering=0.0, samples=6000, wind=0.5)
    record = Record.from_flights(flight)
    weak_throughout = estimate_wind_torque(TRUE, record, [], np.ones(6000, bool))
    assert weak_throughout.reason.code is NoPhysical.MOTOR_WEAK_THROUGHOUT
    assert not weak_throughout.resolved
    short = estimate_wind_torque(TRUE, Record.from_flights(flight[:700]))
    assert short.reason.code is NoPhysical.WIND_TORQUE_TOO_SHORT
    assert not short.resolved


@mark.parametrize("seconds, is_step", [(1.6, True), (2.4, False)])
def test_only_a_fast_change_of_the_torque_is_a_step(seconds, is_step):
    rise = np.clip(DT * np.arange(-3000, 3000) / seconds, -0.5, 0.5)
    if is_step:
        assert _sharp_step(rise, DT) is not None
    else:
        assert _sharp_step(rise, DT) is None


WINDY = simulated(samples=3000, wind=2.0, lag=0.05)
CALM = simulated(samples=1500, wind=0.3)
DELAY_SAMPLES = round(DELAY_SECONDS / WINDY.dt)
BLOCK_SAMPLES = 10
FIRST_ESTIMATE = BLOCK_SAMPLES * -(
    round((FILTER_SECONDS + DELAY_SECONDS) / WINDY.dt) // -BLOCK_SAMPLES
)


def online_wind(executor=None, prior=None):
    memory = SampleMemory(WINDY.dt, BLOCK_SAMPLES, 200)
    return OnlineWindTorque(memory, executor, prior), memory


def updates_of_flight(online, memory, flight, weak_since=None):
    """(T, 2) torque and band of each update; from ``weak_since``, s, on a motor is weak, which is known 2 s later."""
    estimates = np.empty((len(flight), 2))
    for k, (time, inputs, outputs) in enumerate(
        zip(flight.time, flight.inputs, flight.outputs, strict=True)
    ):
        has_completed_block = memory.add(inputs, outputs, time)
        is_known = weak_since is not None and time >= weak_since + 2
        estimates[k] = online.update(inputs, weak_since if is_known else None)
        if has_completed_block:
            online.add(memory.blocks[-1])
    return estimates


def as_identified(smoother):
    """The same smoother, whose parameters count as identified."""
    status = dict.fromkeys(smoother.physical.status, Status.REPORTED)
    return smoother._replace(physical=smoother.physical._replace(status=status))


@mark.slow
def test_the_live_torque_is_nearly_the_smoothed_torque_of_the_whole_flight():
    online, memory = online_wind()
    smoother = fit_wind_torque_smoother(Record.from_flights(WINDY))
    assert smoother.physical.status["effect"] == Status.NOT_IDENTIFIABLE
    online.smoother = as_identified(smoother)
    # No further fit replaces this smoother.
    online._next_fit = len(WINDY) + 1
    live_torque = updates_of_flight(online, memory, WINDY)[:, 0]
    torque, band = smoother.torques(WINDY.inputs, WINDY.outputs).T
    error = live_torque[500:] - torque[500 - DELAY_SAMPLES : -DELAY_SAMPLES]
    assert np.std(error) < 0.1 * torque.std()
    # With an infinite expected variance no prediction error widens the band. The model predicts this flight well, so
    # that its errors widen the band by little.
    without_errors = smoother._replace(rate_filter=smoother.rate_filter._replace(F=np.inf))
    assert_allclose(band, without_errors.torques(WINDY.inputs, WINDY.outputs)[:, 1], rtol=0.5)


@mark.slow
def test_the_band_follows_from_the_derivative_of_the_torque_by_each_motor_s_effect():
    """It is compared with finite differences, also while motors turn the vehicle."""
    smoother = fit_wind_torque_smoother(Record.from_flights(CALM))
    turning = np.sin(2 * np.pi * 0.5 * CALM.time)
    inputs = CALM.inputs + np.outer(turning, [0.1, 0.1, -0.1, -0.1])

    def torques(effect, variance):
        covariance = np.zeros((7, 7))
        covariance[:4, :4] = np.diag(variance)
        physical = smoother.physical._replace(effect=effect, covariance=covariance)
        changed_smoother = smoother._replace(physical=physical)
        return changed_smoother.torques(inputs, CALM.outputs)[300:-DELAY_SAMPLES]

    effect = smoother.physical.effect
    torque, band = torques(effect, np.zeros(4)).T
    for step in 0.05 * abs(effect).max() * np.eye(4):
        # The variance of an effect adds the square of its derivative times the variance.
        _, wider_band = torques(effect, step**2).T
        change_by_derivative = np.sqrt(wider_band**2 - band**2) / coverage_factor()
        change = torques(effect + step, np.zeros(4))[:, 0] - torque
        assert_allclose(change_by_derivative, abs(change), atol=0.1 * abs(change).max())


def plant_of_flight(effect, damping, sd, status=Status.REPORTED):
    theta = np.array([effect, damping, 0.05, 0.02])
    covariance = np.diag(np.square(sd * theta)) + np.outer(theta, theta) * (sd / 2) ** 2
    statuses = dict.fromkeys(("effect", "damping", "lag"), status)
    reasons = dict.fromkeys(statuses)
    return Physical(theta[:1], *theta[1:], covariance, statuses, reasons, 0.0, 0.1, (), 0.01, {}, 1)


def test_an_earlier_flight_counts_by_its_precision():
    """The mean of two normal densities, where the effect may have changed from flight to flight."""
    earlier, now = plant_of_flight(-20.0, 2.0, 0.05), plant_of_flight(-22.0, 2.6, 0.1)
    updates = combined_with_earlier_flight(now, earlier)
    changed = earlier.covariance.copy()
    changed[0, 0] += (20.0 * OmissionErrors.between_flights) ** 2
    weights = np.linalg.inv([changed, now.covariance])
    thetas = [
        [*plant.effect, plant.damping, plant.lag, plant.delay] for plant in (earlier, now, updates)
    ]
    mean = np.linalg.solve(weights.sum(axis=0), np.einsum("nij,nj->i", weights, thetas[:2]))
    assert_allclose(thetas[2], mean)
    assert_allclose(updates.covariance, np.linalg.inv(weights.sum(axis=0)))
    different = plant_of_flight(-40.0, 2.6, 0.1)
    assert combined_with_earlier_flight(different, earlier) is different


@mark.slow
def test_in_calm_air_an_earlier_flight_gives_a_band_that_contains_zero_in_hover_and_manoeuvres():
    """There is no wind, so that the whole estimated torque is an error."""
    calm = in_closed_loop(1, steering=0.0, samples=900, wind=0.0)
    steering = in_closed_loop(2, steering=1.0, wind=0.0)
    assert np.isnan(updates_of_flight(*online_wind(), calm)).all()
    earlier_plant = physical(in_closed_loop(0, steering=1.0))
    statuses = dict.fromkeys(earlier_plant.status, "not identifiable")
    not_identifiable = earlier_plant._replace(status=statuses)
    assert combined_with_earlier_flight(earlier_plant, not_identifiable) is earlier_plant
    online, memory = online_wind(prior=earlier_plant)
    hover = updates_of_flight(online, memory, calm)[-90:]
    assert (
        online.smoother.physical.reasons["effect"].code is ParameterDoubt.KNOWN_FROM_EARLIER_FLIGHT
    )
    memory.end_segment()
    online.end_segment()
    doublets = updates_of_flight(online, memory, steering)[FIRST_ESTIMATE + 1 :]
    for torque, band in (hover.T, doublets.T):
        assert np.mean(abs(torque) <= band) > 0.85
        assert not detect_gusts(torque, band, record_of(len(torque))).gusts
    assert np.median(doublets[:, 1]) > 3 * np.median(hover[:, 1])


@mark.slow
def test_while_a_motor_is_weak_there_is_no_wind_torque_and_nothing_is_fitted():
    online, memory = online_wind()
    online.smoother = smoother = as_identified(fit_wind_torque_smoother(Record.from_flights(CALM)))
    online._next_fit = len(CALM) - 1
    weak_since = CALM.time[600]
    torque = updates_of_flight(online, memory, CALM, weak_since)[:, 0]
    known_sample = 600 + round(2 / CALM.dt)
    assert np.isfinite(torque[500:known_sample]).all()
    assert np.isnan(torque[known_sample:]).all()
    assert online.smoother is smoother
    assert all(block.end_time < weak_since for block in list(online._blocks)[:-1])


def test_without_a_fit_there_is_no_wind_torque():
    constant_motors = replace(WINDY, inputs=np.full_like(WINDY.inputs, 1500.0))
    online, memory = online_wind()
    assert np.isnan(updates_of_flight(online, memory, constant_motors)).all()
    assert online.smoother is None
    # An executor that was shut down fits nothing.
    with ThreadPoolExecutor(1) as executor:
        online, memory = online_wind(executor)
    assert np.isnan(updates_of_flight(online, memory, WINDY[:900])).all()
