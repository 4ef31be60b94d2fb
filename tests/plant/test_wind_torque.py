"""The wind's torque, offline and live: the smoother against a joint Gaussian, bands, gusts, simulated truth."""

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
    """The smoothed wind torque and its variance equal those of the joint Gaussian, also of an unstable plant."""
    rng = default_rng(0)
    commanded = rng.standard_normal(50)
    rate = 0.2 * rng.standard_normal(50)
    noise = 0.02
    plant = sampled_plant(damping, 0.05, components, 0.02)
    rate_filter = plant.rate_filter(noise)
    wind_torque = plant.smooth_wind_torque(rate_filter, commanded, 0.7, rate)
    found_variance = rate_filter.smoothed_variance(len(rate), plant.wind_output)
    early, late = delayed_inputs(commanded[:, None], 0.7)
    input_matrix = np.column_stack([plant.transition.Gamma0[:, 0], plant.transition.Gamma1[:, 0]])
    n = len(plant.wind_output)
    rate_output = np.eye(1, n)
    zero_state = np.zeros(n)
    model = LinearGaussianModel(
        plant.transition.Phi,
        input_matrix,
        zero_state,
        rate_output,
        np.zeros(1),
        plant.Q,
        np.array([[noise**2]]),
    )
    start = zero_state.copy()
    start[:2] = rate[0], commanded[0]
    inputs = np.append(np.column_stack([early, late]), [[0.0, 0.0]], axis=0)[:50]
    steady = plant.rate_filter(noise).P
    means, covariances, _ = joint(model, start, inputs, rate[:, None], steady)
    mean = means @ plant.wind_output
    variance = np.einsum("i,titj,j->t", plant.wind_output, covariances, plant.wind_output)
    assert_allclose(wind_torque.mean, mean, atol=1e-8 * abs(mean).max())
    assert_allclose(found_variance, variance, atol=1e-8 * variance.max())


@mark.slow
def test_a_steady_difference_of_motors_balances_wind_and_their_mean_is_no_torque():
    flight = in_closed_loop(2, steering=0.0, samples=1500)

    def torque(shift, true_plant):
        return estimate_wind_torque(
            true_plant, Record.from_flights(replace(flight, inputs=flight.inputs + shift))
        ).torque

    shift = torque(20 * np.sign(MOTORS), TRUE) - torque(np.zeros(4), TRUE)
    assert_allclose(shift, -20 * abs(MOTORS).sum(), atol=1e-6)
    uneven = TRUE._replace(effect=MOTORS * [1.1, 1.0, 1.0, 1.0])
    assert_allclose(torque(np.zeros(4), uneven), torque(np.full(4, 137.0), uneven), atol=1e-6)


@mark.slow
def test_the_uncertainty_of_the_motors_effect_is_in_the_bands():
    """Also in that of the mean: of motors that differ steadily, as against a steady wind."""
    flight = in_closed_loop(4, steering=0.0, samples=1500)
    record = Record.from_flights(replace(flight, inputs=flight.inputs + 12 * np.sign(MOTORS)))
    uncertain = TRUE._replace(covariance=np.zeros((7, 7)))
    uncertain.covariance[:4, :4] = 0.2**2 * np.outer(MOTORS, MOTORS)
    sure, unsure = (estimate_wind_torque(true_plant, record) for true_plant in (TRUE, uncertain))
    assert unsure.mean_band == approx(1.645 * 0.2 * abs(sure.mean), rel=0.05)
    assert np.all(unsure.band >= sure.band)


@mark.slow
def test_wind_weaker_than_the_errors_is_not_resolved():
    flight = in_closed_loop(6, steering=0.0, samples=2000, wind=0.02)
    wind_torque = estimate_wind_torque(
        TRUE._replace(components=(WindComponent(FIRST_ORDER, 0.02, 0.02),)),
        Record.from_flights(flight),
    )
    assert not wind_torque.resolved
    assert wind_torque.reason.code is NoPhysical.WIND_TORQUE_NOT_RESOLVED
    assert wind_torque.gusts == ()


def turbulent(seed, samples):
    return gaussian_noise(0.05, DT, samples, default_rng(seed))


def record_of(samples):
    return Record(np.zeros((samples, 1)), np.zeros((samples, 2)), DT, (samples,))


@mark.slow
def test_turbulence_alone_has_as_many_gusts_as_it_says():
    """In turbulence without gusts, as many are detected as the stated rate of false alarms."""
    samples = 600_000
    band = np.zeros(600_000)
    wind_torque = detect_gusts(turbulent(0, samples), band, record_of(samples))
    expected = wind_torque.false_per_minute * samples * DT / 60
    assert 5 < expected < 100
    # A count with that mean is within these bounds in more than 99.9 % of cases.
    assert abs(len(wind_torque.gusts) - expected) < 3.5 * np.sqrt(expected)


def test_a_gust_is_found_where_it_is_with_its_length_and_size():
    torque = turbulent(1, 6000)
    torque[3000:3080] += 8.0 * np.sin(np.pi * np.arange(80) / 80)
    wind_torque = detect_gusts(torque, np.zeros(6000), record_of(6000)).gusts
    (gust,) = [each for each in wind_torque if 29.0 < each.start < 32.0]
    assert gust.start == approx(30.2, abs=0.2)
    assert gust.start == gust.sample * DT
    assert gust.length == approx(0.6, abs=0.25)
    assert gust.size == approx(8.0, abs=2.0)
    assert detect_gusts(torque, np.full(6000, 10.0), record_of(6000)).gusts == ()


def test_a_gust_lasts_as_long_as_the_estimate_resolves_and_returns_to_its_level():
    torque = turbulent(3, 6000)
    torque[3000:3003] += 12.0  # 30 ms
    torque[4000:] += 20.0  # A lasting step.
    (short,) = detect_gusts(torque, np.zeros(6000), record_of(6000)).gusts
    assert short.start == approx(30.0, abs=0.2)
    assert detect_gusts(torque, np.zeros(6000), record_of(6000), min_duration=0.05).gusts == ()


@mark.slow
def test_a_motors_step_is_no_wind():
    """From 30 s on the motors hold against what a weak one lacks: neither a gust nor the size is by that."""
    flight = in_closed_loop(5, steering=0.0, samples=6000, wind=0.5)
    true_plant = TRUE._replace(components=(WindComponent(FIRST_ORDER, 0.5, 0.5),))
    inputs = flight.inputs + np.outer(np.arange(6000) >= 3000, 20 * np.sign(MOTORS))
    record = Record(inputs, flight.outputs, DT, (6000,), begins=(7.0,))
    for wind_torque in (
        estimate_wind_torque(true_plant, record),
        estimate_wind_torque(true_plant, record, [3000]),
    ):
        assert wind_torque.sd == approx(0.5, rel=0.2)
        assert not [gust for gust in wind_torque.gusts if 28.0 < gust.start < 32.0]
    sample, size = estimate_wind_torque(true_plant, record).step
    assert (sample, size) == (
        approx(3000, abs=50),
        approx(-20 * abs(MOTORS).sum(), rel=0.1),
    )
    assert (
        estimate_wind_torque(true_plant, record, [3000]).step is None
        and estimate_wind_torque(true_plant, Record.from_flights(flight)).step is None
    )


@mark.slow
def test_what_a_weak_motor_lacks_is_no_wind():
    """Its loss and its repair, 20 s later, are no gusts, and the strength of the wind is that of the other flight."""
    flight = in_closed_loop(5, steering=0.0, samples=6000, wind=0.5)
    true_plant = TRUE._replace(components=(WindComponent(FIRST_ORDER, 0.5, 0.5),))
    sample = np.arange(6000)
    is_weak = (sample >= 2000) & (sample < 4000)
    inputs = flight.inputs + np.outer(is_weak, 20 * np.sign(MOTORS))
    record = Record(inputs, flight.outputs, DT, (6000,), begins=(7.0,))
    is_left_out = (sample >= 1900) & (sample <= 4100)
    torque = estimate_wind_torque(true_plant, record, [2000], is_left_out)
    assert_array_equal(np.isnan(torque.torque), is_left_out)
    assert torque.left_out == approx(22.0, abs=0.05)
    assert torque.sd == approx(0.5, rel=0.25)
    assert not [gust for gust in torque.gusts if 18.0 < gust.start < 42.0 or abs(gust.size) > 5.0]
    assert np.isfinite(torque.spectrum.density).all() and torque.resolved
    all_weak = estimate_wind_torque(true_plant, record, [], np.ones(6000, bool))
    assert all_weak.reason.code is NoPhysical.MOTOR_WEAK_THROUGHOUT and not all_weak.resolved
    # No motor was weak in a flight that is too short.
    short = estimate_wind_torque(true_plant, Record(inputs[:700], flight.outputs[:700], DT, (700,)))
    assert short.reason.code is NoPhysical.WIND_TORQUE_TOO_SHORT and not short.resolved


@mark.parametrize("seconds, is_step", [(1.6, True), (2.4, False)])
def test_what_changes_slowly_is_no_step(seconds, is_step):
    rise = np.clip(DT * np.arange(-3000, 3000) / seconds, -0.5, 0.5)
    if is_step:
        assert _sharp_step(rise, DT) is not None
    else:
        assert _sharp_step(rise, DT) is None


WINDY = simulated(samples=3000, wind=2.0, lag=0.05)
CALM = simulated(samples=1500, wind=0.3)
LAG = round(DELAY_SECONDS / WINDY.dt)
BLOCK = 10
BEGINS = BLOCK * -(round((FILTER_SECONDS + DELAY_SECONDS) / WINDY.dt) // -BLOCK)


def online_wind(executor=None, prior=None):
    memory = SampleMemory(WINDY.dt, BLOCK, 200)
    return OnlineWindTorque(memory, executor, prior), memory


def followed(online, memory, flight, weak_since=None):
    """(T, 2) what each update returns; from ``weak_since``, s, on a motor is weak, which is known 2 s later."""
    wind_torque = np.empty((len(flight), 2))
    for k, (time, inputs, outputs) in enumerate(
        zip(flight.time, flight.inputs, flight.outputs, strict=True)
    ):
        closed = memory.add(inputs, outputs, time)
        is_known = weak_since is not None and time >= weak_since + 2
        wind_torque[k] = online.update(inputs, weak_since if is_known else None)
        if closed:
            online.add(memory.blocks[-1])
    return wind_torque


def identified(plant):
    """The same filter, whose parameters count as identified."""
    status = dict.fromkeys(plant.physical.status, Status.REPORTED)
    return plant._replace(physical=plant.physical._replace(status=status))


@mark.in_full
def test_it_is_nearly_the_smoother_s_of_the_whole_flight():
    online, memory = online_wind()
    online.smoother = plant = fit_wind_torque_smoother(Record.from_flights(WINDY))
    online._next_fit = len(WINDY) + 1
    assert plant.physical.status["effect"] == Status.NOT_IDENTIFIABLE
    online.smoother = identified(plant)
    live = followed(online, memory, WINDY)[:, 0]
    whole, band = plant.torques(WINDY.inputs, WINDY.outputs).T
    assert np.std(live[500:] - whole[500 - LAG : -LAG]) < 0.1 * whole.std()
    # Its latest samples are predicted as well as the others, so that they widen the band by little.
    usual = plant._replace(rate_filter=plant.rate_filter._replace(F=np.inf))
    assert_allclose(band, usual.torques(WINDY.inputs, WINDY.outputs)[:, 1], rtol=0.5)


@mark.slow
def test_its_band_has_the_slopes_by_each_motor_s_effect():
    """Against finite differences, also where the motors lift or turn the vehicle."""
    plant = fit_wind_torque_smoother(Record.from_flights(CALM))
    turning = np.sin(2 * np.pi * 0.5 * CALM.time)
    inputs = CALM.inputs + np.outer(turning, [0.1, 0.1, -0.1, -0.1])

    def torques(effect, variance):
        covariance = np.zeros((7, 7))
        covariance[:4, :4] = np.diag(variance)
        true_plant = plant.physical._replace(effect=effect, covariance=covariance)
        return plant._replace(physical=true_plant).torques(inputs, CALM.outputs)[300:-LAG]

    effect = plant.physical.effect
    sure = torques(effect, np.zeros(4))
    for step in 0.05 * abs(effect).max() * np.eye(4):
        by_slope = np.sqrt(np.diff(np.square([sure, torques(effect, step**2)])[..., 1], axis=0)[0])
        exact = torques(effect + step, np.zeros(4))[:, 0] - sure[:, 0]
        close = 0.1 * abs(exact).max()
        assert_allclose(by_slope / coverage_factor(), abs(exact), atol=close)


def vehicle(effect, damping, sd, status=Status.REPORTED):
    theta = np.array([effect, damping, 0.05, 0.02])
    covariance = np.diag(np.square(sd * theta)) + np.outer(theta, theta) * (sd / 2) ** 2
    statuses = dict.fromkeys(("effect", "damping", "lag"), status)
    reasons = dict.fromkeys(statuses)
    return Physical(theta[:1], *theta[1:], covariance, statuses, reasons, 0.0, 0.1, (), 0.01, {}, 1)


def test_an_earlier_flight_counts_by_its_precision():
    """The estimates of two flights are averaged by their precisions.

    The effect may have changed between the flights, which widens the earlier one.
    """
    earlier, now = vehicle(-20.0, 2.0, 0.05), vehicle(-22.0, 2.6, 0.1)
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
    different = vehicle(-40.0, 2.6, 0.1)
    assert combined_with_earlier_flight(different, earlier) is different


@mark.slow
def test_with_a_prior_the_torque_band_in_calm_hover_is_as_wide_as_steering_makes_it():
    """Without wind: what is drawn is error."""
    calm = in_closed_loop(1, steering=0.0, samples=900, wind=0.0)
    steering = in_closed_loop(2, steering=1.0, wind=0.0)
    assert np.isnan(followed(*online_wind(), calm)).all()
    true_plant = physical(in_closed_loop(0, steering=1.0))
    unknown = true_plant._replace(status=dict.fromkeys(true_plant.status, "not identifiable"))
    assert combined_with_earlier_flight(true_plant, unknown) is true_plant
    online, memory = online_wind(prior=true_plant)
    hover = followed(online, memory, calm)[-90:]
    assert (
        online.smoother.physical.reasons["effect"].code is ParameterDoubt.KNOWN_FROM_EARLIER_FLIGHT
    )
    memory.end_segment()
    online.end_segment()
    doublets = followed(online, memory, steering)[BEGINS + 1 :]
    for torque, band in (hover.T, doublets.T):
        assert (
            np.mean(abs(torque) <= band) > 0.85
            and not detect_gusts(torque, band, record_of(len(torque))).gusts
        )
    assert np.median(doublets[:, 1]) > 3 * np.median(hover[:, 1])


@mark.slow
def test_while_a_motor_is_weak_there_is_no_wind_torque_and_nothing_is_fitted():
    online, memory = online_wind()
    online.smoother = smoother = identified(fit_wind_torque_smoother(Record.from_flights(CALM)))
    online._next_fit = len(CALM) - 1
    weak_since = CALM.time[600]
    torque = followed(online, memory, CALM, weak_since)[:, 0]
    known_sample = 600 + round(2 / CALM.dt)
    assert np.isfinite(torque[500:known_sample]).all()
    assert np.isnan(torque[known_sample:]).all()
    assert online.smoother is smoother
    assert all(block.end_time < weak_since for block in list(online._blocks)[:-1])


def test_a_fit_that_fails_leaves_the_last_one():
    still = replace(WINDY, inputs=np.full_like(WINDY.inputs, 1500.0))
    online, memory = online_wind()
    assert np.isnan(followed(online, memory, still)).all()
    assert online.smoother is None
    with ThreadPoolExecutor(1) as executor:
        gone = online_wind(executor)
    assert np.isnan(followed(*gone, WINDY[:900])).all()
