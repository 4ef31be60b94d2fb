"""Events of a flight that went wrong, as facts (coded findings), by attitude, height and accelerometers.

The autopilot's own reports only support them. First it is decided whether the vehicle flew. Each event then has its
witnesses, the statements of sensors for and against it (:mod:`mavdem.witnesses`); without a second witness for it, its
level is only "watch".
"""

from collections.abc import Iterator, Sequence

import numpy as np

from mavdem.assessment.attitude_losses import attitude_losses
from mavdem.assessment.attitude_swings import attitude_swings
from mavdem.assessment.barometer_drifts import barometer_drifts, drift_with_onset_time
from mavdem.assessment.clipping import clipping_events
from mavdem.assessment.descents import dive_events, fall_events
from mavdem.assessment.doubted_heights import events_with_checked_heights
from mavdem.assessment.flight_losses import CONTACTS, flight_losses
from mavdem.assessment.flights import RECOVERY_SECONDS, flights_in_boot, loss_onset
from mavdem.assessment.flips import flip_events, flip_intervals
from mavdem.assessment.ground_contacts import ground_contact
from mavdem.assessment.height_disagreements import height_disagreements
from mavdem.assessment.height_divergence import height_divergences
from mavdem.assessment.height_offsets import height_offsets
from mavdem.assessment.invalid_attitudes import invalid_attitudes
from mavdem.assessment.log_end import end_in_air
from mavdem.assessment.motor_events import LASTING_SECONDS, motor_events
from mavdem.assessment.motor_speeds import standing_motors
from mavdem.assessment.motor_witnesses import with_sensor_evidence
from mavdem.assessment.position_losses import position_losses
from mavdem.assessment.repeated_reports import in_time_order
from mavdem.assessment.running_motors import motors_left_running
from mavdem.assessment.swing_causes import with_causes_of_swings
from mavdem.assessment.wind_drifts import wind_drifts
from mavdem.assessment.yaw_spins import yaw_spins
from mavdem.dataset.attitude_error import AttitudeError, attitude_error
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT, MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import Intervals, TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.witnesses import Side
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.witnesses import SensorTrust, trust_of_boots
from mavdem.witnesses.boot_sensors import BootSensors


def motion_events(signals: Signals, reports: Sequence[Fact] = ()) -> Facts:
    """Returns what went wrong in a log as its motion shows it, such as a loss of attitude, a fall or a ground contact.

    Each boot of the autopilot (the time from one start of it to the next) is judged by itself. If the vehicle did not
    fly in one, a single event says so. Vehicles other than multirotors have fewer kinds of events, since a plane banks
    and dives on purpose.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        reports: events that the autopilot reports, which support or contradict the events of the motion.

    Returns:
        The events in order of boot and time; empty if the attitude was not recorded.
    """
    if not signals.tilts:
        return ()
    is_multirotor = signals.telemetry.vehicle in POSSIBLE_MULTIROTORS
    events: list[Fact] = []
    # A boot's trust says which of its sensors can be relied on.
    for trust in trust_of_boots(signals):
        boot = trust.boot
        if not is_multirotor:
            events += _events_of_other_vehicle(signals, boot, reports)
            continue
        not_flown = _not_flown_event(signals, trust)
        if not_flown is not None:
            events.append(not_flown)
        else:
            events += _events_of_boot(signals, boot, reports)
    return tuple(in_time_order(with_causes_of_swings(events)))


def _events_of_other_vehicle(
    signals: Signals, boot: int, reports: Sequence[Fact]
) -> Iterator[Fact]:
    """Yields the events of one boot of a vehicle that is not a multirotor, in no particular order.

    They are clipping of the accelerometers and losses of the horizontal position. Losses of attitude, falls and limits
    of motors are no events of such a vehicle, since a plane banks and dives on purpose.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        reports: events that the autopilot reports.
    """
    flights = flights_in_boot(signals, boot)
    yield from clipping_events(signals, boot, flights)
    for flight in flights:
        take_off, _ = flight
        yield from position_losses(BootSensors(signals, boot, take_off), flight, reports)


def _not_flown_event(signals: Signals, trust: SensorTrust) -> Fact | None:
    """Returns the event that the vehicle did not fly between a start of the autopilot (boot) and the next.

    This is the case if the motors ran, and the autopilot may even report a flight, but the sensors show none.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        trust: what the sensors show of this boot: whether the vehicle flew, or None if they do not show it.

    Returns:
        The event, at the first time of the boot; None if the vehicle flew, or may have flown.
    """
    if trust.flew is None or trust.flew:
        return None
    tilt = signals.tilts[0]
    times = tilt.time[tilt.boot == trust.boot]
    # Evidence against a flight is evidence for the event that there was none.
    sensor_facts = tuple(fact.replace(side=Side.FOR) for fact in trust.flight_check.sensor_facts)
    return Fact(MotionEvent.NOT_FLOWN, time=times[0], boot=trust.boot, witnesses=sensor_facts)


def _events_of_boot(signals: Signals, boot: int, reports: Sequence[Fact]) -> Iterator[Fact]:
    """Yields the events of one boot in which a multirotor flew, in no particular order.

    Most events are found flight by flight. Events of motors are found afterwards, since a vehicle that is out of
    control drives sound motors to their limits. Whether the log ends in the air follows from the events of the last
    flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        reports: events that the autopilot reports.
    """
    error = attitude_error(signals, boot)
    if error is None:
        return
    flights = flights_in_boot(signals, boot)
    yield from clipping_events(signals, boot, flights)
    times_out_of_control: Intervals = []
    flips: Intervals = []
    flight_events: list[Fact] = []
    for flight in flights:
        take_off, _ = flight
        sensors = BootSensors(signals, boot, take_off)
        flight_events = list(_events_of_flight(sensors, error, flight, reports))
        flight_events = events_with_checked_heights(sensors, flight_events, flight_events)
        yield from flight_events
        times_out_of_control += _times_out_of_control(flight_events, flight)
        flips += flip_intervals(flight_events)
    for event in motor_events(signals, boot, flights):
        if event.code is MotionEvent.MOTOR_OFF:
            yield from with_sensor_evidence(signals, [event], reports)
        elif event.code is MotionEvent.MOTOR_AT_ITS_STOP and _lies_within(event, flips):
            # A flip needs full thrust of some motors, so that their limit is not a fault.
            yield event.replace(Level.GOOD, is_in_flip=True)
        elif not in_intervals(event.start_time, times_out_of_control):
            yield event
    if flights:
        # After the loop these are the events of the last flight.
        end_event = end_in_air(signals, boot, flights[-1], error.time[-1], flight_events)
        if end_event is not None:
            take_off, _ = flights[-1]
            sensors = BootSensors(signals, boot, take_off)
            yield from events_with_checked_heights(sensors, [end_event], flight_events)


def _lies_within(event: Fact, intervals: Intervals) -> bool:
    """Returns whether an event begins and ends within one of several intervals, s since boot."""
    return any(start <= event.start_time and event.latest_time <= end for start, end in intervals)


def _times_out_of_control(
    flight_events: Sequence[Fact], flight_interval: TimeInterval
) -> Intervals:
    """Returns the intervals of a flight in which motors reach their limits because the vehicle is out of control.

    A motor at its limit in such an interval is not a fault of the motor. Each interval lasts until the end of the
    flight, since a vehicle that was lost hardly flies on as before. Where it begins depends on the event:

    - A height estimate that diverged drives all motors to a limit, and none of them is its cause: at the event.
    - Any other bad event, such as a fall or a flight on the back, may be caused by a motor that reaches its limit as
      the event begins. The interval begins ``LASTING_SECONDS`` later, so that such a limit is still reported.
    - A vehicle that wind carries away is under control: no interval.

    Args:
        flight_events: events of the flight, each a fact (a coded finding) with its time.
        flight_interval: start and end of the flight, s since boot.

    Returns:
        The intervals, s since boot; they may overlap.
    """
    intervals = []
    _, flight_end = flight_interval
    for event in flight_events:
        if event.code is MotionEvent.HEIGHT_DIVERGED:
            intervals.append((event.start_time, flight_end))
        elif event.is_bad and event.code is not MotionEvent.CARRIED_AWAY:
            intervals.append((event.start_time + LASTING_SECONDS, flight_end))
    return intervals


def _events_of_flight(
    sensors: BootSensors,
    error: AttitudeError,
    flight_interval: TimeInterval,
    reports: Sequence[Fact],
) -> Iterator[Fact]:
    """Yields the events of one flight, such as a loss of attitude, a fall or a flip, in no particular order.

    A flight may end with a loss of attitude, a contact with the ground, or both (:func:`flight_losses`). Some events
    follow from every such end, for example a height estimate that diverges. They are sought only before it.

    Args:
        sensors: sensors of the boot, with the take-off of this flight.
        error: error of the attitude in this boot.
        flight_interval: start and end of the flight, s since boot.
        reports: events that the autopilot reports.
    """
    attitude_events = attitude_losses(sensors, error, flight_interval)
    # A loss of attitude from which the vehicle recovered does not end the flight.
    loss = None
    if attitude_events and attitude_events[-1].code is not MotionEvent.ATTITUDE_CAUGHT:
        loss = attitude_events.pop()
    yield from attitude_events
    contact = ground_contact(sensors, error, flight_interval, loss, reports)
    loss, contact = flight_losses(loss, contact)
    for event in (loss, contact):
        if event is not None:
            yield event
    if contact is not None and contact.is_bad and contact.code in CONTACTS:
        running_motors = motors_left_running(sensors.signals, contact)
        if running_motors is not None:
            yield running_motors
    yield from _stopped_motors(sensors, error, flight_interval, loss, contact, reports)
    yield from _falls_of_flight(sensors, flight_interval, loss, contact)
    yield from dive_events(sensors, flight_interval)
    yield from flip_events(sensors, flight_interval)
    controlled_interval = _interval_before(flight_interval, loss, contact)
    yield from _events_under_control(sensors, controlled_interval, reports)
    yield from invalid_attitudes(sensors.signals, sensors.boot, flight_interval)
    yield from _height_sensor_drifts(sensors, flight_interval, controlled_interval)


def _events_under_control(
    sensors: BootSensors, controlled_interval: TimeInterval, reports: Sequence[Fact]
) -> Iterator[Fact]:
    """Yields the events of a flight that are faults only as long as the vehicle is not lost, in no particular order.

    They are swings and spins, errors of the estimated height and position, and a drift in wind.

    Args:
        sensors: sensors of the boot, with the take-off of this flight.
        controlled_interval: start of the flight, and its end or the loss of the vehicle, s since boot.
        reports: events that the autopilot reports.
    """
    yield from attitude_swings(sensors.signals, sensors.boot, controlled_interval)
    yield from yaw_spins(sensors.signals, sensors.boot, controlled_interval)
    divergences = list(height_divergences(sensors, controlled_interval))
    yield from divergences
    if not divergences:
        # A height that diverged has an offset too, which needs no event of its own.
        yield from height_offsets(sensors, controlled_interval)
    yield from position_losses(sensors, controlled_interval, reports)
    yield from wind_drifts(sensors, controlled_interval)


def _height_sensor_drifts(
    sensors: BootSensors, flight_interval: TimeInterval, controlled_interval: TimeInterval
) -> Iterator[Fact]:
    """Yields the event that the barometer drifted in a flight, or else that satellites disagree with it.

    The heights at rest show that the barometer drifted, but not when. If it and satellites disagree in the flight, the
    drift began when their difference began to grow.

    Args:
        sensors: sensors of the boot, with the take-off of this flight.
        flight_interval: start and end of the flight, s since boot.
        controlled_interval: start and end of the part of it before the vehicle was lost, if it was.
    """
    disagreements = list(height_disagreements(sensors, controlled_interval))
    drifts = list(barometer_drifts(sensors, flight_interval))
    if not drifts:
        # Nothing shows which of the two is wrong.
        yield from disagreements
        return
    first_disagreement = disagreements[0] if disagreements else None
    for drift in drifts:
        yield drift_with_onset_time(drift, first_disagreement)


def _stopped_motors(
    sensors: BootSensors,
    error: AttitudeError,
    flight_interval: TimeInterval,
    loss: Fact | None,
    contact: Fact | None,
    reports: Sequence[Fact],
) -> Iterator[Fact]:
    """Yields an event for each motor that stood still in a flight before the vehicle was lost.

    A standstill after a contact with the ground is left out, since the ground blocks propellers. One after a loss of
    attitude in the air is left out if it begins more than ``MAX_SETPOINT_DELAY`` later: the standstill that caused the
    loss may be measured that late, since the telemetry of motor controllers is slow.

    Args:
        sensors: sensors of the boot, with the take-off of this flight.
        error: error of the attitude in this boot.
        flight_interval: start and end of the flight, s since boot.
        loss: the loss of attitude in the air; None without one.
        contact: event of the contact with the ground; None for an ordinary landing.
        reports: events that the autopilot reports.
    """
    _, latest_start = flight_interval
    if contact is not None and contact.code is not MotionEvent.LANDED_HARD:
        contact_onset = loss_onset(contact)
        # A contact whose onset is not known leaves nothing out.
        if contact_onset:
            latest_start = min(latest_start, contact_onset)
    if loss is not None and loss.time is not None:
        latest_start = min(latest_start, loss.time + MAX_SETPOINT_DELAY)
    for standstill in standing_motors(sensors, error, flight_interval, reports):
        if standstill.start_time < latest_start:
            yield standstill


def _interval_before(flight_interval: TimeInterval, *events: Fact | None) -> TimeInterval:
    """Returns the part of a flight before the first of some events.

    Args:
        flight_interval: start and end of the flight, s since boot.
        events: the events; None for one that did not occur.

    Returns:
        Start and end of this part, s since boot.
    """
    start, end = flight_interval
    for event in events:
        if event is not None and event.time is not None:
            end = min(end, event.time)
    return start, end


def _falls_of_flight(
    sensors: BootSensors, flight_interval: TimeInterval, loss: Fact | None, contact: Fact | None
) -> Iterator[Fact]:
    """Yields the fall of a flight, if there was one.

    The interval in which a fall is sought depends on the other events, so that neither a quick descent of an intact
    vehicle nor an estimate that diverges after an impact is mistaken for a fall:

    - With a loss of attitude: from the loss to the contact with the ground.
    - With a contact only: the ``RECOVERY_SECONDS`` before it. If the contact was high above the ground, the interval
      lasts until after the flight, since the vehicle fell from there.
    - Without both: around the end of a record that has no landing.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
        loss: the loss of attitude in the air with which the flight ended; None if there was none.
        contact: event of the contact with the ground; None for an ordinary landing.

    Yields:
        The fall, at most one.
    """
    flight_start, landing_time = flight_interval
    flight_end = min(landing_time, sensors.record_end)
    # The times of a loss and of a contact may be unknown: then the limits around the end of the flight stay.
    search_start = flight_end - RECOVERY_SECONDS
    search_end = flight_end + RECOVERY_SECONDS
    contact_time = None if contact is None else contact.time
    if loss is not None:
        search_start = loss.time or search_start
        search_end = contact_time or search_end
    elif contact is not None:
        search_start = (contact_time or search_start) - RECOVERY_SECONDS
        # Without a height the contact counts as one near the ground.
        contact_height = contact.figures["height"] or 0.0
        if contact_height < MAX_GROUND_HEIGHT:
            search_end = contact_time or search_end
    elif np.isfinite(landing_time):
        # An ordinary landing. After it the estimate of the climb may diverge, which looks like a fall.
        return
    yield from fall_events(sensors, (max(flight_start, search_start), search_end))
