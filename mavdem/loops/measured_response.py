"""The measured response of the rate to its setpoint, beside the predicted one: spectra and fit."""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.dem.record import Record
from mavdem.facts import Fact
from mavdem.facts.loops import Responses
from mavdem.loops.controllers import Controller
from mavdem.loops.margins import Complex, controller_response
from mavdem.loops.resonance import WELCH_SECONDS, Spectra, spectra_of_pieces
from mavdem.plant.identifiability import MIN_RESOLVED_RATE
from mavdem.plant.parameters import rate_column

# Hz, Hz and share: of the band that is compared
MIN_COMPARED_FREQUENCY = 0.3
LEAST_COMPARED_BAND = 1.0
MIN_COMPARED_COHERENCE = 0.8
MIN_RESPONSE_FIT = 80.0  # %, from which the two agree
# of the demand and the parameters', where compared; of their ratio's logarithm
SURE_COHERENCE = 0.9
GAIN_ERROR = 0.3


class MeasuredResponse(NamedTuple):
    """Of the rate to its setpoint, in flight, and as the loop predicts it."""

    # Hz from and to which the setpoint explains enough of the rate's power to compare
    band: Interval
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
    setpoints = () if record.setpoints is None else record.setpoints.T
    by_name = dict(zip(record.setpoint_names, setpoints, strict=False))
    setpoint = by_name.get(f"{controller.axis} rate setpoint")
    if setpoint is None:
        return None
    demand = record.inputs @ per_demand / (per_demand @ per_demand)
    table = [setpoint, record.outputs[:, rate_column(record)], demand]
    wanted = by_name.get(f"{controller.axis} setpoint")
    if controller.derivative_of_error and wanted is not None:
        table += [wanted, record.outputs[:, 0]]
    given = np.isfinite(table).all(axis=0)
    changes = np.flatnonzero(np.diff(given)) + 1
    cuts = np.union1d(record.segment_starts[1:], changes)
    plain = []
    corrected = []
    for piece in np.split(np.array(table), cuts, axis=1):
        if np.isfinite(piece).all() and np.ptp(piece[0]):  # not as of a heading that is held
            asked, rate, moved, *angles = piece
            asked = evenly(asked)
            plain.append(np.array([asked, rate, moved]))
            if angles:
                error = evenly(angles[0]) - angles[1]
                turn = controller.angle_gain * error
                corrected.append(np.array([asked + turn, rate, moved]))
    spectra = [
        spectra_of_pieces(1 / record.dt, pieces, 2 * WELCH_SECONDS) for pieces in (plain, corrected)
    ]
    ways = [
        _compared(cross, record.dt, controller, at, closed)
        for cross in spectra
        if cross is not None
    ]
    return max(ways, key=lambda way: way.fit, default=None)


def _compared(
    cross: Spectra, dt: float, controller: Controller, at: Array, closed: Complex
) -> MeasuredResponse:
    """The response by the spectra of setpoint, rate and demand."""
    hertz = cross.frequency
    of_rate = cross.power[1, 1].real
    coherence = cross.coherence
    is_unclear = (hertz > MIN_COMPARED_FREQUENCY) & ~(coherence >= MIN_COMPARED_COHERENCE)
    unclear = hertz[is_unclear]
    highest = min([*unclear, at[-1], hertz[-1]])
    inside = (hertz >= MIN_COMPARED_FREQUENCY) & (hertz < highest)
    predicted = np.interp(hertz, at, closed)
    unlike = np.abs(cross.response - predicted) ** 2 * cross.driver
    by_wind = (1 - coherence) * of_rate
    fit = agreement = 0.0
    if inside.any():
        power = of_rate[inside].sum()
        fit, agreement = (
            100 * (1 - (error[inside].sum() / power) ** 0.5) for error in (unlike + by_wind, unlike)
        )
    # What the controller should have asked for, by its parameters, and what it did.
    positive = np.maximum(hertz, hertz[1])
    forward, back = controller_response(controller, positive)
    asks = np.stack([forward, -back])
    likewise = (asks.conj() * cross.power[:2, 2]).sum(axis=0)
    asked = np.einsum("if,ijf,jf->f", asks.conj(), cross.power[:2, :2], asks).real
    least = SURE_COHERENCE * asked * cross.power[2, 2].real
    sure = np.abs(likewise) ** 2 > least
    sure &= (hertz > MIN_COMPARED_FREQUENCY) & (hertz < 0.25 / dt)
    gain = np.nan
    if dt < 1 / MIN_RESOLVED_RATE and sure.sum() > 5:
        ratios = np.abs(likewise / asked)[sure]
        gain = np.median(ratios)
    reason = None
    if abs(np.log(gain)) > GAIN_ERROR:
        reason = Fact(Responses.CONTROLLER_GAIN_DIFFERS, ratio=gain)
    elif highest < LEAST_COMPARED_BAND:
        reason = Fact(Responses.RESPONSE_UNEXPLAINED, rate=highest)
    elif agreement < MIN_RESPONSE_FIT:
        share = agreement / 100
        needed = MIN_RESPONSE_FIT / 100
        reason = Fact(Responses.RESPONSE_DISAGREES, share=share, needed=needed)
    return MeasuredResponse((MIN_COMPARED_FREQUENCY, highest), fit, agreement, gain, reason)


def evenly(asked: Array) -> Array:
    """Returns a setpoint (T,) that holds until the next, linear between the times at which it was given."""
    new = np.flatnonzero(np.diff(asked, prepend=np.nan))
    usual = int(np.median(np.diff(new))) if len(new) > 1 else 1
    # a plateau ends one step before the next
    ends = np.maximum(new[1:] - usual, 0)
    kept = np.union1d(new, ends)
    return np.interp(np.arange(len(asked)), kept, asked[kept])
