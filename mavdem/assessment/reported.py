"""Events that the autopilot reports in a log: its states, its texts and error codes, and faults of its sensors."""

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Flags
from mavdem.assessment.autopilot_messages import (
    in_time_order,
    merge_repeats,
    mode_change_reason,
    reported_problems,
)
from mavdem.assessment.flights import RECOVERY_SECONDS, flights_in_boot
from mavdem.assessment.lights.power import BOARD_VOLTAGE_LIMITS, POSSIBLE_BOARD_VOLTAGE
from mavdem.assessment.restarts import restarts
from mavdem.confidence import Interval
from mavdem.dataset.batteries import battery_columns, battery_name
from mavdem.dataset.intervals import Intervals, in_intervals, intersection, true_intervals
from mavdem.dataset.motor_outputs import DEMAND_MESSAGE
from mavdem.dataset.phases import (
    AVERAGING_SECONDS,
    SURFACE_VEHICLES,
    armed_intervals,
    series_of_boot,
    without_grounded,
)
from mavdem.dataset.position_fix import has_position_fix
from mavdem.dataset.segments import Segment, recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.events import Reported
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Columns
from mavdem.ingest.vocabulary import CRITICAL, OFF_GROUND
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.position import position_fix, receiver_message

EMERGENCY_CHARGE = mavlink_constant("MAV_BATTERY_CHARGE_STATE_EMERGENCY")
"""The charge state "emergency", which is worse than "critical": the vehicle must land at once."""

LOW_CHARGE = mavlink_constant("MAV_BATTERY_CHARGE_STATE_LOW")
"""The charge state "low" of BATTERY_STATUS; larger values are worse, but for ``CHARGING``."""

CHARGING = mavlink_constant("MAV_BATTERY_CHARGE_STATE_CHARGING")
"""The charge state of a battery that is charged."""

SENSOR_MASKS = ("health", "present", "enabled")
"""Ends of the names of three bit masks of SYS_STATUS, ``onboard_control_sensors_…``, with a bit for each sensor."""

MAX_TOUCH_DOWN_DROP = 3.0
"""Height, m, by which a vehicle that has landed may still seem to sink: a choice, beyond the barometer's error in the
downwash over the ground. One that sinks farther had its motors stopped in the air."""

MAX_MOTORS = 16
"""Number of motors in PX4's ``motor_failure_mask``, one bit each."""


FAILSAFE_TRIGGERS = (
    Reported.BATTERY_WARNED,
    Reported.BATTERY_ALARMED,
    Reported.RADIO_LOST,
    Reported.GROUND_STATION_LOST,
    Reported.GPS_LOST,
    Reported.FENCE_BREACHED,
    Reported.ESTIMATOR_DIVERGED,
)
"""Reports for which autopilots begin a failsafe."""

TRIGGER_SECONDS = 2.0
"""Seconds before a failsafe within which its trigger is reported: the state of the system comes once a second."""


CONFIRMING_STATES = {
    Reported.FAILSAFE: (Reported.FAILSAFE,),
    Reported.BATTERY_WARNED: (
        Reported.BATTERY_WARNED,
        Reported.BATTERY_ALARMED,
        Reported.BATTERY_SPENT,
    ),
    Reported.BATTERY_ALARMED: (Reported.BATTERY_ALARMED, Reported.BATTERY_SPENT),
    Reported.ATTITUDE_FAILED: (Reported.ATTITUDE_FAILED,),
    Reported.ALTITUDE_FAILED: (Reported.ALTITUDE_FAILED,),
    Reported.MOTOR_FAILED: (Reported.MOTOR_FAILED,),
}
"""By the code of a text: the codes of recorded states, one of which holds if the text is true.

Texts are left out where the recorded state may be that of another sensor or input, such as those on the radio."""

CONFIRMATION_SECONDS = 5.0
"""Seconds around a text within which its state is recorded: the slowest such stream, BATTERY_STATUS of PX4, comes every
2 s, and one message may be lost."""


class Fault(NamedTuple):
    """What a field or bit of a message reports when it is set."""

    code: Reported
    """Code of the event."""
    subject: str = ""
    """What is at fault; empty if the code names it."""


FAILURE_DETECTORS = {
    "fd_roll": Fault(Reported.ATTITUDE_FAILED, "roll"),
    "fd_pitch": Fault(Reported.ATTITUDE_FAILED, "pitch"),
    "fd_alt": Fault(Reported.ALTITUDE_FAILED),
    "fd_motor": Fault(Reported.MOTOR_FAILED),
    "fd_imbalanced_prop": Fault(Reported.PROPELLER_IMBALANCED),
}
"""Faults by the fields of PX4's ``failure_detector_status``."""

SENSOR_FAULTS = {
    "SENSOR_3D_GYRO": Fault(Reported.SENSOR_FAILED, "gyro"),
    "SENSOR_3D_ACCEL": Fault(Reported.SENSOR_FAILED, "accel"),
    "SENSOR_3D_MAG": Fault(Reported.SENSOR_FAILED, "compass"),
    "SENSOR_ABSOLUTE_PRESSURE": Fault(Reported.SENSOR_FAILED, "barometer"),
    "SENSOR_GPS": Fault(Reported.SENSOR_FAILED, "gps"),
    "SENSOR_RC_RECEIVER": Fault(Reported.RADIO_LOST),
    "AHRS": Fault(Reported.ESTIMATOR_DIVERGED, "attitude"),
}
"""Faults by the bits of SYS_STATUS: the name of the bit is MAV_SYS_STATUS_ and the key (MAV_SYS_STATUS_SENSOR)."""


class CountingField(NamedTuple):
    """A field of a message whose every change is an event."""

    message: str
    """Name of the message."""
    field: str
    """Name of its field, which holds a number or count."""
    code: Reported
    """Code of the event."""
    subject: str
    """Subject of the event; ``{}`` stands for the new value."""


COUNTING_FIELDS = (
    CountingField(
        "estimator_selector_status", "primary_instance", Reported.ESTIMATOR_SWITCHED, "lane {}"
    ),
    CountingField("LOCAL_POSITION_NED", "resets", Reported.ESTIMATOR_RESET, "position"),
)
"""The estimator's primary lane, and the counter of its resets of the position."""


class FaultSignal(NamedTuple):
    """For each sample of a message, whether it reports one fault."""

    message: str
    """Name of the message."""
    is_faulty: Flags
    """(N,) for the N samples of the message; (0,) where it or its field was not recorded."""
    code: Reported
    """Code of the event."""
    subject: str = ""
    """What is at fault; empty if the code names it."""
    columns: Columns | None = None
    """The N samples, where they are not all of the message: of one of several batteries."""
    instance: str = ""
    """Name of the battery, even where it is the only one; empty where the subject says what is at fault."""

    def is_about(self, subject: str) -> bool:
        """Returns whether a text with this subject may be about the same battery, motor or axis.

        Args:
            subject: subject of the text; empty if it names none, so that it may be about any.
        """
        reported = self.instance or self.subject
        return not subject or not reported or subject == reported

    def columns_of(self, signals: Signals) -> Columns:
        """Returns the N samples, with their times and boots.

        Args:
            signals: signals of the vehicle, with the message.
        """
        return self.columns or signals.telemetry.messages[self.message]


def reported_events(signals: Signals) -> Facts:
    """Returns the events that the autopilot reports, in order of boot and time.

    Each fact has the figures ``boot``, ``basis`` (names of the messages that it rests on) and ``height`` in metres
    above where its flight began, None if the height is not known. No fault is bad while the vehicle is disarmed: it may
    be carried around, or its parts may be unplugged.

    Args:
        signals: signals of the vehicle.
    """
    states_of_faults = list(_fault_signals(signals))
    problems = [
        _without_contradicted_claim(problem, states_of_faults, signals)
        for problem in reported_problems(signals.telemetry)
    ]
    events = []
    for span in recorded_spans(signals):
        boot = span.boot
        states = [
            *_arming_events(signals, span),
            *_take_offs_and_landings(signals, span),
            *_mode_changes(signals, span),
        ]
        restarts_of_boot = list(restarts(signals, span))
        faults = [
            *restarts_of_boot,
            *_estimator_changes(signals, span),
            *_lasting_faults(signals, span, states_of_faults),
            *(fact for fact in problems if fact.figures["boot"] == boot and _can_be(fact, signals)),
        ]
        if any(fact.figures.get("watchdog") for fact in restarts_of_boot):
            # The restart states the watchdog already.
            faults = [fact for fact in faults if not _is_watchdog_report(fact)]
        flights = flights_in_boot(signals, boot)
        # Faults shortly before arming and after disarming belong to the flight too.
        around_armed = [
            (start - AVERAGING_SECONDS, end + AVERAGING_SECONDS)
            for start, end in armed_intervals(signals, boot)
        ]
        merged_faults = merge_repeats(faults)
        for fact in in_time_order([*states, *merged_faults]):
            time = fact.time or 0.0
            trigger = _trigger_of(fact, merged_faults)
            if trigger is not None:
                fact = fact.replace(cause=trigger)
            # After a restart in flight the motors may be off: that is bad nevertheless.
            is_restart = fact.code is Reported.RESTARTED_IN_FLIGHT
            if fact.is_bad and not is_restart and not in_intervals(time, around_armed):
                fact = fact.replace(Level.WATCH)
            events.append(fact.replace(height=_height_at(signals, boot, flights, time)))
    return tuple(events)


def _height_at(signals: Signals, boot: int, flights: Intervals, time: float) -> float | None:
    """Returns the height above the start of the latest flight, by a source that can be trusted.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        flights: flights of the boot.
        time: s since boot. Before all flights the vehicle is on the ground, at 0 m.

    Returns:
        The height, m; None if no height was recorded.
    """
    begun_flights = [flight for flight in flights if flight[0] <= time]
    if begun_flights:
        take_off, _ = max(begun_flights)
        return BootSensors(signals, boot, take_off).height_at(time)
    return None if BootSensors(signals, boot).height_at(time) is None else 0.0


def _is_watchdog_report(fact: Fact) -> bool:
    """Returns whether a fact is a text of the autopilot about its watchdog."""
    return fact.code is Reported.AUTOPILOT_ERROR and fact.subject == "watchdog"


def _trigger_of(failsafe: Fact, faults: Sequence[Fact]) -> Fact | None:
    """Returns the last report of ``FAILSAFE_TRIGGERS`` shortly before a failsafe.

    Args:
        failsafe: any event; None is returned for one that is no failsafe.
        faults: reports of the same boot, in order of time.

    Returns:
        The last report; None without one.
    """
    if failsafe.code is not Reported.FAILSAFE or failsafe.time is None:
        return None
    trigger = None
    for fault in faults:
        delay = failsafe.time - (fault.time or 0.0)
        if fault.code in FAILSAFE_TRIGGERS and 0 <= delay <= TRIGGER_SECONDS:
            trigger = fault
    return trigger


def _can_be(problem: Fact, signals: Signals) -> bool:
    """Returns whether a reported problem is possible: without a position fix, the GPS position cannot have jumped.

    Args:
        problem: fact that the autopilot reports.
        signals: signals of the vehicle.
    """
    if problem.code is not Reported.GPS_JUMPED:
        return True
    time = np.array([problem.time])
    return bool(has_position_fix(signals.telemetry, problem.figures["boot"], time)[0])


def _without_contradicted_claim(
    problem: Fact, faults: Sequence[FaultSignal], signals: Signals
) -> Fact:
    """Returns the fact that a text reports, or a quotation of the text if the recorded state contradicts it.

    PX4 writes "Failsafe activated" also if it only warns, while its recorded state is no failsafe. The autopilot acts
    by its state, so the state counts. It contradicts a text if it was recorded after the text, and no sample
    within ``CONFIRMATION_SECONDS`` of it shows the fault. Only states of what the text names count: a sound battery
    says nothing of another. A text that names none is contradicted only by the states of all in the boot.

    Args:
        problem: fact that was made from the text.
        faults: the recorded states, of all boots.
        signals: signals of the vehicle.

    Returns:
        The same fact, or one with the code ``AUTOPILOT_SAID`` and the figure ``is_contradicted``.
    """
    if "text" not in problem.figures or not isinstance(problem.code, Reported):
        return problem
    confirming_codes = CONFIRMING_STATES.get(problem.code, ())
    time = problem.time or 0.0
    nearby = [(time - CONFIRMATION_SECONDS, time + CONFIRMATION_SECONDS)]
    are_recorded_after = []
    for fault in faults:
        if fault.code not in confirming_codes or not len(fault.is_faulty):
            continue
        columns = fault.columns_of(signals)
        is_in_boot = columns["boot"] == problem.figures["boot"]
        if not fault.is_about(problem.subject) or not is_in_boot.any():
            continue
        rows = is_in_boot & in_intervals(columns["time"], nearby)
        if fault.is_faulty[rows].any():
            return problem
        are_recorded_after.append(bool((columns["time"][rows] >= time).any()))
    if not are_recorded_after or not all(are_recorded_after):
        return problem
    return problem.with_code(Reported.AUTOPILOT_SAID).replace(is_contradicted=True)


def _event(
    signals: Signals,
    span: Segment,
    message: str,
    code: Reported,
    time: float,
    level: Level | None = None,
    **figures: Any,
) -> Fact:
    """Returns one event, with its boot and the message that it rests on, named as in the source of the log.

    Args:
        signals: signals of the vehicle.
        span: the recorded time of the boot.
        message: name of the message that reports the event.
        code: code of the fact.
        time: time on the boot clock, s.
        level: level of the fact; the usual one of the code, unless given.
        figures: further figures, subject and end of the fact.
    """
    basis = (signals.telemetry.name_in_source(message),)
    return Fact(code, level, time=time, boot=span.boot, basis=basis, **figures)


def _arming_events(signals: Signals, span: Segment) -> Iterator[Fact]:
    """Yields an event for each time the motors were armed or disarmed, by the flag in HEARTBEAT messages.

    A log may begin while they are armed: then the first event is at the log's beginning, and its figure ``is_begun`` is
    true.

    Args:
        signals: signals of the vehicle.
        span: the recorded part of one boot.
    """
    state = series_of_boot(signals.armed, span.boot)
    if state is None:
        return
    is_armed = state.values > 0
    for row in np.flatnonzero(np.diff(is_armed, prepend=False)):
        code = Reported.MOTORS_ARMED if is_armed[row] else Reported.MOTORS_DISARMED
        yield _event(signals, span, "HEARTBEAT", code, state.time[row], is_begun=row == 0)


def _take_offs_and_landings(signals: Signals, span: Segment) -> Iterator[Fact]:
    """Yields take-offs and landings in one boot.

    The flights are those that motor outputs and heights show, because a land detector may be mistaken. But their times
    are averages. So if the land detector reports a change within ``AVERAGING_SECONDS`` of one, the event has its time.
    The outputs of other vehicles than multirotors show no flight: of those that can fly, only what the land detector
    reports counts.

    Args:
        signals: signals of the vehicle.
        span: the recorded part of one boot.
    """
    vehicle = signals.telemetry.vehicle
    if vehicle in SURFACE_VEHICLES:
        return
    detected_changes = np.zeros(0)
    landed_state = series_of_boot(signals.landed_state, span.boot)
    if landed_state is not None:
        # The state 0 is "undefined".
        is_defined = landed_state.values > 0
        in_air = np.isin(landed_state.values[is_defined], OFF_GROUND)
        is_change = np.diff(in_air, prepend=in_air[:1])
        detected_changes = landed_state.time[is_defined][is_change]
    motor_message = DEMAND_MESSAGE if signals.motors is None else signals.motors.message
    for flight in flights_in_boot(signals, span.boot):
        for code, flight_limit in zip(
            (Reported.OFF_GROUND, Reported.ON_GROUND), flight, strict=True
        ):
            if not isfinite(flight_limit) or not without_grounded([flight], signals, span.boot):
                continue
            distances = abs(detected_changes - flight_limit)
            message, time = motor_message, flight_limit
            if np.any(distances <= AVERAGING_SECONDS):
                message = "EXTENDED_SYS_STATE"
                time = detected_changes[np.argmin(distances)]
            elif vehicle not in POSSIBLE_MULTIROTORS:
                continue
            elif code is Reported.ON_GROUND and _is_high(signals, span.boot, flight):
                # The motors were stopped in the air.
                continue
            yield _event(signals, span, message, code, time)


def _is_high(signals: Signals, boot: int, flight: Interval) -> bool:
    """Returns whether the vehicle was in the air when a flight ended by its motor outputs.

    Afterwards it sinks by more than ``MAX_TOUCH_DOWN_DROP``. If the record ends within a second, its height above the
    take-off counts instead.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        flight: start and end of the flight, s since boot.
    """
    take_off, end = flight
    height = BootSensors(signals, boot, take_off).height_above_take_off
    if height is None:
        return False
    end_height = np.interp(end, height.time, height.values)
    ground_height = 0.0
    if height.time[-1] >= end + 1.0:
        is_after = in_intervals(height.time, [(end, end + RECOVERY_SECONDS)])
        ground_height = height.values[is_after].min(initial=end_height)
    return bool(end_height - ground_height > MAX_TOUCH_DOWN_DROP)


def _mode_changes(signals: Signals, span: Segment) -> Iterator[Fact]:
    """Yields changes of the flight mode in one boot, with ArduPilot's reason where the log has it.

    The level of an event is that of its reason: a mode that the pilot chose is good, one of a failsafe is to be
    watched. Reasons are in the field ``Rsn`` of DataFlash's messages MODE, which are translated to CURRENT_MODE.

    Args:
        signals: signals of the vehicle.
        span: the recorded part of one boot.
    """
    columns = signals.telemetry.messages.get("CURRENT_MODE", {})
    message = "CURRENT_MODE" if columns else "HEARTBEAT"
    reason_numbers = {}
    if "Rsn" in columns:
        rows = columns["boot"] == span.boot
        reason_numbers = dict(
            zip(columns["time"][rows].tolist(), columns["Rsn"][rows], strict=True)
        )
    for time, mode in signals.mode_changes(span.boot):
        cause, level = mode_change_reason(reason_numbers.get(time))
        code = Reported.MODE_CHANGED
        yield _event(signals, span, message, code, time, level, subject=mode, cause=cause)


def _estimator_changes(signals: Signals, span: Segment) -> Iterator[Fact]:
    """Yields each change of the state estimator's primary lane, and each of its resets, in one boot.

    Both show in fields that hold a number or count: every change of the value is an event. ``COUNTING_FIELDS`` lists
    them. The subject of an event may contain the new value, such as "lane 1".

    Args:
        signals: signals of the vehicle.
        span: the recorded part of one boot.
    """
    for counting in COUNTING_FIELDS:
        columns = signals.telemetry.messages.get(counting.message, {})
        if counting.field not in columns:
            continue
        rows = columns["boot"] == span.boot
        values = columns[counting.field][rows]
        times = columns["time"][rows]
        for row in 1 + np.flatnonzero(values[1:] != values[:-1]):
            subject = counting.subject.format(int(values[row]))
            yield _event(
                signals, span, counting.message, counting.code, times[row], subject=subject
            )


def _lasting_faults(
    signals: Signals, span: Segment, faults: Sequence[FaultSignal]
) -> Iterator[Fact]:
    """Yields the faults of sensors, radio and battery that have a beginning and an end, while the motors are armed.

    Before arming, sensors start and radios are off, so faults then mean nothing.

    Args:
        signals: signals of the vehicle.
        span: the recorded part of one boot.
        faults: all that messages may report, of all boots.

    Yields:
        A fact with start and end for each interval; a fault that is still there when the record ends has no end.
    """
    armed = intersection(armed_intervals(signals, span.boot), [(span.start, span.end)])
    for fault in faults:
        if not len(fault.is_faulty):
            continue
        columns = fault.columns_of(signals)
        rows = columns["boot"] == span.boot
        faulty_intervals = true_intervals(columns["time"][rows], fault.is_faulty[rows])
        for start, end in intersection(faulty_intervals, armed):
            yield _event(
                signals,
                span,
                fault.message,
                fault.code,
                start,
                until=end if end < span.end else None,
                subject=fault.subject,
            )


def _fault_signals(signals: Signals) -> Iterator[FaultSignal]:
    """Yields every fault that a message may report for a time, with the samples that report it.

    These are failsafes, a lost GPS fix or radio, low voltages and charges, unhealthy sensors, and PX4's failure
    detectors.

    Args:
        signals: signals of the vehicle, with the messages of all boots.

    Yields:
        The message, flags (N,) of its N samples that report the fault, the code of the event, and perhaps its subject.
        The flags are empty for a message that the log does not have.
    """

    def column(message: str, field: str) -> NDArray[Any]:
        """Returns (N,) values of a field, empty if it was not recorded."""
        return signals.telemetry.messages.get(message, {}).get(field, np.zeros(0, np.int64))

    is_critical = column("HEARTBEAT", "system_status") >= CRITICAL
    yield FaultSignal("HEARTBEAT", is_critical, Reported.FAILSAFE)

    receiver = receiver_message(signals.telemetry)
    fix = position_fix(signals)
    if receiver is not None and fix is not None:
        has_fix = fix.values > 0
        is_lost = np.zeros(len(has_fix), dtype=np.bool_)
        for boot in np.unique(fix.boot):
            # A fix can be lost only after there was one in the same boot: a receiver needs time after a restart.
            rows = fix.boot == boot
            is_lost[rows] = np.logical_or.accumulate(has_fix[rows]) & ~has_fix[rows]
        columns = {"time": fix.time, "boot": fix.boot}
        yield FaultSignal(receiver, is_lost, Reported.GPS_LOST, columns=columns)

    yield FaultSignal("input_rc", column("input_rc", "rc_lost") > 0, Reported.RADIO_LOST)

    # The voltage is in mV; it is 0 where the board does not measure it.
    board_voltage = column("POWER_STATUS", "Vcc")
    is_possible = board_voltage >= 1000 * POSSIBLE_BOARD_VOLTAGE[0]
    is_low = is_possible & (board_voltage < 1000 * BOARD_VOLTAGE_LIMITS.bad)
    yield FaultSignal("POWER_STATUS", is_low, Reported.BOARD_VOLTAGE_LOW)

    yield from _battery_faults(signals)

    yield from _sensor_faults(
        *(
            column("SYS_STATUS", f"onboard_control_sensors_{mask}").astype(np.int64)
            for mask in SENSOR_MASKS
        )
    )

    message = "failure_detector_status"
    for field, fault in FAILURE_DETECTORS.items():
        is_detected = column(message, field) > 0
        yield FaultSignal(message, is_detected, fault.code, fault.subject)
    failed_motors = column(message, "motor_failure_mask").astype(np.int64)
    for motor in range(MAX_MOTORS):
        # Bit i of the mask stands for motor i + 1.
        has_failed = failed_motors >> motor & 1 > 0
        if has_failed.any():
            subject = f"motor {motor + 1}"
            yield FaultSignal(message, has_failed, Reported.MOTOR_FAILED, subject)


def _battery_faults(signals: Signals) -> Iterator[FaultSignal]:
    """Yields a signal for each battery and level, true while the autopilot reports it low, critical or spent.

    The battery is the subject where there are several. Where BATTERY_STATUS has the charge states of several batteries,
    that of SYS_STATUS, which is one of them, would repeat it.

    Args:
        signals: signals of the vehicle.
    """
    batteries = []
    for battery in battery_columns(signals.telemetry):
        # The state 0 is "undefined": a battery that never has another one reports nothing.
        if battery.columns.get("charge_state", np.zeros(0)).any():
            batteries.append(battery)
    if any(battery.message == "BATTERY_STATUS" for battery in batteries):
        batteries = [battery for battery in batteries if battery.message == "BATTERY_STATUS"]
    has_several = len(batteries) > 1 or len(signals.batteries) > 1
    for battery in batteries:
        name = battery_name(battery.number)
        subject = name if has_several else ""
        charge = battery.columns["charge_state"]
        is_low = charge == LOW_CHARGE
        is_emergency = charge == EMERGENCY_CHARGE
        is_critical = (charge > LOW_CHARGE) & (charge != CHARGING) & ~is_emergency
        flags_by_code = {
            Reported.BATTERY_WARNED: is_low,
            Reported.BATTERY_ALARMED: is_critical,
            Reported.BATTERY_SPENT: is_emergency,
        }
        for code, is_faulty in flags_by_code.items():
            yield FaultSignal(battery.message, is_faulty, code, subject, battery.columns, name)


def _sensor_faults(
    health: NDArray[np.int64], present: NDArray[np.int64], enabled: NDArray[np.int64]
) -> Iterator[FaultSignal]:
    """Yields the fault signal of each of the ``SENSOR_FAULTS`` by SYS_STATUS.

    A sensor is at fault where it is present and enabled, and not healthy any more. One that was never healthy in a log
    did not fail in it: autopilots clear the bit as well before calibration, or where they do not use the sensor.
    Signals of sound sensors are yielded too: they are never faulty.

    Args:
        health, present, enabled: (N,) bit masks of the N messages, with a bit for each sensor (MAV_SYS_STATUS_SENSOR).
    """
    unhealthy = ~health & present & enabled
    for sensor, fault in SENSOR_FAULTS.items():
        bit = mavlink_constant(f"MAV_SYS_STATUS_{sensor}")
        was_healthy = np.logical_or.accumulate(health & bit > 0)
        has_failed = was_healthy & (unhealthy & bit > 0)
        yield FaultSignal("SYS_STATUS", has_failed, fault.code, fault.subject)
