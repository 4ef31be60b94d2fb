"""Reported: what the autopilot reports of a whole log: its states, its words, and what its sensors lost."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.align import Segment, recorded_parts
from mavdem.alignment.drive import DEMAND_MESSAGE
from mavdem.alignment.phases import AVERAGING_SECONDS, armed, both, during, of_boot, where
from mavdem.alignment.signals import BATTERY_MESSAGES, Signals
from mavdem.assessment.motion import flights_of, height_above
from mavdem.assessment.power import LEAST_SUPPLY
from mavdem.condition.said import in_order, once, reason, said
from mavdem.facts import Fact, Level
from mavdem.facts.events import Reported
from mavdem.facts.fact import Code
from mavdem.ingest.telemetry import Columns
from mavdem.ingest.vocabulary import CRITICAL, OFF_GROUND

FIX_3D = 3  # of GPS_FIX_TYPE
CHARGE_STATES = {2: Reported.BATTERY_WARNED, 3: Reported.BATTERY_ALARMED}
"""Of MAV_BATTERY_CHARGE_STATE, and what is worse is critical too."""
DETECTED = {
    "fd_roll": (Reported.ATTITUDE_FAILED, Level.BAD, "roll"),
    "fd_pitch": (Reported.ATTITUDE_FAILED, Level.BAD, "pitch"),
    "fd_alt": (Reported.ALTITUDE_FAILED, Level.BAD, ""),
    "fd_motor": (Reported.MOTOR_FAILED, Level.BAD, ""),
    "fd_imbalanced_prop": (Reported.PROPELLER_IMBALANCED, Level.WATCH, ""),
}
HEALTH = {
    0: (Reported.SENSOR_FAILED, "gyro"),
    1: (Reported.SENSOR_FAILED, "accel"),
    2: (Reported.SENSOR_FAILED, "compass"),
    3: (Reported.SENSOR_FAILED, "barometer"),
    5: (Reported.SENSOR_FAILED, "gps"),
    16: (Reported.RADIO_LOST, ""),
    21: (Reported.ESTIMATOR_DIVERGED, ""),
}
"""By bit of MAV_SYS_STATUS_SENSOR."""
COUNTED = (
    (
        "estimator_selector_status",
        "primary_instance",
        Reported.ESTIMATOR_SWITCHED,
        Level.WATCH,
        "lane {}",
    ),
    ("LOCAL_POSITION_NED", "resets", Reported.ESTIMATOR_RESET, Level.GOOD, "position"),
)
"""Message and field, and what a change of it means."""


def reported_events(signals: Signals) -> tuple[Fact, ...]:
    """Returns what the autopilot reports, in order of boot and time.

    Each has its ``boot``, its ``basis``, the messages it rests on, and its ``height`` above where its flight began, m,
    None where that is not known. What is said while disarmed, as of a vehicle that is carried, is never bad.
    """
    words = said(signals.telemetry)
    found = []
    for part in recorded_parts(signals):
        own = [fact for make in STATES for fact in make(signals, part)]
        faults = [fact for make in FAULTS for fact in make(signals, part)]
        faults += [fact for fact in words if fact.figures["boot"] == part.boot]
        flights = flights_of(signals, part.boot)
        on = [
            (start - AVERAGING_SECONDS, end + AVERAGING_SECONDS)
            for start, end in armed(signals, part.boot)
        ]
        for fact in in_order([*own, *once(faults)]):
            time = fact.time or 0.0
            if fact.level is Level.BAD and not during(np.array([time]), on).any():
                fact = fact.but(Level.WATCH)
            begun = max((flight for flight in flights if flight[0] <= time), default=(time, inf))
            found.append(fact.but(height=height_above(signals, part.boot, begun, time)))
    return tuple(found)


def _arming(signals: Signals, part: Segment) -> Iterator[Fact]:
    state = of_boot(signals.armed, part.boot)
    if state is None:
        return
    on = state.values > 0
    for row in np.flatnonzero(np.diff(on, prepend=False)):
        yield Fact(
            Reported.MOTORS_ARMED if on[row] else Reported.MOTORS_DISARMED,
            Level.GOOD,
            time=state.time[row],
            is_begun=row == 0,
            boot=part.boot,
            basis=(signals.telemetry.called("HEARTBEAT"),),
        )


def _in_the_air(signals: Signals, part: Segment) -> Iterator[Fact]:
    """Take-offs and landings: when the land detector says so or, where it says nothing, as the motors show them."""
    boot = part.boot
    landed = of_boot(signals.landed_state, boot)
    reports = {Reported.OFF_GROUND: np.zeros(0), Reported.ON_GROUND: np.zeros(0)}
    if landed is not None:
        defined = landed.values > 0
        in_air = np.isin(landed.values[defined], OFF_GROUND)
        changes = np.diff(in_air, prepend=in_air[:1])
        time = landed.time[defined]
        reports = {
            Reported.OFF_GROUND: time[changes & in_air],
            Reported.ON_GROUND: time[changes & ~in_air],
        }
    by_motors = DEMAND_MESSAGE if signals.motors is None else signals.motors.message
    for flight in flights_of(signals, boot):
        for (code, times), end in zip(reports.items(), flight, strict=True):
            if not isfinite(end):
                continue
            near = times[np.abs(times - end) <= AVERAGING_SECONDS]
            source = "EXTENDED_SYS_STATE" if len(near) else by_motors
            yield Fact(
                code,
                Level.GOOD,
                time=min(near, key=lambda time: abs(time - end), default=end),
                boot=boot,
                basis=(signals.telemetry.called(source),),
            )


def _modes(signals: Signals, part: Segment) -> Iterator[Fact]:
    columns = signals.telemetry.messages.get("CURRENT_MODE", {})
    causes = {}
    if "Rsn" in columns:
        here = columns["boot"] == part.boot
        causes = dict(zip(*(columns[name][here].tolist() for name in ("time", "Rsn")), strict=True))
    for time, mode in signals.modes(part.boot):
        cause, level = reason(causes.get(time))
        yield Fact(
            Reported.MODE_CHANGED,
            level,
            time=time,
            subject=mode,
            cause=cause,
            boot=part.boot,
            basis=(signals.telemetry.called("CURRENT_MODE" if columns else "HEARTBEAT"),),
        )


def _restarts(signals: Signals, part: Segment) -> Iterator[Fact]:
    if part.boot > 0:
        basis = (signals.telemetry.called("ATTITUDE"),)
        yield Fact(Reported.RESTARTED, Level.WATCH, time=part.start, boot=part.boot, basis=basis)


def _failsafes(signals: Signals, part: Segment) -> Iterator[Fact]:
    columns = signals.heartbeats or {}
    if "system_status" in columns:
        critical = columns["system_status"] >= CRITICAL
        yield from _lasting(signals, part, "HEARTBEAT", columns, critical, Reported.FAILSAFE)


def _detected(signals: Signals, part: Segment) -> Iterator[Fact]:
    """What PX4's failure detector found."""
    name = "failure_detector_status"
    columns = signals.telemetry.messages.get(name, {})
    for field, meant in DETECTED.items():
        if field in columns:
            yield from _lasting(signals, part, name, columns, columns[field] > 0, *meant)
    if "motor_failure_mask" in columns:
        mask = columns["motor_failure_mask"].astype(np.int64)
        for motor in np.flatnonzero(np.bitwise_or.reduce(mask) >> np.arange(16) & 1).tolist():
            failed = mask >> motor & 1 > 0
            meant = (Reported.MOTOR_FAILED, Level.BAD, f"motor {motor + 1}")
            yield from _lasting(signals, part, name, columns, failed, *meant)


def _changes(signals: Signals, part: Segment) -> Iterator[Fact]:
    """Changes of the estimator's primary lane, and of the counter of its resets."""
    for name, field, code, level, subject in COUNTED:
        columns = signals.telemetry.messages.get(name, {})
        if field not in columns:
            continue
        here = columns["boot"] == part.boot
        values = columns[field][here]
        for row in 1 + np.flatnonzero(values[1:] != values[:-1]):
            yield Fact(
                code,
                level,
                time=columns["time"][here][row],
                subject=subject.format(int(values[row])),
                boot=part.boot,
                basis=(signals.telemetry.called(name),),
            )


def _losses(signals: Signals, part: Segment) -> Iterator[Fact]:
    """GPS without a fix after it had one, a remote control that is lost, and a supply or a battery that is low."""
    messages = signals.telemetry.messages
    if "fix_type" in (columns := messages.get("GPS_RAW_INT", {})):
        fixed = columns["fix_type"] >= FIX_3D
        lost = np.logical_or.accumulate(fixed) & ~fixed
        yield from _lasting(signals, part, "GPS_RAW_INT", columns, lost, Reported.GPS_LOST)
    if columns := messages.get("input_rc", {}):
        lost = columns["rc_lost"] > 0
        yield from _lasting(signals, part, "input_rc", columns, lost, Reported.RADIO_LOST)
    if "onboard_control_sensors_health" in (columns := messages.get("SYS_STATUS", {})):
        sensors = "onboard_control_sensors_"
        used = columns[f"{sensors}present"] & columns[f"{sensors}enabled"]
        failed = (used & ~columns[f"{sensors}health"]).astype(np.int64)
        for bit, (code, subject) in HEALTH.items():
            failing = failed >> bit & 1 > 0
            yield from _lasting(
                signals, part, "SYS_STATUS", columns, failing, code, subject=subject
            )
    if columns := messages.get("POWER_STATUS", {}):
        low = (columns["Vcc"] > 0) & (columns["Vcc"] < 1000 * LEAST_SUPPLY)
        yield from _lasting(signals, part, "POWER_STATUS", columns, low, Reported.BOARD_VOLTAGE_LOW)
    for name in BATTERY_MESSAGES:
        if "charge_state" in (columns := messages.get(name, {})):
            state = np.minimum(columns["charge_state"], max(CHARGE_STATES))
            for number, code in CHARGE_STATES.items():
                yield from _lasting(signals, part, name, columns, state == number, code)


def _lasting(
    signals: Signals,
    part: Segment,
    name: str,
    columns: Columns,
    true: NDArray[np.bool_],
    code: Code,
    level: Level = Level.WATCH,
    subject: str = "",
) -> Iterator[Fact]:
    """A fact for each time for which it was ``true`` (N,) of a message while armed."""
    here = columns["boot"] == part.boot
    inside = both(armed(signals, part.boot), [(part.start, part.end)])
    for start, end in both(where(columns["time"][here], true[here]), inside):
        yield Fact(
            code,
            level,
            time=start,
            until=end if end < part.end else None,
            subject=subject,
            boot=part.boot,
            basis=(signals.telemetry.called(name),),
        )


STATES = (_arming, _in_the_air, _modes)
FAULTS = (_restarts, _failsafes, _detected, _changes, _losses)
