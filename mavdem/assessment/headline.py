"""The headline of a judgement: the most serious of all facts (coded findings) about a vehicle."""

from collections.abc import Iterable, Sequence

from mavdem.assessment.attitude_losses import FAR_ANGLE
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights import OTHER_LIGHTS, VEHICLE_LIGHTS
from mavdem.assessment.lights.motors import is_range_taken_by_commands
from mavdem.dataset.learnability import NEVER_ARMED
from mavdem.facts import Fact, Facts, Level, NamedFacts
from mavdem.facts.assessment import Headline
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.motors import TrimFact
from mavdem.facts.watch import WatchFact
from mavdem.ingest.motors import name_without_place

URGENT_EVENTS = (
    MotionEvent.HIT,
    MotionEvent.TOPPLED,
    MotionEvent.TIPPED,
    MotionEvent.ATTITUDE_LOST,
    MotionEvent.FELL,
    MotionEvent.HEIGHT_DIVERGED,
    MotionEvent.POSITION_LOST,
    MotionEvent.LOG_ENDED_IN_AIR,
    ReportedEvent.RESTARTED,
    ReportedEvent.FAILSAFE,
    ReportedEvent.MOTORS_STOPPED,
    ReportedEvent.FLIGHT_TERMINATED,
    ReportedEvent.CRASH_DETECTED,
)
"""Losses, failsafes, restarts and impacts, the most important first. Even if their level is only "watch", they rank
above every light: a trim or vibration matters less than a vehicle that fell. Only a log that ends in the air ranks
below a light that is bad."""

TRIMS_OF_WEAK_MOTOR = (TrimFact.TRIM_OF_ONE_MOTOR, TrimFact.TRIM_OF_LEADING_MOTOR)
"""Patterns of the trim by which one motor is probably weak, although it is only to be watched."""

PARTIAL_CHECKS = (WatchFact.NO_MOTOR_AT_LIMIT, WatchFact.NO_OSCILLATION)
"""Lights of a live flight that say what one check has shown so far; their figure ``reason`` is why the rest of the
light is unknown."""

MIN_CHECKED_LIGHTS = 4
"""Lights of the vehicle that must be good before a flight is called sound: more than half of the six, a choice."""


def headline_of(evidence: Evidence, lights: NamedFacts) -> Fact:
    """Returns the headline, which is the most serious fact that was found.

    The headline is the first of these that applies:

    1. The vehicle did not fly.
    2. The autopilot restarted in flight.
    3. How the flight was lost.
    4. Another bad event.
    5. A loss, failsafe or impact of the level "watch", or bad power or a bad estimator as its reason.
    6. A bad light.
    7. The log ends in the air.
    8. If there was no flight, the reason or, if nothing shows whether there was one, a warning of the autopilot.
    9. Another fact of the level "watch".
    10. Nothing is wrong with what was checked.

    Args:
        evidence: signals, events and measurements of the vehicle.
        lights: the facts of the eight lights, by name.
    """
    if evidence.not_flown is not None:
        return evidence.not_flown
    restarts = evidence.restarts_in_flight
    if restarts:
        # A restart in flight is the reason for everything that followed.
        return restarts[0]
    # How a flight was lost comes before all other events.
    ending = [] if evidence.ending is None else [evidence.ending]
    bad_events = [fact for fact in (*ending, *evidence.events) if fact.is_bad]
    if bad_events:
        return with_weak_motor(_worst_event(bad_events), lights[Light.MOTORS])
    # If the log ends in the air, it is not known whether the vehicle was lost, so facts that are certain come first.
    warnings = _urgent_warnings(evidence)
    open_ends = [fact for fact in warnings if fact.code is MotionEvent.LOG_ENDED_IN_AIR]
    certain_warnings = [fact for fact in warnings if fact.code is not MotionEvent.LOG_ENDED_IN_AIR]
    if certain_warnings:
        # A battery or an estimator that is bad is the reason for a failsafe.
        for light in (lights[Light.POWER], lights[Light.ESTIMATOR]):
            if light.is_bad:
                return light
        return certain_warnings[0]
    vehicle_lights = _vehicle_lights_by_urgency(lights)
    if evidence.condition.oscillation is not None:
        # A limit cycle drives motors to their limits, and so explains the light of the motors.
        vehicle_lights.insert(0, lights[Light.MARGINS])
    other_lights = [lights[name] for name in OTHER_LIGHTS]
    bad_lights = [fact for fact in (*vehicle_lights, *other_lights) if fact.is_bad]
    if bad_lights:
        return _largest_of_first_kind(bad_lights)
    if open_ends:
        return open_ends[0]
    if not evidence.has_operated:
        return _headline_without_flight(evidence)
    return _first_fact_to_watch(_facts_to_watch(evidence, vehicle_lights), lights)


def _facts_to_watch(evidence: Evidence, vehicle_lights: Sequence[Fact]) -> Facts:
    """Returns the facts from which the headline is chosen if nothing about the vehicle is bad.

    Attitudes far from their setpoint come first, then hard landings, after which the airframe must be checked whatever
    the lights show. Swings in an automatic mode follow: a setpoint that swings is the reason for errors of tracking.
    The lights come next, and last the warnings of the autopilot, except those that its own state contradicts.

    Args:
        evidence: events of the vehicle.
        vehicle_lights: lights of the vehicle, the most important first.

    Returns:
        The facts, the most important first, of any level but bad.
    """
    # Only events of the attitude have the figure "angle", its distance from the setpoint, rad.
    far_attitudes = [
        event for event in evidence.events if event.figures.get("angle", 0.0) > FAR_ANGLE
    ]
    hard_landings = [event for event in evidence.events if event.code is MotionEvent.LANDED_HARD]
    swings = [event for event in evidence.events if event.code is MotionEvent.ATTITUDE_SWUNG]
    warnings = [
        fact
        for fact in evidence.warnings_in_flight(tuple(ReportedEvent))
        if not fact.figures.get("is_contradicted")
    ]
    return (*far_attitudes, *hard_landings, *swings, *vehicle_lights, *warnings)


def _worst_event(bad_events: Sequence[Fact]) -> Fact:
    """Returns the bad event that the headline names.

    Args:
        bad_events: at least one, the most important first.

    Returns:
        The largest of the events with the code of the first. A spent battery is worse than a critical one: if the first
        is a critical battery, and a battery was spent too, the event of the spent battery is returned.
    """
    worst_event = _largest_of_first_kind(bad_events)
    if worst_event.code is ReportedEvent.BATTERY_ALARMED:
        for event in bad_events:
            if event.code is ReportedEvent.BATTERY_SPENT:
                return event
    return worst_event


def with_weak_motor(event: Fact, motors_light: Fact) -> Fact:
    """Adds to the event of a lost flight a motor that was found weak before the loss.

    The motor need not be the cause: the motion may not show what failed first, or something else may have failed.

    Args:
        event: the event in the headline. Its figure ``cause`` is what failed first, and ``word`` is what the autopilot
            reported of a motor; each may name a motor.
        motors_light: the fact of the light "motors", which judges the flight until it was lost. If it is about one
            motor, this is its subject, such as "motor 2 (rear left)".

    Returns:
        The event, with ``motors_light`` as its figure ``weak_motor``. It is unchanged if it is no loss of a flight, no
        single motor was found weak, or the event names this motor already.
    """
    is_loss = event.code in Ending
    # The light may show the loss itself, if that names a motor.
    is_about_weak_motor = motors_light.code not in Ending and bool(motors_light.subject)
    is_weak = motors_light.is_bad or motors_light.code in TRIMS_OF_WEAK_MOTOR
    if not (is_loss and is_about_weak_motor and is_weak):
        return event
    for fact in (event, event.figures.get("cause"), event.figures.get("word")):
        if fact is None:
            continue
        names = (fact.subject, *fact.figures.get("names", ()))
        # The autopilot names a motor without its place.
        if motors_light.subject in names or name_without_place(motors_light.subject) in names:
            return event
    return event.replace(weak_motor=motors_light)


def _headline_without_flight(evidence: Evidence) -> Fact:
    """Returns the headline of a log that shows no flight, or no operation of a vehicle that is not a multirotor.

    The headline is the first of these that applies:

    1. A vehicle that is not a multirotor was never armed.
    2. If the log lacks all signals that show whether the vehicle flew, a problem that the autopilot reported: it may
       have happened in flight.
    3. Why no model of the motion can be learned from the log, such as that the motors were off throughout.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    signals = evidence.signals
    is_other_vehicle = evidence.other_vehicle is not None
    was_never_armed = signals.armed is not None and not signals.armed.values.any()
    if was_never_armed and is_other_vehicle:
        return NEVER_ARMED
    signals_of_flight = (signals.motors, signals.landed_state, signals.armed)
    is_flight_unknown = all(signal is None for signal in signals_of_flight)
    if is_flight_unknown:
        for event in evidence.events:
            is_reported_by_autopilot = isinstance(event.code, ReportedEvent)
            if is_reported_by_autopilot and event.is_watch_or_bad:
                return event
    return evidence.learnability.reason


def _largest_of_first_kind(bad_facts: Sequence[Fact]) -> Fact:
    """Returns the fact that becomes the headline: the most important one, or the largest of several like it.

    Facts with the same code are findings of the same kind, such as losses of thrust of two motors. The size of a loss
    of thrust is its figure ``rise``: by how much the motor's command rose to compensate it. Facts of other kinds have
    no size, so that the first one of them stays.

    Args:
        bad_facts: at least one, the most important first.
    """
    first_code = bad_facts[0].code
    facts_of_first_kind = [fact for fact in bad_facts if fact.code is first_code]
    # Of facts of equal size, ``max`` returns the first.
    return max(facts_of_first_kind, key=lambda fact: fact.figures.get("rise", 0.0))


def _urgent_warnings(evidence: Evidence) -> list[Fact]:
    """Returns the losses, failsafes, restarts and impacts (``URGENT_EVENTS``) that are only to be watched.

    Bad ones are left out here, since they come earlier in the headline's order. An event that the motion shows counts
    at any time, because a vehicle that hit the ground is no longer in flight. An event that only the autopilot reports
    counts if it happened in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The events of the level "watch", the most important first.
    """
    warnings = []
    for event in evidence.events:
        if isinstance(event.code, MotionEvent) and event.code in URGENT_EVENTS:
            warnings.append(event)
    for event in evidence.warnings_in_flight(URGENT_EVENTS):
        if event.code in URGENT_EVENTS:
            warnings.append(event)
    warnings_to_watch = [event for event in warnings if event.level is Level.WATCH]
    warnings_to_watch.sort(key=lambda event: URGENT_EVENTS.index(event.code))
    return warnings_to_watch


def headline_by_lights(lights: NamedFacts) -> Fact:
    """Returns the headline of a flight without a fault, by its lights alone.

    Args:
        lights: the status lights by name; no light of the vehicle is bad.

    Returns:
        The first light of the vehicle that is to be watched. Without one, the fact that nothing is wrong with the
        lights that were checked.
    """
    return _first_fact_to_watch(_vehicle_lights_by_urgency(lights), lights)


def _vehicle_lights_by_urgency(lights: NamedFacts) -> list[Fact]:
    """Returns the lights of the vehicle, the most urgent first.

    They are in the order of ``VEHICLE_LIGHTS``, but the margins come before motors whose range fast commands take up: a
    loop with little margin amplifies noise and gusts about its crossover frequency, so that it needs more of the range.

    Args:
        lights: the status lights by name.
    """
    vehicle_lights = [lights[name] for name in VEHICLE_LIGHTS]
    if is_range_taken_by_commands(lights[Light.MOTORS]):
        vehicle_lights.remove(lights[Light.MARGINS])
        vehicle_lights.insert(0, lights[Light.MARGINS])
    return vehicle_lights


def _first_fact_to_watch(facts: Iterable[Fact], lights: NamedFacts) -> Fact:
    """Returns the first fact that is to be watched or, without one, that nothing is wrong with what was checked.

    Args:
        facts: facts, the most important first; none of them is bad.
        lights: the status lights by name; no light of the vehicle is bad.
    """
    for fact in facts:
        if fact.level is Level.WATCH:
            return fact
    return _nothing_wrong_fact(lights)


def _nothing_wrong_fact(lights: NamedFacts) -> Fact:
    """Returns the headline that nothing is wrong as far as it was checked, or why nothing could be checked.

    Args:
        lights: the facts of the status lights by name; no light of the vehicle is bad or to be watched.

    Returns:
        A fact with the names of the lights that are good, and the names of the lights that are unknown. It is good only
        if the motors and at least ``MIN_CHECKED_LIGHTS`` lights were checked. For a vehicle that is not a multirotor it
        has the ``kind`` of vehicle.
    """
    checked_lights = [name for name in VEHICLE_LIGHTS if lights[name].is_good]
    unchecked_lights = [name for name in VEHICLE_LIGHTS if name not in checked_lights]
    if not checked_lights:
        return Fact(Headline.NOTHING_CHECKED, reason=_reason_nothing_checked(lights))
    # The motors must be among the checked lights, since only their light shows a motor or propeller that is about to
    # fail. But that light alone is not enough.
    is_enough = Light.MOTORS in checked_lights and len(checked_lights) >= MIN_CHECKED_LIGHTS
    motors_light = lights[Light.MOTORS]
    vehicle_kind = None
    if motors_light.code is Unjudged.MULTIROTORS_ONLY:
        vehicle_kind = motors_light.figures["kind"]
    return Fact(
        Headline.NOTHING_WRONG,
        Level.GOOD if is_enough else Level.UNKNOWN,
        names=checked_lights,
        missing=unchecked_lights,
        most_loss=motors_light.figures.get("most_loss"),
        kind=vehicle_kind,
    )


def _reason_nothing_checked(lights: NamedFacts) -> Fact:
    """Returns the reason why no light of the vehicle could be judged.

    A log that lacks data is the reason. If it has all that is needed, the most important light says why it is unknown.

    Args:
        lights: the facts of the status lights by name; all lights of the vehicle are unknown.
    """
    if not lights[Light.LOG].is_good:
        reason = lights[Light.LOG]
    else:
        reason = lights[VEHICLE_LIGHTS[0]]
    if reason.code is Unjudged.NOT_JUDGED and reason.figures["reason"] is not None:
        # A light that is not judged states why.
        reason_not_judged: Fact = reason.figures["reason"]
        return reason_not_judged
    if reason.code in PARTIAL_CHECKS:
        # What one check has shown so far is not the reason why the rest of its light is unknown.
        reason_of_unknown_rest: Fact | None = reason.figures["reason"]
        if reason_of_unknown_rest is not None:
            return reason_of_unknown_rest
    return reason
