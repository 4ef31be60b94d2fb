"""The measured response of the rate to its setpoint, beside the predicted one: spectra and fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.condition.loop.controllers import Controller
from mavdem.condition.loop.margins import Complex, transfer
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.identifiability import SLOWEST_RATE
from mavdem.dem.graybox.parameters import rate_column
from mavdem.dem.record import Record
from mavdem.facts import Fact, Level
from mavdem.facts.loops import Responses

# of the windows of the spectra, by Welch, and how many it takes
WINDOW_SECONDS = 5.0
FEWEST = 6
# Hz, Hz and share: of the band that is compared
LOWEST = 0.3
LEAST_BAND = 1.0
LEAST_COHERENCE = 0.8
LEAST_FIT = 80.0  # %, from which the two agree
# of the demand and the parameters', where compared; of their ratio's logarithm
SURE_COHERENCE = 0.9
GAIN_ERROR = 0.3


class MeasuredResponse(NamedTuple):
    """Of the rate to its setpoint, in flight, and as the loop predicts it."""

    # Hz from and to which the setpoint explains enough of the rate's power to compare
    band: tuple[float, float]
    fit: float  # of the predicted rate to the measured one in the band, 100 (1 - NRMSE) %
    agreement: float  # likewise of what the setpoint explains: what is missing is the loop's error
    # of the motors' demand in flight, over that of the parameters; NaN where it is not known
    controller_gain: float
    reason: Fact | None  # why the two do not agree; None where they do


def measured_response(
    record: Record, controller: Controller, per_demand: Array, at: Array, closed: Complex
) -> MeasuredResponse | None:
    """Returns the response that a ``record`` measures, beside ``closed`` (F′,) ``at`` Hz (F′,); None without setpoints.

    A demand of 1 moves the inputs by ``per_demand`` (r,). ArduPilot's ATTITUDE_TARGET lacks the attitude controller's
    correction of the rate, its RATE has it: of both that setpoint counts which predicts the rate better.
    """
    usual = [
        f"{controller.axis} rate setpoint",
        *[f"{controller.axis} setpoint"] * controller.derivative_of_error,
    ]
    names = [name for name in usual if name in record.setpoint_names]
    if record.setpoints is None or not names or "rate" not in names[0]:
        return None
    size = round(WINDOW_SECONDS / record.dt)
    asked = record.setpoints[:, [record.setpoint_names.index(name) for name in names]]
    seen = record.outputs[:, [rate_column(record), 0]]
    table = np.column_stack([seen, record.inputs @ per_demand / (per_demand @ per_demand), asked])
    plain, corrected = list[Array](), list[Array]()
    for rows in np.split(table, record.starts[1:]):
        known = np.isfinite(rows).all(axis=1)
        edges = np.flatnonzero(np.diff(known, prepend=False, append=False)).reshape(-1, 2)
        for first, last in edges[np.ptp(edges, axis=1) >= size]:
            rate, angle, demand, *given = rows[first:last].T
            setpoint, *wanted = map(evenly, given)
            if np.ptp(setpoint):  # not as of a heading that is held
                plain.append(np.array([setpoint, rate, demand]))
                for one in wanted:
                    asked_for = setpoint + controller.angle * (one - angle)
                    corrected.append(np.array([asked_for, rate, demand]))
    if sum(2 * part.shape[1] // size - 1 for part in plain) < FEWEST:
        return None
    ways = [
        _compared(record.dt, size, parts, controller, at, closed)
        for parts in (plain, corrected)
        if parts
    ]
    return max(ways, key=lambda one: one.fit)


def _compared(
    dt: float,
    size: int,
    parts: Sequence[Array],
    controller: Controller,
    at: Array,
    closed: Complex,
) -> MeasuredResponse:
    """The response by the ``parts`` (3, T), each of setpoint, rate and demand."""
    from scipy.signal import csd  # it takes half a second to import

    densities = sum(
        part.shape[1] * csd(part[:, None], part, 1 / dt, nperseg=size)[1] for part in parts
    )
    smoothed = np.apply_along_axis(np.convolve, -1, densities, np.full(3, 1 / 3), mode="same")
    of_setpoint, of_rate, of_demand = np.maximum(
        np.einsum("iif->if", smoothed).real, np.finfo(float).tiny
    )
    across = smoothed[0, 1]
    hertz = np.arange(len(across)) / (size * dt)
    response = np.asarray(across / of_setpoint, np.complex128)
    predicted = np.interp(hertz, at, closed)
    coherence = np.abs(response) ** 2 * of_setpoint / of_rate
    unclear = hertz[(hertz > LOWEST) & ~(coherence >= LEAST_COHERENCE)]
    highest = float(min([*unclear, at[-1], hertz[-1]]))
    inside = (hertz >= LOWEST) & (hertz < highest)
    unlike = np.abs(response - predicted) ** 2 * of_setpoint
    by_wind = (1 - coherence) * of_rate
    fit, agreement = (
        float(100 * (1 - (error[inside].sum() / of_rate[inside].sum()) ** 0.5))
        if inside.any()
        else 0.0
        for error in (unlike + by_wind, unlike)
    )
    # What the controller should have asked for, by its parameters, and what it did.
    forward, back = transfer(controller, np.maximum(hertz, hertz[1]))
    likewise = forward.conj() * smoothed[0, 2] - back.conj() * smoothed[1, 2]
    asked = np.abs(forward) ** 2 * of_setpoint + np.abs(back) ** 2 * of_rate
    asked = asked - 2 * (forward.conj() * back * across).real
    sure = np.abs(likewise) ** 2 > SURE_COHERENCE * asked * of_demand
    sure &= (hertz > LOWEST) & (hertz < 0.25 / dt)
    gain = np.nan
    if dt < 1 / SLOWEST_RATE and sure.sum() > 5:
        gain = float(np.median(np.abs(likewise / asked)[sure]))
    reason = None
    if abs(np.log(gain)) > GAIN_ERROR:
        reason = Fact(Responses.CONTROLLER_GAIN_DIFFERS, Level.WATCH, ratio=gain)
    elif highest < LEAST_BAND:
        reason = Fact(Responses.RESPONSE_UNEXPLAINED, rate=highest)
    elif agreement < LEAST_FIT:
        share, needed = agreement / 100, LEAST_FIT / 100
        reason = Fact(Responses.RESPONSE_DISAGREES, Level.WATCH, share=share, needed=needed)
    band = LOWEST, highest
    return MeasuredResponse(band, fit, agreement, gain, reason)


def evenly(asked: Array) -> Array:
    """Returns a setpoint (T,) that holds until the next, linear between the times at which it was given."""
    new = np.flatnonzero(np.diff(asked, prepend=np.nan))
    usual = int(np.median(np.diff(new))) if len(new) > 1 else 1
    # a plateau ends one step before the next
    kept = np.union1d(new, np.maximum(new[1:] - usual, 0))
    return np.asarray(np.interp(np.arange(len(asked)), kept, asked[kept]))
