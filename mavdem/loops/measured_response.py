"""The response of the body rate to its setpoint as measured in flight, compared with the one that the loop predicts.

Spectra of setpoint r, rate p and demand u are estimated by Welch's method, and compared where r explains most of p.
"""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.dem.record import Record
from mavdem.facts import Fact
from mavdem.facts.loops import Responses
from mavdem.loops.controllers import Controller
from mavdem.loops.margins import Complex, controller_response
from mavdem.loops.welch import WELCH_SECONDS, WelchSpectra, welch_spectra_of_pieces
from mavdem.plant.identifiability import MIN_RESOLVED_RATE
from mavdem.plant.windows import rate_column

MIN_COMPARED_FREQUENCY = 0.3
"""Lowest frequency at which responses are compared, Hz."""
MIN_COMPARED_COHERENCE = 0.8
"""Coherence of setpoint and rate up to whose first loss responses are compared."""
MIN_COMPARED_BAND = 1.0
"""Hz up to which responses must be compared, at least, for a judgement."""
MIN_RESPONSE_FIT = 80.0
"""Fit, 100 (1 − NRMSE) %, from which on prediction and measurement agree."""

MIN_DEMAND_COHERENCE = 0.9
"""Coherence of the logged demand with the one that the parameters give, from which on their ratio is taken."""
MIN_DEMAND_FREQUENCIES = 6
"""Fewest frequencies with that coherence."""
MAX_DEMAND_FREQUENCY_RATIO = 0.25
"""Highest of these frequencies, by the sampling rate."""
MAX_LOG_GAIN_ERROR = 0.3
"""Natural logarithm of the ratio of both demands beyond which the autopilot flew other gains than its parameters."""


class MeasuredResponse(NamedTuple):
    """How well the response of the rate to its setpoint, measured in flight, is the one that the loop predicts."""

    band: Interval
    """Hz from and to which the setpoint explains enough of the rate's power to compare."""
    fit: float
    """Fit of the predicted rate to the measured one in the band, 100 (1 − NRMSE) %."""
    agreement: float
    """The same fit to what the setpoint explains of the rate: what it lacks is the error of the loop."""
    controller_gain: float
    """Gain of the logged demand over the one that the parameters give; NaN where it is not known."""
    reason: Fact | None
    """Why the two do not agree; None where they do."""


def measured_rate_response(
    record: Record,
    controller: Controller,
    outputs_per_demand: Array,
    frequency: Array,
    closed: Complex,
) -> MeasuredResponse | None:
    """Returns how well the response that a ``record`` shows is the predicted one.

    ArduPilot's ATTITUDE_TARGET lacks the attitude controller's correction of the rate, its log message RATE has it.
    Both are tried, and the setpoint counts that predicts the rate better.

    Args:
        record: the flight, with setpoints.
        controller: of the axis.
        outputs_per_demand: (r,) how much a demand of 1 moves the inputs.
        frequency: (F,) Hz of the prediction.
        closed: (F,) predicted response from setpoint to rate.

    Returns:
        None where the record has no setpoint of the rate, or too few windows.
    """
    # The demand is the least-squares fit of the inputs that it moves.
    demand = record.inputs @ outputs_per_demand / (outputs_per_demand @ outputs_per_demand)
    setpoints = _setpoints_by_name(record)
    rate_setpoint = setpoints.get(f"{controller.axis} rate setpoint")
    if rate_setpoint is None:
        return None
    # Rows of each piece: rate setpoint, rate, demand and, where they are needed, angle setpoint and angle.
    signals = [rate_setpoint, record.outputs[:, rate_column(record)], demand]
    angle_setpoint = None
    if controller.is_ardupilot:
        angle_setpoint = setpoints.get(f"{controller.axis} setpoint")
    if angle_setpoint is not None:
        signals += [angle_setpoint, record.outputs[:, 0]]
    # The same pieces twice: with the rate setpoint as it was logged, and with the attitude controller's correction.
    as_logged = []
    with_correction = []
    for piece in _finite_pieces(np.array(signals), record):
        # A held setpoint has steps that the controller never flew: it is made linear between messages.
        setpoint = interpolated_setpoint(piece[0])
        rate_and_demand = piece[1:3]
        as_logged.append(np.vstack([setpoint, rate_and_demand]))
        if angle_setpoint is not None:
            angle_setpoint_of_piece, angle = piece[3:5]
            angle_error = interpolated_setpoint(angle_setpoint_of_piece) - angle
            corrected = setpoint + controller.angle_gain * angle_error
            with_correction.append(np.vstack([corrected, rate_and_demand]))
    comparisons = []
    for pieces in (as_logged, with_correction):
        spectra = welch_spectra_of_pieces(1 / record.dt, pieces, 2 * WELCH_SECONDS)
        if spectra is not None:
            comparisons.append(_compared(spectra, record.dt, controller, frequency, closed))
    return max(comparisons, key=lambda comparison: comparison.fit, default=None)


def _setpoints_by_name(record: Record) -> dict[str, Array]:
    """Returns (T,) each setpoint of a ``record`` by its name."""
    if record.setpoints is None:
        return {}
    return dict(zip(record.setpoint_names, record.setpoints.T, strict=False))


def _finite_pieces(signals: Array, record: Record) -> list[Array]:
    """Returns pieces of signals without gaps, in each of which the first signal, the setpoint, moves.

    Pieces end at the ends of the record's segments and wherever a signal begins or ceases to be finite. A setpoint that
    does not move, as that of a heading that is held, shows nothing of the response to it.

    Args:
        signals: (k, T) in the rows of the record.
        record: the flight, with T samples in several segments.

    Returns:
        (k, N) each, N as long as the piece.
    """
    is_finite = np.isfinite(signals).all(axis=0)
    changes = np.flatnonzero(np.diff(is_finite)) + 1
    cuts = np.union1d(record.segment_starts[1:], changes)
    return [
        piece
        for piece in np.split(signals, cuts, axis=1)
        if np.isfinite(piece).all() and np.ptp(piece[0])
    ]


def _compared(
    spectra: WelchSpectra, dt: float, controller: Controller, frequency: Array, closed: Complex
) -> MeasuredResponse:
    """Returns the comparison of one estimate of the response with the predicted one.

    They are compared from ``MIN_COMPARED_FREQUENCY`` to where the coherence of setpoint and rate is first lost: beyond,
    wind and noise hide the response. The error of the predicted rate has two parts: (1 − γ²) S_pp, which the setpoint
    does not explain, and |T_measured − T_predicted|² S_rr, by which the responses differ. The fit counts both, the
    agreement only the second, since wind is no error of the loop.

    Args:
        spectra: of setpoint, rate and demand.
        dt: time between samples of these, s.
        controller: of the axis.
        frequency: (F,) of the prediction, Hz.
        closed: (F,) predicted response from setpoint to rate.
    """
    # The signals of the spectra are setpoint 0, rate 1 and demand 2.
    hertz = spectra.frequency
    coherence = spectra.coherence
    is_incoherent = (hertz > MIN_COMPARED_FREQUENCY) & ~(coherence >= MIN_COMPARED_COHERENCE)
    highest = min([*hertz[is_incoherent], frequency[-1], hertz[-1]])
    is_in_band = (hertz >= MIN_COMPARED_FREQUENCY) & (hertz < highest)
    rate_power = spectra.power[1, 1].real
    predicted = np.interp(hertz, frequency, closed)
    prediction_error = np.abs(spectra.response - predicted) ** 2 * spectra.driver_power
    unexplained = (1 - coherence) * rate_power
    # The fit is 100 (1 − NRMSE) %: the root of the error's power over the rate's.
    fit = agreement = 0.0
    if is_in_band.any():
        power = rate_power[is_in_band].sum()
        total_error = prediction_error + unexplained
        fit = 100 * (1 - (total_error[is_in_band].sum() / power) ** 0.5)
        agreement = 100 * (1 - (prediction_error[is_in_band].sum() / power) ** 0.5)
    controller_gain = _controller_gain(spectra, dt, controller)
    # The first reason counts: with other gains than the parameters', the prediction is of another loop.
    reason = None
    if abs(np.log(controller_gain)) > MAX_LOG_GAIN_ERROR:
        reason = Fact(Responses.CONTROLLER_GAIN_DIFFERS, ratio=controller_gain)
    elif highest < MIN_COMPARED_BAND:
        reason = Fact(Responses.RESPONSE_UNEXPLAINED, rate=highest)
    elif agreement < MIN_RESPONSE_FIT:
        share = agreement / 100
        needed = MIN_RESPONSE_FIT / 100
        reason = Fact(Responses.RESPONSE_DISAGREES, share=share, needed=needed)
    return MeasuredResponse(
        (MIN_COMPARED_FREQUENCY, highest), fit, agreement, controller_gain, reason
    )


def _controller_gain(spectra: WelchSpectra, dt: float, controller: Controller) -> float:
    """Returns the gain of the logged demand over that expected of the controller, 1 if the gains are those that flew.

    The demand u is the controller's torque command. Setpoint r and rate p are logged too, and the controller's
    responses to them, C_r and C_p, follow from the parameters. So the demand to be expected is û = C_r r − C_p p. The
    gain from û to u is |S_ûu / S_ûû|, by their cross-spectrum and the power of û. Its median is taken over the
    frequencies at which the two are coherent; elsewhere other parts of the demand, or noise, hide it.

    Args:
        spectra: cross-spectra of setpoint r (index 0), rate p (1) and demand u (2).
        dt: time between samples, s.
        controller: C, by the parameters of the log.

    Returns:
        The gain; NaN where too few frequencies are coherent, or messages are too slow.
    """
    setpoint_and_rate = slice(0, 2)
    demand = 2
    # The controller's integral divides by the frequency, which must not be 0.
    hertz = np.maximum(spectra.frequency, spectra.frequency[1])
    from_setpoint, from_rate = controller_response(controller, hertz)
    # S_ûu and S_ûû follow from the logged spectra: û is the sum of responses × signals. Indices: i, j the signal, f Hz.
    responses = np.stack([from_setpoint, -from_rate])
    inputs_to_demand = spectra.power[setpoint_and_rate, demand]
    expected_to_demand = (responses.conj() * inputs_to_demand).sum(axis=0)
    input_power = spectra.power[setpoint_and_rate, setpoint_and_rate]
    expected_power = np.einsum("if,ijf,jf->f", responses.conj(), input_power, responses).real
    demand_power = spectra.power[demand, demand].real
    coherent_power = MIN_DEMAND_COHERENCE * expected_power * demand_power
    is_coherent = np.abs(expected_to_demand) ** 2 > coherent_power
    is_coherent &= spectra.frequency > MIN_COMPARED_FREQUENCY
    is_coherent &= spectra.frequency < MAX_DEMAND_FREQUENCY_RATIO / dt
    is_fast = dt < 1 / MIN_RESOLVED_RATE
    if not is_fast or is_coherent.sum() < MIN_DEMAND_FREQUENCIES:
        return np.nan
    ratios = np.abs(expected_to_demand / expected_power)[is_coherent]
    return np.median(ratios)


def interpolated_setpoint(setpoint: Array) -> Array:
    """Returns a setpoint, which the record holds until the next message, linear between its messages.

    A record samples the last message, so the setpoint looks like stairs. The true one moved smoothly. A message shows
    as a change of value. A setpoint that stays the same for longer than usual did not move meanwhile: this plateau ends
    one usual step before the next change.

    Args:
        setpoint: (T,) held samples, of any unit.

    Returns:
        (T,) interpolated samples, in the same unit.
    """
    changes = np.flatnonzero(np.diff(setpoint, prepend=np.nan))
    usual_step = int(np.median(np.diff(changes))) if len(changes) > 1 else 1
    ends_of_plateaus = np.maximum(changes[1:] - usual_step, 0)
    nodes = np.union1d(changes, ends_of_plateaus)
    return np.interp(np.arange(len(setpoint)), nodes, setpoint[nodes])
