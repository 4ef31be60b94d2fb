"""Reported: what the autopilot reports of a whole log: its states, its words, and what its sensors lost."""

from collections.abc import Iterator
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Flags
from mavdem.assessment.autopilot_messages import in_order, once, reason, said
from mavdem.assessment.lights.power import SUPPLY
from mavdem.assessment.motion import flights_of, height_above
from mavdem.dataset.intervals import in_intervals, intersection, true_intervals
from mavdem.dataset.motor_outputs import DEMAND_MESSAGE
from mavdem.dataset.phases import (
    AVERAGING_SECONDS,
    armed_intervals,
    series_of_boot,
    without_grounded,
)
from mavdem.dataset.segments import Segment, recorded_spans
from mavdem.dataset.signals import BATTERY_MESSAGES, Signals
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.events import Reported
from mavdem.ingest.vocabulary import CRITICAL, OFF_GROUND, mavlink_constant

FIX_3D = mavlink_constant("GPS_FIX_TYPE_3D_FIX")
LOW_CHARGE = mavlink_constant("MAV_BATTERY_CHARGE_STATE_LOW")  # what is more is worse
SENSOR_BITS = ("health", "present", "enabled")
DETECTED = {
    "fd_roll": (Reported.ATTITUDE_FAILED, "roll"),
    "fd_pitch": (Reported.ATTITUDE_FAILED, "pitch"),
    "fd_alt": (Reported.ALTITUDE_FAILED, ""),
    "fd_motor": (Reported.MOTOR_FAILED, ""),
    "fd_imbalanced_prop": (Reported.PROPELLER_IMBALANCED, ""),
}
HEALTH = {
    "SENSOR_3D_GYRO": (Reported.SENSOR_FAILED, "gyro"),
    "SENSOR_3D_ACCEL": (Reported.SENSOR_FAILED, "accel"),
    "SENSOR_3D_MAG": (Reported.SENSOR_FAILED, "compass"),
    "SENSOR_ABSOLUTE_PRESSURE": (Reported.SENSOR_FAILED, "barometer"),
    "SENSOR_GPS": (Reported.SENSOR_FAILED, "gps"),
    "SENSOR_RC_RECEIVER": (Reported.RADIO_LOST, ""),
    "AHRS": (Reported.ESTIMATOR_DIVERGED, ""),
}
"""By what follows MAV_SYS_STATUS in the name of its bit (MAV_SYS_STATUS_SENSOR)."""
COUNTED = (
    ("estimator_selector_status", "primary_instance", Reported.ESTIMATOR_SWITCHED, "lane {}"),
    ("LOCAL_POSITION_NED", "resets", Reported.ESTIMATOR_RESET, "position"),
)
"""Message and field, and what a change of it means."""


class Complaint(NamedTuple):
    """A ``message``, where each of it (N,) says that something is wrong, and what that is."""

    message: str
    holds: Flags
    code: Reported
    subject: str = ""


def reported_events(signals: Signals) -> Facts:
    """Returns what the autopilot reports, in order of boot and time.

    Each has its ``boot``, its ``basis``, the messages it rests on, and its ``height`` above where its flight began, m,
    None where that is not known. What is said while disarmed, as of a vehicle that is carried, is never bad.
    """
    words = said(signals.telemetry)
    events = []
    for part in recorded_spans(signals):
        states = [fact for make in STATES for fact in make(signals, part)]
        faults = [fact for make in FAULTS for fact in make(signals, part)]
        faults += [fact for fact in words if fact.figures["boot"] == part.boot]
        flights = flights_of(signals, part.boot)
        on = [
            (start - AVERAGING_SECONDS, end + AVERAGING_SECONDS)
            for start, end in armed_intervals(signals, part.boot)
        ]
        for fact in in_order([*states, *once(faults)]):
            time = fact.time or 0.0
            if fact.is_bad and not in_intervals(time, on):
                fact = fact.but(Level.WATCH)
            begun = max((flight for flight in flights if flight[0] <= time), default=(time, inf))
            events.append(fact.but(height=height_above(signals, part.boot, begun, time)))
    return tuple(events)


def _event(
    signals: Signals,
    part: Segment,
    source: str,
    code: Reported,
    time: float,
    level: Level | None = None,
    **figures: Any,
) -> Fact:
    """A fact of one boot, by the message ``source``."""
    basis = (signals.telemetry.name_in_source(source),)
    return Fact(code, level, time=time, boot=part.boot, basis=basis, **figures)


def _arming(signals: Signals, part: Segment) -> Iterator[Fact]:
    state = series_of_boot(signals.armed, part.boot)
    if state is None:
        return
    on = state.values > 0
    for row in np.flatnonzero(np.diff(on, prepend=False)):
        code = Reported.MOTORS_ARMED if on[row] else Reported.MOTORS_DISARMED
        yield _event(signals, part, "HEARTBEAT", code, state.time[row], is_begun=row == 0)


def _in_the_air(signals: Signals, part: Segment) -> Iterator[Fact]:
    """Take-offs and landings: when the land detector says so or, where it says nothing, as the motors show them."""
    changes = np.zeros(0)
    if (landed := series_of_boot(signals.landed_state, part.boot)) is not None:
        defined = landed.values > 0
        in_air = np.isin(landed.values[defined], OFF_GROUND)
        changes = landed.time[defined][np.diff(in_air, prepend=in_air[:1])]
    by_motors = DEMAND_MESSAGE if signals.motors is None else signals.motors.message
    for flight in flights_of(signals, part.boot):
        for code, end in zip((Reported.OFF_GROUND, Reported.ON_GROUND), flight, strict=True):
            near = changes[abs(changes - end) <= AVERAGING_SECONDS]
            source = "EXTENDED_SYS_STATE" if len(near) else by_motors
            at = near[np.argmin(abs(near - end))] if len(near) else end
            if isfinite(end) and without_grounded([flight], signals, part.boot):
                yield _event(signals, part, source, code, at)


def _modes(signals: Signals, part: Segment) -> Iterator[Fact]:
    columns = signals.telemetry.messages.get("CURRENT_MODE", {})
    source = "CURRENT_MODE" if columns else "HEARTBEAT"
    causes = {}
    if "Rsn" in columns:
        here = columns["boot"] == part.boot
        causes = dict(zip(columns["time"][here].tolist(), columns["Rsn"][here], strict=True))
    for time, mode in signals.modes(part.boot):
        cause, level = reason(causes.get(time))
        code = Reported.MODE_CHANGED
        yield _event(signals, part, source, code, time, level, subject=mode, cause=cause)


def _restarts(signals: Signals, part: Segment) -> Iterator[Fact]:
    if part.boot > 0:
        yield _event(signals, part, "ATTITUDE", Reported.RESTARTED, part.start)


def _changes(signals: Signals, part: Segment) -> Iterator[Fact]:
    """Changes of the estimator's primary lane, and of the counter of its resets."""
    for name, field, code, subject in COUNTED:
        columns = signals.telemetry.messages.get(name, {})
        if field not in columns:
            continue
        here = columns["boot"] == part.boot
        values = columns[field][here]
        for row in 1 + np.flatnonzero(values[1:] != values[:-1]):
            time = columns["time"][here][row]
            about = subject.format(int(values[row]))
            yield _event(signals, part, name, code, time, subject=about)


def _lasting(signals: Signals, part: Segment) -> Iterator[Fact]:
    """What a message says for a time while armed."""
    inside = intersection(armed_intervals(signals, part.boot), [(part.start, part.end)])
    for name, true, code, subject in _complaints(signals):
        if not len(true):
            continue
        columns = signals.telemetry.messages[name]
        here = columns["boot"] == part.boot
        for start, end in intersection(true_intervals(columns["time"][here], true[here]), inside):
            until = end if end < part.end else None
            yield _event(signals, part, name, code, start, until=until, subject=subject)


def _complaints(signals: Signals) -> Iterator[Complaint]:
    """What may last; empty for messages that there are not."""

    def values(message: str, field: str) -> NDArray[Any]:
        return signals.telemetry.messages.get(message, {}).get(field, np.zeros(0, np.int64))

    failing = values("HEARTBEAT", "system_status") >= CRITICAL
    yield Complaint("HEARTBEAT", failing, Reported.FAILSAFE)
    fix = values("GPS_RAW_INT", "fix_type")
    lost = np.logical_or.accumulate(fix >= FIX_3D) & (fix < FIX_3D)
    yield Complaint("GPS_RAW_INT", lost, Reported.GPS_LOST)
    yield Complaint("input_rc", values("input_rc", "rc_lost") > 0, Reported.RADIO_LOST)
    supply = values("POWER_STATUS", "Vcc")
    low = (supply > 0) & (supply < 1000 * SUPPLY.bad)
    yield Complaint("POWER_STATUS", low, Reported.BOARD_VOLTAGE_LOW)
    for name in BATTERY_MESSAGES:
        charge = values(name, "charge_state")
        yield Complaint(name, charge == LOW_CHARGE, Reported.BATTERY_WARNED)
        yield Complaint(name, charge > LOW_CHARGE, Reported.BATTERY_ALARMED)
    health, *used = (
        values("SYS_STATUS", f"onboard_control_sensors_{name}").astype(np.int64)
        for name in SENSOR_BITS
    )
    failed = np.bitwise_and.reduce([~health, *used])
    for sensor, (code, subject) in HEALTH.items():
        bit = mavlink_constant(f"MAV_SYS_STATUS_{sensor}")
        yield Complaint("SYS_STATUS", failed & bit > 0, code, subject)
    name = "failure_detector_status"
    for field, meant in DETECTED.items():
        yield Complaint(name, values(name, field) > 0, *meant)
    motors = values(name, "motor_failure_mask").astype(np.int64)
    for motor in np.flatnonzero(np.bitwise_or.reduce(motors) >> np.arange(16) & 1).tolist():
        subject = f"motor {motor + 1}"
        yield Complaint(name, motors >> motor & 1 > 0, Reported.MOTOR_FAILED, subject)


STATES = (_arming, _in_the_air, _modes)
FAULTS = (_restarts, _changes, _lasting)
