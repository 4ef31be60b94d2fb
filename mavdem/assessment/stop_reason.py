"""Why all motors of a vehicle went to idle in the air, as a fact (a coded finding): failsafe, switch, or the pilot."""

from collections.abc import Sequence

import numpy as np

from mavdem.assessment.autopilot_messages import reports_failsafe
from mavdem.assessment.battery_levels import cell_count, voltage_levels
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import FailedFirst
from mavdem.facts.events import ReportedEvent
from mavdem.witnesses.boot_sensors import BootSensors

FIRST_RESPONSE_SECONDS = 0.3
"""Seconds in which a controller answers a failure before the vehicle has turned: three samples at 10 Hz."""

STOP_REASON_SECONDS = 2.0
"""Seconds around the stop of all motors within which its reason is reported."""

REASONS_OF_STOP = (
    ReportedEvent.MOTORS_STOPPED,
    ReportedEvent.FLIGHT_TERMINATED,
    ReportedEvent.RADIO_LOST,
    ReportedEvent.BATTERY_ALARMED,
    ReportedEvent.BATTERY_SPENT,
    ReportedEvent.GROUND_STATION_LOST,
    ReportedEvent.FENCE_BREACHED,
    ReportedEvent.FAILSAFE,
    ReportedEvent.ESTIMATOR_DIVERGED,
)
"""Reports of the autopilot that explain why it stopped all motors, independently of the pilot.

A warning of a low battery comes again and again, so that it explains a stop only if the pilot did not close the
throttle.
"""

BATTERY_ALARMS = (ReportedEvent.BATTERY_ALARMED, ReportedEvent.BATTERY_SPENT)
"""Reports of an empty battery. They describe the state of the battery, which does not affect the motors by itself."""


def reason_of_stop(signals: Signals, events: Sequence[Fact], boot: int, stop: Fact) -> Fact:
    """Finds the reason why all motors went to idle: a reported failsafe or switch, or the pilot's throttle.

    A failsafe is preferred, then the closed throttle, and last a warning of the battery. Only what was reported or done
    within ``STOP_REASON_SECONDS`` of the stop is examined.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        events: events of the flight, with those that the autopilot reports.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        stop: the fact that all motors went to idle, with its time.

    Returns:
        The reason; the fact ``stop`` itself if the log shows none.
    """
    stop_time = stop.start_time
    earliest_time = stop_time - STOP_REASON_SECONDS
    latest_time = stop_time + STOP_REASON_SECONDS
    reports = [
        event
        for event in events
        if event.figures.get("boot") == boot
        and _is_reported_in(event, (earliest_time, latest_time))
    ]
    for report in reports:
        explains_stop = report.code in REASONS_OF_STOP
        if explains_stop and _is_confirmed_report(signals, boot, stop_time, report):
            return Fact(FailedFirst.FAILSAFE_FIRST, time=stop_time, cause=report)
    # A pilot who closes the throttle later reacts to the fall. A short delay is allowed, since the stick may be logged
    # more slowly than the motors.
    throttle_closing = BootSensors(signals, boot).throttle_closed_fact(
        (earliest_time, stop_time + FIRST_RESPONSE_SECONDS)
    )
    if throttle_closing is not None:
        return Fact(FailedFirst.THROTTLE_CLOSED_FIRST, time=throttle_closing.time)
    for report in reports:
        if report.code is ReportedEvent.BATTERY_WARNED:
            return Fact(FailedFirst.FAILSAFE_FIRST, time=stop_time, cause=report)
    return stop


def _is_confirmed_report(signals: Signals, boot: int, stop_time: float, report: Fact) -> bool:
    """Returns whether a report can be the reason why all motors stopped.

    An alarm of an empty battery can only if the autopilot acted on it, by a failsafe, or the voltage was low before the
    stop: a battery that breaks loose in a crash raises an alarm too. Any other report can.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        stop_time: time when the motors stopped, s since boot.
        report: fact (a coded finding) that the autopilot reported something, with its time.
    """
    is_mere_alarm = report.code in BATTERY_ALARMS and not reports_failsafe(report)
    return not is_mere_alarm or _battery_was_low(signals, boot, stop_time)


def _is_reported_in(event: Fact, interval: TimeInterval) -> bool:
    """Returns whether the autopilot reported an event in an interval.

    The start of the report must be in the interval. For a lost radio, any part of the loss may be in it, since the
    failsafe acts only seconds after the loss begins.

    Args:
        event: fact (a coded finding) that the autopilot reported, with its time.
        interval: start and end, s since boot.
    """
    earliest_time, latest_time = interval
    start = event.start_time
    # A lost radio lasts until it is regained. Any other report counts at its start alone.
    end = event.latest_time if event.code is ReportedEvent.RADIO_LOST else start
    overlaps_interval = start <= latest_time and end >= earliest_time
    return overlaps_interval


def _battery_was_low(signals: Signals, boot: int, time: float) -> bool:
    """Returns whether a battery was low before a time, by its median voltage over ``RECOVERY_SECONDS``.

    The limit is the voltage of a low battery. The voltage of a critical one is not used, since most logs do not contain
    it, and it may be anywhere below.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: time when the motors stopped, s since boot.

    Returns:
        True if one battery was low; False also if no voltage or no limit is known.
    """
    parameters = signals.telemetry.parameters
    for battery in signals.batteries:
        voltage = series_of_boot(battery.voltage, boot)
        if voltage is None:
            continue
        is_just_before = in_intervals(voltage.time, [(time - RECOVERY_SECONDS, time)])
        volts_before = voltage.values[is_just_before]
        cells = cell_count(parameters, battery) or 0
        low_voltage = voltage_levels(parameters, battery.number, cells).watch
        if len(volts_before) and np.median(volts_before) < low_voltage:
            return True
    return False
