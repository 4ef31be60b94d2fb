"""Judgement of a vehicle by facts (coded findings with a level): status lights, loops, headline, next step."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from mavdem.assessment.attitude_losses import FAR_ANGLE
from mavdem.assessment.axis.findings import Finding, next_step_for_model
from mavdem.assessment.axis.loop_decision import (
    DecisionsByAxis,
    LoopDecision,
    LoopDiagnosis,
    LoopObservations,
    common_action,
    decide_on_loops,
)
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights import OTHER_LIGHTS, REGISTRY, VEHICLE_LIGHTS, RegisteredLight
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.learnability import NEVER_ARMED
from mavdem.facts import Code, Fact, Facts, Level, NamedFacts
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.loops import LoopAction
from mavdem.facts.motors import TrimFact
from mavdem.facts.watch import WatchFact
from mavdem.immutable import ImmutableResult, ReadOnlyDict
from mavdem.ingest.motors import name_without_place

LIGHTS_OF_FLIGHT = (Light.MOTORS, Light.VIBRATION, Light.TRACKING, Light.MARGINS, Light.WIND)
"""Lights that judge a vehicle in the air, and so are unknown if it never was."""

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

EVENTS_BY_LIGHT: dict[Light, tuple[Code, ...]] = {
    Light.MOTORS: (
        MotionEvent.OUTPUT_FROZE,
        MotionEvent.MOTOR_OFF,
        MotionEvent.MOTOR_STOOD_STILL,
        ReportedEvent.THRUST_LOST,
        ReportedEvent.MOTOR_FAILED,
        ReportedEvent.MOTORS_STOPPED,
    ),
    Light.TRACKING: (
        *Ending,
        MotionEvent.HIT,
        MotionEvent.TOPPLED,
        MotionEvent.TIPPED,
        MotionEvent.ATTITUDE_LOST,
        MotionEvent.ATTITUDE_SWUNG,
        MotionEvent.FELL,
        ReportedEvent.ATTITUDE_FAILED,
        ReportedEvent.CRASH_DETECTED,
        ReportedEvent.FLIGHT_TERMINATED,
        ReportedEvent.PARACHUTE_RELEASED,
        ReportedEvent.FAILSAFE,
    ),
    Light.POWER: (
        ReportedEvent.RESTARTED,
        ReportedEvent.RESTARTED_IN_FLIGHT,
        ReportedEvent.BATTERY_ALARMED,
        ReportedEvent.BATTERY_SPENT,
        ReportedEvent.BOARD_VOLTAGE_LOW,
    ),
    Light.ESTIMATOR: (
        MotionEvent.ATTITUDE_INVALID,
        MotionEvent.HEIGHT_DIVERGED,
        MotionEvent.POSITION_LOST,
        ReportedEvent.ALTITUDE_FAILED,
        ReportedEvent.ESTIMATOR_DIVERGED,
        ReportedEvent.GPS_LOST,
    ),
    Light.WIND: (MotionEvent.CARRIED_AWAY,),
}
"""The events in the headline that each light shows, unless it is as bad by itself.

Tracking is the light of vehicles that did not do as they were commanded, for any reason."""

LIGHT_OF_EVENT: dict[Code, Light] = {
    code: light for light, codes in EVENTS_BY_LIGHT.items() for code in codes
}
"""The light of each event of ``EVENTS_BY_LIGHT``."""

TRIMS_OF_WEAK_MOTOR = (TrimFact.TRIM_OF_ONE_MOTOR, TrimFact.TRIM_OF_LEADING_MOTOR)
"""Patterns of the trim by which one motor is probably weak, although it is only to be watched."""

PARTIAL_CHECKS = (WatchFact.NO_MOTOR_AT_LIMIT, WatchFact.NO_OSCILLATION)
"""Lights of a live flight that say what one check has shown so far; their figure ``reason`` is why the rest of the
light is unknown."""

MIN_CHECKED_LIGHTS = 3
"""Lights of the vehicle that must be good before a flight is called sound: half of them, a choice."""


@dataclass(frozen=True)
class Judgement(ImmutableResult):
    """The judgement of one vehicle."""

    headline: Fact
    """The worst that was found, or that nothing is wrong."""
    next_step: Fact
    """What to do about it."""
    lights: NamedFacts
    """The facts of the eight lights, by name in the order in which they are shown."""
    loop_decisions: DecisionsByAxis = field(default_factory=ReadOnlyDict)
    """What is wrong with the loops of roll, pitch and yaw, and what to change, by axis; empty without a flight."""


def judge(evidence: Evidence, purposes: Sequence[Finding] = (), **known_lights: Fact) -> Judgement:
    """Judges a vehicle: its lights, its control loops, the headline and the next step.

    A light is a fact that judges one subject, such as the motors or the vibration, by its level: good, watch, bad or
    unknown. Each result needs the ones before it: the lights; the decisions on the loops, whose advice the lights of
    tracking and margins show; the headline, which also depends on the events; and the next step, which follows from the
    headline. If the vehicle must not fly as it is, advice to fly is removed from the lights (``Fact.grounded``).

    Args:
        evidence: events, condition and loops of the vehicle.
        purposes: grades of its model for each purpose; empty without a model.
        known_lights: lights by name that were judged before, and are not judged again.

    Returns:
        Headline, next step, lights by name, and decisions by axis.
    """
    lights = dict[str, Fact]()
    for light in REGISTRY:
        lights[str(light.name)] = _judged_light(evidence, light, lights, known_lights)
    decisions = loop_decisions(evidence, lights[Light.MOTORS])
    for name in (Light.TRACKING, Light.MARGINS):
        lights[name] = with_action_on_loops(lights[name], decisions)
    if evidence.reasons_not_to_fly:
        lights = {name: fact.grounded for name, fact in lights.items()}
    headline = headline_of(evidence, lights)
    model_step = next_step_for_model(purposes) if purposes else None
    next_step = choose_next_step(headline, lights, model_step)
    if evidence.other_vehicle is None:
        lights = lights_with_event(lights, headline)
    return Judgement(headline, next_step, lights, ReadOnlyDict(decisions))


def lights_with_event(lights: NamedFacts, headline: Fact) -> dict[str, Fact]:
    """Returns the lights with the event that is the headline as the fact of its light, unless that is as bad by itself.

    Lights judge a flight until it was lost, so that of tracking may be good beside a headline that control was lost.

    Args:
        lights: the facts of the eight lights, by name.
        headline: fact that the first sentence of a result states: an event or a status light.
    """
    light = light_of_event(headline)
    if light is None or not headline.warns:
        return dict(lights)
    return {**lights, light: worst_fact([lights[light], headline])}


def light_of_event(event: Fact) -> Light | None:
    """Returns the light that shows an event in the headline; None for one of no light."""
    if event.figures.get("watchdog"):
        # A watchdog restarts a program that hangs, whatever its supply.
        return Light.TRACKING
    return LIGHT_OF_EVENT.get(event.code)


def lights_without_loops(evidence: Evidence) -> dict[str, Fact]:
    """Judges the status lights that do not depend on the control loops, such as power, as :func:`judge` shows them.

    If the vehicle must not fly as it is, the lights are shown without advice to fly (``Fact.grounded``).

    Args:
        evidence: signals, events and measurements of the vehicle; its loops need not be known yet.

    Returns:
        Lights by name.
    """
    lights = dict[str, Fact]()
    for light in REGISTRY:
        # A light may need the facts of lights before it.
        if not light.is_of_loops:
            lights[str(light.name)] = _judged_light(evidence, light, lights)
    if evidence.reasons_not_to_fly:
        lights = {name: fact.grounded for name, fact in lights.items()}
    return lights


def _judged_light(
    evidence: Evidence,
    light: RegisteredLight,
    earlier_lights: NamedFacts,
    known_lights: NamedFacts = MappingProxyType({}),
) -> Fact:
    """Returns the fact of one status light: that it is not judged, the known fact, or what its function returns.

    Args:
        evidence: signals, events and measurements of the vehicle.
        light: the light. One of the ``LIGHTS_OF_FLIGHT`` is not judged if the vehicle did not fly.
        earlier_lights: facts by name of lights that come before it, among them those that it needs.
        known_lights: facts by name of lights that were judged before.
    """
    if evidence.not_flown is not None and light.name in LIGHTS_OF_FLIGHT:
        return Fact(Unjudged.NOT_JUDGED, reason=evidence.not_flown)
    if light.name in known_lights:
        return known_lights[light.name]
    needed_lights = [earlier_lights[name] for name in light.needs]
    return light.judge(evidence, *needed_lights)


def loop_decisions(evidence: Evidence, motors: Fact) -> DecisionsByAxis:
    """Returns the decision on the loops of each axis.

    Args:
        evidence: signals, events and measurements of the vehicle.
        motors: the fact of the light on motors: bad motors must be repaired before the vehicle is tuned.

    Returns:
        Decisions by axis; empty for a vehicle that did not fly or is not a multirotor.
    """
    if evidence.not_flown is not None or evidence.other_vehicle is not None:
        return {}
    repairs = repairs_before_tuning(evidence, motors)
    decisions = dict[str, LoopDecision]()
    for margins in evidence.margins:
        observations = LoopObservations(
            margins=margins,
            tracking=evidence.tracking[margins.axis],
            oscillation=evidence.condition.oscillation,
            gain_reduction=evidence.gain_reduction,
            vehicle_doubts=repairs,
            parameters=evidence.signals.telemetry.parameters,
            tune_arguments=tuple(evidence.command_arguments),
        )
        decisions[margins.axis] = decide_on_loops(observations)
    return decisions


def repairs_before_tuning(evidence: Evidence, motors: Fact) -> Facts:
    """Returns why a vehicle must be repaired before it is tuned: why it must not fly or, if it may, its bad motors.

    Args:
        evidence: signals, events and measurements of the vehicle.
        motors: the fact that the status light "motors" shows.

    Returns:
        The reasons; empty if no repair is needed.
    """
    if evidence.reasons_not_to_fly:
        return evidence.reasons_not_to_fly
    return (motors,) if motors.is_bad else ()


def with_action_on_loops(light: Fact, decisions: DecisionsByAxis) -> Fact:
    """Adds to the fact of a status light about loops the action that was decided for the axes that the fact names.

    Args:
        light: status light of tracking or of margins: a fact with a level.
        decisions: decisions on the loops, by axis.

    Returns:
        The fact with the figure ``action``. A good light needs none; if its axis follows its setpoint badly although
        the margins are good, its figure ``follows`` is False. A light that names no axis is unchanged.
    """
    axis = light.figures.get("axis", "")
    if axis not in decisions:
        return light
    decision = decisions[axis]
    if light.is_good:
        follows_badly = decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY
        return light.replace(follows=False) if follows_badly else light
    axes = light.figures.get("names", (axis,))
    return light.replace(action=common_action([decisions[name].action for name in axes]))


def unjudged(refusal: Fact) -> Judgement:
    """Returns the judgement of a log that cannot be judged: everything is unknown for one reason, the ``refusal``."""
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=refusal)
    unknown_light = Fact(Unjudged.NOT_JUDGED, reason=refusal)
    return Judgement(refusal, next_step, {str(light.name): unknown_light for light in REGISTRY})


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
    8. If there was no flight, the reason.
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
    vehicle_lights = [lights[name] for name in VEHICLE_LIGHTS]
    if evidence.condition.oscillation is not None:
        # A limit cycle drives motors to their limits, and so explains the light of the motors.
        vehicle_lights.insert(0, lights[Light.MARGINS])
    other_lights = [lights[name] for name in OTHER_LIGHTS]
    # How a flight was lost comes before all other events.
    ending = [] if evidence.ending is None else [evidence.ending]
    bad_events = [fact for fact in (*ending, *evidence.events) if fact.is_bad]
    urgent = _urgent_warnings(evidence)
    # If the log ends in the air, it is not known whether the vehicle was lost, so facts that are certain come first.
    open_ends = [fact for fact in urgent if fact.code is MotionEvent.LOG_ENDED_IN_AIR]
    urgent = [fact for fact in urgent if fact.code is not MotionEvent.LOG_ENDED_IN_AIR]
    bad_lights = [fact for fact in (*vehicle_lights, *other_lights) if fact.is_bad]
    # A battery or an estimator that is bad is the reason for a failsafe.
    reasons = [lights[name] for name in (Light.POWER, Light.ESTIMATOR) if lights[name].is_bad]
    if urgent and reasons:
        urgent = reasons
    if bad_events:
        return with_weak_motor(_worst_event(bad_events), lights[Light.MOTORS])
    if urgent:
        return urgent[0]
    if bad_lights:
        return _largest_of_first_kind(bad_lights)
    if open_ends:
        return open_ends[0]
    if not evidence.has_operated:
        return _reason_on_ground(evidence)
    return _first_fact_to_watch(_facts_to_watch(evidence, vehicle_lights), lights)


def _facts_to_watch(evidence: Evidence, vehicle_lights: Sequence[Fact]) -> Facts:
    """Returns the facts from which the headline is chosen if nothing about the vehicle is bad.

    Attitudes far from their setpoint come first, then the lights, and last the warnings of the autopilot, except those
    that its own state contradicts.

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
    warnings = [
        fact
        for fact in evidence.warnings_in_flight(tuple(ReportedEvent))
        if not fact.figures.get("is_contradicted")
    ]
    return (*far_attitudes, *vehicle_lights, *warnings)


def _worst_event(bad_events: Sequence[Fact]) -> Fact:
    """Returns the bad event that the headline names.

    Args:
        bad_events: at least one, the most important first.

    Returns:
        The largest of the events with the code of the first. A spent battery is worse than a critical one: if the first
        is a critical battery, and a battery was spent too, the event of the spent one.
    """
    worst_event = _largest_of_first_kind(bad_events)
    if worst_event.code is ReportedEvent.BATTERY_ALARMED:
        for event in bad_events:
            if event.code is ReportedEvent.BATTERY_SPENT:
                return event
    return worst_event


def with_weak_motor(event: Fact, motors: Fact) -> Fact:
    """Adds to the event of a lost flight a motor that was found weak before the loss.

    The motor need not be the cause: the motion may not show what failed first, or something else may have failed.

    Args:
        event: the event in the headline. Its figure ``cause`` is what failed first, and ``word`` is what the autopilot
            reported of a motor; each may name a motor.
        motors: the fact of the light "motors", which judges the flight until it was lost. If it is about one motor,
            this is its subject, such as "motor 2 (rear left)".

    Returns:
        The event, with ``motors`` as its figure ``weak_motor``. It is unchanged if it is no loss of a flight, no single
        motor was found weak, or the event names this motor already.
    """
    is_loss = event.code in Ending
    # The light may show the loss itself, if that names a motor.
    is_about_weak_motor = motors.code not in Ending and bool(motors.subject)
    is_weak = motors.is_bad or motors.code in TRIMS_OF_WEAK_MOTOR
    if not (is_loss and is_about_weak_motor and is_weak):
        return event
    for fact in (event, event.figures.get("cause"), event.figures.get("word")):
        if fact is None:
            continue
        names = (fact.subject, *fact.figures.get("names", ()))
        # The autopilot names a motor without its place.
        if motors.subject in names or name_without_place(motors.subject) in names:
            return event
    return event.replace(weak_motor=motors)


def _reason_on_ground(evidence: Evidence) -> Fact:
    """Returns the fact that says why a log has no flight or, of a vehicle that is no multirotor, no operation."""
    if evidence.other_vehicle is not None:
        armed_signal = evidence.signals.armed
        if armed_signal is not None and not armed_signal.values.any():
            return NEVER_ARMED
    return evidence.learnability.reason


def _largest_of_first_kind(bad_facts: Sequence[Fact]) -> Fact:
    """Returns the fact that the headline names: the largest one of those with the same code as the first.

    Only losses of thrust have a size: their figure ``rise``, by which the command of a motor rose to compensate its
    loss. The largest loss is named, not the earliest. Of facts without that figure the first is returned.

    Args:
        bad_facts: at least one, the most important first.
    """
    with_first_code = [fact for fact in bad_facts if fact.code is bad_facts[0].code]
    return max(with_first_code, key=lambda fact: fact.figures.get("rise", 0.0))


def _urgent_warnings(evidence: Evidence) -> list[Fact]:
    """Returns the events of ``URGENT_EVENTS`` with the level "watch", the most important first.

    Events that the motion shows are included at any time, since a vehicle that hit the ground is no longer in flight.
    Events that the autopilot reports are included only if they happened in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        Events in the order of ``URGENT_EVENTS``.
    """
    reported_warnings = list(evidence.warnings_in_flight(URGENT_EVENTS))
    motion = [event for event in evidence.events if isinstance(event.code, MotionEvent)]
    urgent = [fact for fact in (*motion, *reported_warnings) if fact.code in URGENT_EVENTS]
    warnings_to_watch = [fact for fact in urgent if fact.level is Level.WATCH]
    return sorted(warnings_to_watch, key=lambda fact: URGENT_EVENTS.index(fact.code))


def headline_by_lights(lights: NamedFacts) -> Fact:
    """Returns the headline of a flight without a fault, by its lights alone.

    Args:
        lights: the status lights by name; no light of the vehicle is bad.

    Returns:
        The first light of the vehicle that is to be watched or, without one, that nothing is wrong with those that were
        checked.
    """
    return _first_fact_to_watch([lights[name] for name in VEHICLE_LIGHTS], lights)


def _first_fact_to_watch(facts: Iterable[Fact], lights: NamedFacts) -> Fact:
    """Returns the first fact that is to be watched or, without one, that nothing is wrong with what was checked.

    Args:
        facts: facts of which none is bad, the most important first.
        lights: the status lights by name; no light of the vehicle is bad.
    """
    for fact in facts:
        if fact.level is Level.WATCH:
            return fact
    return _nothing_wrong_fact(lights)


def _nothing_wrong_fact(lights: NamedFacts) -> Fact:
    """Returns the fact that nothing is wrong as far as it was checked, or the reason why nothing could be checked.

    Args:
        lights: the status lights by name; no light of the vehicle is bad or to be watched.

    Returns:
        A fact with the lights that are good and those that are unknown. It is good only if the motors and at least
        ``MIN_CHECKED_LIGHTS`` were checked. For a vehicle that is not a multirotor it has the ``kind``.
    """
    checked_lights = [name for name in VEHICLE_LIGHTS if lights[name].is_good]
    unchecked_lights = [name for name in VEHICLE_LIGHTS if name not in checked_lights]
    if not checked_lights:
        # A log that lacks data is the reason. If it has all that is needed, the most urgent light says why it is
        # unknown.
        reason = lights[unchecked_lights[0] if lights[Light.LOG].is_good else Light.LOG]
        if reason.code in PARTIAL_CHECKS and reason.figures["reason"] is not None:
            # What a check has shown so far is not the reason why the rest of its light is unknown.
            reason = reason.figures["reason"]
        return Fact(Headline.NOTHING_CHECKED, reason=reason)
    # The motors must be among the checked lights, since only their light shows a motor or propeller that is about to
    # fail. But that light alone is not enough.
    is_enough = Light.MOTORS in checked_lights and len(checked_lights) >= MIN_CHECKED_LIGHTS
    level = Level.GOOD if is_enough else Level.UNKNOWN
    motors = lights[Light.MOTORS]
    kind = motors.figures["kind"] if motors.code is Unjudged.MULTIROTORS_ONLY else None
    return Fact(
        Headline.NOTHING_WRONG,
        level,
        names=checked_lights,
        missing=unchecked_lights,
        most_loss=motors.figures.get("most_loss"),
        kind=kind,
    )


def choose_next_step(headline: Fact, lights: NamedFacts, model_step: Fact | None) -> Fact:
    """Returns the next step: repair what is wrong, otherwise log what is missing, otherwise improve the model.

    Args:
        headline: headline of the judgement. If something is wrong, its advice is the next step.
        lights: the lights by name. If nothing is wrong, the next step is the advice of the first light that is not
            good. One that is not judged, for a reason that nothing helps against, is passed over.
        model_step: step that improves the model, for a vehicle without fault whose lights are all good; None without a
            model.

    Returns:
        The fact that advises the step.
    """
    if headline.code is not Headline.NOTHING_WRONG:
        return _step_against_faults(headline, lights)
    is_other_vehicle = False
    is_without_advice = False
    for name in (Light.LOG, *VEHICLE_LIGHTS):
        # This light is unknown because the vehicle is no multirotor: no other log of it would change that.
        if lights[name].code is Unjudged.MULTIROTORS_ONLY:
            is_other_vehicle = True
        elif not lights[name].is_good:
            advice = lights[name]
            if advice.code is Unjudged.NOT_JUDGED and advice.figures["reason"] is not None:
                # What makes a judgement possible is advised by the reason why there is none.
                advice = advice.figures["reason"]
                if not advice.remedy:
                    is_without_advice = True
                    continue
            return Fact(NextStep.DO_AS_ADVISED, reason=advice)
    if is_other_vehicle:
        return Fact(NextStep.KEEP_LOG)
    if is_without_advice and model_step is None:
        return Fact(NextStep.KEEP_LOG)
    return model_step or Fact(NextStep.KEEP_MODEL)


def _step_against_faults(headline: Fact, lights: NamedFacts) -> Fact:
    """Returns the next step: to do what the fault in the headline needs, and what some other bad lights need.

    The advice of another light is added only if the fault in the headline does not explain that light. Bad power always
    has other causes, and so has bad vibration if power is the headline. After a loss of the vehicle, every bad light
    may be its reason, and a motor that is bad, or was found weak, is named as the suspect.

    Args:
        headline: headline of the judgement, with a fault.
        lights: all status lights by name: facts with a level.

    Returns:
        The fact that advises the step, with the headline as ``reason`` and the facts of the other lights as ``also``.
    """
    unexplained_lights = [Light.POWER]
    if headline == lights[Light.POWER]:
        unexplained_lights.append(Light.VIBRATION)
    is_loss = headline.code in Ending
    if is_loss:
        unexplained_lights = VEHICLE_LIGHTS
        motors = lights[Light.MOTORS]
        if motors.is_bad or "weak_motor" in headline.figures:
            headline = headline.replace(suspect=motors.subject)
    other_facts = []
    for name in unexplained_lights:
        fact = lights[name]
        # The fact of a light may be the loss itself, which is in the headline already.
        shows_loss = fact.code in Ending
        if fact.is_bad and not shows_loss and not _advises_other_step_first(fact):
            other_facts.append(fact)
    return Fact(NextStep.DO_AS_ADVISED, headline.level, reason=headline, also=tuple(other_facts))


def _advises_other_step_first(light: Fact) -> bool:
    """Returns whether the fact of a light only advises to do first what the headline or another light advises."""
    action = light.figures.get("action")
    return isinstance(action, Fact) and action.code is LoopAction.DO_FIRST
