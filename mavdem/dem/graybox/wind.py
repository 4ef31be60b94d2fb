"""The wind's torque in a recorded flight: its course with a band, and its level, spectrum and gusts.

With the physical parameters known, the rate's equation leaves the wind's torque d = rate' + damping · rate − torque.
It is smoothed over each segment, as coloured noise of the components that the fit found.

**The steady part.** Its mean is what the motors' mean balances. A motor's absolute command says nothing about torque,
only differences between motors do: so the steady part is that of equal motors and a centred load. An unequal motor or
a load to one side adds to it what it takes to balance it.

Gusts: where the wind's torque leaves its running level by more than its turbulence does, for as long as the estimate
resolves, and returns to it. Where the vehicle changed, as by a motor's loss of thrust, the series is cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.ndimage import median_filter

from mavdem.confidence import half_width, quantile
from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.engine.model import discretize, recursion
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.graybox.identifiability import MODEL_ERRORS
from mavdem.dem.graybox.likelihood import delayed, plant, stationary, step_covariance, with_wind
from mavdem.dem.graybox.parameters import Physical, rate_column
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record
from mavdem.facts import Fact
from mavdem.facts.model import NoPhysical

RELATIVE_STEP = 1e-4  # of a parameter, for slopes by differences
# of the estimate's variance, that its errors may have before it is not resolved
MAX_ERROR_SHARE = 0.75
# of the cancelled share: with more, the motors do too much else for it to be known
MAX_SCATTER = 0.1
SPECTRUM_SECONDS = 8.0  # of the windows whose spectra are averaged, with half of each in the next
# of windows by Hann with half of each in the next, as many count (Welch, 1967)
INDEPENDENT = 18 / 19
SLOW_HERTZ = 1.0  # below which the slow wind's answer counts

CHANGE_SECONDS = 2.0  # on either side of a step
STEP_SHARE = 0.5
STEP_SHARPNESS = 0.75
"""Of the variance by a step, and of the step within ``CHANGE_SECONDS``: no wind of 105 simulated flights had both."""
LEVEL_SECONDS = 10.0  # of the running median, which a gust stands out from
LEVEL_STEP_SECONDS = 0.1  # between samples of that median
THRESHOLD = 4.0  # standard deviations from it, by the median absolute deviation
END = 0.5  # of the threshold, within which a gust begins and ends
# half widths of the band, which a gust exceeds: errors in quick manoeuvres are no gusts
CERTAIN = 2.0
NORMAL_MEDIAN = 0.6745  # absolute deviation of a normal distribution, in standard deviations


class DetectedGust(NamedTuple):
    """Wind that leaves its running level by ``THRESHOLD`` standard deviations.

    Attributes:
        sample: the first of it, in the record.
        start: that sample's time since the record's first, s; gaps between segments do not count.
        length: s, for which it stays beyond half the threshold.
        size: its largest distance from the level, with its sign, rad/s².
    """

    sample: int
    start: float
    length: float
    size: float


class WindSpectrum(NamedTuple):
    """One-sided spectral densities (F,), (rad/s²)²/Hz, of the estimate and of the model that smooths it."""

    frequency: Array  # Hz
    density: Array
    model: Array


@dataclass(frozen=True, eq=False, repr=False)
class WindTorque:
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
        motors: (T,) the motors' torque about its mean.
        step: the sample at which its level changes at once and stays, and by how much, rad/s²: a load that moved, a
            motor, or the front of a wind; ``None`` without one. ``sd`` is that on either side.
        gusts: in order of time; none where the wind is not resolved.
        gust_threshold: rad/s² from the running level.
        false_gusts_per_minute: to expect of Gaussian turbulence with the same spectrum, without gusts.
        spectrum: of the estimate and of the model.
        cancelled_share: of its variance, by the motors; NaN where they steer too much for it to be known.
        cancelled_share_slow: likewise of its variance below 1 Hz.
        resolved: whether its course is larger than its errors, but for those of its size.
        reason: why it is not to be taken for the wind's; ``None`` where it is.
        dt: sampling step, s.
    """

    torque: Array
    band: Array
    mean: float
    mean_band: float
    sd: float
    scale_error: float
    motors: Array
    step: tuple[int, float] | None
    gusts: tuple[DetectedGust, ...]
    gust_threshold: float
    false_gusts_per_minute: float
    spectrum: WindSpectrum
    cancelled_share: float
    cancelled_share_slow: float
    resolved: bool
    reason: Fact | None
    dt: float

    def __repr__(self) -> str:
        number = len(self.gusts)
        return (
            f"<WindTorque: mean {self.mean:.3g} ± {self.mean_band:.2g}, sd {self.sd:.3g} rad/s², "
            f"{number} gust{'' if number == 1 else 's'}{'' if self.resolved else ', not resolved'}>"
        )


class _Torques(NamedTuple):
    """Of all segments: the wind's torque (T,), its smoother's variance, and the motors' torque about its mean."""

    mean: Array
    variance: Array
    motors: Array


def wind(physical: Physical, record: Record, changes: Sequence[float] = ()) -> WindTorque:
    """Returns the wind's torque in a record, from all of it; ``LinAlgError`` where no filter is steady.

    ``changes`` are times on the record's clock, s, at which the vehicle changed, as by a motor's loss of thrust.
    """
    column = rate_column(record)
    theta = np.array([*physical.effect, physical.damping, physical.lag, physical.delay])
    with one_thread():
        torques = _torques(theta, physical, record, column)
        nudges = RELATIVE_STEP * np.maximum(np.abs(theta), RELATIVE_STEP)
        beside = [
            _torques(theta + nudge, physical, record, column).mean for nudge in np.diag(nudges)
        ]
        slopes = (np.array(beside) - torques.mean) / nudges[:, None]
    cuts = record.samples_at(changes)
    levels = slopes.mean(axis=1)
    covariance = physical.covariance
    step = _step(_about_means(torques.mean, cuts), record.dt)
    cuts = sorted({*cuts, *([] if step is None else step[:1])})
    moved = _about_means(torques.mean, cuts)
    moving = _about_means(slopes, cuts)
    size = float(np.mean(moved**2))
    smoother = torques.variance + MODEL_ERRORS.wind**2 * size

    def with_parameters(slopes: Array) -> Array:
        return np.asarray(smoother + np.einsum("it,ij,jt->t", slopes, covariance, slopes))

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
    scale_error = np.sqrt(shares @ covariance @ shares + added**2 + MODEL_ERRORS.wind_sd**2)
    spectra = _spectra(torques, record)
    band = half_width(variance)
    gusty = gusts(torques.mean, band, record, shortest_gust(physical, record.dt))
    return WindTorque(
        torque=torques.mean,
        band=band,
        mean=float(torques.mean.mean()),
        mean_band=float(half_width(levels @ covariance @ levels + MODEL_ERRORS.wind_sd**2 * size)),
        sd=float(np.sqrt(size + torques.variance.mean())),
        scale_error=float(scale_error),
        motors=torques.motors,
        step=step,
        gusts=gusty.found if resolved else (),
        gust_threshold=gusty.threshold,
        false_gusts_per_minute=gusty.false_per_minute,
        spectrum=WindSpectrum(
            spectra.frequency, spectra.wind, wind_density(physical, spectra.frequency)
        ),
        cancelled_share=spectra.cancelled_share(np.inf),
        cancelled_share_slow=spectra.cancelled_share(SLOW_HERTZ),
        resolved=resolved,
        reason=None if resolved else unresolved,
        dt=record.dt,
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
    least = round(LEVEL_SECONDS / dt)
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


def _torques(theta: Array, physical: Physical, record: Record, column: int) -> _Torques:
    """Of all segments, with effect, damping, lag and delay ``theta`` (r + 3,), of the rate in a ``column``."""
    effect = theta[:-3]
    (damping, lag, delay) = theta[-3:].tolist()
    axis = plant(
        damping, lag, physical.components, record.dt, physical.refinements.get("jumps", 0.0)
    )
    trim = record.inputs.mean(axis=0)
    level = balanced(effect, trim, record.effect_directions)
    parts = []
    for inputs, outputs in record.segments:
        rate = outputs[:, column]
        commanded = (inputs - trim) @ effect
        # What is steady acts like a steady command; about it the wind's mean is 0.
        constant = steady(rate, commanded, damping, record.dt)
        smoothed = axis.smoothed(physical.noise, commanded + constant, delay / record.dt, rate)
        parts.append(
            (smoothed.mean + constant + level, smoothed.variance, smoothed.states[:, 1] - constant)
        )
    return _Torques(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def steady(rate: Array, commanded: Array, damping: float, dt: float) -> float:
    """The mean torque, rad/s², that a segment's rate (T,) has besides the ``commanded`` torque (T,)."""
    return float((rate[-1] - rate[0]) / (len(rate) * dt) + damping * rate.mean() - commanded.mean())


def balanced(effect: Array, trim: Array, directions: Array | None) -> float:
    """The wind's torque, rad/s², that inputs ``trim`` (r,) of motors with this ``effect`` (r,) balance.

    Of motors that are equal: along the mixer's ``directions`` (r,), or, where these are not known, without what all
    have in common, since the common command lifts the vehicle. A single input is the torque's own command.
    """
    if directions is not None:
        effect = directions * (directions @ effect) / (directions @ directions)
    elif len(effect) > 1:
        effect = effect - effect.mean()
    return -float(trim @ effect)


class _Spectra(NamedTuple):
    """One-sided densities (F,) over windows of the segments: of the wind, of the motors' answer, and across."""

    frequency: Array
    wind: Array
    answer: Array
    across: Array
    windows: float  # independent ones

    def cancelled_share(self, highest: float) -> float:
        """Share of the wind's variance up to a frequency, Hz, that the motors' torque cancels.

        With the transfer G = across / wind from the wind to the answer, |1 − G|² of the density is left over. So what
        the motors do besides, such as steering, does not count. The scatter of G, which does not vanish with few
        windows, is taken off (Bendat and Piersol, Random Data, 4th ed., sec. 9.2).
        """
        below = (self.frequency <= highest) & (self.wind > 0)
        wind = self.wind[below]
        answer = self.answer[below]
        across = self.across[below]
        total = float(wind.sum())
        left = float((np.abs(wind - across) ** 2 / wind).sum())
        scatter = float((answer - np.abs(across) ** 2 / wind).sum()) / max(self.windows - 1, 1)
        return (
            1 - (left - scatter) / total
            if total and scatter <= MAX_SCATTER * total
            else float("nan")
        )


def _spectra(torques: _Torques, record: Record) -> _Spectra:
    """By Welch's method, of windows of ``SPECTRUM_SECONDS``, or as long as the longest segment."""
    from scipy.signal import csd, detrend  # it takes half a second to import

    length = min(round(SPECTRUM_SECONDS / record.dt), record.longest)
    total = np.zeros((3, length // 2 + 1), complex)
    windows = 0.0
    frequency = np.zeros(length // 2 + 1)
    cuts = record.starts[1:]
    for torque, motors in zip(
        np.split(torques.mean, cuts), np.split(-torques.motors, cuts), strict=True
    ):
        if len(torque) < length:
            continue
        weight = 2 * len(torque) // length - 1
        for sums, (one, other) in zip(
            total, ((torque, torque), (motors, motors), (torque, motors)), strict=True
        ):
            frequency, density = csd(one, other, 1 / record.dt, nperseg=length, detrend=detrend)
            sums += weight * density
        windows += weight
    wind, answer, across = total / windows
    return _Spectra(frequency, wind.real, answer.real, across, INDEPENDENT * windows)


def wind_density(physical: Physical, frequency: Array) -> Array:
    """Returns (F,) the spectral density of the wind's components at Hz (F,), one-sided, (rad/s²)²/Hz."""
    density = np.zeros(len(frequency))
    for colour, size, time in physical.components:
        resolvent = 2j * np.pi * frequency[:, None, None] * np.eye(len(colour.A)) - colour.A / time
        seen = np.tile(colour.C[:, None], (len(frequency), 1, 1))
        across = np.linalg.solve(np.swapaxes(resolvent, 1, 2), seen)[..., 0]
        density += (
            2 * size**2 * np.einsum("fi,ij,fj->f", across, colour.drive / time, across.conj()).real
        )
    return density


class Gusts(NamedTuple):
    """What was found, the threshold in rad/s², and how many a minute Gaussian turbulence alone would give."""

    found: tuple[DetectedGust, ...]
    threshold: float
    false_per_minute: float


def shortest_gust(physical: Physical, dt: float) -> float:
    """Returns how long a gust lasts at least, s: half a period of the fastest wind that the estimate resolves.

    That is above the noise of the rate, and below half of the Nyquist frequency. And the time that the motors take to
    answer, within which an error of lag or delay looks like a gust.
    """
    frequency = np.linspace(0.0, 0.25 / dt, 201)[1:]
    noise = 2 * dt * physical.noise**2 * ((2 * np.pi * frequency) ** 2 + physical.damping**2)
    resolved = frequency[wind_density(physical, frequency) > noise]
    return 0.5 / float(resolved.max(initial=frequency[0])) + physical.lag + physical.delay


def gusts(torque: Array, band: Array, record: Record, shortest: float = 0.0) -> Gusts:
    """Returns the gusts of the wind's ``torque`` (T,), no less than twice the half width of its ``band`` (T,).

    There are none where the errors that the band stands for are most of what the torque is.
    They last ``shortest`` s or more and return to the level they left: a step, as of a motor, is none. The rate of
    false ones is that at which a Gaussian process of the same variance and the same variance of its derivative crosses
    the threshold, on both sides (Rice, "Mathematical analysis of random noise", 1944, sec. 3.3).
    """
    parts = np.split(torque, record.starts[1:])
    bands = np.split(band, record.starts[1:])
    away = [part - _level(part, record.dt) for part in parts]
    sd = float(np.median(np.abs(np.concatenate(away)))) / NORMAL_MEDIAN
    if sd == 0.0 or np.mean((band / quantile()) ** 2) > MAX_ERROR_SHARE * np.var(torque):
        return Gusts((), THRESHOLD * sd, 0.0)
    slopes = np.concatenate([np.diff(part) for part in away]) / record.dt
    # Likewise by the median, so that gusts do not count.
    crossings = float(np.median(np.abs(slopes))) / NORMAL_MEDIAN / sd / (2 * np.pi)
    false = 2 * 60 * crossings * float(np.exp(-(THRESHOLD**2) / 2))
    detected = []
    beside = round(LEVEL_SECONDS / 2 / record.dt)
    for first, whole, part, width in zip(record.starts.tolist(), parts, away, bands, strict=True):
        outside = np.concatenate([[False], np.abs(part) > END * THRESHOLD * sd, [False]])
        # A change of sign ends a gust.
        edges = np.flatnonzero(np.diff(outside * np.sign(np.concatenate([[0], part, [0]]))))
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            peak = start + int(np.argmax(np.abs(part[start:stop])))
            sample = first + start
            length = (stop - start) * record.dt
            before = whole[max(start - beside, 0) : start]
            after = whole[stop : stop + beside]
            stays = (
                before.size
                and after.size
                and abs(np.median(after) - np.median(before)) > THRESHOLD * sd
            )
            high = abs(part[peak]) > max(THRESHOLD * sd, CERTAIN * width[peak])
            if high and length >= shortest and not stays:
                detected.append(DetectedGust(sample, sample * record.dt, length, float(part[peak])))
    return Gusts(tuple(detected), THRESHOLD * sd, false)


def _level(part: Array, dt: float) -> Array:
    """(T,) the running median of a segment."""
    stride = max(1, round(LEVEL_STEP_SECONDS / dt))
    coarse = part[::stride]
    width = min(len(coarse), round(LEVEL_SECONDS / (stride * dt)))
    median = median_filter(coarse, width | 1, mode="nearest")
    return np.interp(np.arange(len(part)), np.arange(len(coarse)) * stride, median)


def simulated(physical: Physical, record: Record, inputs: Array) -> Forecast:
    """Mean and variance (H, m) of an angle and its rate under commanded ``inputs`` (H, r), after the training data.

    It begins with the last measured sample, and with the torque that the last commands left in the motors. The steady
    disturbance of the training data stays: it balances the mean inputs. The variance is that of the wind, of which
    nothing else is known, and of motors' effect, damping and lag, to first order.

    ``ValueError`` for outputs that are not an angle and its rate.
    """
    pairs = derivative_pairs(record)
    if record.outputs.shape[1] != 2 or not pairs:
        raise ValueError(
            "a simulation needs two outputs, an angle and its rate: the plant has no others"
        )
    order = list(pairs[0])
    theta = np.array([*physical.effect, physical.damping, physical.lag])
    mean = _mean(theta, physical.delay, record, order, inputs)
    nudges = RELATIVE_STEP * np.maximum(np.abs(theta), RELATIVE_STEP)
    slopes = [
        (_mean(theta + nudge, physical.delay, record, order, inputs) - mean) / nudge.sum()
        for nudge in np.diag(nudges)
    ]
    variance = np.einsum("iht,ij,jht->ht", slopes, physical.covariance[:-1, :-1], slopes)
    variance += _of_wind(physical, record.dt, len(inputs))
    back = np.argsort(order)
    return Forecast(mean[:, back], variance[:, back])


def _mean(theta: Array, delay: float, record: Record, order: list[int], inputs: Array) -> Array:
    """(H, 2) angle and rate of the plant with motors, damping and lag ``theta`` (r + 2,), without wind."""
    motors = theta[:-2]
    damping = theta[-2]
    lag = theta[-1]
    trim = record.inputs.mean(axis=0)
    steps = delay / record.dt
    A = np.array([[0.0, 1.0, 0.0], [0.0, -damping, 1.0], [0.0, 0.0, -1 / lag]])
    state, now, later = discretize(A, np.array([[0.0], [0.0], [1 / lag]]), record.dt)

    def pushes(commands: Array) -> Array:
        """(T − 1, 3) what commands (T, r) add to angle, rate and torque in each step."""
        early, late = delayed(commands - trim, steps)
        return np.asarray(
            np.outer(early @ motors, now[:, 0]) + np.outer(late @ motors, later[:, 0])
        )

    # The disturbance is what the mean of rate' = torque − damping · rate + disturbance leaves.
    turned = 0.0
    torques = []
    for before, outputs in record.segments:
        start = (before[0] - trim) @ motors
        driven = recursion(state[2:, 2:], pushes(before)[:, 2:], np.array([start]))
        torques.append(np.append(start, driven))
        turned += outputs[-1, order[1]] - outputs[0, order[1]]
    rate = record.outputs[:, order[1]].mean()
    torque = np.concatenate(torques)
    steady = turned / (len(record) * record.dt) + damping * rate - torque.mean()
    before, outputs = record.segments[-1]
    ahead = pushes(np.vstack([before, inputs]))[len(before) - 1 :]
    # A steady disturbance acts like a steady command.
    ahead += steady * (now + later)[:, 0]
    x = np.array([*outputs[-1, order], torques[-1][-1] + steady])
    path = np.empty((len(inputs), 2))
    for step, push in enumerate(ahead):
        x = state @ x + push
        path[step] = x[:2]
    return path


def _of_wind(physical: Physical, dt: float, steps: int) -> Array:
    """(H, 2) variance that the wind gives angle and rate from a known beginning."""
    A, drive, wind = with_wind(
        np.array([[0.0, 1.0], [0.0, -physical.damping]]), physical.components
    )
    A[1] += wind
    P = stationary(A, drive, 2)
    variance = np.empty((steps, 2))
    state = expm(A * dt)
    process = step_covariance(A, drive, dt)
    for step in range(steps):
        P = state @ P @ state.T + process
        variance[step] = P.diagonal()[:2]
    return variance
