"""The wind's torque in a recorded flight: its course with a band, and its level, spectrum and gusts.

With the physical parameters known, the rate's equation leaves the wind's torque d = rate' + damping · rate − torque.
It is smoothed over each segment, as coloured noise of the components that the fit found.

**The steady part.** Its mean is what the motors' mean balances. A motor's absolute command says nothing about torque,
only differences between motors do: so the steady part is that of equal motors and a centred load. An unequal motor or
a load to one side adds to it what it takes to balance it.

Where the vehicle changed, as by a motor's loss of thrust, the series is cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, ArrayPair
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
    gusts,
    min_gust_duration,
)
from mavdem.plant.identifiability import OmissionErrors
from mavdem.plant.parameters import (
    Physical,
    parameter_vector,
    rate_column,
    slopes_of,
    wind_torque_density,
)
from mavdem.plant.sampled_plant import plant

CHANGE_SECONDS = 2.0  # on either side of a step
STEP_SHARE = 0.5
STEP_SHARPNESS = 0.75
"""Of the variance by a step, and of the step within ``CHANGE_SECONDS``: no wind of 105 simulated flights had both."""


class WindSpectrum(NamedTuple):
    """One-sided spectral densities (F,), (rad/s²)²/Hz, of the estimate and of the model that smooths it."""

    frequency: Array  # Hz
    density: Array
    model: Array


@dataclass(frozen=True, eq=False, repr=False)
class WindTorque(ImmutableResult):
    """The wind's torque on one axis per moment of inertia, rad/s²; T samples.

    Attributes:
        torque: (T,) its course, steady part included.
        band: (T,) half width that holds the truth with probability 90 %: of the smoother, of the physical parameters to
            first order, and of what the model leaves out.
        mean: its mean, that of equal motors and a centred load.
        mean_band: likewise the half width for the mean.
        sd: the standard deviation of the wind's torque, between changes of the vehicle; the estimate's own is less,
            since smoothing shrinks it.
        scale_error: standard deviation of the error of ``sd``, relative: by effect, damping, lag and delay, and by what
            the model leaves out. Large where the motors' effect is not identifiable: motors that do more balance more.
        step: the sample at which its level changes at once and stays, and by how much, rad/s²: a load that moved, a
            motor, or the front of a wind; ``None`` without one. ``sd`` is that on either side.
        gusts: in order of time; none where the wind is not resolved.
        gust_threshold: rad/s² from the running level.
        false_gusts_per_minute: to expect of Gaussian turbulence with the same spectrum, without gusts.
        spectrum: of the estimate and of the model.
        resolved: whether its course is larger than its errors, but for those of its size.
        reason: why it is not to be taken for the wind's; ``None`` where it is.
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


def estimate_wind_torque(
    physical: Physical, record: Record, changes: Sequence[float] = ()
) -> WindTorque:
    """Returns the wind's torque in a record, from all of it; ``LinAlgError`` where no filter is steady.

    ``changes`` are times on the record's clock, s, at which the vehicle changed, as by a motor's loss of thrust.
    """
    column = rate_column(record)
    theta = parameter_vector(physical)
    with one_thread():
        torque, spread = _torques(theta, physical, record, column)
        slopes = slopes_of(
            lambda theta: _torques(theta, physical, record, column)[0], theta, torque
        )
    cuts = record.sample_indices(changes)
    levels = slopes.mean(axis=1)
    covariance = physical.covariance
    step = _step(_about_means(torque, cuts), record.dt)
    cuts = sorted({*cuts, *([] if step is None else step[:1])})
    moved = _about_means(torque, cuts)
    moving = _about_means(slopes, cuts)
    size = float(np.mean(moved**2))
    smoother = spread + OmissionErrors.wind**2 * size

    def with_parameters(slopes: Array) -> Array:
        return smoother + np.einsum("it,ij,jt->t", slopes, covariance, slopes)

    variance = with_parameters(slopes)
    # Motors that do more, and balance more: an error of the size alone leaves the course as it is. Where the motors do
    # more than balance the wind, as in steering, no more of it counts as one of the size.
    samples = len(moved)
    shares = moving @ moved / (samples * size)
    scales = np.append(shares[:-3], np.zeros(3))
    scales /= max(1.0, abs(float(theta @ scales)))
    error = float(with_parameters(moving - np.outer(scales, moved)).mean())
    resolved = error < MAX_ERROR_SHARE * size
    unresolved = Fact(
        NoPhysical.WIND_TORQUE_NOT_RESOLVED, torque_error=np.sqrt(error), torque_sd=np.sqrt(size)
    )
    # An error of the parameters adds to the size in proportion, and by the square of what is not like the wind.
    unlike = moving - np.outer(shares, moved)
    added = np.sum((unlike @ unlike.T) * covariance) / (2 * samples * size)
    scale_error = np.sqrt(shares @ covariance @ shares + added**2 + OmissionErrors.wind_sd**2)
    band = half_width(variance)
    gusty = gusts(torque, band, record, min_gust_duration(physical, record.dt))
    return WindTorque(
        torque=torque,
        band=band,
        mean=torque.mean(),
        mean_band=float(
            half_width(levels @ covariance @ levels + OmissionErrors.wind_sd**2 * size)
        ),
        sd=np.sqrt(size + spread.mean()),
        scale_error=float(scale_error),
        step=step,
        gusts=gusty.found if resolved else (),
        gust_threshold=gusty.threshold,
        false_gusts_per_minute=gusty.false_per_minute,
        spectrum=_spectrum(torque, record, physical),
        resolved=resolved,
        reason=None if resolved else unresolved,
    )


def _about_means(values: Array, cuts: Sequence[int]) -> Array:
    """(…, T) without the mean of each part between cuts."""
    parts = np.split(values, cuts, axis=-1)
    return np.concatenate(
        [part - part.mean(axis=-1, keepdims=True) for part in parts if part.size], axis=-1
    )


def _step(torque: Array, dt: float) -> tuple[int, float] | None:
    """The sample and size of the step that explains most of a torque (T,) of mean 0, where it is one."""
    number = len(torque)
    least = round(RUNNING_LEVEL_SECONDS / dt)
    near = round(CHANGE_SECONDS / dt)
    at = np.arange(least, number - least)
    if not len(at):
        return None
    sums = np.cumsum(torque)[at - 1]
    explained = sums**2 * number / (at * (number - at))
    sample = int(at[np.argmax(explained)])
    size = float(torque[sample:].mean() - torque[:sample].mean())
    sharp = (torque[sample : sample + near].mean() - torque[sample - near : sample].mean()) / size
    return (
        (sample, size)
        if explained.max() > STEP_SHARE * (torque @ torque) and sharp > STEP_SHARPNESS
        else None
    )


def _torques(
    theta: Array,
    physical: Physical,
    record: Record,
    column: int,
) -> ArrayPair:
    """The wind's torque in all segments (T,) and its smoother's variance, of the rate in a ``column``.

    With effect, damping, lag and delay ``theta`` (r + 3,).
    """
    effect = theta[:-3]
    (damping, lag, delay) = theta[-3:].tolist()
    jumps = physical.refinements.get(Refinement.JUMPS, 0.0)
    axis = plant(damping, lag, physical.components, record.dt, jumps)
    filtered = axis.filter(physical.noise)
    trim = record.inputs.mean(axis=0)
    level = balanced(effect, trim, record.effect_directions)
    parts = []
    for inputs, outputs in record.segments:
        rate = outputs[:, column]
        commanded = (inputs - trim) @ effect
        # What is steady acts like a steady command; about it the wind's mean is 0.
        constant = steady(rate, commanded, damping, record.dt)
        smoothed = axis.smoothed(filtered, commanded + constant, delay / record.dt, rate)
        parts.append((smoothed.mean + constant + level, smoothed.variance))
    torque, variance = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return torque, variance


def steady(
    rate: Array,
    commanded: Array,
    damping: float,
    dt: float,
) -> float:
    """Returns the mean torque, rad/s², that a segment's rate (T,) has besides the ``commanded`` torque (T,)."""
    return (rate[-1] - rate[0]) / (len(rate) * dt) + damping * rate.mean() - commanded.mean()


def balanced(effect: Array, trim: Array, directions: Array | None) -> float:
    """Returns the wind's torque, rad/s², that inputs ``trim`` (r,) of motors with this ``effect`` (r,) balance.

    Of motors that are equal: along the mixer's ``directions`` (r,), or, where these are not known, without what all
    have in common, since the common command lifts the vehicle. A single input is the torque's own command.
    """
    if directions is not None:
        effect = directions * (directions @ effect) / (directions @ directions)
    elif len(effect) > 1:
        effect = effect - effect.mean()
    return -float(trim @ effect)


def _spectrum(torque: Array, record: Record, physical: Physical) -> WindSpectrum:
    """By Welch's method, of windows of ``SPECTRUM_SECONDS``, or as long as the longest segment."""
    from scipy.signal import detrend, welch  # it takes half a second to import

    length = min(round(SPECTRUM_SECONDS / record.dt), record.longest_segment)
    parts = [part for part in np.split(torque, record.segment_starts[1:]) if len(part) >= length]
    densities = [welch(part, 1 / record.dt, nperseg=length, detrend=detrend) for part in parts]
    weights = [2 * len(part) // length - 1 for part in parts]
    density = np.average([density for _, density in densities], axis=0, weights=weights)
    frequency = densities[0][0]
    return WindSpectrum(frequency, density, wind_torque_density(physical, frequency))
