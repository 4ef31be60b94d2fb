"""Step response: the closed loops of rate and attitude as a flight shows them, at any rate of its messages.

The response T of what is seen, p, to what is asked, r, is an impulse response of ``TAPS`` values, fitted by generalised
least squares: residuals are whitened by an autoregression, and windows with more of the wind count less, which is what
weights by coherence do. A smooth, decaying Gaussian process is its prior, averaged over sizes and decays by their
evidence; that tells resonances from noise without smoothing them, and shows in the band what was not asked.

Wind moves r as well, by the controller of the attitude: r = x − K φ. So r is replaced among the regressors by what of
it the pilot or the autopilot's navigation asks, x / (1 + K T / s), x = r + K φ: an instrument, with the last T.

The band is that of the scatter of the windows' scores, as of a jackknife, and of what the prior left out. A controller
with an integrator settles at 1, within ``STEADY``.

References: G. Pillonetto and G. De Nicolao, A new kernel-based approach for linear system identification, Automatica
46(1), 2010; L. Ljung, System Identification, 2nd ed., secs. 7.6 and 13.5, of instruments and of feedback.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.special import softmax

from mavdem.arrays import Array
from mavdem.confidence import INTERVAL_QUANTILES, coverage_factor
from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import (
    MIN_SLOW_MOTION_RATE,
    MIN_STREAM_RATE,
    Signals,
    rate_between_outages,
)
from mavdem.dataset.time_series import TimeSeries
from mavdem.dem.engine.linalg import SMALLEST_POSITIVE, normal_draws, one_thread
from mavdem.facts import Fact
from mavdem.facts.loops import StepResponses
from mavdem.immutable import ImmutableResult
from mavdem.loops.margins import Complex
from mavdem.loops.resonance import (
    FEWEST_WINDOWS,
    HIGHEST_SHARE,
    MIN_COHERENCE,
    USUAL_ANGLE_GAIN,
    Spectra,
    controller_if_known,
    evenly_sampled,
    spectra_of_pieces,
)

SECONDS = {"rate": 0.5, "attitude": 2.0}
"""Of a step's response, until it has settled; a window is two of them, and the one before."""
TAPS = 100  # of it at most: of rates up to 200 Hz, for resonances of up to half of that
MOST_WINDOWS = 300
NOISE_PASSES = 4
ORDER = 12  # of the autoregression of the residuals
SMOOTH = 0.04
SLOW_TAIL = 0.2, 2.0
SLOW_SHARE = 0.03
"""Of the prior, in shares of the step: lengths over which it is alike, and of the slow tail that an integrator leaves
that length, its decay, and its share of the variance."""
DECAYS = np.geomspace(0.06, 2.0, 6)
SIZES = np.geomspace(0.1, 1e5, 13)
STEADY = 0.03
LEAST_POWER = (
    1e-4  # of the setpoint's largest density: interpolation between samples leaves as much
)
LEAST_KNOWN = 0.25  # standard deviation of |T| beyond which it is not known
SETTLED = 0.05  # of the step: the band of the settling time
RESPONSE_DRAWS = 300
STEP_HERTZ = 0.05  # of the sum over a predicted response
DISAGREES = 0.3
"""Of the frequencies, at which prediction and band lie apart, where a tenth does by chance alone."""


FIGURES = ("overshoot", "rise_time", "settling", "delay", "peak", "peak_frequency")


class IntervalEstimate(NamedTuple):
    """A figure with its 90 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class StepResponse(ImmutableResult):
    """The closed loop of one axis as measured: after a step of 1 of its setpoint, and by frequency.

    Attributes:
        axis, loop: "roll", "pitch" or "yaw"; "rate" or "attitude".
        time: (K,) s after the step.
        step, step_half: (K,) response, and half widths of its 90 % band.
        frequency: (F,) Hz up to ``highest``.
        response, gain_half: (F,) T, and half widths of the 90 % band of |T|.
        max_frequency: Hz, up to which the flight shows it.
        windows: how many there were.
        overshoot: the largest step less 1, and less what noise adds to it.
        rise_time, settling, delay: s from 10 to 90 %, until it stays within 5 %, until one half.
        peak, peak_frequency: the largest |T|, and where it is, Hz.
        coherence: of setpoint and response there.
    """

    axis: str
    loop: str
    time: Array
    step: Array
    step_half: Array
    frequency: Array
    response: Complex
    gain_half: Array
    max_frequency: float
    windows: int
    overshoot: IntervalEstimate
    rise_time: IntervalEstimate
    settling: IntervalEstimate
    delay: IntervalEstimate
    peak: IntervalEstimate
    peak_frequency: IntervalEstimate
    coherence: float

    @property
    def gain(self) -> Array:
        """(F,) |T|."""
        return np.abs(self.response)

    @property
    def fact(self) -> Fact:
        """What it shows, with its highest frequency."""
        figures = {name: getattr(self, name).value for name in FIGURES}
        return Fact(
            StepResponses.STEP_MEASURED,
            subject=f"{self.axis} {self.loop}",
            overshoot_interval=self.overshoot[1:],
            peak_interval=self.peak[1:],
            coherence=self.coherence,
            highest=self.max_frequency,
            **figures,
        )

    def comparison(self, frequency: Array, closed: Complex) -> Fact:
        """Returns whether the ``closed`` loop (F′,) at Hz (F′,) that was predicted is the measured one.

        Where it is not, the prediction is doubted, unless it peaks beyond what the flight shows.
        """
        visible = frequency <= self.max_frequency
        predicted = np.interp(self.frequency, frequency, abs(closed))
        band = np.maximum(self.gain_half, STEADY)
        off = abs(predicted - self.gain) > band
        share = off.mean()
        subject = f"{self.axis} {self.loop}"
        peak = frequency[np.argmax(abs(closed))]
        if share <= DISAGREES:
            agrees = StepResponses.PREDICTION_AGREES
            return Fact(agrees, subject=subject, highest=self.max_frequency)
        code = StepResponses.PREDICTION_DOUBTED
        highest_peak = abs(closed).max()
        known_peak = abs(closed[visible]).max(initial=0.0)
        if highest_peak > known_peak:
            code = StepResponses.MEASUREMENT_DOUBTED
        return Fact(code, subject=subject, share=share, frequency=peak, highest=self.max_frequency)


def rate_step_response(signals: Signals, parts: Segments) -> StepResponse | Fact:
    """Returns the response of the body rate to its setpoint in ``parts`` of a flight, or why it is not known.

    ArduPilot's ATTITUDE_TARGET lacks the attitude controller's correction of the rate, which is added then.
    """
    if signals.rate_and_setpoint is None:
        return Fact(StepResponses.NO_SETPOINT, subject=f"{signals.axis} rate")
    rate, asked = signals.rate_and_setpoint
    used = [asked, rate]
    attitude = signals.attitude
    if attitude is not None and rate.time is attitude.time:
        used += [
            signal
            for signal in (attitude.angle_series, signals.angle_setpoint)
            if signal is not None
        ]
    return _response(signals, "rate", used, parts, MIN_STREAM_RATE)


def attitude_step_response(signals: Signals, parts: Segments) -> StepResponse | Fact:
    """Returns the response of the angle to its setpoint in ``parts`` of a flight, or why it is not known."""
    if signals.angle_setpoint is None or signals.attitude is None:
        return Fact(StepResponses.NO_SETPOINT, subject=f"{signals.axis} attitude")
    used = [signals.angle_setpoint, signals.attitude.angle_series]
    return _response(signals, "attitude", used, parts, MIN_SLOW_MOTION_RATE)


def _response(
    signals: Signals, loop: str, used: Sequence[TimeSeries], parts: Segments, least: float
) -> StepResponse | Fact:
    """That of the second of ``used`` to the first; or that messages are too slow, too few, or too little was asked."""
    subject = f"{signals.axis} {loop}"
    seconds = SECONDS[loop]
    if min(map(rate_between_outages, used)) < least:
        return Fact(StepResponses.TOO_SLOW, subject=subject, least_rate=least)
    grid = evenly_sampled(used, parts, 4 * seconds, least, TAPS / seconds)
    if grid is None:
        return Fact(StepResponses.TOO_LITTLE_FLIGHT, subject=subject, least_duration=4 * seconds)
    sampled, pieces = grid
    pieces = [piece for piece in pieces if np.ptp(piece[0])]
    samples = sum(piece.shape[1] for piece in pieces)
    least_samples = 2 * FEWEST_WINDOWS * seconds * sampled
    if samples < least_samples:
        return Fact(StepResponses.TOO_LITTLE_ASKED, subject=subject)
    controller = controller_if_known(signals)
    gain = USUAL_ANGLE_GAIN if controller is None else controller.angle_gain
    gain *= loop == "rate"
    if loop == "rate" and len(used) < 3:
        pieces = [np.vstack([piece, np.cumsum(piece[1]) / sampled]) for piece in pieces]
    if len(used) > 3 and not _is_corrected(sampled, pieces, gain):
        for piece in pieces:
            piece[0] += gain * (piece[3] - piece[2])
    fit = _fitted(sampled, pieces, gain, seconds)
    spectra = spectra_of_pieces(sampled, pieces)
    return _described(signals.axis, loop, sampled, fit, spectra)


def _is_corrected(sampled: float, pieces: Sequence[Array], gain: float) -> bool:
    """Whether the rate's setpoint has the correction of the attitude's error in it, by ``gain``, 1/s."""
    asked, _, angle, wanted = np.concatenate(pieces, axis=1)
    turning = sampled * np.gradient(wanted)
    terms = np.column_stack([turning, gain * (wanted - angle)])
    fitted = np.linalg.lstsq(terms, asked)[0]
    return fitted[1] > 0.5


class _Fit(NamedTuple):
    """Impulse response, and its covariance."""

    weights: Array  # (K,) of the last K setpoints, the last first; their sum is T at 0 Hz
    covariance: Array  # (K, K)
    windows: int


def _fitted(sampled: float, pieces: Sequence[Array], angle_gain: float, seconds: float) -> _Fit:
    """By ``pieces`` (k, N) of a setpoint, what follows it and, with an ``angle_gain``, the angle."""
    taps = round(seconds * sampled)
    size = 3 * taps
    lags = np.arange(1, taps + 1) / taps
    decay = np.exp(-5 * lags)
    weights = decay / decay.sum()
    asked, seen = (_windows([piece[row] for piece in pieces], taps, size) for row in range(2))
    with one_thread():
        for _ in range(NOISE_PASSES):
            driver = asked
            if angle_gain:
                clean = [_without_feedback(piece, angle_gain, weights, sampled) for piece in pieces]
                driver = _windows(clean, taps, size)
            explained = _regressors(asked, taps) @ weights
            left = seen[:, taps:] - explained
            whitening = _autoregression(left)
            spread = _filtered(left, whitening).std(axis=1)
            # A window of nothing but repeated samples leaves nothing, and would count for all the others.
            scale = np.maximum(spread, spread.max() / 1e3 + SMALLEST_POSITIVE)[:, None]
            r, p, z = (_filtered(series, whitening) / scale for series in (asked, seen, driver))
            fit = _step(r, p, z, taps)
            weights = fit.weights
    return fit


def _without_feedback(piece: Array, angle_gain: float, weights: Array, sampled: float) -> Array:
    """(N,) the rate's setpoint that remains where the angle moves by it alone: x / (1 + K T / s)."""
    size = piece.shape[1]
    outer = piece[0] + angle_gain * piece[2]
    there_and_back = np.append(outer, outer[::-1])
    mirrored = np.fft.rfft(there_and_back)
    frequency = np.fft.rfftfreq(2 * size, 1 / sampled)
    positive = np.maximum(frequency, frequency[1] / 100)
    s = 2j * np.pi * positive
    impulse = np.append(0.0, weights)
    closed = np.fft.rfft(impulse, 2 * size)
    feedback = angle_gain * closed / s
    driving = mirrored / (1 + feedback)
    return np.fft.irfft(driving, 2 * size)[:size]


def _windows(series: Sequence[Array], taps: int, size: int) -> Array:
    """(W, size) windows of all pieces but their first ``2 taps``, each with ``taps`` of the one before."""
    views = [
        np.lib.stride_tricks.sliding_window_view(part[2 * taps :], size)[:: size - taps]
        for part in series
        if len(part) >= 2 * taps + size
    ]
    windows = np.concatenate([*views, np.zeros((0, size))])
    every = -(-len(windows) // MOST_WINDOWS) or 1
    return windows[::every]


def _regressors(windows: Array, taps: int) -> Array:
    """(W, B, K) the ``taps`` values before each sample of windows, but for their first K, the last first."""
    return np.lib.stride_tricks.sliding_window_view(windows, taps, axis=1)[:, :-1, ::-1]


def _filtered(windows: Array, polynomial: Array) -> Array:
    """(W, T − P) windows (W, T) through a filter of P + 1 taps."""
    views = np.lib.stride_tricks.sliding_window_view(windows, len(polynomial), axis=1)
    return views @ polynomial[::-1]


def _autoregression(left: Array) -> Array:
    """The filter (P,) that whitens residuals (W, B), and takes their mean away."""
    steps = np.diff(left, axis=1)
    size = steps.shape[1]
    covariance = [np.mean(steps[:, : size - lag] * steps[:, lag:]) for lag in range(ORDER + 1)]
    covariance[0] *= 1 + 1e-6
    own = solve_toeplitz(covariance[:-1], covariance[1:])
    whitening = np.append(1.0, -own)
    return np.convolve(whitening, [1.0, -1.0])


def _step(asked: Array, seen: Array, driver: Array, taps: int) -> _Fit:
    """The weights of ``asked`` that explain ``seen``, all (W, size), by the instrument ``driver``; errors are white."""
    measured, instruments = (_regressors(values, taps) for values in (asked, driver))
    target = seen[:, taps:]
    normal, own = (
        np.tensordot(instruments, values, axes=((0, 1), (0, 1)))
        for values in (instruments, measured)
    )
    moment = np.tensordot(instruments, target, axes=((0, 1), (0, 1)))
    steady = np.full(taps, 1 / STEADY)
    constraint = np.outer(steady, steady)
    precision = normal + constraint
    pulled = moment + steady / STEADY
    prior = _prior(precision, pulled)
    informed = own + constraint
    identity = np.eye(taps)
    inverse = np.linalg.solve(identity + prior @ informed, prior)
    weights = inverse @ pulled
    left = target - measured @ weights
    scores = np.einsum("wbk,wb->wk", instruments, left) @ inverse.T
    used = np.trace(inverse @ own)
    windows = len(seen)
    # As a jackknife has it: each window draws the estimate towards itself.
    free_windows = max(windows - used, windows / 4)
    scatter = scores.T @ scores * windows / free_windows
    missed = identity - inverse @ informed
    by_steady = inverse @ steady
    biased = missed @ prior @ missed.T
    covariance = scatter + biased + np.outer(by_steady, by_steady)
    return _Fit(weights, covariance, windows)


def _prior(precision: Array, moment: Array) -> Array:
    """(K, K) the covariance of the weights before the flight, over sizes and decays by their evidence."""
    taps = len(moment)
    after = np.linspace(0.0, 1.0, taps + 1)
    shapes = []
    evidence = []
    for decay in DECAYS:
        slow = SLOW_SHARE * _matern(after, *SLOW_TAIL)
        shape = _matern(after, SMOOTH, decay) + slow
        # The response begins at 0.
        from_zero = shape - np.outer(shape[0], shape[0]) / shape[0, 0]
        shape = from_zero[1:, 1:] / taps**2
        jitter = 1e-8 * np.trace(shape) / taps * np.eye(taps)
        root = np.linalg.cholesky(shape + jitter)
        projected = root.T @ precision @ root
        values, vectors = np.linalg.eigh(projected)
        sizes = SIZES[:, None]
        gained = sizes * np.maximum(values, 0.0)
        along = vectors.T @ (root.T @ moment)
        fits = sizes * along**2 / (1 + gained)
        shapes.append(shape)
        evidence.append((fits - np.log1p(gained)).sum(axis=1) / 2)
    return np.tensordot(softmax(evidence) @ SIZES, shapes, axes=1)


def _matern(after: Array, length: float, decay: float) -> Array:
    """(K, K) Matérn's covariance of 5/2, decaying, at shares of the step's duration (K,)."""
    between = np.abs(np.subtract.outer(after, after))
    apart = between * 5**0.5 / length
    polynomial = 1 + apart + apart**2 / 3
    alike = polynomial * np.exp(-apart)
    decayed = np.exp(-np.add.outer(after, after) / decay)
    return alike * decayed


def _described(
    axis: str, loop: str, sampled: float, fit: _Fit, spectra: Spectra | None
) -> StepResponse | Fact:
    """Figures of a fit, with intervals of draws; or that too little is known at any frequency."""
    nothing = Fact(StepResponses.TOO_LITTLE_ASKED, subject=f"{axis} {loop}")
    if spectra is None:
        return nothing
    taps = len(fit.weights)
    time = np.arange(1, taps + 1) / sampled
    # Setpoints of the angle may come without stamps of their own.
    highest = HIGHEST_SHARE * sampled / (2 if loop == "rate" else 4)
    hertz = np.linspace(0.5, highest, 2 * taps)
    drawn = normal_draws(fit.weights, fit.covariance, RESPONSE_DRAWS, seed=31)
    every = np.vstack([fit.weights, drawn])
    # By Euler and Maclaurin: between two values the response is not straight.
    slopes = np.eye(taps, k=-1) - np.eye(taps, k=1)
    bends = every @ slopes / 24
    steps = np.cumsum(every, axis=1) - every / 2 - bends
    turns = np.outer(time, hertz)
    responses = every @ np.exp(-2j * np.pi * turns)
    gains = abs(responses)
    spread = gains[1:].std(axis=0)
    too_wide = np.flatnonzero(spread > LEAST_KNOWN)
    unknown = np.append(too_wide, len(hertz))[0]
    is_asked = spectra.driver >= LEAST_POWER * spectra.driver.max()
    coherence = np.where(is_asked, spectra.coherence, 0.0)
    is_coherent = coherence >= MIN_COHERENCE
    asked = spectra.frequency[is_coherent].max(initial=0.0)
    unknown = min(unknown, np.searchsorted(hertz, asked))
    half = coverage_factor() * steps[1:].std(axis=0)
    if unknown < 2 or half.max() >= 1.0:  # such a band holds no response, and twice as much
        return nothing
    hertz = hertz[:unknown]
    overshoot, *others = _figures(time, steps, hertz, gains[:, :unknown])
    # Noise adds to the highest value of a step: as much as each draw adds to it again.
    added = overshoot - overshoot[0]
    added[0] = added[1:].mean()
    estimates = map(_estimate, [np.maximum(overshoot[0] - added, 0.0), *others])
    figures = dict(zip(FIGURES, estimates, strict=True))
    return StepResponse(
        axis=axis,
        loop=loop,
        time=time,
        step=steps[0],
        step_half=half,
        frequency=hertz,
        response=responses[0, :unknown],
        gain_half=coverage_factor() * gains[1:, :unknown].std(axis=0),
        max_frequency=hertz[-1],
        windows=fit.windows,
        coherence=np.interp(figures["peak_frequency"].value, spectra.frequency, coherence),
        **figures,
    )


def _figures(time: Array, steps: Array, hertz: Array, gains: Array) -> tuple[Array, ...]:
    """Those of ``FIGURES``, each (N,), of steps (N, K) and |T| (N, F)."""
    tenth, half, most = (_reached(time, steps, level) for level in (0.1, 0.5, 0.9))
    rise = np.where(most < time[-1], most - tenth, most)
    is_off = abs(steps - 1) > SETTLED
    settled = (is_off * time).max(axis=1, initial=time[0])
    overshoot = np.maximum(steps.max(axis=1) - 1, 0.0)
    return overshoot, rise, settled, half, gains.max(axis=1), hertz[gains.argmax(axis=1)]


def _reached(time: Array, steps: Array, level: float) -> Array:
    """(N,) when steps (N, K) first have a ``level``, between their values; the last time where one never has."""
    highest = np.maximum.accumulate(steps, axis=1)
    is_below = highest <= level
    low = highest.max(axis=1, where=is_below, initial=0.0)
    high = highest.min(axis=1, where=~is_below, initial=np.inf)
    values = is_below.sum(axis=1) + (level - low) / (high - low)
    return np.interp(values, np.arange(len(time) + 1), [0.0, *time])


def step_from_frequency_response(frequency: Array, closed: Complex, time: Array) -> Array:
    """Returns (T,) what follows a step of 1 of the setpoint of a ``closed`` loop (F,), by its frequencies, Hz.

    It is 2/π ∫ Re(T) sin(ωt)/ω dω.
    """
    even = np.arange(STEP_HERTZ / 2, frequency[-1], STEP_HERTZ)
    real = np.interp(even, frequency, closed.real)
    angles = 2 * np.pi * np.outer(time, even)
    waves = np.sin(angles) / even
    return waves @ real * STEP_HERTZ * 2 / np.pi


def _estimate(values: Array) -> IntervalEstimate:
    """The first of values (N,), and the interval of the others, widened to hold it."""
    low, high = np.quantile(values[1:], INTERVAL_QUANTILES).tolist()
    value = values[0]
    return IntervalEstimate(value, min(low, value), max(high, value))
