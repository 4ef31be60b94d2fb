"""The closed loop: spectra against simulation at any rate, slopes against differences, plants given back."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, param, raises
from scipy.signal import cont2discrete, lfilter

from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.loops.identified_plant import physical_plant
from mavdem.plant.closed_loop import likelihood
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
from mavdem.plant.closed_loop.reference import with_reference_from_gyro
from mavdem.plant.closed_loop.response import KnownController, Quantity
from mavdem.plant.closed_loop.spectra import (
    SPECTRUM_SECONDS,
    Messages,
    cross_spectra,
    with_stamps_of_cycles,
    with_unrounded_stamps,
)

CYCLE = 0.0025
SECONDS = 90.0
# LATE: cycles from the rate to the output that acts.
EFFECT, DAMPING, LAG, LATE = 150.0, 1.0, 0.03, 2
P, D, ANGLE = 0.1, 0.002, 5.0
NOISE, ANGLE_NOISE = 0.005, 2e-4


class Flown(NamedTuple):
    """A linear loop, a value a cycle."""

    rate: np.ndarray
    output: np.ndarray
    setpoint: np.ndarray
    asked: np.ndarray


@cache
def fly(seed, steered=1.0, in_time=1, turbulence=((0.5, 2.0),), noise=NOISE):
    """Simulates rate, output, setpoint and command of a plant that follows steps in turbulence.

    Turbulence is given by correlation time, s, and size, rad/s².
    """
    rng = default_rng(seed)
    count = round(SECONDS / CYCLE)
    A = np.array([[0, 1, 0], [0, -DAMPING, 1], [0, 0, -1 / LAG]])
    B = np.array([[0, 0], [0, 1], [EFFECT / LAG, 0]])
    A, B, *_ = cont2discrete((A, B, A, B), CYCLE)
    holds = in_time * rng.integers(40 // in_time, 200 // in_time, count // 40)  # Numbers of cycles.
    asked = steered * np.repeat(rng.normal(0, 1, len(holds)), holds)[:count]
    wind = sum(
        lfilter([(2 * CYCLE / time) ** 0.5], [1, CYCLE / time - 1], rng.normal(0, size, count))
        for time, size in turbulence
    )
    gyro_noise, angle_noise = rng.normal(0, [[noise], [ANGLE_NOISE]], (2, count))
    state, delayed_outputs, before = np.zeros(3), [0.0] * LATE, 0.0
    rows = np.empty((count, 3))
    for k in range(count):
        rate = state[1] + gyro_noise[k]
        setpoint = asked[k] - ANGLE * (state[0] + angle_noise[k])
        output = P * (setpoint - rate) - D * (rate - before) / CYCLE
        before = rate
        delayed_outputs.append(output)
        rows[k] = rate, output, setpoint
        state = A @ state + B @ [delayed_outputs[k], wind[k]]
    return Flown(*rows.T, asked)


def back(frequency):
    """Of the controller that flies."""
    return P + D * (1 - np.exp(-2j * np.pi * frequency * CYCLE)) / CYCLE


KNOWN = KnownController(
    lambda f: (np.full(np.shape(f), P, complex), back(f)),
    lambda f: np.ones(np.shape(f), complex),
    ANGLE,
    CYCLE,
)
STAMPS = 7.0 + CYCLE * np.arange(round(SECONDS / CYCLE))
STARTS = np.arange(STAMPS[0], STAMPS[-1] - SPECTRUM_SECONDS, SPECTRUM_SECONDS / 2)


def sent(one, every=1, begin=0, late=0):
    """Every so many messages of a quantity, each second of them so many cycles late."""
    rows = np.arange(begin, len(STAMPS) - late, every)
    rows[1::2] += late
    return Messages(STAMPS[rows], one[rows])


def axis(flown, *every):
    """As spectra, of every so many messages."""
    return AxisPosterior(cross_spectra([sent(one, *every) for one in flown], STARTS), KNOWN, 0.0)


TRUE = {
    "effect": np.log(EFFECT),
    "damping": np.log(DAMPING),
    "lag": np.log(LAG),
    "delay": np.log((LATE + 0.5) * CYCLE),
}
KNOWN_PLANT = np.append(list(TRUE.values()), PRIOR_MEAN[len(TRUE) :])


@mark.slow
@mark.parametrize("every", [(), (4, 0, 1)])
def test_a_plant_is_given_back(every):
    """With its delay, which has half a cycle of hold, within three standard deviations and a share of the truth."""
    identified = identify_axis(axis(fly(3), *every))
    allowed = 3 * np.sqrt(identified.covariance.diagonal())[: len(TRUE)] + [0.03, 0.3, 0.05, 0.05]
    assert (abs(identified.theta - KNOWN_PLANT)[: len(TRUE)] <= allowed).all()
    assert identified.posterior.reference_share(identified.theta) > 0.5


@mark.slow
@mark.parametrize("in_time, every", [param(1, 16, marks=mark.in_full), (4, 4)])
def test_lag_and_delay_together_are_known_at_25_hz_and_where_steps_keep_time(in_time, every):
    """Of neither of which alone much is known there: whether a step comes sooner or the motors later looks alike."""
    identified = np.exp(identify_axis(axis(fly(3, in_time=in_time), every)).theta)
    assert identified[2] + identified[3] == approx(LAG + (LATE + 0.5) * CYCLE, rel=0.25)
    assert identified[0] == approx(EFFECT, rel=0.2)


@mark.in_full
def test_eddies_in_turbulence_are_not_taken_for_a_lag():
    """Of one colour for both, the wind made it a quarter shorter."""
    eddies = fly(3, 0.3, turbulence=((2.0, 6.0), (0.03, 6.0)))
    assert identify_axis(axis(eddies)).theta[2] == approx(TRUE["lag"], abs=0.1)


@mark.slow
@mark.parametrize("noise, every", [(NOISE, 4), param(NOISE / 5, 1, marks=mark.in_full)])
def test_the_densities_are_those_of_the_flight(noise, every):
    """Whitened by the model, the spectra of rate and output are one, also of a quiet gyro."""
    identified = identify_axis(axis(fly(3, noise=noise), every))
    model = identified.posterior.densities.density(identified.theta)
    for quantity in (0, 1):
        ratio = (
            identified.posterior.spectra.mean_density[:, quantity, quantity]
            / model[:, quantity, quantity]
        )
        assert np.mean(ratio.real) == approx(1.0, abs=0.1)


@mark.slow
@mark.parametrize("late", [0, 2])
def test_the_slopes_are_those_of_the_value(late):
    """Also of setpoints of another cycle, in which the angle has noise of its own."""
    begins = 0, 0, late, late
    streams = [sent(one, 4, begin) for begin, one in zip(begins, fly(3), strict=True)]
    one = AxisPosterior(cross_spectra(streams, STARTS), KNOWN, 0.0)
    about = one.expand(KNOWN_PLANT)
    for k, name in enumerate(PARAMETER_NAMES):
        step = np.eye(len(PARAMETER_NAMES))[k] * 1e-4 * PRIOR_SD[k]
        slope = (one.value(KNOWN_PLANT + step) - one.value(KNOWN_PLANT - step)) / (2 * step[k])
        sd = np.sqrt(about.curvature[k, k])
        assert about.gradient[k] == approx(slope, rel=1e-3, abs=1e-3 * sd), name


@mark.slow
def test_wind_and_noise_of_another_density_change_the_gradient_as_their_variance_states(
    monkeypatch,
):
    """All of the disturbances are larger by one factor, so that the variance has one direction."""
    posterior = axis(fly(3), 4)
    monkeypatch.setattr(likelihood, "DISTURBANCE_OCTAVES", np.inf)
    density = posterior.densities.density(KNOWN_PLANT)
    disturbances = posterior.densities.density(KNOWN_PLANT, with_reference=False)
    gradients = []
    for estimate in (density, density + likelihood.DISTURBANCE_DEVIATION * disturbances):
        monkeypatch.setattr(posterior, "_estimate", estimate)
        gradients.append(posterior.expand(KNOWN_PLANT).gradient)
    change = gradients[1] - gradients[0]
    variance = posterior.disturbance_gradient_variance(KNOWN_PLANT)
    assert_allclose(
        variance, np.outer(change, change), rtol=1e-6, atol=1e-9 * np.abs(variance).max()
    )


@mark.slow
def test_nothing_asked_is_nothing_steered():
    k = len(PARAMETER_NAMES)
    still, steered = axis(fly(4, steered=1e-6), 4), axis(fly(3), 4)
    assert still.reference_share(KNOWN_PLANT) < 0.05
    known = np.zeros((k, k))
    unsteered_fit = IdentifiedAxis(still, KNOWN_PLANT, known, KNOWN_PLANT)
    steered_fit = IdentifiedAxis(steered, KNOWN_PLANT, known, KNOWN_PLANT)
    assert unsteered_fit.steered_frequency == 0.0
    # Steps of the setpoint are quick.
    assert steered_fit.steered_frequency > 4.0
    # Below setpoints' frequencies the phase at the crossover has no further error, above it has one of 3°.
    crossover = 2.3
    assert steered_fit.crossover == unsteered_fit.crossover == approx(crossover, rel=0.05)
    variances = [
        physical_plant(fit, np.ones(1)).covariance[-1, -1] for fit in (unsteered_fit, steered_fit)
    ]
    phase_error = 360 * crossover * np.sqrt(variances[0] - variances[1])
    assert phase_error == approx(3.0, rel=0.05)


@mark.slow
def test_the_reference_of_a_setpoint_of_another_cycle_has_the_noise_of_one_angle():
    """With an angle that is interpolated between messages it had that of one and a half."""
    flown = fly(4, steered=1e-6)
    angle = (flown.asked - flown.setpoint) / ANGLE
    rate, output = (sent(one, 4, 2) for one in (flown.rate, flown.output))

    def spectra(begin):
        """With setpoints from this cycle on, and references by the angle between its messages."""
        setpoint = sent(flown.setpoint, 4, begin)
        angle_then = np.interp(setpoint.time, *sent(angle, 4, 2))
        reference = Messages(setpoint.time, setpoint.values + ANGLE * angle_then)
        return cross_spectra([rate, output, setpoint, reference], STARTS)

    by_gyro = with_reference_from_gyro(spectra(0), KNOWN)
    is_noise = by_gyro.frequency > 10.0
    density = by_gyro.mean_density[is_noise, Quantity.REFERENCE, Quantity.REFERENCE].real
    assert density.mean() == approx((ANGLE * ANGLE_NOISE) ** 2 * 4 * CYCLE, rel=0.15)
    of_one_cycle = spectra(2)
    assert with_reference_from_gyro(of_one_cycle, KNOWN) is of_one_cycle


@mark.slow
def test_messages_of_several_rates_count_at_the_slowest():
    """And what is lost of them is not made up."""
    identified = cross_spectra([sent(fly(3).rate, 4), sent(fly(3).output, 10)], STARTS)
    assert identified.message_rate == approx(40.0, rel=1e-3) and identified.frequency[-1] < 20.0
    assert abs(np.array(identified.stamp_offsets)).max() < 4 * CYCLE
    stream = sent(fly(3).rate, 4)
    is_received = default_rng(1).random(len(stream.time)) > 0.2
    lossy_spectra = cross_spectra([Messages(*(part[is_received] for part in stream))], STARTS)
    whole_spectra = cross_spectra([stream], STARTS)
    common_bins = min(len(lossy_spectra.frequency), len(whole_spectra.frequency), 10)
    assert np.log(
        lossy_spectra.mean_density[:common_bins] / whole_spectra.mean_density[:common_bins]
    ).real == approx(0.0, abs=0.3)


@dataclass(frozen=True)
class PosteriorStandIn:
    """Stands for an ``AxisPosterior`` of which no value is asked for."""

    prior_sd: np.ndarray | None = None
    saturated_share: float = 0.0

    def disturbance_gradient_variance(self, theta):
        return np.zeros((len(theta), len(theta)))


def test_maxima_at_several_times_of_steps_count_as_their_evidence_and_each_once():
    """Two maxima have the same curvature, and the second is three times as probable.

    It is found twice, but counts once.
    """
    size = len(PRIOR_MEAN)
    axis = PosteriorStandIn(prior_sd=np.ones(size))
    one, other = (PRIOR_MEAN + far * (np.arange(size) == STEP_TIME) for far in (-2.0, 2.0))
    other[0] += 1.0
    values = (one, 5.0), (other, 5.0 + np.log(3)), (other + 1e-3, 4.9 + np.log(3))
    maxima = [QuadraticExpansion(at, value, 0 * at, 4 * np.eye(size)) for at, value in values]
    identified = _mixture_of_modes(axis, maxima)
    assert identified.theta[[0, STEP_TIME]] == approx([PRIOR_MEAN[0] + 0.75, 1.0])
    assert identified.covariance[0, [0, STEP_TIME]] == approx(
        [0.6 / 4 + 0.4 / 16 + 3 / 16, 4 * 3 / 16]
    )
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

    def value(self, at):
        return self.expand(at).value

    def disturbance_gradient_variance(self, theta):
        return np.zeros((len(theta), len(theta)))

    def expand(self, at):
        precision = PRIOR_SD**-2.0
        precision[STEP_TIME] = 400.0
        mode = PRIOR_MEAN.copy()
        mode[STEP_TIME], height = at[STEP_TIME], -100.0
        for step_time, peak in ((0.0, 0.0), (1.6, 8.0)):
            if abs(at[STEP_TIME] - step_time) < 0.5:
                mode[STEP_TIME], height = step_time, peak
        slope = precision * (mode - at)
        return QuadraticExpansion(at, height + slope @ (at - mode) / 2, slope, np.diag(precision))


def test_a_higher_mode_between_the_first_step_times_is_found():
    identified = identify_axis(PosteriorOfTwoStepTimes(PRIOR_SD))
    assert identified.main_mode[STEP_TIME] == approx(1.6, abs=0.01)


def test_the_quicker_pole_is_the_lags():
    """Damping and motor lag can be exchanged without changing the response: the faster pole is called the lag."""

    def response(theta):
        effect, damping, lag, _ = np.exp(theta[list(PLANT)])
        return effect / (lag * turn + 1) / (turn + damping)

    turn = 2j * np.pi * np.geomspace(0.1, 100, 20)
    theta = PRIOR_MEAN.copy()
    theta[list(PLANT)] = np.log([3e5, 1650.0, 0.4, 0.001])
    assert response(with_quicker_pole_as_lag(theta)) == approx(response(theta))
    _, damping, lag, _ = np.exp(with_quicker_pole_as_lag(theta)[list(PLANT)])
    assert (damping, lag) == approx((2.5, 1 / 1650))
    assert np.array_equal(
        with_quicker_pole_as_lag(with_quicker_pole_as_lag(theta)), with_quicker_pole_as_lag(theta)
    )


def test_limits_explain_a_controller_of_less_gain_and_none_of_more():
    """A motor at its limit lowers the effective gain of the controller.

    It explains an estimate of half the gain, but not of twice.
    """
    row = np.eye(len(PARAMETER_NAMES))[PARAMETER_NAMES.index("controller")]

    def of(gain, limited, likeliest=1.0):
        theta, best = (PRIOR_MEAN + np.log(each) * row for each in (gain, gain * likeliest))
        return IdentifiedAxis(
            PosteriorStandIn(saturated_share=limited), theta, np.eye(len(theta)), best
        )

    assert of(0.5, 0.6).controller_consistent and of(0.5, 0.6).saturation_loss == approx(0.5)
    assert of(0.5, 0.3).saturation_loss == 0.3
    assert (
        not of(0.5, 0.0).controller_consistent
        and of(0.9, 0.0).controller_consistent
        and of(0.9, 0.0).saturation_loss == 0.0
    )
    assert not of(2.0, 0.9).controller_consistent and of(2.0, 0.9).saturation_loss == 0.0
    assert not of(
        0.9, 0.0, likeliest=0.6
    ).controller_consistent  # The highest of several maxima must be consistent, too.


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


@mark.parametrize("cycle", [0.0025, 0.001])
def test_stamps_that_are_cut_to_milliseconds_are_restored_by_the_cycles_of_exact_ones(cycle):
    """Though the controller's clock is slow, and messages of both kinds are lost."""
    cycles = 7.0003 + 1.0001 * cycle * np.arange(20_000)
    is_received = default_rng(1).random((2, 20_000)) > 0.9
    sent_at, exact = (cycles[received] for received in is_received)
    cut = np.floor(1e3 * sent_at) / 1e3
    restored = with_stamps_of_cycles(Messages(cut, cut), exact, cycle).time
    assert np.mean(abs(restored - sent_at) < 0.02e-3) > 0.95


def test_stamps_that_are_exact_or_between_the_cycles_are_kept():
    cycles = STAMPS[::4]
    exact = Messages(cycles[1:] - 0.3e-3 * default_rng(1).random(len(cycles) - 1), cycles[1:])
    assert with_stamps_of_cycles(exact, cycles, CYCLE) is exact
    between = np.floor(1e3 * np.sort(default_rng(1).uniform(7.0, 90.0, 2000))) / 1e3
    unrelated = Messages(between, between)
    assert with_stamps_of_cycles(unrelated, cycles, CYCLE) is unrelated
    none = Messages(np.array([]), np.array([]))
    assert with_stamps_of_cycles(none, cycles, CYCLE) is none
    # A millisecond has several cycles of so quick a controller.
    assert with_stamps_of_cycles(unrelated, cycles, CYCLE / 10) is unrelated
