"""Status light of the log, judged by facts (coded findings): rates and gaps of its streams, signs of a simulation."""

from typing import Any

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.attitude import TUNING_MESSAGE, Attitude, attitude_from_messages
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.rate_advice import rate_advice
from mavdem.dataset.signals import MIN_STREAM_RATE, rate_between_outages
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.log import LogLight
from mavdem.facts.loops import LoopFact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.sources import Flaw, Repair
from mavdem.ingest.telemetry import Log, Telemetry, rate_without_gaps

MAX_GAP = 1.0
"""Time without attitude in flight, s, that is to be watched: longer than a fall from 5 m."""

MIN_COMMANDED_FRACTION = 0.5
"""Fraction of the flight, from the first command to the last, below which most of what the motors did is missing."""

MAX_DAMAGED_FRACTION = 0.01
"""Fraction of damaged frames or bytes that is to be watched: a choice.

So many losses thin every stream, parameters included.
"""

MAX_CUT_BYTES = 288
"""Bytes outside of messages up to which a file is cut and not damaged: one whole message is the most a cut leaves.

MAVLink 2's longest frame has 280 bytes and a .tlog's stamp 8; DataFlash's longest message has 255.
"""


REASONS_BY_RATES = (NotLearnableReason.STREAMS_TOO_SLOW, LoopFact.NO_RATE_SETPOINT)
"""Reasons why margins are unknown that faster streams would remove."""


def log_light(evidence: Evidence, margins: Fact | None = None) -> Fact:
    """Judges how well the log recorded the motion, by the streams that a model is learned from.

    A model predicts the attitude from the outputs of the motors. So these two streams are judged, in this order:

    1. If one of them is missing, the motion was not recorded.
    2. If the commands cover less than ``MIN_COMMANDED_FRACTION`` of the flight, they are incomplete.
    3. If the slower one is below ``MIN_STREAM_RATE``, the log is too slow for a full model. That is to be watched only
       if a judgement is lost by it, which is that of the margins. The rate is that in flight between outages, Hz, so
       that neither a logger that is slower on the ground nor pauses of the link reduce it. If the attitude was logged
       more slowly than the body rates, it is computed from them in between. Then the rate of the body rates is used;
       the light states both.
    4. If a gap of the attitude in flight is longer than ``MAX_GAP``, or the logger itself lost messages ("dropouts"),
       the log has gaps.
    5. If damage has cost more than ``MAX_DAMAGED_FRACTION`` of the log, or more than ``MAX_GAP``, it is damaged.
    6. If the log ends in the air, and no loss of the vehicle explains it, the rest of the flight is missing.

    The light also states how much of the file could not be read.

    Args:
        evidence: the signals of the vehicle, its flights, and whether a model can be learned.
        margins: the fact of the light "margins"; None if that is not judged, which counts as lost by slow streams.

    Returns:
        A fact with the rates, Hz, the longest gap, s, and the settings that would give faster streams. Its level is the
        colour of the light on the log: good, watch, bad or unknown.
    """
    signals = evidence.signals
    attitude = signals.attitude
    if evidence.other_vehicle is not None:
        return _log_of_other_vehicle(evidence)
    # The input of a model is the outputs of the motors or, if those are too slow, the controller's demand.
    model_inputs = signals.model_inputs
    if attitude is None or model_inputs is None:
        return Fact(LogLight.MOTION_NOT_RECORDED, reason=evidence.learnability.reason)
    rate = _rate_in_flight(evidence, attitude)
    motor_rate = _rate_in_flight(evidence, model_inputs)
    attitude_steps = _attitude_steps(evidence, attitude)
    longest_gap = attitude_steps.max(initial=0.0)
    telemetry = signals.telemetry
    damage = _damage_fact(evidence.log, telemetry)
    flight_seconds = _seconds_in_flight(evidence, attitude)
    command_seconds = _seconds_in_flight(evidence, model_inputs)
    # The level is that of the code (None), unless nothing is lost by a slow log.
    level = None
    optional_figures: dict[str, Any] = {}
    # The first flaw that applies is the light, in the order of the docstring.
    if command_seconds < MIN_COMMANDED_FRACTION * flight_seconds:
        code = LogLight.COMMANDS_INCOMPLETE
        optional_figures = {"duration": command_seconds, "airborne": flight_seconds}
    elif min(rate, motor_rate) < MIN_STREAM_RATE:
        code = LogLight.RECORDED_SLOWLY
        if not _are_margins_lost_by_rates(margins):
            level = Level.GOOD
    elif longest_gap > MAX_GAP or telemetry.dropouts:
        code = LogLight.RECORDED_WITH_GAPS
        if not telemetry.dropouts:
            # Where the logger counts its dropouts, those are stated instead.
            optional_figures = {"gaps": np.count_nonzero(attitude_steps > MAX_GAP)}
    elif damage is not None and _is_damage_large(damage):
        code = LogLight.RECORDED_WITH_DAMAGE
    else:
        code = LogLight.RECORDED_FAST
    recording = Fact(
        code,
        level,
        attitude_rate=_logged_attitude_rate(evidence, attitude),
        rate=rate,
        motor_rate=motor_rate,
        output_rate=_rate_of_replaced_outputs(evidence, model_inputs),
        longest_gap=longest_gap,
        dropouts=telemetry.dropouts,
        needed_rate=MIN_STREAM_RATE,
        damage=damage,
        # Gaps are due to the link in a stream, and to the memory card in a log.
        is_received=not telemetry.translated_from,
        remedy=rate_advice(telemetry, components=evidence.log.components),
        **optional_figures,
    )
    return worst_fact([recording, *_missing_ends_of_flights(evidence)])


def _are_margins_lost_by_rates(margins: Fact | None) -> bool:
    """Returns whether slow messages are the reason why the stability margins of the control loops are not known surely.

    Margins may also be unknown for another reason, such as a flight that is too short, or a firmware without the needed
    parameters: then a faster log would not help.

    Args:
        margins: the judgement of the margins, a coded finding. None if they were not judged: then the log is taken to
            be too slow for them.
    """
    if margins is None:
        return True
    if margins.level is Level.UNKNOWN and margins.figures.get("is_log_slow"):
        # The margins were computed, but the log is too slow to be sure of them.
        return True
    reason = margins.figures.get("reason")
    is_unknown = margins.code is MarginsLight.MARGINS_UNKNOWN
    return is_unknown and isinstance(reason, Fact) and reason.code in REASONS_BY_RATES


def _missing_ends_of_flights(evidence: Evidence) -> list[Fact]:
    """Returns the events that the log ends in the air, so that the rest of a flight is missing.

    After a loss of the vehicle nothing is missing: the loss explains why the log ends.

    Args:
        evidence: events of the vehicle.
    """
    ends_in_air = []
    for event in evidence.events:
        is_explained_by_loss = "is_after_loss" in event.figures
        if event.code is MotionEvent.LOG_ENDED_IN_AIR and not is_explained_by_loss:
            ends_in_air.append(event)
    return ends_in_air


def _logged_attitude_rate(evidence: Evidence, attitude: Attitude) -> float:
    """Returns how often the autopilot logged angles between outages, Hz.

    Models may use more angles than were logged: where body rates were logged more often, angles in between were
    interpolated (PX4) or integrated from the body rates of the tuning messages (ArduPilot). The lowest rate that is
    known is therefore the one of the logged angles.

    Args:
        evidence: flights, messages and repairs of the vehicle.
        attitude: angles of one axis with those computed in between.
    """
    telemetry = evidence.signals.telemetry
    rates = [_rate_in_flight(evidence, attitude)]
    are_angles_integrated = attitude.message == TUNING_MESSAGE
    if are_angles_integrated:
        # Each attitude message has the angles of all axes, so any axis shows the rate of the messages.
        any_axis = TILT_AXES[0]
        logged_attitude = attitude_from_messages(telemetry, any_axis)
        if logged_attitude is not None:
            rates.append(_rate_in_flight(evidence, logged_attitude))
    for repair in telemetry.repairs:
        if repair.code is Repair.ATTITUDE_INTERPOLATED:
            rates.append(repair.figures["attitude_rate"])
    return min(rates)


def _rate_of_replaced_outputs(evidence: Evidence, model_inputs: MotorOutputs) -> float | None:
    """Returns how fast motor outputs were logged, Hz, if that is too slow for a model and it uses other inputs instead.

    These other inputs are the demand of the controller.

    Args:
        evidence: flights and motor outputs of the vehicle.
        model_inputs: the inputs that the model uses.

    Returns:
        The rate; 0 if no motor outputs were logged. None if the model uses the motor outputs.
    """
    motors = evidence.signals.motors
    if model_inputs is motors:
        return None
    return 0.0 if motors is None else _rate_in_flight(evidence, motors)


def _damage_fact(log: Log, telemetry: Telemetry) -> Fact | None:
    """Returns the fact about how much of a damaged log could not be read; None if it is sound, or only cut at its end.

    Args:
        log: the log, with the number of its frames.
        telemetry: repairs of the file that the vehicle was read from.

    Returns:
        The fact, with the number of bytes and of damaged frames, the fraction of the log that these are, and the time,
        s, that they contained, if it is known.
    """
    unread_byte_count = 0
    # Bytes that were skipped, as a fraction of the file.
    skipped_fraction = 0.0
    damaged_frame_count = 0
    lost_seconds = 0.0
    # Each format of logs has its own kinds of damage.
    for repair in telemetry.repairs:
        unread_bytes = _unread_bytes(repair)
        unread_byte_count += unread_bytes
        if repair.code is Repair.BYTES_SKIPPED:
            skipped_fraction += unread_bytes / repair.figures["total"]
        elif repair.code is Repair.FRAMES_LEFT_OUT and repair.figures["flaw"] == Flaw.DAMAGE:
            damaged_frame_count += repair.figures["count"]
        elif repair.code in (Repair.ULOG_DAMAGED, Repair.CHUNKS_DAMAGED):
            lost_seconds += repair.figures["duration"]
    if not unread_byte_count and not damaged_frame_count:
        return None
    # Bytes that were skipped belong to no frame, so that the two fractions are of different parts of the log.
    damaged_fraction = damaged_frame_count / max(log.frames, 1)
    return Fact(
        LogLight.DAMAGED,
        size=unread_byte_count,
        frames=damaged_frame_count,
        share=damaged_fraction + skipped_fraction,
        duration=lost_seconds,
    )


def _is_damage_large(damage: Fact) -> bool:
    """Returns whether damage has cost so much of a log that it is to be watched.

    Args:
        damage: the fact about it: ``share`` is the damaged fraction of the log, ``duration`` the time lost, s.
    """
    lost_fraction = damage.figures["share"]
    lost_seconds = damage.figures["duration"]
    return lost_fraction > MAX_DAMAGED_FRACTION or lost_seconds > MAX_GAP


def _unread_bytes(repair: Fact) -> int:
    """Returns the number of damaged bytes that one repair of a file had to skip.

    Args:
        repair: repair that was needed to read the file. A file that was cut within its last message is not damaged:
            only the rest of that message is missing.

    Returns:
        The number; 0 if the file was merely cut.
    """
    if repair.code is Repair.ULOG_DAMAGED:
        return int(repair.figures["count"])
    if repair.code is Repair.CHUNKS_DAMAGED:
        return int(repair.figures["size"])
    if repair.code is Repair.BYTES_SKIPPED and repair.figures["count"] > MAX_CUT_BYTES:
        return int(repair.figures["count"])
    return 0


def _rate_in_flight(evidence: Evidence, stream: Attitude | MotorOutputs) -> float:
    """Returns the mean rate of a stream in flight without outages, Hz; without flight, its rate in the whole log.

    Args:
        evidence: the flights of the vehicle.
        stream: samples of the vehicle.
    """
    # An empty array comes first, since without a flight there would be nothing to join.
    steps_by_flight = [np.zeros(0)]
    for flight in evidence.in_flight(_stamps(stream)):
        steps_by_flight.append(np.diff(flight.time))
    rate_in_flight = rate_without_gaps(np.concatenate(steps_by_flight))
    has_samples_in_flight = rate_in_flight > 0
    return rate_in_flight if has_samples_in_flight else rate_between_outages(stream)


def _seconds_in_flight(evidence: Evidence, stream: Attitude | MotorOutputs) -> float:
    """Returns the time, s, from the first to the last sample of a stream in each flight, of all flights together.

    Args:
        evidence: the flights of the vehicle.
        stream: samples of the vehicle.
    """
    seconds = 0.0
    for flight in evidence.in_flight(_stamps(stream)):
        seconds += float(flight.time[-1] - flight.time[0])
    return seconds


def _stamps(stream: Attitude | MotorOutputs) -> TimeSeries:
    """Returns the times of a stream as a series; they are its values too, since only the times are used."""
    return TimeSeries(stream.time, stream.boot, values=stream.time)


def _attitude_steps(evidence: Evidence, attitude: Attitude) -> Array:
    """Returns the time from each sample of the attitude in flight to the next one, s, by which gaps are found.

    Args:
        evidence: the flights of the vehicle.
        attitude: its attitude.

    Returns:
        The n steps within all flights, (n,), one flight after another; empty without flight.
    """
    # An empty array comes first, since without a flight there would be nothing to join.
    steps_by_flight = [np.zeros(0)]
    for flight in evidence.in_flight(attitude.angle_series):
        steps_by_flight.append(np.diff(flight.time))
    return np.concatenate(steps_by_flight)


def _log_of_other_vehicle(evidence: Evidence) -> Fact:
    """Judges how well the log recorded a vehicle that is not a multirotor, such as a plane or a rover.

    No model of motion is learned of such a vehicle. So neither a low rate nor missing motor outputs are a flaw of the
    log; only gaps and damage are.

    Args:
        evidence: the signals of the vehicle, and when it operated.

    Returns:
        A fact whose code is the first flaw that applies: no attitude; gaps of the attitude longer than ``MAX_GAP``, or
        messages that the logger itself lost ("dropouts"); damage of the file; none.
    """
    telemetry = evidence.signals.telemetry
    attitude = evidence.signals.attitude
    if attitude is None:
        return Fact(LogLight.ATTITUDE_NOT_RECORDED)
    attitude_steps = _attitude_steps(evidence, attitude)
    longest_gap = attitude_steps.max(initial=0.0)
    damage = _damage_fact(evidence.log, telemetry)
    code = LogLight.RECORDED_OTHER_VEHICLE
    if longest_gap > MAX_GAP or telemetry.dropouts:
        code = LogLight.RECORDED_WITH_GAPS
    elif damage is not None and _is_damage_large(damage):
        code = LogLight.RECORDED_WITH_DAMAGE
    return Fact(
        code,
        attitude_rate=rate_between_outages(attitude),
        longest_gap=longest_gap,
        dropouts=telemetry.dropouts,
        damage=damage,
        # Gaps are due to the link in a stream, and to the memory card in a log.
        is_received=not telemetry.translated_from,
    )
