"""Physical parameters (gray-box model) of a whole flight: each motor's effect, the damping, and the motors' lag.

The model is that of :mod:`mavdem.dem.graybox.likelihood`. All settled flight is cut into windows of about 7 s. Effect,
damping and lag belong to the vehicle and are the same in all of them; trim and the level of the wind are each window's
own. See docs/physical.md.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt
from scipy.stats import norm

from mavdem.dem.engine.linalg import Array, inverse, one_thread
from mavdem.dem.graybox.coloured import Coloured
from mavdem.dem.graybox.fitting import WINDS, GrayBoxFit, directed, fitted, log_likelihood
from mavdem.dem.graybox.identifiability import (
    PARAMETERS,
    SLOW_BIAS,
    SLOWEST_RATE,
    IdentifiabilityFigures,
    Status,
    judged,
)
from mavdem.dem.graybox.likelihood import DAMPING, LAG, FlightWindows, Parameters, lagged
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record, UniformRecord
from mavdem.dem.validation import LEVEL, require_probability

EFFECT_ERROR, DAMPING_ERROR, LAG_ERROR, DELAY_ERROR = 0.03, 0.3, 0.05, 0.002
"""Standard deviations of nonlinear effects: as a share of the effect, which changes with the tilt in wind; of damping,
1/s; as a share of the lag, since rotors spin up twice as fast as they slow down; and of the delay, s. By so much
simulated flights differ from the same vehicle linearised, sampled at every step of their controller."""

WINDOW_SECONDS, SHORTEST_WINDOW_SECONDS = 7.0, 2.0
MIN_SAMPLES = 200
CHOOSING_WINDOWS = 10  # of which the wind's spectrum and the refinements are chosen
MIN_REFINING_WINDOWS, MIN_GAIN_NATS = 4, 3.0  # windows below which nothing is refined, and what unseen ones must gain
BAND_HZ, MAX_BAND_SHARE = (0.4, 6.0), 0.125  # of the roll motion; its upper end in shares of the sampling rate


class WindComponent(NamedTuple):
    """One component of the wind: noise of this ``colour`` with standard deviation ``size``, rad/s², and ``time``, s."""

    colour: Coloured
    size: float
    time: float


class PhysicalInterval(NamedTuple):
    """Half widths; NaN where a parameter is not identifiable."""

    effect: Array  # (r,)
    damping: float
    lag: float
    delay: float


class WindowTable(NamedTuple):
    """FlightWindows of the flight, W of them, each with an estimate of its own, to first order about that of all.

    Attributes:
        start: (W,) s of the given samples before it.
        effect, effect_sd: (W,) mean magnitude over the motors, rad/s² per unit of input, and its standard deviation.
        damping, damping_sd: (W,) 1/s.
        lag, lag_sd: (W,) s.
        wind: (W,) standard deviation of the wind's torque, rad/s², its constant part not included.
    """

    start: Array
    effect: Array
    effect_sd: Array
    damping: Array
    damping_sd: Array
    lag: Array
    lag_sd: Array
    wind: Array


class Physical(NamedTuple):
    """Physical parameters of one axis.

    Attributes:
        effect: (r,) of each motor on the angular acceleration in steady state, rad/s² per unit of input.
        damping: of the rate by itself, 1/s.
        lag: time constant of the motors, s.
        delay: of their commands, s; dead time of the stream is in it.
        covariance: (r + 3, r + 3) of effect, damping, lag and delay: of the estimate, its spread from window to window,
            over the wind's possible spectra, and nonlinear effects.
        status: "reported", "biased" or "not identifiable", by "effect", "damping" and "lag".
        reasons: likewise, a sentence or two; empty where nothing is to be said.
        bias: likely relative error of the effect, negative where it comes out low; 0 unless it is biased by the rate.
        wind: standard deviation of the angular acceleration that is not by the motors, rad/s², without its constant.
        wind_share: of its variance in the sum with that of the motors' torque, in the band of the motion.
        components: of the wind.
        noise: standard deviation of the measured rate's white noise, rad/s.
        refinements: parameters that predict unseen windows better, by name (docs/physical.md).
        windows: a table over time.
    """

    effect: Array
    damping: float
    lag: float
    delay: float
    covariance: Array
    status: dict[str, Status]
    reasons: dict[str, str]
    bias: float
    wind: float
    wind_share: float
    components: tuple[WindComponent, ...]
    noise: float
    refinements: dict[str, float]
    windows: WindowTable

    @property
    def motors(self) -> Array:
        """Deprecated name of :attr:`effect`."""
        warnings.warn("Physical.motors is now Physical.effect", DeprecationWarning, stacklevel=2)
        return self.effect

    @property
    def identifiable(self) -> bool:
        """Whether the motors' effect is reported, be it with a bias."""
        return self.status["effect"] != "not identifiable"

    @property
    def told(self) -> bool:
        """Deprecated name of :attr:`identifiable`."""
        warnings.warn("Physical.told is now Physical.identifiable", DeprecationWarning, stacklevel=2)
        return self.identifiable

    @property
    def caution(self) -> str | None:
        """Why the effect is not identifiable; ``None`` where it is."""
        return None if self.identifiable else f"The motors' effect is not identifiable. {self.reasons['effect']}"

    def interval(self, level: float = LEVEL) -> PhysicalInterval:
        """Half widths of intervals that hold each parameter with probability ``level``; a likely bias widens them.

        Raises:
            ValueError: a level that is no probability between 0 and 1.
        """
        require_probability(level)
        half = norm.ppf(0.5 + level / 2) * np.sqrt(self.covariance.diagonal())
        half[:-3] += np.abs(self.bias * self.effect)
        effect, damping, lag = (
            np.where(self.status[name] == "not identifiable", np.nan, part)
            for name, part in zip(PARAMETERS, (half[:-3], half[-3], half[-2]), strict=True)
        )
        delay = np.nan if self.status["lag"] == "not identifiable" else half[-1]
        return PhysicalInterval(effect, float(damping), float(lag), float(delay))


def physical(train: UniformRecord | Sequence[UniformRecord]) -> Physical:
    """Estimates the motors' effect, damping and lag from all that is given.

    Takes about a second for 60 s at 100 Hz. Forecasts do not use it.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: rates in rad/s. The rate is the output that
            is the derivative of another, or the only one.

    Raises:
        ValueError: no output is the rate of another, there are too few samples, no motor moves, or there is no steady
            filter.
    """
    record = Record.of(train)
    if not record.inputs.std(axis=0).any():
        raise ValueError("physical parameters need motors that move: all inputs are constant")
    rate = rate_column(record)
    windows, starts, unit = _windows(record, rate)
    with one_thread():
        fits, refined = _chosen(windows, record.effect_directions)
        whole = fitted(refined.parameters, windows, refined.theta) if len(windows.rate) > CHOOSING_WINDOWS else refined
    return _result(whole, fits, windows, starts, unit)


def rate_column(record: Record) -> int:
    """Which output is the rate: the derivative of another, or the only one; ``ValueError`` where none is."""
    if record.outputs.shape[1] == 1:
        return 0
    pairs = derivative_pairs(record)
    if not pairs:
        raise ValueError("physical parameters need an angle and its rate: no output is the derivative of another")
    return pairs[0][1]


def _windows(record: Record, rate: int) -> tuple[FlightWindows, Array, float]:
    """FlightWindows of one length, s before each, and the unit of their inputs."""
    shortest = max(MIN_SAMPLES, round(SHORTEST_WINDOW_SECONDS / record.dt))
    if record.longest < shortest:
        raise ValueError(
            f"physical parameters need at least {shortest} samples without long gaps, not {record.longest}"
        )
    # Up to half as long again, or down to what there is, so that as little as possible is left over.
    usual = min(round(WINDOW_SECONDS / record.dt), record.longest)
    lengths = [length for length in range(usual, int(1.5 * usual) + 1, max(1, usual // 50)) if length <= record.longest]
    length = max(lengths, key=lambda length: sum(own // length for own in record.lengths) * length)
    begins = np.concatenate(
        [start + length * np.arange(own // length) for start, own in zip(record.starts, record.lengths, strict=True)]
    ).astype(np.intp)
    places = begins[:, None] + np.arange(length)
    inputs = record.inputs - record.inputs[places].mean(axis=(0, 1))
    unit = float(np.sqrt(np.mean(inputs[places].var(axis=(0, 1)))))
    if not unit:
        raise ValueError("physical parameters need motors that move: all inputs are constant")
    rates = record.outputs[:, rate]
    return FlightWindows(inputs[places] / unit, rates[places], None, record.dt), np.asarray(record.dt * begins), unit


def _chosen(windows: FlightWindows, directions: Array | None) -> tuple[list[GrayBoxFit], GrayBoxFit]:
    """A fit for each wind that has one, and the most probable one with the refinements that unseen windows bear out."""
    count = len(windows.rate)
    some = windows.of(np.linspace(0, count - 1, min(count, CHOOSING_WINDOWS)).round().astype(np.intp))
    plain, start = directed(some, directions)
    fits = []
    for wind in WINDS:
        parameters = plain._replace(wind=wind)
        first = parameters.prior[0]
        first[0] = start[0]
        try:
            fits.append(fitted(parameters, some, first))
        except np.linalg.LinAlgError:
            continue
    if not fits:
        raise ValueError("there is no steady filter for these motors and rates: take another part of the flight")
    best = max(fits, key=lambda fit: fit.evidence)
    if len(some.rate) < MIN_REFINING_WINDOWS:
        return fits, best
    return fits, _refined(best, some)


def _refined(plain: GrayBoxFit, windows: FlightWindows) -> GrayBoxFit:
    """With each refinement that predicts windows better that it was not fitted to, in two-fold cross-validation."""
    names = ["thrust curve", "spin-up"] + (["voltage"] if windows.voltage is not None else [])
    chosen, score = plain, _unseen(plain.parameters, windows, plain.theta)
    for name in names:
        parameters = chosen.parameters._replace(refinements=(*chosen.parameters.refinements, name))
        start = np.append(chosen.theta, 0.0)
        try:
            tried = _unseen(parameters, windows, start)
        except np.linalg.LinAlgError:
            continue
        if min(tried - score) > 0 and sum(tried - score) > MIN_GAIN_NATS:
            chosen, score = fitted(parameters, windows, start), tried
    return chosen


def _unseen(parameters: Parameters, windows: FlightWindows, start: Array) -> Array:
    """(2,) log likelihood of every other window with parameters fitted to those between."""
    found = []
    for half in (0, 1):
        fit = fitted(parameters, windows.of(slice(half, None, 2)), start)
        errors, _ = parameters.innovations(fit.theta[None], windows.of(slice(1 - half, None, 2)))
        found.append(log_likelihood(errors[0]))
    return np.array(found)


def _result(
    whole: GrayBoxFit, fits: Sequence[GrayBoxFit], windows: FlightWindows, starts: Array, unit: float
) -> Physical:
    parameters, theta, r = whole.parameters, whole.theta, whole.parameters.motors
    scaled = parameters.effect(theta)
    damping, delay = float(np.exp(theta[r + 1])), float(max(theta[r + 3], 0.0))
    lag, own_lag = float(parameters.lag(theta, windows.dt)), float(np.exp(theta[r + 2]))
    # Of the logarithm of the lag by θ: less than 1 where the lag is near the shortest.
    near = (own_lag / lag) ** 2
    # Effect, damping, lag and delay by θ.
    slopes = np.zeros((r + 3, len(theta)))
    slopes[:r, 0], slopes[:r, 1 : r + 1] = scaled, np.exp(theta[0]) * np.eye(r)
    slopes[r, r + 1], slopes[r + 1, r + 2], slopes[r + 2, r + 3] = damping, lag * near, 1.0
    own = inverse(whole.curvature)
    along = np.zeros(len(theta))
    along[: r + 1] = np.append(1.0, _share(scaled) * np.exp(theta[0]) / scaled)
    ways = np.vstack([along, np.eye(len(theta))[r + 1], near * np.eye(len(theta))[r + 2]])
    table, between = _over_time(whole, ways, parameters, starts, unit, windows.dt)
    by_wind = [[_log_effect(fit), fit.theta[r + 1], np.log(fit.parameters.lag(fit.theta, windows.dt))] for fit in fits]
    spread = dict(zip(PARAMETERS, np.ptp(by_wind, axis=0).tolist(), strict=True))
    relative = np.sqrt(np.einsum("ij,jk,ik->i", ways, own, ways))
    share, aliased = _wind_share(parameters, theta, windows, whole.levels), _aliased(parameters, theta, windows)
    figures = IdentifiabilityFigures(
        wind_share=share,
        aliased=aliased,
        sd=dict(zip(PARAMETERS, relative.tolist(), strict=True)),
        changed=dict(zip(PARAMETERS, np.sqrt(between).tolist(), strict=True)),
        spread=spread,
        prior={"effect": np.inf, "damping": DAMPING[1], "lag": LAG[1]},
        lag=own_lag,
        dt=windows.dt,
    )
    status, reasons = judged(figures)
    covariance = slopes @ own @ slopes.T
    covariance[:r, :r] += np.outer(scaled, scaled) * (between[0] + spread["effect"] ** 2 / 12)
    covariance[:r, :r] += np.diag(scaled**2) * EFFECT_ERROR**2
    covariance[r, r] += damping**2 * (between[1] + spread["damping"] ** 2 / 12) + DAMPING_ERROR**2
    covariance[r + 1, r + 1] += lag**2 * (between[2] + spread["lag"] ** 2 / 12 + LAG_ERROR**2)
    covariance[-1, -1] += DELAY_ERROR**2
    scale = np.append(np.full(r, 1 / unit), np.ones(3))
    sizes = np.sqrt(np.mean(whole.levels**2)) * parameters.sizes(theta)
    components = tuple(
        WindComponent(colour, float(size), float(time))
        for colour, size, time in zip(parameters.wind, sizes, parameters.times(theta), strict=True)
    )
    return Physical(
        effect=scaled / unit,
        damping=damping,
        lag=lag,
        delay=delay,
        covariance=covariance * np.outer(scale, scale),
        status=status,
        reasons=reasons,
        bias=SLOW_BIAS if 1 / windows.dt < SLOWEST_RATE else 0.0,
        wind=float(np.sqrt(np.sum(sizes**2))),
        wind_share=share,
        components=components,
        noise=float(np.sqrt(np.mean(whole.levels**2)) * np.exp(theta[parameters.of_noise])),
        refinements=dict(zip(parameters.refinements, theta[parameters.of_noise + 1 :].tolist(), strict=True)),
        windows=table,
    )


def _share(effect: Array) -> Array:
    """(r,) slopes of the logarithm of the mean magnitude by the logarithm of each motor's effect."""
    return np.asarray(np.abs(effect) / np.abs(effect).sum())


def _log_effect(fit: GrayBoxFit) -> float:
    return float(np.log(np.abs(fit.parameters.effect(fit.theta)).mean()))


def _over_time(
    whole: GrayBoxFit, ways: Array, parameters: Parameters, starts: Array, unit: float, dt: float
) -> tuple[WindowTable, Array]:
    """Each window's own estimate, and (3,) the variance that the spread between windows adds to the mean's.

    A step of Fisher's scoring from the estimate of all, with the prior about it. The spread is that of a random-effects
    model (DerSimonian and Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7, 1986).
    """
    _, sd = parameters.prior
    covariances = np.linalg.inv(whole.information + np.diag(sd**-2.0))
    steps = np.einsum("wij,wj->wi", covariances, whole.scores)
    off = steps @ ways.T
    own = np.einsum("ij,wjk,ik->wi", ways, covariances, ways)
    # The prior draws each window's estimate towards that of all: undone, as far as that was little.
    drawn = np.clip(1 - own / np.einsum("ij,j,ij->i", ways, sd**2, ways), 0.25, 1.0)
    off, own = off / drawn, own / drawn
    between = np.array([_added(values, variances) for values, variances in zip(off.T, own.T, strict=True)])
    theta, r = whole.theta, parameters.motors
    effect = np.abs(parameters.effect(theta)).mean() / unit
    sds = np.sqrt(own)
    damping, lag = np.exp(theta[r + 1]), parameters.lag(theta, dt)
    sizes = float(np.sqrt(np.sum(parameters.sizes(theta) ** 2)))
    values, errors = np.exp(np.clip(off, -3, 3)) * [effect, damping, lag], sds * [effect, damping, lag]
    table = WindowTable(
        starts, values[:, 0], errors[:, 0], values[:, 1], errors[:, 1], values[:, 2], errors[:, 2], whole.levels * sizes
    )
    return table, between


def _added(values: Array, variances: Array) -> float:
    """What the spread between windows adds to the variance of their mean."""
    count = len(values)
    if count < 2:
        return 0.0
    weights = 1 / variances
    mean = float(weights @ values / weights.sum())
    excess = float(weights @ (values - mean) ** 2) - (count - 1)
    between = max(0.0, excess / float(weights.sum() - weights @ weights / weights.sum()))
    return 1 / float((1 / (variances + between)).sum()) - 1 / float(weights.sum())


def _wind_share(parameters: Parameters, theta: Array, windows: FlightWindows, levels: Array) -> float:
    """Of the variance of wind and motors together, in the band of the motion; windows count as they do in the fit."""
    r, rate = parameters.motors, 1 / windows.dt
    commanded, lag = parameters.commanded(theta, windows), float(parameters.lag(theta, windows.dt))
    torque = lagged(commanded[:, :, None], lag, windows.dt)[:, :, 0]
    turning = np.gradient(windows.rate, windows.dt, axis=1) + np.exp(theta[r + 1]) * windows.rate
    band = butter(2, (BAND_HZ[0], min(BAND_HZ[1], MAX_BAND_SHARE * rate)), "bandpass", fs=rate, output="sos")
    of_motors, of_all = (sosfiltfilt(band, each, axis=1) for each in (torque, turning))
    wind, motors = (float(np.mean(each.var(axis=1) / levels**2)) for each in (of_all - of_motors, of_motors))
    return wind / (wind + motors)


def _aliased(parameters: Parameters, theta: Array, windows: FlightWindows) -> float:
    """The share of the commands' variance above half of the Nyquist frequency, each window without its mean."""
    commands = parameters.commanded(theta, windows)
    commands = commands - commands.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(commands * np.hanning(commands.shape[1]), axis=1)) ** 2
    return float(power[:, power.shape[1] // 2 :].sum() / power.sum())
