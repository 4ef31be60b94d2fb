"""Faults that messages report for a time: failsafes, lost fixes and radios, low batteries, and failed sensors."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Flags
from mavdem.assessment.lights.power import BOARD_VOLTAGE_LIMITS, POSSIBLE_BOARD_VOLTAGE
from mavdem.dataset.batteries import BatteryColumns, battery_columns, battery_name
from mavdem.dataset.signals import Signals
from mavdem.facts.events import ReportedEvent
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.ingest.vocabulary import CRITICAL
from mavdem.witnesses.position import position_fix, receiver_message

EMERGENCY_CHARGE = mavlink_constant("MAV_BATTERY_CHARGE_STATE_EMERGENCY")
"""The charge state "emergency", which is worse than "critical": the vehicle must land at once."""

LOW_CHARGE = mavlink_constant("MAV_BATTERY_CHARGE_STATE_LOW")
"""The charge state "low" of BATTERY_STATUS; larger values are worse, but for ``CHARGING``."""

CHARGING = mavlink_constant("MAV_BATTERY_CHARGE_STATE_CHARGING")
"""The charge state of a battery that is charged."""

SENSOR_MASKS = ("health", "present", "enabled")
"""Ends of the names of three bit masks of SYS_STATUS, ``onboard_control_sensors_…``, with a bit for each sensor."""

MAX_MOTORS = 16
"""Number of motors in PX4's ``motor_failure_mask``, one bit each."""

MILLIVOLTS_PER_VOLT = 1000
"""Millivolts of a volt: the unit of POWER_STATUS."""


class Fault(NamedTuple):
    """What a field or bit of a message reports when it is set."""

    code: ReportedEvent
    """Code of the event."""
    subject: str = ""
    """What is at fault; empty if the code names it."""


FAILURE_DETECTORS = {
    "fd_roll": Fault(ReportedEvent.ATTITUDE_FAILED, "roll"),
    "fd_pitch": Fault(ReportedEvent.ATTITUDE_FAILED, "pitch"),
    "fd_alt": Fault(ReportedEvent.ALTITUDE_FAILED),
    "fd_motor": Fault(ReportedEvent.MOTOR_FAILED),
    "fd_imbalanced_prop": Fault(ReportedEvent.PROPELLER_IMBALANCED),
}
"""Faults by the fields of PX4's ``failure_detector_status``."""

SENSOR_FAULTS = {
    "SENSOR_3D_GYRO": Fault(ReportedEvent.SENSOR_FAILED, "gyro"),
    "SENSOR_3D_ACCEL": Fault(ReportedEvent.SENSOR_FAILED, "accel"),
    "SENSOR_3D_MAG": Fault(ReportedEvent.SENSOR_FAILED, "compass"),
    "SENSOR_ABSOLUTE_PRESSURE": Fault(ReportedEvent.SENSOR_FAILED, "barometer"),
    "SENSOR_GPS": Fault(ReportedEvent.SENSOR_FAILED, "gps"),
    "SENSOR_RC_RECEIVER": Fault(ReportedEvent.RADIO_LOST),
    "AHRS": Fault(ReportedEvent.ESTIMATOR_DIVERGED, "attitude"),
}
"""Faults by the bits of SYS_STATUS: the name of the bit is MAV_SYS_STATUS_ and the key (MAV_SYS_STATUS_SENSOR)."""


class FaultSignal(NamedTuple):
    """For each sample of a message, whether it reports one fault."""

    message: str
    """Name of the message."""
    is_faulty: Flags
    """(N,) for the N samples of the message; (0,) if it or its field was not recorded."""
    code: ReportedEvent
    """Code of the event."""
    subject: str = ""
    """What is at fault; empty if the code names it."""
    columns: Columns | None = None
    """The N samples, if they are not all samples of the message, such as those of one of several batteries."""
    instance: str = ""
    """Name of the battery, even if it is the only one; empty if the subject says what is at fault."""

    def is_about(self, subject: str) -> bool:
        """Returns whether a text with this subject may be about the same battery, motor or axis.

        Args:
            subject: subject of the text; empty if it names none, so that it may be about any.
        """
        reported_subject = self.instance or self.subject
        return not subject or not reported_subject or subject == reported_subject

    def columns_of(self, signals: Signals) -> Columns:
        """Returns the N samples, with their times and boots.

        Args:
            signals: signals of the vehicle, with the message.
        """
        return self.columns or signals.telemetry.messages[self.message]


def fault_signals(signals: Signals) -> Iterator[FaultSignal]:
    """Yields every fault that a message may report for a time, with the samples that report it.

    Args:
        signals: signals of the vehicle, with the messages of all boots.

    Yields:
        A signal for each message and fault, also for faults that never occur. Its flags are empty if the log does not
        have the message.
    """
    telemetry = signals.telemetry
    is_critical = _column(telemetry, "HEARTBEAT", "system_status") >= CRITICAL
    yield FaultSignal("HEARTBEAT", is_critical, ReportedEvent.FAILSAFE)
    yield from _lost_fix(signals)
    is_radio_lost = _column(telemetry, "input_rc", "rc_lost") > 0
    yield FaultSignal("input_rc", is_radio_lost, ReportedEvent.RADIO_LOST)
    yield _low_board_voltage(telemetry)
    yield from _battery_faults(signals)
    # SYS_STATUS has bit masks of the sensors that are healthy, present and enabled.
    masks = []
    for mask_name in SENSOR_MASKS:
        mask = _column(telemetry, "SYS_STATUS", f"onboard_control_sensors_{mask_name}")
        masks.append(mask.astype(np.int64))
    health, present, enabled = masks
    yield from _sensor_faults(health, present, enabled)
    yield from _detected_failures(telemetry)


def _column(telemetry: Telemetry, message: str, field: str) -> NDArray[Any]:
    """Returns (N,) values of a field of a message; empty if it was not recorded."""
    return telemetry.messages.get(message, {}).get(field, np.zeros(0, np.int64))


def _lost_fix(signals: Signals) -> Iterator[FaultSignal]:
    """Yields the signal of a lost GPS fix; nothing without a receiver.

    A fix can be lost only after there was one in the same boot: a receiver needs time after a restart.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    receiver = receiver_message(signals.telemetry)
    fix = position_fix(signals)
    if receiver is None or fix is None:
        return
    has_fix = fix.values > 0
    is_lost = np.zeros(len(has_fix), dtype=np.bool_)
    for boot in np.unique(fix.boot):
        is_of_boot = fix.boot == boot
        has_fix_in_boot = has_fix[is_of_boot]
        # True from the first fix of the boot on.
        had_fix_in_boot = np.logical_or.accumulate(has_fix_in_boot)
        is_lost[is_of_boot] = had_fix_in_boot & ~has_fix_in_boot
    columns = {"time": fix.time, "boot": fix.boot}
    yield FaultSignal(receiver, is_lost, ReportedEvent.GPS_LOST, columns=columns)


def _low_board_voltage(telemetry: Telemetry) -> FaultSignal:
    """Returns the signal that the supply voltage of the board is below its limit.

    Voltages that are too low to be possible, such as 0 V, mean that it was not measured, and are not a fault.

    Args:
        telemetry: messages of the vehicle.
    """
    volts = _column(telemetry, "POWER_STATUS", "Vcc") / MILLIVOLTS_PER_VOLT
    lowest_possible, _ = POSSIBLE_BOARD_VOLTAGE
    is_low = (volts >= lowest_possible) & (volts < BOARD_VOLTAGE_LIMITS.bad)
    return FaultSignal("POWER_STATUS", is_low, ReportedEvent.BOARD_VOLTAGE_LOW)


def _detected_failures(telemetry: Telemetry) -> Iterator[FaultSignal]:
    """Yields the signal of each of PX4's ``FAILURE_DETECTORS``, and one of each motor that they report as failed.

    Args:
        telemetry: messages of the vehicle.
    """
    message = "failure_detector_status"
    for field, fault in FAILURE_DETECTORS.items():
        is_detected = _column(telemetry, message, field) > 0
        yield FaultSignal(message, is_detected, fault.code, fault.subject)
    failed_motors = _column(telemetry, message, "motor_failure_mask").astype(np.int64)
    for motor in range(MAX_MOTORS):
        # Bit i of the mask belongs to motor i + 1.
        has_failed = failed_motors >> motor & 1 > 0
        if has_failed.any():
            yield FaultSignal(message, has_failed, ReportedEvent.MOTOR_FAILED, f"motor {motor + 1}")


def _battery_faults(signals: Signals) -> Iterator[FaultSignal]:
    """Yields three signals for each battery: whether the autopilot reports it low, critical or spent.

    The battery is the subject if the vehicle has several. If BATTERY_STATUS has charge states, other messages are not
    used, since they repeat the state of one of these batteries.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    batteries = _batteries_with_charge_state(signals.telemetry)
    has_several_batteries = len(batteries) > 1 or len(signals.batteries) > 1
    for battery in batteries:
        name = battery_name(battery.number)
        subject = name if has_several_batteries else ""
        # MAV_BATTERY_CHARGE_STATE: above low are critical, emergency, failed and unhealthy; charging is the last one.
        state = battery.columns["charge_state"]
        is_low = state == LOW_CHARGE
        is_emergency = state == EMERGENCY_CHARGE
        is_critical = (state > LOW_CHARGE) & (state != CHARGING) & ~is_emergency
        flags_by_code = {
            ReportedEvent.BATTERY_WARNED: is_low,
            ReportedEvent.BATTERY_ALARMED: is_critical,
            ReportedEvent.BATTERY_SPENT: is_emergency,
        }
        for code, is_faulty in flags_by_code.items():
            yield FaultSignal(battery.message, is_faulty, code, subject, battery.columns, name)


def _batteries_with_charge_state(telemetry: Telemetry) -> list[BatteryColumns]:
    """Returns the messages on batteries that report a charge state, such as "low" or "critical".

    Several messages may report the same battery: if BATTERY_STATUS has a charge state, the others are left out.

    Args:
        telemetry: messages of the vehicle.
    """
    reporting_batteries = []
    for battery in battery_columns(telemetry):
        # The state 0 is "undefined": a battery that never has another one reports nothing.
        if battery.columns.get("charge_state", np.zeros(0)).any():
            reporting_batteries.append(battery)
    by_battery_status = [
        battery for battery in reporting_batteries if battery.message == "BATTERY_STATUS"
    ]
    return by_battery_status or reporting_batteries


def _sensor_faults(
    health: NDArray[np.int64], present: NDArray[np.int64], enabled: NDArray[np.int64]
) -> Iterator[FaultSignal]:
    """Yields the fault signal of each of the ``SENSOR_FAULTS`` by SYS_STATUS.

    A sensor is faulty if it is present and enabled, and not healthy any more. A sensor that was never healthy before in
    the log did not fail: autopilots also clear the bit before calibration, or if they do not use the sensor. The
    signals of sensors without a fault are yielded too, with all flags false.

    Args:
        health: (N,) bit masks of the healthy sensors, with a bit for each sensor (MAV_SYS_STATUS_SENSOR), of N
            messages.
        present: (N,) likewise of the sensors that the vehicle has.
        enabled: (N,) likewise of the sensors that are switched on.
    """
    unhealthy = ~health & present & enabled
    for sensor, fault in SENSOR_FAULTS.items():
        sensor_bit = mavlink_constant(f"MAV_SYS_STATUS_{sensor}")
        is_healthy = health & sensor_bit > 0
        is_unhealthy = unhealthy & sensor_bit > 0
        # True from the first message on in which the sensor is healthy.
        was_healthy = np.logical_or.accumulate(is_healthy)
        yield FaultSignal("SYS_STATUS", was_healthy & is_unhealthy, fault.code, fault.subject)
