"""Events that the autopilot reports, as facts (coded findings): states, texts, error codes, and faults of sensors."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.autopilot_messages import reported_problems
from mavdem.assessment.fault_signals import FaultSignal, fault_signals
from mavdem.assessment.flights import RECOVERY_SECONDS, flights_in_boot, flights_off_ground
from mavdem.assessment.mode_causes import mode_change_cause, mode_requests
from mavdem.assessment.repeated_reports import in_time_order, merge_repeats
from mavdem.assessment.restarts import restarts
from mavdem.dataset.flight_states import (
    SURFACE_VEHICLES,
    armed_intervals,
    contradicted_landings,
)
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    in_intervals,
    intersection,
    true_intervals,
)
from mavdem.dataset.motor_outputs import DEMAND_MESSAGE
from mavdem.dataset.position_fix import has_position_fix
from mavdem.dataset.segments import Segment, recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import AVERAGING_SECONDS, TimeSeries, series_of_boot
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.events import ReportedEvent
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.vocabulary import OFF_GROUND
from mavdem.physical_constants import GRAVITY
from mavdem.witnesses.boot_sensors import BootSensors

LAND_DETECTOR_MESSAGE = "EXTENDED_SYS_STATE"
"""Message in which the autopilot's land detector reports whether the vehicle is on the ground."""

MAX_TOUCH_DOWN_DROP = 3.0
"""Height, m, by which a vehicle that has landed may still seem to sink: a choice, beyond the barometer's error in the
downwash over the ground. One that sinks farther had its motors stopped in the air."""

MAX_SINK_RATE = 15.0
"""Speed downward, m/s, beyond which no multirotor descends before its motors stop: racing quadrotors dive as fast."""

FAILSAFE_TRIGGERS = (
    ReportedEvent.BATTERY_WARNED,
    ReportedEvent.BATTERY_ALARMED,
    ReportedEvent.RADIO_LOST,
    ReportedEvent.GROUND_STATION_LOST,
    ReportedEvent.GPS_LOST,
    ReportedEvent.FENCE_BREACHED,
    ReportedEvent.ESTIMATOR_DIVERGED,
)
"""Reports for which autopilots begin a failsafe."""

TRIGGER_SECONDS = 2.0
"""Seconds before a failsafe within which its trigger is reported: the state of the system comes once a second."""


CONFIRMING_STATES = {
    ReportedEvent.FAILSAFE: (ReportedEvent.FAILSAFE,),
    ReportedEvent.BATTERY_WARNED: (
        ReportedEvent.BATTERY_WARNED,
        ReportedEvent.BATTERY_ALARMED,
        ReportedEvent.BATTERY_SPENT,
    ),
    ReportedEvent.BATTERY_ALARMED: (ReportedEvent.BATTERY_ALARMED, ReportedEvent.BATTERY_SPENT),
    ReportedEvent.ATTITUDE_FAILED: (ReportedEvent.ATTITUDE_FAILED,),
    ReportedEvent.ALTITUDE_FAILED: (ReportedEvent.ALTITUDE_FAILED,),
    ReportedEvent.MOTOR_FAILED: (ReportedEvent.MOTOR_FAILED,),
}
"""By the code of a text: the codes of recorded states, one of which holds if the text is true.

Texts are left out if the recorded state may be that of another sensor or input, such as those on the radio."""

CONFIRMATION_SECONDS = 5.0
"""Seconds around a text within which its state is recorded: the slowest such stream, BATTERY_STATUS of PX4, comes every
2 s, and one message may be lost."""


class CountingField(NamedTuple):
    """A field of a message whose every change is an event."""

    message: str
    """Name of the message."""
    field: str
    """Name of its field, which holds a number or count."""
    code: ReportedEvent
    """Code of the event."""
    subject: str
    """Subject of the event; ``{}`` is replaced by the new value."""


COUNTING_FIELDS = (
    CountingField(
        "estimator_selector_status", "primary_instance", ReportedEvent.ESTIMATOR_SWITCHED, "lane {}"
    ),
    CountingField("LOCAL_POSITION_NED", "resets", ReportedEvent.ESTIMATOR_RESET, "position"),
)
"""The estimator's primary lane, and the counter of its resets of the position."""

SAME_SWITCH_SECONDS = 1.0
"""Time, s, within which switches of the lane are one: PX4 tries one lane after the other within milliseconds.

A choice, the longest time between two messages that have the number of the lane.
"""


def reported_events(signals: Signals) -> Facts:
    """Returns the events that the autopilot reports, such as mode changes and faults, in order of boot and time.

    No fault is bad while the vehicle is disarmed, since it may be carried around, or its parts may be unplugged.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Facts with the figures ``boot``, ``basis`` (names of the messages that they were made from) and ``height``, m
        above the place where the flight began, None if it is not known. A failsafe has the report that triggered it as
        ``cause``.
    """
    # Autopilots report a fault in two ways: by a flag in regular messages, and by a text or error code as it begins.
    fault_flags = list(fault_signals(signals))
    faults_in_texts = []
    for fault in reported_problems(signals.telemetry):
        fault_or_quotation = _quotation_if_contradicted(fault, fault_flags, signals)
        if _is_possible_problem(fault_or_quotation, signals):
            faults_in_texts.append(fault_or_quotation)
    events: list[Fact] = []
    for recorded_span in recorded_spans(signals):
        faults_of_boot = _faults_of_boot(signals, recorded_span, faults_in_texts, fault_flags)
        events += _events_of_boot(signals, recorded_span, merge_repeats(faults_of_boot))
    return tuple(events)


def _events_of_boot(
    signals: Signals, recorded_span: Segment, faults: Sequence[Fact]
) -> Iterator[Fact]:
    """Yields the changes of state and the faults of one boot in the order of time, with height and trigger.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.
        faults: faults that the autopilot reports in this boot, in any order.

    Yields:
        Facts with the figure ``height``, m; a failsafe has its trigger as ``cause``. A fault of a disarmed vehicle is
        at most to be watched.
    """
    boot = recorded_span.boot
    flights = flights_in_boot(signals, boot)
    armed_periods = armed_intervals(signals, boot)
    state_changes = [
        *_arming_events(signals, recorded_span),
        *_take_offs_and_landings(signals, recorded_span),
        *_mode_changes(signals, recorded_span, faults),
    ]
    for event in in_time_order([*state_changes, *faults]):
        trigger = _failsafe_trigger(event, faults)
        if trigger is not None:
            event = event.replace(cause=trigger)
        if event.is_bad and _is_harmless_on_ground(event, armed_periods):
            event = event.replace(Level.WATCH)
        yield event.replace(height=_height_at(signals, boot, flights, event.start_time))


def _is_harmless_on_ground(event: Fact, armed_periods: Intervals) -> bool:
    """Returns whether an event happened while the motors were disarmed, so that it is not bad for the vehicle.

    Args:
        event: an event that the autopilot reports, a coded finding.
        armed_periods: start and end of each time in which the motors were armed, s since boot.
    """
    if event.code is ReportedEvent.RESTARTED_IN_FLIGHT:
        # A restart in flight is bad even if the motors are off after it.
        return False
    # Faults shortly before arming and after disarming belong to the flight too.
    intervals_around_armed = [
        (start - AVERAGING_SECONDS, end + AVERAGING_SECONDS) for start, end in armed_periods
    ]
    return not in_intervals(event.start_time, intervals_around_armed)


def _faults_of_boot(
    signals: Signals,
    recorded_span: Segment,
    faults_in_texts: Sequence[Fact],
    fault_flags: Sequence[FaultSignal],
) -> list[Fact]:
    """Returns the faults of one boot that the autopilot reports, in no particular order.

    They are restarts, changes of the estimator, faults with a start and an end, and problems in texts and error codes.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.
        faults_in_texts: facts (coded findings) about the faults that texts and error codes report, of all boots.
        fault_flags: for each fault, whether the samples of a message report it, of all boots.

    Returns:
        A fact for each fault. A restart by the watchdog is stated once.
    """
    restarts_of_boot = list(restarts(signals, recorded_span))
    faults_in_texts_of_boot = [
        fault for fault in faults_in_texts if fault.figures["boot"] == recorded_span.boot
    ]
    faults = _without_passing_lanes(
        [
            *restarts_of_boot,
            *_estimator_changes(signals, recorded_span),
            *_lasting_faults(signals, recorded_span, fault_flags),
            *faults_in_texts_of_boot,
        ]
    )
    if any(restart.figures.get("watchdog") for restart in restarts_of_boot):
        # The fact about the restart names the watchdog as its cause already.
        return [fault for fault in faults if not _is_watchdog_report(fault)]
    return faults


def _height_at(signals: Signals, boot: int, flights: Intervals, time: float) -> float | None:
    """Returns the height above the start of the latest flight, by a source that can be trusted.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flights: flights of the boot.
        time: s since boot. Before all flights the vehicle is on the ground, at 0 m.

    Returns:
        The height, m; None if no height was recorded.
    """
    take_offs = [take_off for take_off, _ in flights if take_off <= time]
    if take_offs:
        latest_take_off = max(take_offs)
        return BootSensors(signals, boot, latest_take_off).height_at(time)
    is_recorded = BootSensors(signals, boot).height_at(time) is not None
    return 0.0 if is_recorded else None


def _is_watchdog_report(fact: Fact) -> bool:
    """Returns whether a fact (coded finding) is a text of the autopilot about its watchdog."""
    return fact.code is ReportedEvent.AUTOPILOT_ERROR and fact.subject == "watchdog"


def _failsafe_trigger(failsafe: Fact, faults: Sequence[Fact]) -> Fact | None:
    """Returns the last report of ``FAILSAFE_TRIGGERS`` shortly before a failsafe.

    Args:
        failsafe: any event; None is returned for one that is no failsafe.
        faults: reports of the same boot, in order of time.

    Returns:
        The last report; None without one.
    """
    if failsafe.code is not ReportedEvent.FAILSAFE or failsafe.time is None:
        return None
    trigger = None
    for fault in faults:
        delay = failsafe.time - fault.start_time
        if fault.code in FAILSAFE_TRIGGERS and 0 <= delay <= TRIGGER_SECONDS:
            trigger = fault
    return trigger


def _is_possible_problem(problem: Fact, signals: Signals) -> bool:
    """Returns whether a problem that the autopilot reports can be true.

    The only report that is known to be false is a jump of the GPS position at a time without a position fix.

    Args:
        problem: fact that the autopilot reports.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    if problem.code is not ReportedEvent.GPS_JUMPED:
        return True
    time = np.array([problem.time])
    return bool(has_position_fix(signals.telemetry, problem.figures["boot"], time)[0])


def _quotation_if_contradicted(
    problem: Fact, faults: Sequence[FaultSignal], signals: Signals
) -> Fact:
    """Returns the fault that a text reports, or only a quotation of the text if the recorded state contradicts it.

    PX4 writes "Failsafe activated" also if it only warns, while its recorded state is no failsafe. The state is
    preferred, since the autopilot acts by it. Only states of the subject that the text names are compared, such as the
    same battery. If it names none, the states of all subjects must contradict it.

    Args:
        problem: fact that was made from the text.
        faults: the recorded states, of all boots.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The same fact, or one with the code ``AUTOPILOT_SAID`` and the figure ``is_contradicted``.
    """
    if "text" not in problem.figures or not isinstance(problem.code, ReportedEvent):
        return problem
    confirming_codes = CONFIRMING_STATES.get(problem.code, ())
    states_near_text = []
    for fault in faults:
        if fault.code in confirming_codes and fault.is_about(problem.subject):
            state = _state_near_text(fault, problem, signals)
            if state is not None:
                states_near_text.append(state)
    if not states_near_text:
        return problem
    is_confirmed = any(state.is_faulty for state in states_near_text)
    # A state that was not recorded after the text may have changed by then.
    are_all_recorded_after = all(state.is_recorded_after for state in states_near_text)
    if is_confirmed or not are_all_recorded_after:
        return problem
    return problem.with_code(ReportedEvent.AUTOPILOT_SAID).replace(is_contradicted=True)


class _StateNearText(NamedTuple):
    """A recorded state of the autopilot within ``CONFIRMATION_SECONDS`` of a text."""

    is_faulty: bool
    """Whether any of its samples shows the fault that the text reports."""
    is_recorded_after: bool
    """Whether it has a sample after the text."""


def _state_near_text(fault: FaultSignal, text: Fact, signals: Signals) -> _StateNearText | None:
    """Returns what a recorded state shows within ``CONFIRMATION_SECONDS`` of a text that reports a fault.

    Args:
        fault: the recorded state, of all boots.
        text: fact that was made from the text.
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The state near the text; None if it was not recorded in this boot.
    """
    if not len(fault.is_faulty):
        return None
    columns = fault.columns_of(signals)
    is_in_boot = columns["boot"] == text.figures["boot"]
    if not is_in_boot.any():
        return None
    time = text.start_time
    nearby = (time - CONFIRMATION_SECONDS, time + CONFIRMATION_SECONDS)
    is_near = is_in_boot & in_intervals(columns["time"], [nearby])
    return _StateNearText(
        is_faulty=bool(fault.is_faulty[is_near].any()),
        is_recorded_after=bool((columns["time"][is_near] >= time).any()),
    )


def _reported_event(
    signals: Signals,
    recorded_span: Segment,
    message: str,
    code: ReportedEvent,
    time: float,
    level: Level | None = None,
    **figures: Any,
) -> Fact:
    """Returns one event that a message of the autopilot reports, as a fact with its boot and this message.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.
        message: name of the message; the fact (coded finding) has its name in the log's own format, as the figure
            ``basis``.
        code: what happened.
        time: time on the boot clock, s.
        level: how serious it is; None for the usual level of the code.
        figures: further figures of the fact, its ``subject`` (such as a motor) and its ``end_time``.
    """
    message_in_log = signals.telemetry.name_in_source(message)
    return Fact(code, level, time=time, boot=recorded_span.boot, basis=(message_in_log,), **figures)


def _arming_events(signals: Signals, recorded_span: Segment) -> Iterator[Fact]:
    """Yields an event for each time the motors were armed or disarmed, by the flag in HEARTBEAT messages.

    If a log begins while they are armed, the first event is at the beginning of the log, and its figure ``is_begun`` is
    true.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of one boot.
    """
    state = series_of_boot(signals.armed, recorded_span.boot)
    if state is None:
        return
    is_armed = state.values > 0
    # Before the first sample the motors count as disarmed, so that a log that begins while they are armed has an event.
    has_changed = np.diff(is_armed, prepend=False)
    for sample in np.flatnonzero(has_changed):
        code = ReportedEvent.MOTORS_ARMED if is_armed[sample] else ReportedEvent.MOTORS_DISARMED
        yield _reported_event(
            signals, recorded_span, "HEARTBEAT", code, state.time[sample], is_begun=sample == 0
        )


def _take_offs_and_landings(signals: Signals, recorded_span: Segment) -> Iterator[Fact]:
    """Yields the events of take-offs and landings in one boot, and false reports of the autopilot's land detector.

    Since the land detector may be mistaken, flights are found by motor outputs and heights. Two kinds of its reports
    are events of their own: that the vehicle is on the ground, while height and motors show that it flies; and a
    landing high in a flight, followed by a take-off. Vehicles that stay on the ground or water have no such events.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of one boot, which lasts from one start of the autopilot to the next.
    """
    if signals.telemetry.vehicle in SURFACE_VEHICLES:
        return
    yield from _false_ground_reports(signals, recorded_span)
    boot = recorded_span.boot
    detector_changes = _land_detector_changes(signals, boot)
    for flight in flights_off_ground(signals, boot):
        take_off, _ = flight
        height = BootSensors(signals, boot, take_off).height_above_take_off
        for start, end in _landings_detected_high(detector_changes, height, flight):
            yield _reported_event(
                signals,
                recorded_span,
                LAND_DETECTOR_MESSAGE,
                ReportedEvent.LANDING_DETECTED_IN_FLIGHT,
                start,
                end_time=end,
            )
        yield from _ends_of_flight(signals, recorded_span, flight, height, detector_changes.time)


def _false_ground_reports(signals: Signals, recorded_span: Segment) -> Iterator[Fact]:
    """Yields an event for each time that the land detector reports the ground while height and motors show a flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of one boot, which lasts from one start of the autopilot to the next.
    """
    for contradicted_landing in contradicted_landings(signals, recorded_span.boot):
        start, end = contradicted_landing.interval
        yield _reported_event(
            signals,
            recorded_span,
            LAND_DETECTOR_MESSAGE,
            ReportedEvent.GROUND_REPORTED_IN_FLIGHT,
            start,
            end_time=end,
            largest_height=contradicted_landing.rise,
        )


def _ends_of_flight(
    signals: Signals,
    recorded_span: Segment,
    flight: TimeInterval,
    height: TimeSeries | None,
    detected_times: Array,
) -> Iterator[Fact]:
    """Yields the take-off and the landing of one flight.

    A flight is found in averages, so that its start and end are inexact. If the land detector reports a change within
    ``AVERAGING_SECONDS``, the event gets the time of this report. The outputs of vehicles that are not multirotors do
    not show flights: their events are the reports of the land detector alone.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of the boot.
        flight: start and end of the flight, s since boot; infinite if the record begins or ends in the air, which gives
            no event.
        height: height (N,) above the take-off, m; None if it is not known.
        detected_times: (K,) times of the changes that the land detector reports in the boot, s.
    """
    motor_message = DEMAND_MESSAGE if signals.motors is None else signals.motors.message
    take_off, landing = flight
    for code, time in (
        (ReportedEvent.OFF_GROUND, take_off),
        (ReportedEvent.ON_GROUND, landing),
    ):
        if not isfinite(time):
            continue
        detected_time = _nearest_within(detected_times, time, AVERAGING_SECONDS)
        if detected_time is not None:
            yield _reported_event(
                signals, recorded_span, LAND_DETECTOR_MESSAGE, code, detected_time
            )
            continue
        # Motors that stop in the air, for example after a failure, end a flight without a landing.
        is_stop_in_air = code is ReportedEvent.ON_GROUND and stopped_in_air(height, landing)
        if signals.telemetry.vehicle in POSSIBLE_MULTIROTORS and not is_stop_in_air:
            yield _reported_event(signals, recorded_span, motor_message, code, time)


def _nearest_within(times: Array, time: float, max_distance: float) -> float | None:
    """Selects the time that is nearest to a given time from several times; None if it is too far away.

    Args:
        times: (N,) times, s; there may be none.
        time: the given time, s.
        max_distance: largest distance, s.
    """
    distances = abs(times - time)
    if not np.any(distances <= max_distance):
        return None
    return float(times[np.argmin(distances)])


def _landings_detected_high(
    detector_changes: TimeSeries, height: TimeSeries | None, flight: TimeInterval
) -> Iterator[TimeInterval]:
    """Yields when the land detector reported a landing high in a flight, and a take-off afterwards.

    PX4 stops the motors when it detects a landing, so that a short report in the air can cost the vehicle. A report up
    to ``MAX_TOUCH_DOWN_DROP`` above the take-off is left out, since the vehicle may have touched the ground.

    Args:
        detector_changes: changes (K,) of the land detector's report: 1 for a take-off, 0 for a landing.
        height: height (N,) above the take-off, m; None if it is not known.
        flight: start and end of the flight, s since boot.

    Yields:
        Times of the reported landing and take-off, s since boot.
    """
    if height is None:
        return
    changes = detector_changes.within(flight)
    # Landings and take-offs alternate, so that the change after a landing is a take-off. A last landing has none.
    for (time, next_time), is_take_off in zip(
        pairwise(changes.time), changes.values[:-1], strict=True
    ):
        if not is_take_off and height.value_at(time) > MAX_TOUCH_DOWN_DROP:
            yield float(time), float(next_time)


def _land_detector_changes(signals: Signals, boot: int) -> TimeSeries:
    """Returns the changes of what the land detector reports.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The changes (K,), s since boot: 1 when the vehicle left the ground, 0 when it touched it. Empty without messages
        of the land detector.
    """
    landed_state = series_of_boot(signals.landed_state, boot)
    if landed_state is None:
        return TimeSeries(np.zeros(0), np.zeros(0, dtype=int), np.zeros(0))
    # The state 0 is "undefined".
    is_defined = landed_state.values > 0
    times = landed_state.time[is_defined]
    boots = landed_state.boot[is_defined]
    is_in_air = np.isin(landed_state.values[is_defined], OFF_GROUND)
    # The first report is no change: it is compared with itself.
    has_changed = np.diff(is_in_air, prepend=is_in_air[:1])
    return TimeSeries(times[has_changed], boots[has_changed], is_in_air[has_changed].astype(float))


def stopped_in_air(height: TimeSeries | None, end: float) -> bool:
    """Returns whether the vehicle was in the air when its motors stopped, or were disarmed.

    It was in the air if it sank by more than ``MAX_TOUCH_DOWN_DROP`` afterwards. Where the record ends too soon to show
    that, its height above the take-off must have been more than this instead.

    Args:
        height: height (N,) above the take-off, m; None if it is not known, and then the vehicle counts as landed.
        end: end of the flight, when the motors stopped, s since boot.
    """
    if height is None:
        return False
    recorded_seconds_after_end = height.time[-1] - end
    # In 1 s a vehicle falls by 5 m.
    if recorded_seconds_after_end >= 1.0:
        return has_sunk_after(height, end)
    return height.value_at(end) > MAX_TOUCH_DOWN_DROP


def has_sunk_after(height: TimeSeries, end: float) -> bool:
    """Returns whether the vehicle sank by more than ``MAX_TOUCH_DOWN_DROP`` after the end of a flight.

    Then its motors stopped in the air. The ``RECOVERY_SECONDS`` after the end are examined.

    Args:
        height: height (N,) above the take-off, m.
        end: end of the flight, s since boot.
    """
    height_at_end = height.value_at(end)
    after_end = height.within((end, end + RECOVERY_SECONDS))
    seconds = after_end.time - end
    drops = height_at_end - after_end.values
    # A height from which nothing can have fallen so soon is not a measurement.
    free_fall = MAX_SINK_RATE * seconds + GRAVITY / 2 * seconds**2
    is_possible = drops <= free_fall + MAX_TOUCH_DOWN_DROP
    largest_drop = drops[is_possible].max(initial=0.0)
    return bool(largest_drop > MAX_TOUCH_DOWN_DROP)


def _mode_changes(
    signals: Signals, recorded_span: Segment, faults: Sequence[Fact]
) -> Iterator[Fact]:
    """Yields changes of the flight mode in one boot, with their cause if the log contains it.

    The level of an event is the level of its cause: a mode that the pilot chose is good, one of a failsafe is to be
    watched.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of one boot.
        faults: reports of the autopilot in this boot, in any order.
    """
    boot = recorded_span.boot
    message = "CURRENT_MODE" if signals.telemetry.messages.get("CURRENT_MODE") else "HEARTBEAT"
    reason_by_time = _ardupilot_reasons_by_time(signals, boot)
    requests = mode_requests(signals, boot)
    for time, mode in signals.mode_changes(boot):
        cause, level = mode_change_cause(time, reason_by_time.get(time), requests, faults)
        yield _reported_event(
            signals,
            recorded_span,
            message,
            ReportedEvent.MODE_CHANGED,
            time,
            level,
            subject=mode,
            cause=cause,
        )


def _ardupilot_reasons_by_time(signals: Signals, boot: int) -> dict[float, float]:
    """Returns the numbers of ArduPilot's reasons for changes of the flight mode in one boot, by time in s since boot.

    They are in the field ``Rsn`` of DataFlash's messages MODE, which are translated to CURRENT_MODE. Without this field
    the result is empty.

    Args:
        signals: logged time series of the vehicle, with its messages.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
    """
    columns = signals.telemetry.messages.get("CURRENT_MODE", {})
    if "Rsn" not in columns:
        return {}
    is_in_boot = columns["boot"] == boot
    times = columns["time"][is_in_boot].tolist()
    return dict(zip(times, columns["Rsn"][is_in_boot].tolist(), strict=True))


def _estimator_changes(signals: Signals, recorded_span: Segment) -> Iterator[Fact]:
    """Yields each change of the state estimator's primary lane, and each of its resets, in one boot.

    A lane is one of several estimators that run side by side on different sensors. The autopilot flies by the primary
    one.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of one boot.

    Yields:
        An event for each change of the value of one of the ``COUNTING_FIELDS``, which have the number of the lane or
        count resets. Its subject may contain the new value, such as "lane 1".
    """
    for counting_field in COUNTING_FIELDS:
        columns = signals.telemetry.messages.get(counting_field.message, {})
        if counting_field.field not in columns:
            continue
        is_in_boot = columns["boot"] == recorded_span.boot
        counter_values = columns[counting_field.field][is_in_boot]
        times = columns["time"][is_in_boot]
        # np.diff belongs to pairs of samples, of which the second one has the new value.
        for sample in 1 + np.flatnonzero(np.diff(counter_values)):
            yield _reported_event(
                signals,
                recorded_span,
                counting_field.message,
                counting_field.code,
                times[sample],
                subject=counting_field.subject.format(int(counter_values[sample])),
            )


def _without_passing_lanes(faults: Sequence[Fact]) -> list[Fact]:
    """Leaves out the lanes of the estimator that the autopilot tried and left within ``SAME_SWITCH_SECONDS``.

    Both the number of the lane and a text may report a switch. What remains of both is the lane that stays.

    Args:
        faults: reports of the autopilot in one boot, in any order.
    """
    switches = [fault for fault in faults if fault.code is ReportedEvent.ESTIMATOR_SWITCHED]
    passing_switches = []
    for switch in switches:
        for other_switch in switches:
            delay = other_switch.start_time - switch.start_time
            names_other_lane = other_switch.subject not in ("", switch.subject)
            if names_other_lane and 0 < delay <= SAME_SWITCH_SECONDS:
                passing_switches.append(switch)
                break
    return [fault for fault in faults if fault not in passing_switches]


def _lasting_faults(
    signals: Signals, recorded_span: Segment, fault_flags: Sequence[FaultSignal]
) -> Iterator[Fact]:
    """Yields an event for each time in which the autopilot reports a fault, such as of a sensor, while it is armed.

    Faults while it is disarmed mean nothing, since sensors may be starting and radios off. A fault that began before
    the arming begins with it.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        recorded_span: recorded time of one boot.
        fault_flags: for each kind of fault the samples, of all boots, that say whether it is there.

    Yields:
        Events with start and end. The end may be after the disarming. If a fault is still there when the record ends,
        its event has no end and is marked as ``is_permanent``.
    """
    recorded_interval = [(recorded_span.start, recorded_span.end)]
    armed_spans = intersection(armed_intervals(signals, recorded_span.boot), recorded_interval)
    for fault in fault_flags:
        for faulty_interval in _faulty_intervals(fault, signals, recorded_span.boot):
            _, end = faulty_interval
            is_permanent = end == inf
            for start, _ in intersection([faulty_interval], armed_spans):
                event = _reported_event(
                    signals,
                    recorded_span,
                    fault.message,
                    fault.code,
                    start,
                    end_time=None if is_permanent else end,
                    subject=fault.subject,
                )
                yield event.replace(is_permanent=True) if is_permanent else event


def _faulty_intervals(fault: FaultSignal, signals: Signals, boot: int) -> Intervals:
    """Returns start and end of each time in which a fault lasted, s since boot; an infinite end if it did not end.

    Args:
        fault: for each sample of a message, whether it reports the fault, of all boots.
        signals: logged time series of the vehicle, with its messages.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
    """
    if not len(fault.is_faulty):
        # The message was not recorded.
        return []
    columns = fault.columns_of(signals)
    is_in_boot = columns["boot"] == boot
    return true_intervals(columns["time"][is_in_boot], fault.is_faulty[is_in_boot])
