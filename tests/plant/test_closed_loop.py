"""Identification in closed loop: spectra of simulated loops, derivatives by differences, and identified plants."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx, mark, raises
from scipy.signal import cont2discrete, lfilter

from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.plant.closed_loop.identification import (
    IdentifiedAxis,
    _mixture_of_modes,
    identify_axis,
    with_quicker_pole_as_lag,
)
from mavdem.plant.closed_loop.likelihood import AxisPosterior
from mavdem.plant.closed_loop.parameters import (
    PARAMETER_NAMES,
    PLANT,
    PRIOR_MEAN,
    PRIOR_SD,
    STEP_TIME,
)
from mavdem.plant.closed_loop.response import KnownController
from mavdem.plant.closed_loop.spectra import (
    SPECTRUM_SECONDS,
    Messages,
    cross_spectra,
    with_unrounded_stamps,
)

CYCLE = 0.0025
SECONDS = 90.0
EFFECT, DAMPING, LAG = 150.0, 1.0, 0.03
DELAY_CYCLES = 2
"""Cycles from the gyro's sample to the output that acts on the motors."""
P, D, ANGLE_GAIN = 0.1, 0.002, 5.0
GYRO_NOISE, ANGLE_NOISE = 0.005, 2e-4


class SimulatedLoop(NamedTuple):
    """Signals of a linear rate loop, one value per cycle."""

    rate: np.ndarray
    output: np.ndarray
    setpoint: np.ndarray
    pilot_command: np.ndarray


@cache
def simulated_loop(
    seed, command_size=1.0, hold_unit=1, turbulence=((0.5, 2.0),), gyro_noise=GYRO_NOISE
):
    """Simulates a closed loop in turbulence, whose pilot commands random steps of the rate.

    Steps last a multiple of ``hold_unit`` cycles. Turbulence is a sum of first-order noises, each with its correlation
    time, s, and standard deviation, rad/s².
    """
    rng = default_rng(seed)
    count = round(SECONDS / CYCLE)
    # States are angle, rate and torque; inputs are the output of the controller and the wind torque.
    A = np.array([[0, 1, 0], [0, -DAMPING, 1], [0, 0, -1 / LAG]])
    B = np.array([[0, 0], [0, 1], [EFFECT / LAG, 0]])
    A, B, *_ = cont2discrete((A, B, A, B), CYCLE)
    hold_cycles = hold_unit * rng.integers(40 // hold_unit, 200 // hold_unit, count // 40)
    steps = rng.normal(0, 1, len(hold_cycles))
    pilot_command = command_size * np.repeat(steps, hold_cycles)[:count]
    wind = sum(
        lfilter([(2 * CYCLE / time) ** 0.5], [1, CYCLE / time - 1], rng.normal(0, size, count))
        for time, size in turbulence
    )
    rate_errors, angle_errors = rng.normal(0, [[gyro_noise], [ANGLE_NOISE]], (2, count))
    state = np.zeros(3)
    outputs = [0.0] * DELAY_CYCLES
    previous_rate = 0.0
    signals = np.empty((count, 3))
    for k in range(count):
        rate = state[1] + rate_errors[k]
        setpoint = pilot_command[k] - ANGLE_GAIN * (state[0] + angle_errors[k])
        output = P * (setpoint - rate) - D * (rate - previous_rate) / CYCLE
        previous_rate = rate
        outputs.append(output)
        signals[k] = rate, output, setpoint
        # The output of ``DELAY_CYCLES`` before acts now.
        state = A @ state + B @ [outputs[k], wind[k]]
    return SimulatedLoop(*signals.T, pilot_command)


def feedback_response(frequency):
    """The response of the simulated controller's output to the rate, with its sign reversed."""
    return P + D * (1 - np.exp(-2j * np.pi * frequency * CYCLE)) / CYCLE


KNOWN = KnownController(
    lambda f: (np.full(np.shape(f), P, complex), feedback_response(f)),
    lambda f: np.ones(np.shape(f), complex),
    ANGLE_GAIN,
    CYCLE,
)
STAMPS = 7.0 + CYCLE * np.arange(round(SECONDS / CYCLE))
STARTS = np.arange(STAMPS[0], STAMPS[-1] - SPECTRUM_SECONDS, SPECTRUM_SECONDS / 2)


def sent(values, every=1, first=0, late=0):
    """Messages of every ``every``-th value from ``first`` on; each second one is sent ``late`` cycles later."""
    cycles = np.arange(first, len(STAMPS) - late, every)
    cycles[1::2] += late
    return Messages(STAMPS[cycles], values[cycles])


def posterior(loop, *sending):
    """The posterior of the loop's parameters by messages of its signals, sent as :func:`sent` says."""
    spectra = cross_spectra([sent(signal, *sending) for signal in loop], STARTS)
    return AxisPosterior(spectra, KNOWN, 0.0)


TRUE = {
    "effect": np.log(EFFECT),
    "damping": np.log(DAMPING),
    "lag": np.log(LAG),
    # The output is held for a cycle, which adds half a cycle to the delay.
    "delay": np.log((DELAY_CYCLES + 0.5) * CYCLE),
}
TRUE_THETA = np.append(list(TRUE.values()), PRIOR_MEAN[len(TRUE) :])


@mark.slow
@mark.parametrize("sending", [(), (4,), (4, 0, 1)])
def test_the_parameters_of_a_simulated_plant_are_identified(sending):
    """Errors are within three standard deviations and a small bias."""
    identified = identify_axis(posterior(simulated_loop(3), *sending))
    max_bias = [0.03, 0.3, 0.05, 0.05]
    max_errors = 3 * np.sqrt(identified.covariance.diagonal())[: len(TRUE)] + max_bias
    assert (abs(identified.theta - TRUE_THETA)[: len(TRUE)] <= max_errors).all()
    assert identified.posterior.reference_share(identified.theta) > 0.5


@mark.slow
@mark.parametrize("hold_unit, every", [(1, 16), (4, 4)])
def test_the_sum_of_lag_and_delay_is_identified_at_25_hz_and_with_synchronous_steps(
    hold_unit, every
):
    """Each alone is hardly identifiable there: an earlier step and a slower motor have similar effects."""
    loop = simulated_loop(3, hold_unit=hold_unit)
    effect, _, lag, delay, *_ = np.exp(identify_axis(posterior(loop, every)).theta)
    assert lag + delay == approx(LAG + (DELAY_CYCLES + 0.5) * CYCLE, rel=0.25)
    assert effect == approx(EFFECT, rel=0.2)


@mark.slow
def test_fast_eddies_in_turbulence_do_not_bias_the_lag():
    """With a single correlation time of the wind the identified lag was a quarter too short."""
    loop = simulated_loop(3, command_size=0.3, turbulence=((2.0, 6.0), (0.03, 6.0)))
    assert identify_axis(posterior(loop)).theta[2] == approx(TRUE["lag"], abs=0.1)


@mark.slow
@mark.parametrize("gyro_noise, every", [(GYRO_NOISE, 4), (GYRO_NOISE / 5, 1)])
def test_modelled_densities_agree_with_measured_ones(gyro_noise, every):
    """The mean ratio of both is 1 for rate and output, also with a quiet gyro."""
    identified = identify_axis(posterior(simulated_loop(3, gyro_noise=gyro_noise), every))
    modelled = identified.posterior.densities.density(identified.theta)
    measured = identified.posterior.spectra.mean_density
    for quantity in (0, 1):
        ratio = measured[:, quantity, quantity] / modelled[:, quantity, quantity]
        assert np.mean(ratio.real) == approx(1.0, abs=0.1)


@mark.slow
@mark.parametrize("late", [0, 2])
def test_the_gradient_of_the_log_posterior_agrees_with_differences(late):
    """Also for setpoints that are logged in another cycle than rate and output."""
    first_cycles = 0, 0, late, late
    signals = zip(simulated_loop(3), first_cycles, strict=True)
    streams = [sent(signal, every=4, first=first) for signal, first in signals]
    log_posterior = AxisPosterior(cross_spectra(streams, STARTS), KNOWN, 0.0)
    expansion = log_posterior.expand(TRUE_THETA)
    for k, name in enumerate(PARAMETER_NAMES):
        step = np.eye(len(PARAMETER_NAMES))[k] * 1e-4 * PRIOR_SD[k]
        value_difference = log_posterior.value(TRUE_THETA + step) - log_posterior.value(
            TRUE_THETA - step
        )
        slope = value_difference / (2 * step[k])
        tolerance = 1e-3 * np.sqrt(expansion.curvature[k, k])
        assert expansion.gradient[k] == approx(slope, rel=1e-3, abs=tolerance), name


@mark.slow
def test_without_commands_the_reference_causes_no_motion():
    hover = posterior(simulated_loop(4, command_size=1e-6), 4)
    assert hover.reference_share(TRUE_THETA) < 0.05


def test_spectra_of_streams_with_several_rates_have_the_slowest_rate():
    loop = simulated_loop(3)
    spectra = cross_spectra([sent(loop.rate, every=4), sent(loop.output, every=10)], STARTS)
    assert spectra.message_rate == approx(40.0, rel=1e-3)
    assert spectra.frequency[-1] < 20.0
    assert abs(np.array(spectra.stamp_offsets)).max() < 4 * CYCLE


def test_lost_messages_hardly_change_the_spectra():
    complete = sent(simulated_loop(3).rate, every=4)
    is_received = default_rng(1).random(len(complete.time)) > 0.2
    received = Messages(complete.time[is_received], complete.values[is_received])
    density_with_losses = cross_spectra([received], STARTS).mean_density[:10]
    density = cross_spectra([complete], STARTS).mean_density[:10]
    assert np.log(density_with_losses / density).real == approx(0.0, abs=0.3)


@dataclass(frozen=True)
class PosteriorStandIn:
    """Stands for an ``AxisPosterior`` of which no value is asked for."""

    prior_sd: np.ndarray | None = None
    saturated_share: float = 0.0


def test_modes_are_weighted_by_their_evidence_and_each_counts_once():
    """Two modes have the same curvature, and the second is three times as probable. It is reached by two ascents."""
    size = len(PRIOR_MEAN)
    axis = PosteriorStandIn(prior_sd=np.ones(size))
    first = PRIOR_MEAN.copy()
    first[STEP_TIME] -= 2.0
    second = PRIOR_MEAN.copy()
    second[STEP_TIME] += 2.0
    second[0] += 1.0
    log_ratio = np.log(3)
    ends = [(first, 5.0), (second, 5.0 + log_ratio), (second + 1e-3, 4.9 + log_ratio)]
    curvature = 4 * np.eye(size)
    expansions = [
        QuadraticExpansion(point, value, np.zeros(size), curvature) for point, value in ends
    ]
    mixture = _mixture_of_modes(axis, expansions)
    # The weights are 1/4 and 3/4.
    assert mixture.theta[[0, STEP_TIME]] == approx([PRIOR_MEAN[0] + 0.75, 1.0])
    variance = 0.6 / 4 + 0.4 / 16 + 3 / 16
    assert mixture.covariance[0, [0, STEP_TIME]] == approx([variance, 4 * 3 / 16])
    with raises(np.linalg.LinAlgError):
        _mixture_of_modes(axis, [QuadraticExpansion(PRIOR_MEAN, -np.inf, PRIOR_MEAN, np.eye(size))])


@dataclass(frozen=True)
class DensitiesStandIn:
    """Stands for a ``DensityModel`` of messages that come less often than the controller runs."""

    surplus_interval: float = 0.01


@dataclass(frozen=True)
class ControllerStandIn:
    """Stands for a ``KnownController`` of gain 1."""

    def transfer(self, frequency):
        return np.ones(1), np.ones(1)


@dataclass(frozen=True)
class PosteriorOfTwoStepTimes:
    """Stands for an ``AxisPosterior`` with two narrow modes in the time of steps: near 0, and a higher one near 1.6.

    An ascent that begins elsewhere ends on a plain far below both.
    """

    prior_sd: np.ndarray
    densities: DensitiesStandIn = DensitiesStandIn()
    controller: ControllerStandIn = ControllerStandIn()

    @property
    def prior_mean(self):
        return PRIOR_MEAN

    def value(self, theta):
        return self.expand(theta).value

    def expand(self, theta):
        precision = PRIOR_SD**-2.0
        precision[STEP_TIME] = 400.0
        mode = PRIOR_MEAN.copy()
        mode[STEP_TIME], height = theta[STEP_TIME], -100.0
        for step_time, peak in ((0.0, 0.0), (1.6, 8.0)):
            if abs(theta[STEP_TIME] - step_time) < 0.5:
                mode[STEP_TIME], height = step_time, peak
        gradient = precision * (mode - theta)
        value = height + gradient @ (theta - mode) / 2
        return QuadraticExpansion(theta, value, gradient, np.diag(precision))


def test_a_higher_mode_between_the_first_step_times_is_found():
    identified = identify_axis(PosteriorOfTwoStepTimes(PRIOR_SD))
    assert identified.main_mode[STEP_TIME] == approx(1.6, abs=0.01)


def test_the_faster_of_both_poles_is_assigned_to_the_motor_lag():
    def response(theta):
        effect, damping, lag, _ = np.exp(theta[list(PLANT)])
        return effect / (lag * s + 1) / (s + damping)

    s = 2j * np.pi * np.geomspace(0.1, 100, 20)
    theta = PRIOR_MEAN.copy()
    theta[list(PLANT)] = np.log([3e5, 1650.0, 0.4, 0.001])
    assert response(with_quicker_pole_as_lag(theta)) == approx(response(theta))
    _, damping, lag, _ = np.exp(with_quicker_pole_as_lag(theta)[list(PLANT)])
    assert (damping, lag) == approx((2.5, 1 / 1650))
    assert np.array_equal(
        with_quicker_pole_as_lag(with_quicker_pole_as_lag(theta)), with_quicker_pole_as_lag(theta)
    )


def identified_with_gain(gain, saturated_share, main_mode_gain=None):
    """An identified axis whose controller has the gain relative to its parameters, as mean and in the highest mode."""
    gain_of_theta = np.eye(len(PARAMETER_NAMES))[PARAMETER_NAMES.index("controller")]
    theta = PRIOR_MEAN + np.log(gain) * gain_of_theta
    main_mode = PRIOR_MEAN + np.log(main_mode_gain or gain) * gain_of_theta
    posterior = PosteriorStandIn(saturated_share=saturated_share)
    return IdentifiedAxis(posterior, theta, np.eye(len(theta)), main_mode)


def test_saturation_explains_a_lower_gain_of_the_controller():
    often_saturated = identified_with_gain(0.5, saturated_share=0.6)
    assert often_saturated.controller_consistent
    assert often_saturated.saturation_loss == approx(0.5)
    assert identified_with_gain(0.5, saturated_share=0.3).saturation_loss == 0.3
    assert not identified_with_gain(0.5, saturated_share=0.0).controller_consistent


def test_a_gain_near_1_needs_no_saturation():
    identified = identified_with_gain(0.9, saturated_share=0.0)
    assert identified.controller_consistent
    assert identified.saturation_loss == 0.0
    # Of several modes the highest must be consistent, too.
    other_mode = identified_with_gain(0.9, saturated_share=0.0, main_mode_gain=0.9 * 0.6)
    assert not other_mode.controller_consistent


def test_saturation_does_not_explain_a_higher_gain_of_the_controller():
    identified = identified_with_gain(2.0, saturated_share=0.9)
    assert not identified.controller_consistent
    assert identified.saturation_loss == 0.0


@mark.parametrize("rate", [80.0, 400.0])
def test_stamps_that_were_rounded_to_milliseconds_are_restored_though_some_are_lost(rate):
    sent_at = 7.0 + np.arange(2000) / rate
    arrived = default_rng(1).random(2000) > 0.1
    rounded = np.floor(1e3 * sent_at[arrived] + 1e-6) / 1e3
    restored = with_unrounded_stamps(Messages(rounded, rounded)).time
    # Rounding down makes all stamps earlier by 0.25 ms in the mean, which nothing shows.
    errors = restored - (sent_at[arrived] - 0.25e-3)
    assert abs(errors).max() < 0.15e-3
    assert errors.std() < 0.2 * (rounded - sent_at[arrived]).std()


def test_stamps_that_are_exact_or_late_are_kept():
    exact = 7.0 + np.arange(2000) / 80
    assert with_unrounded_stamps(Messages(exact, exact)).time is exact
    late = np.floor(1e3 * exact) / 1e3
    late[500] += 4e-3
    assert with_unrounded_stamps(Messages(late, late)).time[500] == late[500]
    # A sender with a cycle of 4 ms sends at 80 Hz after 12, 12 and 16 ms; one with a cycle of 2 ms after 12 and 14 ms.
    for cycle in (4, 2):
        cycles = cycle / 1e3 * np.ceil(12.5 * np.arange(2000) / cycle - 1e-9)
        assert_array_equal(with_unrounded_stamps(Messages(cycles, cycles)).time, cycles)
    uneven = np.floor(1e3 * np.sort(default_rng(1).uniform(0.0, 20.0, 2000))) / 1e3
    assert with_unrounded_stamps(Messages(uneven, uneven)).time is uneven
