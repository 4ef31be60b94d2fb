"""Learnability: whether a model of one axis can be learned from a log, or the fact (a coded finding) why it cannot."""

from collections.abc import Iterator, Sequence

import numpy as np

from mavdem.dataset import flight_states, grounded, quality
from mavdem.dataset.motor_outputs import (
    DEMAND_MESSAGE,
    RECORD_A_FLIGHT,
    motor_outputs_or_reason,
)
from mavdem.dataset.quality import QualityFigures
from mavdem.dataset.rate_advice import rate_advice
from mavdem.dataset.segment_learnability import (
    MAX_IMPOSSIBLE_SHARE,
    MIN_SEGMENT_DURATION,
    Learnability,
    SegmentJudge,
    first_learnable,
    impossible_attitude,
)
from mavdem.dataset.segments import settled_segments
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.facts import Fact
from mavdem.facts.learnability import NotLearnableReason, UnusableOutputs
from mavdem.ingest import Component
from mavdem.ingest.motors import MULTIROTORS, POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Telemetry

NEVER_ARMED = Fact(NotLearnableReason.NEVER_ARMED, remedy=RECORD_A_FLIGHT)
"""Refusal of a log in which the vehicle was never armed."""

MAX_JUDGED_SEGMENTS = 100
"""Number of segments that are tried, the longest first. Of thousands, between clocks that jump, none is better."""


def learnability_of(signals: Signals, components: Sequence[Component] = ()) -> Learnability:
    """Returns whether a model can be learned from a log: the learnability of its longest usable segment.

    A segment is a part of the flight without gaps, take-off or landing. If none is usable, the learnability of the
    longest one states why.

    Args:
        signals: Logged time series of the vehicle, with angle, rate and setpoints of an axis.
        components: All components in the log, for the advice on rates: one of them may request other rates.

    Returns:
        The checks of that segment with its measured quality, and the flight or the reason why nothing can be learned.
    """
    # They come in the order in which segments are preferred. The first is that of the longest usable segment.
    return next(segment_learnabilities(signals, components))


def segment_learnabilities(
    signals: Signals, components: Sequence[Component] = (), min_rate: float = MIN_STREAM_RATE
) -> Iterator[Learnability]:
    """Yields the learnability of the log's best segment and, if that is learnable, of all its other segments.

    A segment is a span of settled flight in which attitude and model inputs were recorded without gaps. The steps:

    1. A log that cannot have a usable flight (no multirotor, no attitude, no model inputs) gives only the reason.
    2. So does a log whose vehicle was never armed or never flew, or that has no segment at all.
    3. The segments of ``MIN_SEGMENT_DURATION`` or more are tried from the longest on, until one can be learned from.
    4. The others are then aligned with the sampling step of that one, since one model has only one step. A segment
       whose messages are too slow for that step is refused.

    It is a generator, so that a caller who needs only the best segment does not pay for the others.

    Args:
        signals: Logged time series of the vehicle, with angle, rate and setpoints of an axis.
        components: All components in the log, for the advice on rates.
        min_rate: Rate, Hz, that attitude and model inputs need.

    Yields:
        First what :func:`learnability_of` returns, then the other segments of ``MIN_SEGMENT_DURATION`` or more.
    """
    reason = _unusable_log(signals, components)
    if reason is not None:
        yield Learnability(signals.axis, learnable=False, reason=reason)
        return
    attitude, inputs = signals.attitude_and_inputs
    segments = settled_segments(signals)
    log_quality = quality.log_quality(signals, len(segments))
    judge = SegmentJudge(
        signals,
        attitude=attitude,
        inputs=inputs,
        components=components,
        log_quality=log_quality,
        segments=segments,
        min_rate=min_rate,
    )
    if log_quality.armed == 0:
        reason = NEVER_ARMED
    elif log_quality.airborne == 0:
        reason = _reason_never_airborne(signals, log_quality)
    elif not segments:
        reason = judge.slow_or_short(log_quality)
    if reason is not None:
        yield Learnability(signals.axis, learnable=False, reason=reason, figures=log_quality)
        return

    candidates = [segment for segment in segments if segment.duration >= MIN_SEGMENT_DURATION]
    if not candidates:
        # All segments are too short. The longest one is judged nevertheless, since its reason states its duration.
        candidates = [segments[0]]
    best_learnability = first_learnable(judge, candidates[:MAX_JUDGED_SEGMENTS])
    yield best_learnability
    if best_learnability.learnable and best_learnability.flight is not None:
        for segment in candidates:
            if segment != best_learnability.segment:
                yield judge.learnability(segment, best_learnability.flight.dt)


def _unusable_log(signals: Signals, components: Sequence[Component]) -> Fact | None:
    """Returns the reason why no segment of a log can be used, whatever its quality.

    The vehicle must be a multirotor that was armed, with a recorded attitude and recorded model inputs, and the values
    of the attitude must be finite and mostly possible.

    Args:
        signals: Logged time series of the vehicle, with angle, rate and setpoints of an axis.
        components: All components in the log, of which another one may be a multirotor.

    Returns:
        The reason, as a fact (a code with figures); None if segments may be usable.
    """
    telemetry = signals.telemetry
    if telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return _reason_no_multirotor(signals, components)
    # The format of the log that was translated to MAVLink, such as ULog, on which the advice depends.
    recorder = telemetry.translated_from
    attitude = signals.attitude
    if attitude is None:
        return Fact(
            NotLearnableReason.NO_ATTITUDE,
            recorder=recorder,
            missing=_missing_part_of_attitude(telemetry),
            remedy=rate_advice(telemetry),
        )
    if signals.model_inputs is None:
        was_never_armed = signals.armed is not None and not signals.armed.values.any()
        return NEVER_ARMED if was_never_armed else _missing_inputs(signals)
    if attitude.impossible_count > MAX_IMPOSSIBLE_SHARE * attitude.sent_count:
        reason = impossible_attitude(signals, NotLearnableReason.ATTITUDE_UNIT)
        return reason.replace(recorder=recorder)
    if not len(attitude.time):
        message_name = telemetry.name_in_source(attitude.message)
        return Fact(NotLearnableReason.ATTITUDE_NOT_FINITE, name=message_name, axis=signals.axis)
    return None


def _missing_part_of_attitude(telemetry: Telemetry) -> str:
    """Finds out which part of the attitude a DataFlash log lacks.

    DataFlash logs angles together with their setpoints (ATT or ANG), and body rates with theirs (RATE). Without both
    there is no ATTITUDE, but ATTITUDE_TARGET is made of the setpoints that were logged, and its name in the log shows
    which these are.

    Args:
        telemetry: Messages of a vehicle without ATTITUDE.

    Returns:
        The missing part, "angles" or "rates"; "" if it is not known.
    """
    if "ATTITUDE_TARGET" not in telemetry.messages:
        return ""
    name = telemetry.name_in_source("ATTITUDE_TARGET")
    return {"ATT": "rates", "ANG": "rates", "RATE": "angles"}.get(name, "")


def _reason_no_multirotor(signals: Signals, components: Sequence[Component]) -> Fact:
    """Returns the reason to refuse a vehicle that is no multirotor, since models are of multirotors only.

    The user may have chosen the wrong vehicle of the log, so the reason names another one that is a multirotor.

    Args:
        signals: signals of the chosen vehicle.
        components: all MAVLink components in the log.

    Returns:
        The reason, with MAVLink ids and type of the first multirotor; None in their place if there is none.
    """
    other_ids = None
    other_type = None
    for component in components:
        if component.kind in MULTIROTORS:
            other_ids = _component_ids(component)
            other_type = component.kind
            break
    return Fact(
        NotLearnableReason.NO_MULTIROTOR,
        recorder=signals.telemetry.translated_from,
        kind=signals.telemetry.vehicle,
        other=other_ids,
        other_kind=other_type,
    )


def _component_ids(component: Component) -> str:
    """Returns MAVLink's ids of a component, "system:component"."""
    return f"{component.system}:{component.component}"


def _missing_inputs(signals: Signals) -> Fact:
    """Returns the reason why a log has no inputs of the model.

    The inputs are the motor outputs or, if the caller chose it, the controller's demand of torque about the axis. A
    demand that never changed is none. If no motor outputs were recorded, the reason advises how to record them.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of one axis.
    """
    telemetry = signals.telemetry
    if signals.inputs == "demand":
        code = NotLearnableReason.NO_DEMAND
        if DEMAND_MESSAGE in telemetry.messages:
            code = NotLearnableReason.DEMAND_CONSTANT
        return Fact(
            code,
            axis=signals.axis,
            name=telemetry.name_in_source(DEMAND_MESSAGE),
            recorder=telemetry.translated_from,
        )
    reason = motor_outputs_or_reason(telemetry)
    assert isinstance(reason, Fact)
    if reason.code is UnusableOutputs.NO_MOTOR_MESSAGE:
        return reason.replace(remedy=rate_advice(telemetry))
    return reason


def _reason_never_airborne(signals: Signals, log_quality: QualityFigures) -> Fact:
    """Returns the reason to refuse a vehicle that was armed but did not fly, with what shows that it did not.

    There are three cases:

    1. The autopilot reported that it was in the air, but it had no vertical speed.
    2. The autopilot reported it on the ground throughout.
    3. Neither was reported, but the collective (mean output of all motors) was too low to fly. Without a collective,
       the reason is that nothing shows whether it flew.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        log_quality: measured quality of the log, with the time for which the vehicle was armed, s.
    """
    telemetry = signals.telemetry
    message_name = telemetry.name_in_source("EXTENDED_SYS_STATE")
    attitude, _ = signals.attitude_and_inputs
    is_reported_airborne = False
    for boot in np.unique(attitude.boot):
        if flight_states.airborne_intervals(signals, int(boot)):
            is_reported_airborne = True
            break
    is_nothing_reported = not is_reported_airborne and signals.landed_state is None
    if is_nothing_reported and signals.collective is None:
        return Fact(
            NotLearnableReason.NO_EVIDENCE_OF_FLIGHT,
            name=message_name,
            remedy=rate_advice(telemetry),
        )
    # The sentence on the fact states the case by these two figures: the first is known in case 1 only, the second in
    # case 3 only, and neither in case 2.
    min_climb_rate = grounded.MIN_LIFT_OFF_SPEED if is_reported_airborne else None
    highest_collective = flight_states.max_collective(signals) if is_nothing_reported else None
    return Fact(
        NotLearnableReason.NEVER_AIRBORNE,
        armed=log_quality.armed,
        name=message_name,
        climb_rate=min_climb_rate,
        collective=highest_collective,
        least_collective=flight_states.min_airborne_collective(telemetry.parameters),
        remedy=RECORD_A_FLIGHT,
    )
