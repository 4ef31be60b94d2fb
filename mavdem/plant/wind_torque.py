"""Wind torque of a recorded flight over time with its 90 % interval, its mean and deviation, spectrum and gusts.

With known physical parameters, the equation of the rate leaves the wind torque w = dp/dt + damping · p − motor torque.
It is smoothed over each segment by a Kalman smoother, as coloured noise of the components that the gray-box fit found.

**The mean.** The mean wind torque is what the motors' mean balances. The absolute command of a motor says nothing about
torque, only differences between motors do. So the mean is that for equal motors and a centred load: an unequal motor,
or a load to one side, adds to it what balances it.

Where the vehicle changed, for example when a motor lost thrust, the flight is divided into sections. While a motor
gives less thrust than the model assumes, what the others balance is not wind: these samples are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Indices
from mavdem.confidence import half_width
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.record import Record
from mavdem.facts import Fact
from mavdem.facts.model import NoPhysical, Refinement
from mavdem.immutable import ImmutableResult
from mavdem.plant.closed_loop.spectra import SPECTRUM_SECONDS
from mavdem.plant.gusts import (
    MAX_ERROR_SHARE,
    RUNNING_LEVEL_SECONDS,
    DetectedGust,
    detect_gusts,
    min_gust_duration,
)
from mavdem.plant.identifiability import OmissionErrors
from mavdem.plant.parameters import (
    DYNAMICS,
    EFFECTS,
    Physical,
    parameter_gradient,
    parameter_vector,
    wind_torque_density,
)
from mavdem.plant.power_density import power_density
from mavdem.plant.sampled_plant import SampledPlant, sampled_plant
from mavdem.plant.windows import rate_column

STEP_EDGE_SECONDS = 2.0
"""Time on either side of a step within which its sharpness is measured, s: a choice."""

MIN_STEP_VARIANCE_SHARE = 0.5
"""Least share of the torque's variance that a step explains.

No wind of 105 simulated flights reached both this and ``MIN_STEP_SHARPNESS``.
"""

MIN_WIND_SECONDS = 10.0
"""Least duration of flight with sound motors from which the strength of the wind torque is estimated, s: a choice."""

MIN_STEP_SHARPNESS = 0.75
"""Least change of the level within ``STEP_EDGE_SECONDS`` on either side of a step, relative to the step's size.

See ``MIN_STEP_VARIANCE_SHARE`` for its origin.
"""


class WindSpectrum(NamedTuple):
    """One-sided spectral densities of the wind torque, (rad/s²)²/Hz."""

    frequency: Array
    """Frequencies (F,), Hz."""

    density: Array
    """Density of the estimated wind torque (F,)."""

    model: Array
    """Density of the model that smooths it (F,)."""


@dataclass(frozen=True, eq=False, repr=False)
class WindTorque(ImmutableResult):
    """Wind torque on one axis per moment of inertia, rad/s², at the T samples of a flight.

    Attributes:
        torque: (T,) the torque over time, with its mean; NaN while a motor had lost thrust, since it is then not only
            the wind's.
        band: (T,) half width of the band that holds the truth with probability 90 %: by the smoother, by the physical
            parameters to first order, and by what the model leaves out.
        mean: its mean, for equal motors and a centred load.
        mean_band: half width of the 90 % interval of the mean.
        sd: standard deviation of the wind torque, between changes of the vehicle; larger than ``torque`` has, since
            smoothing shrinks it.
        scale_error: relative standard error of ``sd``, by effect, damping, lag and delay, and by what the model leaves
            out. It is large if the motors' effect is not identifiable, since a larger effect balances more torque.
        step: sample at which the level changes at once and stays, and by how much, rad/s²: a load that moved, a motor,
            or a front of the wind; ``None`` without one. ``sd`` is that on either side.
        gusts: the gusts in order of time; none if the wind torque is not resolved.
        gust_threshold: distance from the running level that a gust exceeds, rad/s².
        false_gusts_per_minute: number of false gusts to expect of Gaussian turbulence with the same spectrum.
        spectrum: spectral densities of the estimate and of the model.
        resolved: whether its variance is larger than its errors' variance, apart from a common error of its size.
        reason: why it cannot be assumed to be the wind's; ``None`` if it is resolved.
        left_out: time that is left out because a motor had lost thrust, s.
    """

    torque: Array
    band: Array
    mean: float
    mean_band: float
    sd: float
    scale_error: float
    step: tuple[int, float] | None
    gusts: tuple[DetectedGust, ...]
    gust_threshold: float
    false_gusts_per_minute: float
    spectrum: WindSpectrum
    resolved: bool
    reason: Fact | None
    left_out: float = 0.0


class _TorqueErrors(NamedTuple):
    """Errors of a wind torque over time by the uncertainty of the physical parameters."""

    form_variance: float
    """Mean variance of the errors, without those that multiply the torque by the same factor always, (rad/s²)²."""

    scale_error: float
    """Relative standard error of the torque's standard deviation."""


class _Sections(NamedTuple):
    """Sections of a flight, in each of which neither the vehicle nor the level of the wind torque changes."""

    starts: list[int]
    """First sample of each section after the first one, which begins at 0; ascending."""

    step: tuple[int, float] | None
    """Sample and size, rad/s², of a sudden step of the wind torque's level; None without one."""


def estimate_wind_torque(
    physical: Physical,
    record: Record,
    changes: Sequence[int] = (),
    has_weak_motor: Flags | None = None,
) -> WindTorque:
    """Estimates the wind torque over time in a recorded flight, its strength, spectrum and gusts.

    It is computed by a Kalman smoother with the estimated physical parameters. Their uncertainty is propagated by the
    derivatives of the torque by the parameters, which are finite differences. The strength is the standard
    deviation from the mean of each section between changes of the vehicle. A sudden step of the level, for example by
    a shifted load, separates two sections like such a change, so that it does not appear as strong wind.

    Args:
        physical: control effectiveness, damping, motor time constant and delay of the axis.
        record: inputs and outputs.
        changes: samples of the record at which the vehicle changed, for example by a motor's loss of thrust.
        has_weak_motor: whether a motor had lost thrust at each sample (T,); such samples have no wind torque, and no
            gusts begin there. None if no motor lost thrust.

    Returns:
        The wind torque per moment of inertia. If it is not resolved, the reason is included.

    Raises:
        numpy.linalg.LinAlgError: there is no steady-state filter for these parameters.
    """
    column = rate_column(record)
    theta = parameter_vector(physical)

    def torque_at(theta: Array) -> Array:
        """Returns the smoothed torque (T,) for effects, damping, lag and delay (r + 3,)."""
        return _smoothed_torque(theta, physical, record, column)

    with one_thread():
        torque = torque_at(theta)
        smoother_variance = _smoother_variance(physical, record)
        # Derivatives (r + 3, T) of the torque by the parameters.
        gradient = parameter_gradient(torque_at, theta, torque)

    is_wind = np.ones(len(torque), bool) if has_weak_motor is None else ~has_weak_motor
    left_out = float(np.sum(~is_wind) * record.dt)
    has_enough_wind = is_wind.sum() * record.dt >= MIN_WIND_SECONDS
    if not has_enough_wind:
        # The results are then computed for the whole flight; the reason says that they do not describe the wind alone.
        is_wind = np.ones(len(torque), bool)
    sections = _sections_of_flight(torque, changes, is_wind, record.dt)
    deviation = _without_section_means(torque, sections.starts)
    # Mean square of the deviation of the wind torque from its means, (rad/s²)².
    power = float(np.mean(deviation[is_wind] ** 2))
    # The errors that the parameters do not cause are the smoother's, and the errors by what the model leaves out.
    other_variance = smoother_variance + OmissionErrors.wind**2 * power
    variance = other_variance + _variance_by_parameters(gradient, physical.covariance)
    errors = _torque_errors(
        deviation[is_wind],
        _without_section_means(gradient, sections.starts)[:, is_wind],
        other_variance[is_wind],
        theta,
        physical.covariance,
    )
    reason = _reason_against_wind(
        len(torque) * record.dt,
        is_long_enough_with_thrust=has_enough_wind,
        error_variance=errors.form_variance,
        power=power,
    )
    is_resolved = reason is None
    # Errors of the parameters are the same at all samples, so they do not average out in the mean.
    mean_gradient = gradient[:, is_wind].mean(axis=1)
    mean_variance = (
        mean_gradient @ physical.covariance @ mean_gradient + OmissionErrors.wind_sd**2 * power
    )
    band = half_width(variance)
    min_duration = min_gust_duration(physical, record.dt)
    detection = detect_gusts(torque, band, record, min_duration, is_wind)
    return WindTorque(
        torque=np.where(is_wind, torque, np.nan),
        band=np.where(is_wind, band, np.nan),
        mean=torque[is_wind].mean(),
        mean_band=float(half_width(mean_variance)),
        sd=np.sqrt(power + smoother_variance[is_wind].mean()),
        scale_error=errors.scale_error,
        step=sections.step,
        gusts=detection.gusts if is_resolved else (),
        gust_threshold=detection.threshold,
        false_gusts_per_minute=detection.false_per_minute,
        spectrum=_torque_spectrum(torque, is_wind, record, physical),
        resolved=is_resolved,
        reason=reason,
        left_out=left_out,
    )


def _reason_against_wind(
    duration: float, *, is_long_enough_with_thrust: bool, error_variance: float, power: float
) -> Fact | None:
    """Returns the reason why an estimated torque cannot be assumed to be caused by the wind.

    The reasons are, in this order: the flight is too short; for most of it some motor lacks thrust, which acts like a
    torque of its own; or the errors of the torque are not small compared with the torque.

    Args:
        duration: duration of the flight, s.
        is_long_enough_with_thrust: whether all motors had their thrust for ``MIN_WIND_SECONDS`` or more.
        error_variance: variance of the errors that change the torque's form over time, (rad/s²)². Errors that multiply
            all of it by a common factor do not count.
        power: mean square of the torque about its means, (rad/s²)².

    Returns:
        The first reason that holds; None if the torque is the wind's.
    """
    if duration < MIN_WIND_SECONDS:
        return Fact(NoPhysical.WIND_TORQUE_TOO_SHORT, least_duration=MIN_WIND_SECONDS)
    if not is_long_enough_with_thrust:
        return Fact(NoPhysical.MOTOR_WEAK_THROUGHOUT)
    if error_variance < MAX_ERROR_SHARE * power:
        return None
    return Fact(
        NoPhysical.WIND_TORQUE_NOT_RESOLVED,
        torque_error=np.sqrt(error_variance),
        torque_sd=np.sqrt(power),
    )


def _first_samples_after_changes(flags: Flags) -> Indices:
    """Returns the indices of the samples at which flags (T,) differ from the flags of the sample before."""
    last_samples_before = np.flatnonzero(np.diff(flags))
    return last_samples_before + 1


def resolved_wind_torque(
    wind_torque: WindTorque | None, physical: Physical | None
) -> WindTorque | None:
    """Returns the estimated torque if it may be shown as a torque of the wind.

    The wind torque is the total torque minus the torque of the motors. So the effectiveness of the motors must be
    identifiable, and the remainder larger than its errors.

    Args:
        wind_torque: the estimate; None if there is none.
        physical: physical parameters of the axis; None if they were not estimated.

    Returns:
        The wind torque; None if one of these conditions fails.
    """
    if wind_torque is None or wind_torque.reason is not None:
        return None
    if physical is None or not physical.identifiable:
        return None
    return wind_torque


def _variance_by_parameters(gradient: Array, covariance: Array) -> Array:
    """Returns the variance of each sample of a time series that uncertain parameters cause, to first order.

    With the gradient g of a sample by the parameters and their covariance P, it is gᵀ P g.

    Args:
        gradient: derivatives of the T samples by the k parameters (k, T).
        covariance: covariance of the parameters (k, k).

    Returns:
        Variances (T,).
    """
    # Letters of einsum: parameters i and j, sample t.
    return np.einsum("it,ij,jt->t", gradient, covariance, gradient)


def _torque_errors(
    deviation: Array, gradient: Array, other_variance: Array, theta: Array, covariance: Array
) -> _TorqueErrors:
    """Computes by how much uncertain physical parameters change the form of a wind torque over time, and its strength.

    The wind torque is the torque that the motors balance. If the motors are more effective than assumed, it is larger
    by the same factor at all times: such an error changes its strength, but not when and how the wind acts. All other
    errors change the form of the torque over time, and decide whether it is resolved.

    To separate the two, the derivative of the torque by each parameter is regressed on the torque itself:
    gradient_i(t) = a_i torque(t) + residual_i(t). The coefficient a_i is the relative change of the torque by
    parameter i.

    Args:
        deviation: (T,) wind torque about its means, rad/s².
        gradient: (r + 3, T) its derivatives by the parameters, about their means too.
        other_variance: (T,) variance of the errors that the parameters do not cause, (rad/s²)².
        theta: (r + 3,) effects, damping, lag and delay.
        covariance: (r + 3, r + 3) covariance of these parameters.

    Returns:
        Mean variance of the errors of the form, (rad/s²)², and relative error of the torque's standard deviation.
    """
    # Least squares: a_i is the sum of gradient_i(t) torque(t) over the sum of torque(t)².
    relative_changes = gradient @ deviation / float(np.sum(deviation**2))
    form_variance = other_variance + _variance_of_form_errors(
        deviation, gradient, relative_changes, theta, covariance
    )
    strength_variance = _relative_variance_of_strength(
        deviation, gradient, relative_changes, covariance
    )
    return _TorqueErrors(float(form_variance.mean()), scale_error=float(np.sqrt(strength_variance)))


def _variance_of_form_errors(
    deviation: Array, gradient: Array, relative_changes: Array, theta: Array, covariance: Array
) -> Array:
    """Returns the variance of those errors of the wind torque that change its form over time, at each sample.

    They are caused by uncertain parameters. An error of all effects by one common factor is left out: it makes the
    torque stronger or weaker at all times alike.

    Args:
        deviation: (T,) wind torque about its means, rad/s².
        gradient: (r + 3, T) its derivatives by effects, damping, lag and delay.
        relative_changes: (r + 3,) relative change of the torque by each parameter, of :func:`_torque_errors`.
        theta: (r + 3,) effects, damping, lag and delay.
        covariance: (r + 3, r + 3) their covariance.

    Returns:
        Variances (T,), (rad/s²)².
    """
    # Only the effects of the motors multiply the torque: damping, lag and delay get a 0.
    changes_by_effects = np.append(relative_changes[EFFECTS], np.zeros(3))
    # If all effects double, the torque grows by this factor of itself. It is 1 if the motors only balance the wind. If
    # they also steer the vehicle it could exceed 1, and is limited.
    change_by_doubled_effects = abs(float(theta @ changes_by_effects))
    changes_by_effects /= max(1.0, change_by_doubled_effects)
    gradient_of_form = gradient - np.outer(changes_by_effects, deviation)
    return _variance_by_parameters(gradient_of_form, covariance)


def _relative_variance_of_strength(
    deviation: Array, gradient: Array, relative_changes: Array, covariance: Array
) -> float:
    """Returns the variance of the relative error of the wind torque's standard deviation.

    An error δ of the parameters changes the torque d(t) to (1 + a · δ) d(t) + δ · residual(t). The standard deviation
    changes relatively by a · δ, and by mean((δ · residual)²) / (2 mean(d²)), since the residual is not correlated with
    d. The second change is always an increase: its expected value is counted as an error.

    Args:
        deviation: (T,) wind torque d about its means, rad/s².
        gradient: (r + 3, T) its derivatives by the parameters.
        relative_changes: (r + 3,) relative change a of the torque by each parameter, of :func:`_torque_errors`.
        covariance: (r + 3, r + 3) covariance of the parameters.

    Returns:
        The variance, without a unit, with the error by what the model leaves out.
    """
    sum_of_squares = len(deviation) * float(np.mean(deviation**2))
    residuals = gradient - np.outer(relative_changes, deviation)
    # The expected value of (δ · residual)², summed over the samples.
    expected_squares = np.sum((residuals @ residuals.T) * covariance)
    mean_increase = expected_squares / (2 * sum_of_squares)
    linear_variance = relative_changes @ covariance @ relative_changes
    return float(linear_variance + mean_increase**2 + OmissionErrors.wind_sd**2)


def _sections_of_flight(
    torque: Array, changes: Sequence[int], is_wind: Flags, dt: float
) -> _Sections:
    """Divides a flight into sections, in each of which neither the vehicle nor the level of the wind torque changes.

    A section begins at each change of the vehicle, whenever a motor lost or regained thrust, and at a sudden step of
    the torque's level, such as by a load that moved.

    Args:
        torque: smoothed wind torque (T,), rad/s².
        changes: samples at which the vehicle changed.
        is_wind: whether all motors had their thrust at each sample (T,).
        dt: time step, s.

    Returns:
        The sections, and the step, if there is one.
    """
    starts = sorted({*changes, *_first_samples_after_changes(is_wind).tolist()})
    # While a motor lacks thrust there is no wind torque. Such gaps already separate the levels, so that no step is
    # searched for.
    if not is_wind.all():
        return _Sections(starts, step=None)
    step = _sharp_step(_without_section_means(torque, starts), dt)
    if step is not None:
        step_sample, _ = step
        starts = sorted({*starts, step_sample})
    return _Sections(starts, step)


def _without_section_means(values: Array, section_starts: Sequence[int]) -> Array:
    """Subtracts from values their mean in each section of the flight.

    Args:
        values: (…, T) values over T samples, such as wind torque in rad/s².
        section_starts: ascending indices of the samples at which a new section begins; the first begins at 0.

    Returns:
        (…, T) values with mean 0 in each section.
    """
    centred_sections = []
    for section in np.split(values, section_starts, axis=-1):
        if section.size:
            centred_sections.append(section - section.mean(axis=-1, keepdims=True))
    return np.concatenate(centred_sections, axis=-1)


def _sharp_step(torque: Array, dt: float) -> tuple[int, float] | None:
    """Finds a single step in a torque, if one explains most of its variance and is sharp.

    At each sample the torque is split into what is before and what is after, each with its mean. The best split is the
    one that leaves the least variance. It counts as a step if it explains ``MIN_STEP_VARIANCE_SHARE`` of the variance,
    and if most of the change happens within ``STEP_EDGE_SECONDS``: a slow drift of the wind can be split in two as
    well, but is not sharp.

    Args:
        torque: torque over time (T,), with mean 0, rad/s².
        dt: time step, s.

    Returns:
        First sample after the step, which is at least ``RUNNING_LEVEL_SECONDS`` from both ends, and the size of the
        step, rad/s²; None if there is no step.
    """
    count = len(torque)
    margin = round(RUNNING_LEVEL_SECONDS / dt)
    candidates = np.arange(margin, count - margin)
    if not len(candidates):
        return None
    # With N samples of mean 0, a split after n samples with the sum S explains S² N / (n (N − n)) of the sum of
    # squares. That sum is the cumulative sum at sample n − 1.
    sums_before = np.cumsum(torque)[candidates - 1]
    explained_squares = sums_before**2 * count / (candidates * (count - candidates))
    sample = int(candidates[np.argmax(explained_squares)])
    size = float(torque[sample:].mean() - torque[:sample].mean())
    edge = round(STEP_EDGE_SECONDS / dt)
    mean_just_before = torque[sample - edge : sample].mean()
    mean_just_after = torque[sample : sample + edge].mean()
    # The fraction of the change that happens close to the split.
    sharpness = (mean_just_after - mean_just_before) / size
    sum_of_squares = torque @ torque
    is_large = explained_squares.max() > MIN_STEP_VARIANCE_SHARE * sum_of_squares
    if is_large and sharpness > MIN_STEP_SHARPNESS:
        return sample, size
    return None


def _smoothed_torque(
    theta: Array,
    physical: Physical,
    record: Record,
    column: int,
) -> Array:
    """Returns the smoothed wind torque in all segments, including its mean, for given physical parameters.

    The parameters are passed as a vector, so that a caller can compute derivatives by finite differences.

    Args:
        theta: effects, damping, lag and delay (r + 3,), which replace the values of ``physical``.
        physical: the other parameters: components of the wind torque, noise and refinements.
        record: inputs and outputs, with the segments one after the other.
        column: column of the rate in the outputs.

    Returns:
        Wind torque (T,), rad/s².
    """
    effect = theta[EFFECTS]
    damping, lag, delay = theta[DYNAMICS].tolist()
    plant = _sampled_plant(damping, lag, physical, record)
    rate_filter = plant.rate_filter(physical.noise)
    trim = record.inputs.mean(axis=0)
    trim_torque = torque_balanced_by_trim(effect, trim, record.effect_directions)
    torques = []
    for inputs, outputs in record.segments:
        rate = outputs[:, column]
        commanded_torque = (inputs - trim) @ effect
        # The smoother models a wind torque of mean 0. A constant torque acts like a constant command, and is added to
        # it.
        constant_torque = mean_external_torque(rate, commanded_torque, damping, record.dt)
        smoothed_wind = plant.smooth_wind_torque(
            rate_filter, commanded_torque + constant_torque, delay / record.dt, rate
        )
        torques.append(smoothed_wind.mean + constant_torque + trim_torque)
    return np.concatenate(torques)


def _smoother_variance(physical: Physical, record: Record) -> Array:
    """Returns the variance of the smoother's error in all segments.

    Args:
        physical: physical parameters, whose errors are not part of this variance.
        record: inputs and outputs of the flight, by segments without a gap.

    Returns:
        The variance (T,), (rad/s²)².
    """
    plant = _sampled_plant(physical.damping, physical.lag, physical, record)
    rate_filter = plant.rate_filter(physical.noise)
    variances = []
    for inputs, _ in record.segments:
        variances.append(rate_filter.smoothed_variance(len(inputs), plant.wind_output))
    return np.concatenate(variances)


def _sampled_plant(damping: float, lag: float, physical: Physical, record: Record) -> SampledPlant:
    """Returns the discretised plant with these damping, 1/s, and motor lag, s, and all else of ``physical``."""
    jump_advance = physical.refinements.get(Refinement.JUMPS, 0.0)
    return sampled_plant(damping, lag, physical.components, record.dt, jump_advance)


def mean_external_torque(
    rate: Array,
    motor_torque: Array,
    damping: float,
    dt: float,
) -> float:
    """Returns the mean torque per inertia that acts in a segment in addition to the motors' torque.

    The body rate p follows dp/dt = −damping · p + motor torque + external torque. So the external torque is
    dp/dt + damping · p − motor torque, of which the mean is returned.

    Args:
        rate: body rate p (T,), rad/s.
        motor_torque: (T,), rad/s².
        damping: rate damping, 1/s.
        dt: time step, s.

    Returns:
        The mean torque per inertia, rad/s².
    """
    mean_acceleration = (rate[-1] - rate[0]) / (len(rate) * dt)
    return mean_acceleration + damping * rate.mean() - motor_torque.mean()


def torque_balanced_by_trim(effect: Array, trim: Array, directions: Array | None) -> float:
    """Returns the steady wind torque that the mean inputs balance if the motors are equal.

    It is the negative of the motors' mean torque. Only the part of the effects that rotates the vehicle counts.

    Args:
        effect: effect of each input (r,), rad/s² per unit.
        trim: mean inputs (r,).
        directions: relative effect of each input by the mixer (r,). If they are None, the mean of the effects of all
            inputs is subtracted instead, since a common input only lifts the vehicle. A single input is the commanded
            torque itself.

    Returns:
        The steady wind torque, rad/s².
    """
    rotating_effect = effect
    if directions is not None:
        # The projection of the effects on the mixer's direction.
        rotating_effect = directions * (directions @ effect) / (directions @ directions)
    elif len(effect) > 1:
        rotating_effect = effect - effect.mean()
    return -float(trim @ rotating_effect)


def _torque_spectrum(
    torque: Array, is_wind: Flags, record: Record, physical: Physical
) -> WindSpectrum:
    """Estimates the spectral density of the wind torque by Welch's method, for comparison with the model's.

    The record is cut into pieces at the ends of its segments, and where ``is_wind`` changes. Pieces in which it is
    false are left out. Windows last ``SPECTRUM_SECONDS``, or as long as the longest piece. Shorter pieces are left out
    too, and the densities of the others are averaged with their numbers of windows as weights. The linear trend of each
    window is removed.

    Args:
        torque: wind torque (T,), rad/s².
        is_wind: whether all motors had their thrust at each sample (T,), so that the torque is caused by wind. It is
            true at some sample.
        record: time step and segments of the samples.
        physical: physical parameters, with the modelled components of the wind torque.

    Returns:
        One-sided densities of the estimate and of the model, (rad/s²)²/Hz.
    """
    piece_starts = np.union1d(record.segment_starts[1:], _first_samples_after_changes(is_wind))
    pieces = []
    for piece, wind_flags in zip(
        np.split(torque, piece_starts), np.split(is_wind, piece_starts), strict=True
    ):
        # The record was cut where the flag changes, so that it is the same at all samples of a piece.
        if wind_flags[0]:
            pieces.append(piece)
    window_length = min(round(SPECTRUM_SECONDS / record.dt), max(map(len, pieces)))
    densities = []
    window_counts = []
    for piece in pieces:
        if len(piece) < window_length:
            continue
        frequency, density = power_density(piece, 1 / record.dt, window_length, without_trend=True)
        densities.append(density)
        # Windows begin every half length.
        window_counts.append(2 * len(piece) // window_length - 1)
    mean_density = np.average(densities, axis=0, weights=window_counts)
    return WindSpectrum(frequency, mean_density, wind_torque_density(physical, frequency))
