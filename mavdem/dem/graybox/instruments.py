"""Setpoints as instruments: effect, damping and lag from what was asked of the axis, whatever the wind does.

A pilot's stick moves the motors and does not answer the wind. So the part of the motion that the setpoints of the last
second explain has no wind in it, and slopes of the predictions by the parameters, worked out from that part alone, are
not correlated with the wind's torque. The parameters are those at which the prediction errors are orthogonal to these
slopes (refined instrumental variables: Young, "Recursive Estimation and Time-Series Analysis", 2nd ed., ch. 7;
Söderström and Stoica, System Identification, ch. 8). A wrong spectrum of the wind costs precision then, no bias.

Setpoints of outer loops that hold a position or an attitude answer the wind too. A stick whose changes the motion
before it helps to predict is no instrument either: a pilot flies by what he sees.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.fitting import RELATIVE_STEP, GrayBoxFit
from mavdem.dem.graybox.likelihood import FlightWindows

LOOP = " setpoint"
"""What the names of setpoints end with that loops make which hold an attitude or a position. They answer the wind, too
slowly for a test of a minute to show it, and the effect came out 8 to 40 % low with them (docs/physical.md)."""

MEMORY_SECONDS, SPACING_SECONDS = 1.0, 0.05  # of the setpoints before a sample that explain it
AHEAD_SECONDS, CAUSE_LAGS, MAX_CAUSED = 0.1, 12, 0.02
"""A setpoint answers the motion if that of the last second, at so many lags, explains more than this share of what its
own past leaves of it so much later, chance taken off."""
MIN_WINDOWS = 3
MAX_STEPS, HALVED_AFTER, LONGEST_STEP = 25, 5, 0.5
CONVERGED = 0.2  # a step, in standard deviations of each parameter
RIDGE = 1e-6  # of the mean square of what explains
MAX_SD = 0.1  # of the logarithm of the effect, up to which the instruments are strong enough


class Instrumental(NamedTuple):
    """Parameters θ (k,), and the covariance (4, 4) of those at ``places``: log effect, damping and lag, and delay."""

    theta: Array
    covariance: Array
    places: list[int]
    names: tuple[str, ...]  # of the setpoints


def exogenous(setpoints: Array, outputs: Array, dt: float) -> list[int]:
    """Which columns of setpoints (W, N, q) move, and do not answer the motion ``outputs`` (W, N, m)."""
    moving = [column for column in range(setpoints.shape[2]) if setpoints[:, :, column].std(axis=1).all()]
    return [column for column in moving if _caused(setpoints[:, :, column], outputs, dt) <= MAX_CAUSED]


def _caused(setpoint: Array, motion: Array, dt: float) -> float:
    """Share of what a setpoint's (W, N) own past leaves that past motion (W, N, m) explains, corrected for chance."""
    ahead, count = max(1, round(AHEAD_SECONDS / dt)), setpoint.shape[1]
    lags = np.unique(np.round(np.geomspace(1, MEMORY_SECONDS / dt, CAUSE_LAGS)).astype(int)) - 1
    first = lags[-1]
    if count <= 2 * (first + ahead):
        return 1.0

    def past(signals: Array) -> Array:
        before = [signals[:, first - lag : count - ahead - lag : ahead] for lag in lags]
        return np.concatenate(before, axis=2).reshape(-1, signals.shape[2] * len(lags))

    target = setpoint[:, first + ahead :: ahead].ravel()
    alone = np.column_stack([past(setpoint[:, :, None]), np.ones(len(target))])
    both = np.hstack([alone, past(motion)])
    left = [float(np.sum((target - table @ np.linalg.lstsq(table, target)[0]) ** 2)) for table in (alone, both)]
    free = len(target) - both.shape[1]
    if free <= 0 or not left[0]:
        return 1.0
    return float(1 - (left[1] / free) / (left[0] / (len(target) - alone.shape[1])))


def instrumental(
    fit: GrayBoxFit, windows: FlightWindows, setpoints: Array, names: tuple[str, ...]
) -> Instrumental | None:
    """By the instruments ``setpoints`` (W, N, q), with the wind's spectrum of ``fit``; ``None`` where they are weak."""
    parameters, r = fit.parameters, fit.parameters.motors
    if len(windows.rate) < MIN_WINDOWS:
        return None
    explained, measured = _explained(windows, setpoints)
    places = [0, r + 1, r + 2, r + 3]
    mean, sd = (each[places] for each in parameters.prior)
    prior = np.diag(sd**-2.0)
    theta = fit.theta.copy()
    for count in range(MAX_STEPS):
        steps = RELATIVE_STEP * np.maximum(0.01, np.abs(theta[places]))
        points = np.repeat(theta[None], 5, axis=0)
        points[np.arange(1, 5), places] += steps
        of_instruments, errors = (parameters.innovations(points, each)[0] for each in (explained, measured))
        level = np.sqrt(np.mean(errors[0] ** 2, axis=1))[:, None]
        slopes, own = ((each[0] - each[1:]) / steps[:, None, None] / level for each in (of_instruments, errors))
        across = np.einsum("kwn,jwn->kj", slopes, own) + prior
        score = np.einsum("kwn,wn->k", slopes, errors[0] / level) - prior @ (theta[places] - mean)
        step = np.linalg.solve(across, score)
        step *= min(1.0, LONGEST_STEP / np.abs(step[:3]).max()) * (1.0 if count < HALVED_AFTER else 0.5)
        theta[places] += step
        inverse = np.linalg.inv(across)
        covariance = inverse @ (np.einsum("kwn,jwn->kj", slopes, slopes) + prior) @ inverse.T
        if (np.abs(step) < CONVERGED * np.sqrt(covariance.diagonal())).all():
            return Instrumental(theta, covariance, places, names) if covariance[0, 0] <= MAX_SD**2 else None
    return None


def _explained(windows: FlightWindows, setpoints: Array) -> tuple[FlightWindows, FlightWindows]:
    """Inputs and rate that the setpoints of the last second explain, and as they are, both without their means."""
    spacing, memory = max(1, round(SPACING_SECONDS / windows.dt)), round(MEMORY_SECONDS / windows.dt)
    count = windows.rate.shape[1]
    past = np.concatenate([setpoints[:, memory - lag : count - lag] for lag in range(0, memory + 1, spacing)], axis=2)
    signals = np.concatenate([windows.inputs, windows.rate[:, :, None]], axis=2)[:, memory:]
    past, signals = (each - each.mean(axis=1, keepdims=True) for each in (past, signals))
    # Each window by what the others say: fitted to itself, its wind would be in it (Angrist, Imbens and Krueger,
    # "Jackknife instrumental variables estimation", Journal of Applied Econometrics 14, 1999).
    grams = np.einsum("wni,wnj->wij", past, past)
    products = np.einsum("wni,wnj->wij", past, signals)
    ridge = RIDGE * np.trace(grams.sum(axis=0)) / past.shape[2] * np.eye(past.shape[2])
    weights = np.linalg.solve(grams.sum(axis=0) - grams + ridge, products.sum(axis=0) - products)
    parts = (past @ weights, signals)
    explained, measured = (FlightWindows(each[:, :, :-1], each[:, :, -1], windows.dt) for each in parts)
    return explained, measured
