"""How a flight was lost, as a fact (a coded finding): the last event that may lose a vehicle, and what failed first."""

from collections.abc import Sequence
from typing import Any

from mavdem.assessment.first_failure import CAUSES_OF_ALL_MOTORS, first_failure
from mavdem.assessment.flights import loss_onset
from mavdem.assessment.repeated_reports import in_time_order
from mavdem.assessment.stop_reason import FIRST_RESPONSE_SECONDS
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Code, Fact, Facts
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.witnesses import SensorFact
from mavdem.ingest.motors import name_without_place
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.sensor_facts import checked_event, supporting_fact

ENDINGS: dict[Code, Ending] = {
    MotionEvent.ATTITUDE_LOST: Ending.CONTROL_LOST,
    MotionEvent.TIPPED: Ending.TIPPED_OVER,
    MotionEvent.TOPPLED: Ending.TOPPLED_AT_LANDING,
    MotionEvent.HIT: Ending.CRASHED,
}
"""How a flight ended, by the event of its motion with which it was lost."""

MAX_REPORT_DELAY = 10.0
"""Time, s, up to which ArduPilot's crash check reports a crash after it happened: a choice.

Its own delay is 2 s, and it waits for the vehicle to lie still.
"""

MAX_EARLY_REPORT = 1.0
"""Time, s, by which the report may seem to come before the crash, since stamps of messages differ: a choice."""

FIGURES_OF_LOSS = ("height", "height_source", "speed", "speed_source", "boot")
"""Figures that the ending takes over from the loss, None where the loss does not have them."""

OPTIONAL_FIGURES = ("onset", "is_ground", "satellite_height")
"""Figures that only some losses have, and that the ending takes over from the loss."""

REPORTS_OF_LOSS = (ReportedEvent.CRASH_DETECTED, ReportedEvent.PARACHUTE_RELEASED)
"""Reports of the autopilot that a flight was lost. They are used if the motion does not show it."""


def find_ending(
    signals: Signals, events: Sequence[Fact], collective: float | None = None
) -> Fact | None:
    """Returns the fact about how the last lost flight was lost, with what failed first; None if no flight was lost.

    Only bad events are used. The loss is the last event by which a vehicle may be lost; a contact with the ground that
    followed a loss in the air is none. Reports of a loss by the autopilot are used only if the motion shows none. What
    failed first follows from the commands of the motors (:func:`mavdem.assessment.first_failure.first_failure`), and a
    report of the autopilot on one motor is added to it.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        events: events of ``motion_events`` and ``reported_events``.
        collective: mean output of all motors in the hover, as a fraction of their range; None if it is not known.

    Returns:
        A fact (coded finding) with the figures ``cause`` (the fact about what failed first, or None), ``word`` (what
        the autopilot reported of a motor, if the cause does not contain it) and, without a cause, the flight ``mode``
        in which it happened. Its subject is the motor, if cause and report agree on one.
    """
    bad_events = in_time_order(event for event in events if event.is_bad)
    losses = [
        event
        for event in bad_events
        if event.code in ENDINGS and "is_after_loss" not in event.figures
    ]
    reports = [event for event in bad_events if event.code in REPORTS_OF_LOSS]
    if losses:
        loss = losses[-1]
        cause = _cause_of_loss(signals, events, loss, collective)
    elif reports:
        loss = reports[-1]
        cause = loss
    else:
        return None
    boot = loss.figures["boot"]
    motor_report = _motor_report(signals, bad_events, boot)
    subject = _failed_motor(cause, motor_report)
    if cause is not None and motor_report is not None and cause.subject == motor_report.subject:
        # A report on the motor that the cause names already says nothing new.
        motor_report = None
    return Fact(
        ENDINGS.get(loss.code, Ending.LOSS_REPORTED),
        time=loss.time,
        end_time=loss.end_time,
        subject=subject,
        cause=cause,
        word=motor_report,
        mode="" if cause is not None else signals.mode_at(boot, loss_onset(loss) or 0.0),
        witnesses=loss.figures.get("witnesses", ()),
        **_figures_of_loss(loss),
    )


def _figures_of_loss(loss: Fact) -> dict[str, Any]:
    """Returns the figures by name that the fact on a lost flight takes over from the event of the loss.

    Args:
        loss: the event, a coded finding. A figure of ``FIGURES_OF_LOSS`` that it lacks becomes None, and one of
            ``OPTIONAL_FIGURES`` is left out.
    """
    figures = {name: loss.figures.get(name) for name in FIGURES_OF_LOSS}
    for name in OPTIONAL_FIGURES:
        if name in loss.figures:
            figures[name] = loss.figures[name]
    return figures


def _failed_motor(cause: Fact | None, motor_report: Fact | None) -> str:
    """Returns the name of the one motor that cause and report blame; empty if they blame none, or two different ones.

    Args:
        cause: the fact (coded finding) about what failed first; None if it is not known. If it concerns all motors,
            none is named.
        motor_report: report of the autopilot that a motor failed; None without one.
    """
    if cause is not None and cause.code in CAUSES_OF_ALL_MOTORS:
        return ""
    motors = set()
    for fact in (cause, motor_report):
        if fact is not None and fact.subject:
            motors.add(fact.subject)
    return motors.pop() if len(motors) == 1 else ""


def _cause_of_loss(
    signals: Signals, events: Sequence[Fact], loss: Fact, collective: float | None
) -> Fact | None:
    """Returns the fact about what failed first in a loss that the motion shows; None if nothing did or it is unknown.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        events: events of ``motion_events`` and ``reported_events``.
        loss: the event by which the vehicle was lost.
        collective: mean output of all motors in the hover, as a fraction of their range; None if it is not known.
    """
    if loss.code is MotionEvent.TIPPED:
        # The ground tipped the vehicle over, so that no part of it failed first.
        return None
    if loss.code is MotionEvent.TOPPLED:
        # The ground drives the motors of a toppling vehicle to their limits: they show no cause, but the stick may.
        return _throttle_closed_before(loss)
    return first_failure(signals, events, loss, collective)


def _throttle_closed_before(loss: Fact) -> Fact | None:
    """Returns the fact (coded finding) that a vehicle toppled because the pilot had closed the throttle.

    The throttle must be closed at most ``FIRST_RESPONSE_SECONDS`` after the vehicle began to topple. Most pilots close
    it later, when they see that the vehicle topples: that is a reaction and no cause.

    Args:
        loss: the event of the vehicle that toppled. Its figure ``witnesses`` has the facts of other sensors and sticks
            that support it. A closed throttle may be one of them.

    Returns:
        The fact about the cause; None if the throttle was not closed, or too late.
    """
    onset = loss_onset(loss) or 0.0
    latest_time_of_cause = onset + FIRST_RESPONSE_SECONDS
    for sensor_fact in loss.figures["witnesses"]:
        if sensor_fact.code is not SensorFact.THROTTLE_CLOSED:
            continue
        if sensor_fact.start_time <= latest_time_of_cause:
            return Fact(FailedFirst.THROTTLE_CLOSED_FIRST, time=sensor_fact.time)
    return None


def lower_unconfirmed_crash_reports(signals: Signals, events: Sequence[Fact]) -> list[Fact]:
    """Lowers the level of each report of a crash to "watch" unless sensors confirm it.

    ArduPilot's crash check also reports vehicles that never moved. So the report alone is not enough: a sensor must
    confirm it, by a knock, a tumble, a fast descent or a rest on the side near the report. If no sensor was recorded
    that could show any of these, the report keeps its level.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        events: events that the motion shows, and events that the autopilot reports.

    Returns:
        All events, in the same order.
    """
    # Events of the motion with which a flight may have been lost, such as an impact on the ground.
    losses = [event for event in events if event.code in ENDINGS]
    checked_events = []
    for event in events:
        is_crash_report = event.code is ReportedEvent.CRASH_DETECTED and event.is_bad
        if is_crash_report and _has_measurements(signals, event):
            event = _checked_crash_report(event, _signs_of_crash(signals, event, losses))
        checked_events.append(event)
    return checked_events


def _checked_crash_report(report: Fact, signs_of_crash: Facts) -> Fact:
    """Returns an autopilot's report of a crash, with level "watch" if no sensor confirms it.

    An event needs the support of two independent sources (:func:`mavdem.witnesses.sensor_facts.checked_event`). The
    autopilot is one of them, so that one sensor is enough.

    Args:
        report: the report, a bad event.
        signs_of_crash: facts of the sensors about the time of the report.

    Returns:
        A copy of the report, whose figure ``witnesses`` has the fact (coded finding) that the autopilot reported the
        crash, and the facts of the sensors.
    """
    # The fact about the report contains the report itself, whose text its sentence quotes, but no further witnesses.
    report_as_witness = supporting_fact(
        SensorFact.AUTOPILOT_REPORTED, cause=report.replace(witnesses=())
    )
    return checked_event(report, (report_as_witness, *signs_of_crash))


def _interval_of_crash(report: Fact) -> TimeInterval:
    """Returns the interval in which a crash that the autopilot reports can have happened, s since boot.

    It begins ``MAX_REPORT_DELAY`` before the report, and ends ``MAX_EARLY_REPORT`` after it.

    Args:
        report: fact (a coded finding) that the autopilot reported a crash, with its time.
    """
    time = report.start_time
    return time - MAX_REPORT_DELAY, time + MAX_EARLY_REPORT


def _has_measurements(signals: Signals, report: Fact) -> bool:
    """Returns whether gyro, accelerometer or a height were recorded around a report of a crash.

    Without any of them nothing can confirm the report, and nothing contradict it.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        report: fact (a coded finding) that the autopilot reported a crash, with its time and boot.
    """
    interval = _interval_of_crash(report)
    sensors = BootSensors(signals, report.figures["boot"])
    # A boot without heights has no sink rates.
    if sensors.sink_rates(interval):
        return True
    if sensors.accelerometer is not None and sensors.accelerometer.peak(interval) is not None:
        return True
    for attitude in signals.attitudes:
        rate = series_of_boot(attitude.rate_series, sensors.boot)
        if rate is not None and in_intervals(rate.time, [interval]).any():
            return True
    return False


def _signs_of_crash(signals: Signals, report: Fact, losses: Sequence[Fact]) -> Facts:
    """Collects what the sensors show at the time of a reported crash: facts that support the report or contradict it.

    If the motion shows that the vehicle was lost at that time, these are the sensor facts (coded findings) of that
    loss, its figure ``witnesses``. Otherwise each sensor is examined: whether the accelerometer measured a knock, the
    gyro a tumble, the height sensors a fast descent, and whether the vehicle came to rest on its side.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        report: the autopilot's report of the crash.
        losses: events in which the vehicle was lost, as its motion shows.

    Returns:
        The facts of the sensors; empty if no sensor shows a crash.
    """
    boot = report.figures["boot"]
    interval = _interval_of_crash(report)
    earliest_time, latest_time = interval
    for loss in losses:
        if loss.figures["boot"] == boot and earliest_time <= loss.start_time <= latest_time:
            # The report itself may be among the facts of the loss, but the caller has counted it already.
            facts_of_loss = []
            for fact in loss.figures.get("witnesses", ()):
                if fact.code is not SensorFact.AUTOPILOT_REPORTED:
                    facts_of_loss.append(fact)
            return tuple(facts_of_loss)
    return _sensor_signs_of_crash(BootSensors(signals, boot), interval)


def _sensor_signs_of_crash(sensors: BootSensors, interval: TimeInterval) -> Facts:
    """Collects what each sensor shows of a crash: a knock, a tumble, a fast descent, and a rest on the vehicle's side.

    Args:
        sensors: sensors of the vehicle in the boot of the crash.
        interval: start and end of the time in which the crash can have happened, s since boot.

    Returns:
        The facts of the sensors that show one of these; empty if none does.
    """
    earliest_time, latest_time = interval
    signs = list[Fact]()
    knock = sensors.knock_fact(interval)
    if knock is not None:
        signs.append(knock)
    tumble = sensors.rotation_fact(interval)
    if tumble is not None:
        signs.append(tumble)
    for fact in sensors.sink_facts(interval):
        # Other facts of the height sensors say that the vehicle did not sink.
        if fact.code is SensorFact.SANK:
            signs.append(fact)
    rest_after_loss = sensors.rest_after(earliest_time, latest_time)
    if rest_after_loss is not None and rest_after_loss.is_on_side:
        signs += [rest_after_loss.rest_fact, *rest_after_loss.pose_facts]
    return tuple(signs)


def _motor_report(signals: Signals, bad_events: Sequence[Fact], boot: int) -> Fact | None:
    """Returns the last report of the autopilot in a boot that one of the motors failed.

    Args:
        signals: signals of the vehicle, with the names of its motors.
        bad_events: bad events of the log in the order of time.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        A fact (coded finding) with the full name of the motor, such as "motor 2 (rear left)", if the autopilot only
        says "motor 2"; None without such a report.
    """
    if signals.motors is None:
        return None
    full_names = {name_without_place(name): name for name in signals.motors.geometry.names}
    for event in reversed(bad_events):
        is_report = event.code in (ReportedEvent.THRUST_LOST, ReportedEvent.MOTOR_FAILED)
        if is_report and event.subject in full_names and event.figures["boot"] == boot:
            subject = full_names[event.subject]
            return Fact(event.code, event.level, time=event.time, subject=subject, boot=boot)
    return None
