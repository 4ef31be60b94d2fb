"""Judgement of a vehicle by facts (coded findings with a level): status lights, loops, headline, next step."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from mavdem.assessment.axis.loop_decision import (
    REDUCTIONS_OF_RATE_GAINS,
    DecisionsByAxis,
    LoopDecision,
    LoopDiagnosis,
    LoopObservations,
    common_action,
    decide_on_loops,
)
from mavdem.assessment.event_lights import light_or_warning, lights_with_event
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.headline import headline_of
from mavdem.assessment.lights import REGISTRY, RegisteredLight
from mavdem.assessment.next_step import choose_next_step
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.assessment import NextStep
from mavdem.facts.ending import MotionEvent
from mavdem.facts.lights import Light, Unjudged
from mavdem.immutable import ImmutableResult, ReadOnlyDict

LIGHTS_OF_FLIGHT = (Light.MOTORS, Light.VIBRATION, Light.TRACKING, Light.MARGINS, Light.WIND)
"""Lights that judge a vehicle in the air, and so are unknown if it never was."""


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


def judge(evidence: Evidence, **known_lights: Fact) -> Judgement:
    """Judges a vehicle: its lights, its control loops, the headline and the next step.

    A light is a fact that judges one subject, such as the motors or the vibration, by its level: good, watch, bad or
    unknown. Each result needs the ones before it: the lights; the decisions on the loops, whose advice the lights of
    tracking and margins show; the headline, which also depends on the events; and the next step, which follows from the
    headline. If the vehicle must not fly as it is, advice to fly is removed from the lights
    (``Fact.without_flight_advice``).

    Args:
        evidence: events, condition and loops of the vehicle.
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
        lights = {name: fact.without_flight_advice for name, fact in lights.items()}
    headline = headline_of(evidence, lights)
    next_step = choose_next_step(headline, lights)
    is_multirotor = evidence.other_vehicle is None
    if is_multirotor:
        # The light on the subject of an event, such as a motor that failed, is then as bad as the event.
        lights = lights_with_event(lights, headline)
    return Judgement(headline, next_step, lights, ReadOnlyDict(decisions))


def lights_without_loops(evidence: Evidence) -> dict[str, Fact]:
    """Judges the parts of a vehicle that can be judged without its control loops, such as motors and power.

    These judgements can be shown while the loops are still computed, which takes longer. Each is a status light: a fact
    (coded finding) with a level, such as good or bad. If the vehicle must not fly as it is, the lights give no advice
    that needs a flight.

    Args:
        evidence: signals, events and measurements of the vehicle; its loops need not be known yet.

    Returns:
        The lights by name, such as "power".
    """
    lights = dict[str, Fact]()
    for light in REGISTRY:
        # A light may need the facts of lights before it.
        if not light.is_of_loops:
            lights[str(light.name)] = _judged_light(evidence, light, lights)
    if evidence.reasons_not_to_fly:
        lights = {name: fact.without_flight_advice for name, fact in lights.items()}
    return lights


def _judged_light(
    evidence: Evidence,
    light: RegisteredLight,
    earlier_lights: NamedFacts,
    known_lights: NamedFacts = MappingProxyType({}),
) -> Fact:
    """Judges one status light, such as the light of the motors, by the function that is registered for it.

    If the function finds that the light is unknown, the worst warning in flight about its subject is shown instead. A
    light that judges flight is not judged for a vehicle that did not fly.

    Args:
        evidence: signals, events and measurements of the vehicle.
        light: the light, with its name, its function, and the names of the lights whose facts that function needs.
        earlier_lights: facts by name of the lights that were judged before this one.
        known_lights: facts by name of lights that need not be judged again.

    Returns:
        The fact that the light shows, whose level is its colour.
    """
    if evidence.not_flown is not None and light.name in LIGHTS_OF_FLIGHT:
        return Fact(Unjudged.NOT_JUDGED, reason=evidence.not_flown)
    if light.name in known_lights:
        return known_lights[light.name]
    needed_facts = [earlier_lights[name] for name in light.needs]
    return light_or_warning(light.name, light.judge(evidence, *needed_facts), evidence)


def loop_decisions(evidence: Evidence, motors_light: Fact) -> DecisionsByAxis:
    """Returns for roll, pitch and yaw what to do about the axis' control loops, and why.

    For example: tune pitch, since its phase margin is too small; roll needs nothing.

    Args:
        evidence: signals, events and measurements of the vehicle.
        motors_light: the fact of the light on motors: bad motors must be repaired before the vehicle is tuned.

    Returns:
        Decisions by axis; empty for a vehicle that did not fly or is not a multirotor.
    """
    if evidence.not_flown is not None or evidence.other_vehicle is not None:
        return {}
    repairs = repairs_before_tuning(evidence, motors_light)
    # Slow swings of the attitude may explain why an axis does not follow its setpoint.
    swings = [event for event in evidence.events if event.code is MotionEvent.ATTITUDE_SWUNG]
    decisions = dict[str, LoopDecision]()
    for margins in evidence.margins:
        observations = LoopObservations(
            margins=margins,
            tracking=evidence.tracking[margins.axis],
            oscillation=evidence.condition.oscillation,
            gain_reduction=evidence.gain_reduction,
            vehicle_repairs=repairs,
            parameters=evidence.parameters_in_flight,
            tune_arguments=tuple(evidence.command_arguments),
            attitude_swing=_worst_swing(margins.axis, swings),
        )
        decisions[margins.axis] = decide_on_loops(observations)
    return decisions


def _worst_swing(axis: str, swings: Sequence[Fact]) -> Fact | None:
    """Returns the worst swing of the attitude in an automatic mode, which may explain why an axis follows badly.

    A bad swing, which was far from its setpoint, ranks above others. Of swings that are equally bad, one of the axis
    itself ranks first.

    Args:
        axis: "roll", "pitch" or "yaw".
        swings: events that roll or pitch swung to and fro.

    Returns:
        The event; None if there was no swing.
    """
    # Pairs are compared by their first element, and by the second only if the first ones are equal.
    return max(swings, key=lambda swing: (swing.is_bad, swing.subject == axis), default=None)


def repairs_before_tuning(evidence: Evidence, motors_light: Fact) -> Facts:
    """Returns why a vehicle must be repaired before it is tuned: why it must not fly or, if it may, its bad motors.

    Args:
        evidence: signals, events and measurements of the vehicle.
        motors_light: the fact that the status light "motors" shows.

    Returns:
        The reasons; empty if no repair is needed.
    """
    if evidence.reasons_not_to_fly:
        return evidence.reasons_not_to_fly
    return (motors_light,) if motors_light.is_bad else ()


def with_action_on_loops(light: Fact, decisions: DecisionsByAxis) -> Fact:
    """Adds to the status light of tracking or margins what to do about the axes that it names, such as to tune pitch.

    The light judges one of both quantities, but the decision on an axis rests on both. So the decision may find a loop
    at fault although this light is good: the margins are good, but the axis follows its setpoint badly.

    Args:
        light: status light of tracking or of margins: a fact with a level.
        decisions: decisions on the loops, by axis.

    Returns:
        The light. One that is not good has what to do about all its axes as the figure ``action``. A good one whose
        axis follows its setpoint badly has the figure ``follows`` = False, and its sentence then says so. All other
        good lights, and those that name no axis, are unchanged.
    """
    # The axis that decides the light. A light that names several axes has all of them as the figure ``names``.
    axis = light.figures.get("axis", "")
    if axis not in decisions:
        return light
    decision = decisions[axis]
    if light.is_good:
        follows_badly = decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY
        return light.replace(follows=False) if follows_badly else light
    axes = light.figures.get("names", (axis,))
    action = common_action([decisions[name].action for name in axes])
    if action is not None and action.code in REDUCTIONS_OF_RATE_GAINS:
        # Such gains are lowered before one flight, also those of axes that the light does not name.
        all_actions = [each.action for each in decisions.values() if each.action is not None]
        action = common_action([each for each in all_actions if each.code is action.code])
    return light.replace(action=action)


def unjudged(refusal: Fact) -> Judgement:
    """Returns the judgement of a log that cannot be judged: everything is unknown for one reason, the ``refusal``."""
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=refusal)
    unknown_light = Fact(Unjudged.NOT_JUDGED, reason=refusal)
    return Judgement(refusal, next_step, {str(light.name): unknown_light for light in REGISTRY})
