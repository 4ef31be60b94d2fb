"""Estimation of physical parameters from a whole flight.

The model is that of :mod:`mavdem.dem.graybox.likelihood`. All that is given is cut into windows of about 7 s. Effect,
damping and lag belong to the vehicle and are the same in all of them; trim and the level of the wind are each window's
own. See docs/physical.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from mavdem.dem.engine.linalg import Array, inverse, one_thread
from mavdem.dem.graybox.fitting import WINDS, GrayBoxFit, directed, fitted, log_likelihood
from mavdem.dem.graybox.identifiability import (
    PARAMETERS,
    REPORTED_SHARE,
    SLOW_BIAS,
    SLOW_SD,
    SLOWEST_RATE,
    WIND_BIAS_SD,
    IdentifiabilityFigures,
    judged,
)
from mavdem.dem.graybox.instruments import LOOP, Instrumental, exogenous, instrumental
from mavdem.dem.graybox.likelihood import DAMPING, LAG, REFINEMENTS, FlightWindows, Parameters, lagged
from mavdem.dem.graybox.parameters import Cut, Physical, WindComponent, WindowTable, cut
from mavdem.dem.record import Record, UniformRecord

EFFECT_ERROR, MOTOR_ERROR = 0.025, 0.015
DAMPING_ERROR, LAG_ERROR, DELAY_ERROR = 0.3, 0.05, 0.002
"""Standard deviations of nonlinear effects: as a share of the effect, which changes with the tilt in wind, of all
motors and of each; of damping, 1/s; as a share of the lag, since rotors spin up twice as fast as they slow down; and of
the delay, s. By so much simulated flights differ from the same vehicle linearised, sampled at every step of their
controller."""

CHOOSING_WINDOWS = 10  # of which the wind's spectrum and the refinements are chosen
MIN_REFINING_WINDOWS, MIN_GAIN_NATS = 4, 3.0  # windows below which nothing is refined, and what unseen ones must gain
RANGE = 1.69  # of three values, in their standard deviations
BAND_HZ, MAX_BAND_SHARE = (0.4, 6.0), 0.125  # of the roll motion; its upper end in shares of the sampling rate


class _Theta(NamedTuple):
    """θ (k,) with its covariance (k, k), of the estimate by itself.

    ``between`` (3,) is the variance that the spread over windows adds to the logarithms of mean effect, damping and
    lag; ``spread`` (3,) is their range over the wind's possible spectra.
    """

    theta: Array
    covariance: Array
    between: Array
    spread: Array


def physical(train: UniformRecord | Sequence[UniformRecord]) -> Physical:
    """Estimates the motors' effect, damping and lag from all that is given.

    Takes about three seconds for 60 s at 100 Hz. Forecasts do not use it.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: rates in rad/s. The rate is the output that
            is the derivative of another, or the only one.

    Raises:
        ValueError: no output is the rate of another, there are too few samples, no motor moves, or there is no steady
            filter.
    """
    record = Record.of(train)
    pieces = cut(record)
    windows = pieces.windows
    with one_thread(), np.errstate(all="ignore"):  # what overflows is not finite, and no step goes there
        fits, refined = _chosen(windows, record.effect_directions)
        whole = fitted(refined.parameters, windows, refined.theta) if len(windows.rate) > CHOOSING_WINDOWS else refined
        estimate, table = _by_prediction_errors(whole, fits, pieces)
        figures = _figures(whole, estimate, windows)
        status, reasons = judged(figures)
        by_wind = figures.wind_share
        if status["effect"] != "reported" and (by := _by_instruments(whole, pieces)) is not None:
            steered = _with_instruments(estimate, by)
            better, why = judged(_figures(whole, steered, windows)._replace(wind_share=0.0))
            if better["effect"] == "reported":
                turned = [name for name in PARAMETERS if better[name] == "reported" != status[name]]
                said = f"Reported with the {' and '.join(by.names)} as instrument. Without:"
                reasons = why | {name: f"{said} {reasons[name]}" for name in turned}
                estimate, status, by_wind = steered, better, 0.0
    return _physical(whole, estimate, pieces, table, by_wind)._replace(
        status=status, reasons=reasons, wind_share=figures.wind_share
    )


def _by_instruments(whole: GrayBoxFit, pieces: Cut) -> Instrumental | None:
    if pieces.setpoints is None:
        return None
    sticks = [column for column, name in enumerate(pieces.setpoint_names) if not name.endswith(LOOP)]
    asked = pieces.setpoints[:, :, sticks]
    known = np.flatnonzero(np.isfinite(asked).all(axis=(1, 2)))
    if not (sticks and len(known)):
        return None
    moving = exogenous(asked[known], pieces.outputs[known], pieces.windows.dt)
    names = tuple(pieces.setpoint_names[sticks[column]] for column in moving)
    return instrumental(whole, pieces.windows.of(known), asked[known][:, :, moving], names) if moving else None


def _with_instruments(plain: _Theta, found: Instrumental) -> _Theta:
    places, covariance = found.places, plain.covariance.copy()
    covariance[places], covariance[:, places] = 0.0, 0.0
    covariance[np.ix_(places, places)] = found.covariance
    return _Theta(found.theta, covariance, np.zeros(3), np.zeros(3))


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
    chosen, score = plain, _unseen(plain.parameters, windows, plain.theta)
    for name in REFINEMENTS:
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


def _by_prediction_errors(whole: GrayBoxFit, fits: Sequence[GrayBoxFit], pieces: Cut) -> tuple[_Theta, WindowTable]:
    parameters, dt = whole.parameters, pieces.windows.dt
    table, between = _over_time(whole, _ways(parameters, whole.theta, dt), pieces)
    by_wind = [_logarithms(fit.parameters, fit.theta, dt) for fit in fits]
    return _Theta(whole.theta, inverse(whole.curvature), between, np.ptp(by_wind, axis=0)), table


def _logarithms(parameters: Parameters, theta: Array, dt: float) -> list[float]:
    """Of mean effect, damping and lag."""
    return [
        float(np.log(np.abs(parameters.effect(theta)).mean())),
        float(np.log(parameters.damping(theta))),
        float(np.log(parameters.lag(theta, dt))),
    ]


def _ways(parameters: Parameters, theta: Array, dt: float) -> Array:
    """(3, k) slopes of the logarithms of mean effect, damping and lag by θ."""
    r, ways = parameters.motors, np.zeros((3, len(theta)))
    effect = parameters.effect(theta)
    ways[0, 0], ways[0, 1 : r + 1] = 1.0, np.sign(effect) * np.exp(theta[0]) / np.abs(effect).sum()
    # Less than 1 where the damping is near the largest, and the lag near the shortest.
    ways[1, r + 1] = float(parameters.damping(theta) / np.exp(theta[r + 1]))
    ways[2, r + 2] = float(np.exp(theta[r + 2]) / parameters.lag(theta, dt)) ** 2
    return ways


def _figures(whole: GrayBoxFit, estimate: _Theta, windows: FlightWindows) -> IdentifiabilityFigures:
    parameters, theta = whole.parameters, estimate.theta
    ways = _ways(parameters, theta, windows.dt)
    sd = np.sqrt(np.einsum("ij,jk,ik->i", ways, estimate.covariance, ways))
    by_name = (sd, np.sqrt(estimate.between), estimate.spread)
    own, changed, spread = (dict(zip(PARAMETERS, values.tolist(), strict=True)) for values in by_name)
    return IdentifiabilityFigures(
        wind_share=_wind_share(parameters, theta, windows, whole.levels),
        aliased=_aliased(parameters, theta, windows),
        sd=own,
        changed=changed,
        spread=spread,
        prior={"effect": np.inf, "damping": DAMPING[1], "lag": LAG[1]},
        damping=float(parameters.damping(theta)),
        lag=float(np.exp(theta[parameters.motors + 2])),
        dt=windows.dt,
    )


def _physical(whole: GrayBoxFit, estimate: _Theta, pieces: Cut, table: WindowTable, wind_share: float) -> Physical:
    """In the units of the flight; what is still to be judged is empty."""
    parameters, theta, dt = whole.parameters, estimate.theta, pieces.windows.dt
    r, effect = parameters.motors, parameters.effect(theta)
    damping, lag = float(parameters.damping(theta)), float(parameters.lag(theta, dt))
    # Effect, damping, lag and delay by θ.
    slopes = np.zeros((r + 3, len(theta)))
    slopes[:r, 0], slopes[:r, 1 : r + 1] = effect, np.exp(theta[0]) * np.eye(r)
    slopes[r : r + 2] = _ways(parameters, theta, dt)[1:] * [[damping], [lag]]
    slopes[r + 2, r + 3] = 1.0
    # The range of three values is 1.7 of their standard deviations in the mean (Tippett 1925).
    more = estimate.between + (estimate.spread / RANGE) ** 2
    covariance = slopes @ estimate.covariance @ slopes.T
    bias = WIND_BIAS_SD**2 if wind_share > REPORTED_SHARE else 0.0
    slow = SLOW_SD**2 if 1 / dt < SLOWEST_RATE else 0.0
    covariance[:r, :r] += np.outer(effect, effect) * (more[0] + bias + EFFECT_ERROR**2)
    covariance[:r, :r] += np.diag(effect**2) * MOTOR_ERROR**2
    covariance[r, r] += damping**2 * (more[1] + slow) + DAMPING_ERROR**2
    covariance[r + 1, r + 1] += lag**2 * (more[2] + slow + LAG_ERROR**2)
    covariance[-1, -1] += DELAY_ERROR**2
    scale = np.append(np.full(r, 1 / pieces.unit), np.ones(3))
    level = float(np.sqrt(np.mean(whole.levels**2)))
    sizes = level * parameters.sizes(theta)
    return Physical(
        effect=effect / pieces.unit,
        damping=damping,
        lag=lag,
        delay=float(max(theta[r + 3], 0.0)),
        covariance=covariance * np.outer(scale, scale),
        status={},
        reasons={},
        bias=SLOW_BIAS if 1 / dt < SLOWEST_RATE else 0.0,
        wind=float(np.sqrt(np.sum(sizes**2))),
        wind_share=wind_share,
        components=tuple(
            WindComponent(colour, float(size), float(time))
            for colour, size, time in zip(parameters.wind, sizes, parameters.times(theta), strict=True)
        ),
        noise=level * float(np.hypot(np.exp(theta[parameters.of_noise]), parameters.least_noise)),
        refinements=dict(zip(parameters.refinements, theta[parameters.of_noise + 1 :].tolist(), strict=True)),
        windows=table,
    )


def _over_time(whole: GrayBoxFit, ways: Array, pieces: Cut) -> tuple[WindowTable, Array]:
    """Each window's own estimate, and (3,) the variance that the spread between windows adds to the mean's.

    A step of Fisher's scoring from the estimate of all, with the prior about it. The spread is that of a random-effects
    model (DerSimonian and Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7, 1986).
    """
    parameters = whole.parameters
    _, sd = parameters.prior
    covariances = np.linalg.inv(whole.information + np.diag(sd**-2.0))
    steps = np.einsum("wij,wj->wi", covariances, whole.scores)
    off = steps @ ways.T
    own = np.einsum("ij,wjk,ik->wi", ways, covariances, ways)
    # The prior draws each window's estimate towards that of all: undone, as far as that was little.
    drawn = np.clip(1 - own / np.einsum("ij,j,ij->i", ways, sd**2, ways), 0.25, 1.0)
    off, own = off / drawn, own / drawn
    between = np.array([_added(values, variances) for values, variances in zip(off.T, own.T, strict=True)])
    here = np.exp(_logarithms(parameters, whole.theta, pieces.windows.dt)) / [pieces.unit, 1.0, 1.0]
    (effect, damping, lag), sds = (np.exp(np.clip(off, -3, 3)) * here).T, (np.sqrt(own) * here).T
    wind = whole.levels * float(np.sqrt(np.sum(parameters.sizes(whole.theta) ** 2)))
    table = WindowTable(pieces.starts, effect, sds[0], damping, sds[1], lag, sds[2], wind)
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
    rate = 1 / windows.dt
    commanded, lag = parameters.commanded(theta, windows), float(parameters.lag(theta, windows.dt))
    torque = lagged(commanded[:, :, None], lag, windows.dt)[:, :, 0]
    turning = np.gradient(windows.rate, windows.dt, axis=1) + parameters.damping(theta) * windows.rate
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
