"""The response of the body rate to its setpoint as measured in flight, compared with the one that the loop predicts.

Spectra of setpoint r, rate p and demand u are estimated by Welch's method, and compared where r explains most of p.
"""

from math import nan
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.dem.record import Record
from mavdem.facts import Fact
from mavdem.facts.loops import ResponseFact
from mavdem.loops.controllers import Controller
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE
from mavdem.loops.margins import Complex, controller_response
from mavdem.loops.welch import WELCH_SECONDS, WelchSpectra, welch_spectra_of_pieces
from mavdem.plant.identifiability import MIN_RESOLVED_RATE
from mavdem.plant.windows import rate_column

MIN_COMPARED_FREQUENCY = 0.3
"""Lowest frequency at which responses are compared, Hz: a choice."""
MIN_COMPARED_COHERENCE = 0.8
"""Least coherence of setpoint and rate: responses are compared up to the first frequency with less. A choice."""
MIN_COMPARED_BAND = 1.0
"""Least upper end of the compared band for a judgement, Hz: a choice."""
MIN_RESPONSE_FIT = 80.0
"""Fit, 100 (1 − NRMSE) %, from which on prediction and measurement agree: a choice."""

MIN_DEMAND_COHERENCE = 0.9
"""Least coherence of logged and expected demand at the frequencies from which their ratio is computed: a choice."""
MIN_DEMAND_FREQUENCIES = 6
"""Least number of such frequencies: a choice."""
MAX_DEMAND_FREQUENCY_RATIO = 0.25
"""Highest of these frequencies, relative to the sampling rate: a choice."""
MAX_LOG_GAIN_ERROR = 0.3
"""Largest natural logarithm of the ratio of both demands: beyond, other gains flew than the parameters state."""


class MeasuredResponse(NamedTuple):
    """Comparison of the measured response of the rate to its setpoint with the one that the loop predicts."""

    band: Interval
    """Lowest and highest frequency at which the setpoint explains enough of the rate's power to compare, Hz."""
    fit: float
    """Fit of the predicted rate to the measured one in the band, 100 (1 − NRMSE) %."""
    agreement: float
    """The same fit to the rate that the setpoint explains: what it lacks to 100 % is the loop's error."""
    controller_gain: float
    """Gain of the logged demand divided by the gain by the parameters; NaN if it is not known."""
    reason: Fact | None
    """Why the two do not agree; ``None`` if they do."""


def measured_rate_response(
    record: Record,
    controller: Controller,
    outputs_per_demand: Array,
    frequency: Array,
    predicted: Complex,
    *,
    is_controller_identified: bool = False,
    limited_share: float = 0.0,
) -> MeasuredResponse | None:
    """Measures the response of the rate to its setpoint in a flight, and compares it with the predicted one.

    ArduPilot's message ATTITUDE_TARGET lacks the attitude controller's correction of the rate, while its log message
    RATE contains it. Both versions of the setpoint are tried, and the one that predicts the rate better is used.

    Args:
        record: the flight, with setpoints.
        controller: controller of the axis.
        outputs_per_demand: change of each of the r inputs per unit of demand (r,).
        frequency: frequencies of the prediction (F,), Hz.
        predicted: predicted response from setpoint to rate (F,).
        is_controller_identified: whether the plant was identified together with the gain of the controller, which then
            agrees with the parameters. The ratio of demands is then not compared, because aliasing and limits of the
            motors bias it. (By that ratio, 18 of 128 loops of ``tools/validation/loops.py`` at 100 Hz were in doubt,
            although the phase margins of all of them were within 5° of the truth.)
        limited_share: fraction of the flight with a motor at a limit. Above ``MIN_AT_LIMIT_SHARE`` a disagreement does
            not put the loop in doubt, since at a limit the rate does not respond like a linear loop, which the
            identification allows for. (Otherwise 10 of the same 128 loops were in doubt, although the true plants had
            the margins with the advised gains.)

    Returns:
        The comparison; ``None`` if the record has no rate setpoint or too few windows.
    """
    comparisons = []
    for pieces in _pieces_by_setpoint(record, controller, outputs_per_demand):
        spectra = welch_spectra_of_pieces(1 / record.dt, pieces, 2 * WELCH_SECONDS)
        if spectra is not None:
            comparisons.append(
                _comparison_with_prediction(spectra, record.dt, controller, frequency, predicted)
            )
    best_comparison = max(comparisons, key=lambda comparison: comparison.fit, default=None)
    if best_comparison is None:
        return None
    compared_gain = nan if is_controller_identified else best_comparison.controller_gain
    _, highest_frequency = best_comparison.band
    reason = _reason_of_disagreement(compared_gain, highest_frequency, best_comparison.agreement)
    if reason is not None and limited_share > MIN_AT_LIMIT_SHARE:
        reason = Fact(ResponseFact.RESPONSE_LIMITED, share=limited_share)
    return best_comparison._replace(reason=reason)


def _pieces_by_setpoint(
    record: Record, controller: Controller, outputs_per_demand: Array
) -> list[list[Array]]:
    """Cuts rate setpoint, rate and demand of a flight into pieces, for each possible version of the setpoint.

    The first version is the rate setpoint as logged. The second, for ArduPilot with logged angle setpoints, contains
    the correction of the attitude controller as well, which is angle gain × error of the angle.

    Args:
        record: the flight, with setpoints.
        controller: controller of the axis.
        outputs_per_demand: change of each of the r inputs per unit of demand (r,).

    Returns:
        The pieces (3, N) of each version, of different lengths N; empty if the record has no rate setpoint.
    """
    setpoints = _setpoints_by_name(record)
    rate_setpoint = setpoints.get(f"{controller.axis} rate setpoint")
    if rate_setpoint is None:
        return []
    rate = record.outputs[:, rate_column(record)]
    # A record does not contain the demand, so it is estimated by least squares from the inputs that it changes.
    demand = record.inputs @ outputs_per_demand / (outputs_per_demand @ outputs_per_demand)
    signals = [rate_setpoint, rate, demand]
    angle_setpoint = None
    if controller.is_ardupilot:
        angle_setpoint = setpoints.get(f"{controller.axis} setpoint")
    if angle_setpoint is not None:
        # The angle is the first output of a record.
        signals += [angle_setpoint, record.outputs[:, 0]]

    pieces_as_logged = []
    pieces_with_correction = []
    for piece in _finite_pieces(np.array(signals), record):
        # A record repeats a setpoint until the next message. The true setpoint does not have these steps, so it is
        # interpolated.
        repeated_rate_setpoint, rate_in_piece, demand_in_piece = piece[:3]
        logged_setpoint = interpolated_setpoint(repeated_rate_setpoint)
        pieces_as_logged.append(np.array([logged_setpoint, rate_in_piece, demand_in_piece]))
        if angle_setpoint is not None:
            repeated_angle_setpoint, angle = piece[3:]
            angle_error = interpolated_setpoint(repeated_angle_setpoint) - angle
            corrected_setpoint = logged_setpoint + controller.angle_gain * angle_error
            pieces_with_correction.append(
                np.array([corrected_setpoint, rate_in_piece, demand_in_piece])
            )
    return [pieces_as_logged, pieces_with_correction]


def _setpoints_by_name(record: Record) -> dict[str, Array]:
    """Returns each setpoint of a record (T,) by its name; none if the record has no setpoints."""
    if record.setpoints is None:
        return {}
    return dict(zip(record.setpoint_names, record.setpoints.T, strict=False))


def _finite_pieces(signals: Array, record: Record) -> list[Array]:
    """Cuts signals of a flight into pieces without gaps from which a response to the setpoint can be computed.

    Pieces end at the ends of the record's segments, and where any signal begins or ceases to be finite. Pieces with a
    constant setpoint, such as a constant heading, are left out: they show no response.

    Args:
        signals: (k, T) k signals at the samples of the record; the first is the setpoint.
        record: the flight, with its segments.

    Returns:
        (k, N) pieces, of different lengths N.
    """
    is_finite = np.isfinite(signals).all(axis=0)
    changes_of_finiteness = np.flatnonzero(np.diff(is_finite)) + 1
    piece_starts = np.union1d(record.segment_starts[1:], changes_of_finiteness)
    pieces = []
    for piece in np.split(signals, piece_starts, axis=1):
        setpoint = piece[0]
        if np.isfinite(piece).all() and np.ptp(setpoint) > 0:
            pieces.append(piece)
    return pieces


def _comparison_with_prediction(
    spectra: WelchSpectra, dt: float, controller: Controller, frequency: Array, predicted: Complex
) -> MeasuredResponse:
    """Compares a measured response of the rate to its setpoint with the predicted one.

    The band begins at ``MIN_COMPARED_FREQUENCY`` and ends where setpoint r and rate p are no longer coherent: above
    that, wind and noise hide the response. With the coherence γ², the error of the predicted rate is the sum of two:
    (1 − γ²) S_pp, which the setpoint does not explain, and |T_measured − T_predicted|² S_rr, by which the responses
    differ. The fit contains both, the agreement only the second, since wind is no error of the loop.

    Args:
        spectra: cross-spectra of setpoint, rate and demand, in this order.
        dt: time step of the samples, s.
        controller: rate controller of the axis, with its gains and mixer.
        frequency: (F,) frequencies of the prediction, Hz.
        predicted: (F,) predicted response from setpoint to rate.

    Returns:
        Band, Hz, and fit and agreement, %, without a ``reason``: the caller judges whether they suffice.
    """
    measured_frequency = spectra.frequency
    highest_prediction = frequency[-1]
    highest = min(_first_incoherent_frequency(spectra), highest_prediction)
    is_in_band = measured_frequency >= MIN_COMPARED_FREQUENCY
    is_in_band &= measured_frequency < highest
    rate_index = 1
    rate_power = spectra.power[rate_index, rate_index].real
    predicted_response = np.interp(measured_frequency, frequency, predicted)
    prediction_error = np.abs(spectra.response - predicted_response) ** 2 * spectra.driver_power
    unexplained_power = (1 - spectra.coherence) * rate_power
    # Both are 1 minus a normalised RMS error: the root of the power of an error over the power of the rate.
    fit = agreement = 0.0
    if is_in_band.any():
        power = rate_power[is_in_band].sum()
        total_error = prediction_error + unexplained_power
        fit = 100 * (1 - (total_error[is_in_band].sum() / power) ** 0.5)
        agreement = 100 * (1 - (prediction_error[is_in_band].sum() / power) ** 0.5)
    return MeasuredResponse(
        band=(MIN_COMPARED_FREQUENCY, highest),
        fit=fit,
        agreement=agreement,
        controller_gain=_controller_gain(spectra, dt, controller),
        reason=None,
    )


def _first_incoherent_frequency(spectra: WelchSpectra) -> float:
    """Returns the lowest frequency at which setpoint and rate are not coherent enough to be compared.

    Frequencies up to ``MIN_COMPARED_FREQUENCY`` are ignored. If all others are coherent, the result is the highest
    frequency of the spectra.

    Args:
        spectra: cross-spectra of setpoint and rate, with their coherence.

    Returns:
        The frequency, Hz.
    """
    # A coherence of NaN counts as incoherent, since comparisons with NaN are false.
    is_coherent = spectra.coherence >= MIN_COMPARED_COHERENCE
    is_judged = spectra.frequency > MIN_COMPARED_FREQUENCY
    incoherent_frequencies = spectra.frequency[is_judged & ~is_coherent]
    return float(incoherent_frequencies.min(initial=spectra.frequency[-1]))


def _reason_of_disagreement(
    controller_gain: float, highest_frequency: float, agreement: float
) -> Fact | None:
    """Returns the first reason why the measured response differs from the predicted one.

    The gains come first: if other gains flew than the parameters state, the prediction describes another
    loop. Then the band must be wide enough for a comparison.

    Args:
        controller_gain: gain of the logged demand relative to the one that the parameters give; NaN if it is not known.
        highest_frequency: upper end of the compared band, Hz.
        agreement: fit of the prediction to the rate that the setpoint explains, %.

    Returns:
        The first reason, as a fact, from which reports make a sentence; None if they agree.
    """
    # If the gain is NaN, this comparison is false.
    if abs(np.log(controller_gain)) > MAX_LOG_GAIN_ERROR:
        return Fact(ResponseFact.CONTROLLER_GAIN_DIFFERS, ratio=controller_gain)
    if highest_frequency < MIN_COMPARED_BAND:
        return Fact(ResponseFact.RESPONSE_UNEXPLAINED, rate=highest_frequency)
    if agreement < MIN_RESPONSE_FIT:
        share = agreement / 100
        min_fit = MIN_RESPONSE_FIT / 100
        return Fact(ResponseFact.RESPONSE_DISAGREES, share=share, needed=min_fit)
    return None


def _controller_gain(spectra: WelchSpectra, dt: float, controller: Controller) -> float:
    """Returns the gain of the logged demand over the demand by the logged gains: 1 if these gains flew.

    The demand u is the controller's torque command. Setpoint r and rate p are logged too, and the controller's
    responses to them, C_r and C_p, follow from the parameters. So the expected demand is û = C_r r − C_p p. The gain
    from û to u is |S_ûu / S_ûû|, by their cross-spectrum and the power of û. The result is its median over the
    frequencies at which the two are coherent; at others, other parts of the demand or noise hide it.

    Args:
        spectra: cross-spectra of setpoint r (index 0), rate p (1) and demand u (2).
        dt: time between samples, s.
        controller: C, by the parameters of the log.

    Returns:
        The gain, without unit; NaN if too few frequencies are coherent, or messages are too slow.
    """
    setpoint_and_rate = slice(0, 2)
    demand = 2
    # The frequency 0 is replaced by the next one, since the controller's integral divides by it.
    positive_frequency = np.maximum(spectra.frequency, spectra.frequency[1])
    demand_from_setpoint, demand_from_rate = controller_response(controller, positive_frequency)
    # û is the sum of responses × signals, so S_ûu and S_ûû follow from the logged spectra. Indices: i and j are the
    # signals, setpoint and rate; f is the frequency.
    responses = np.stack([demand_from_setpoint, -demand_from_rate])
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
    """Interpolates a setpoint linearly between its messages.

    A record holds the value of the last message, so that the setpoint has steps, while the true one moved smoothly.
    Each change of the value is assumed to be a message. If the value is constant for longer than the usual time between
    messages, the setpoint did not move: such a plateau ends one usual interval before the next change.

    Args:
        setpoint: samples of the held setpoint (T,), in any unit.

    Returns:
        Interpolated samples (T,), in the same unit.
    """
    # Indices of the samples at which the value is another than before; the first sample is one of them.
    changes = np.flatnonzero(np.diff(setpoint, prepend=np.nan))
    usual_interval = int(np.median(np.diff(changes))) if len(changes) > 1 else 1
    ends_of_plateaus = np.maximum(changes[1:] - usual_interval, 0)
    # Where changes follow each other at the usual interval, the end of a plateau is the change before it.
    known_samples = np.union1d(changes, ends_of_plateaus)
    return np.interp(np.arange(len(setpoint)), known_samples, setpoint[known_samples])
