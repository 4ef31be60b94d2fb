"""The next step of a judgement, a fact (a coded finding): what to repair, to log or to fly, by headline and lights.

It does not depend on a learned model. A flight that was received live is judged without one, and the same flight has
the same next step at the end of its session, in the library and in the review of its log.
"""

from mavdem.assessment.event_lights import EVENTS_BY_LIGHT
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.ending import Ending
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.loops import LoopAction
from mavdem.facts.power import PowerLight

REPORTS_OF_BATTERY = (
    ReportedEvent.BATTERY_WARNED,
    ReportedEvent.BATTERY_ALARMED,
    ReportedEvent.BATTERY_SPENT,
)
"""What an autopilot reports of a battery, often without its number."""

MEASURED_BATTERY = (PowerLight.BATTERY_LOW, PowerLight.CHARGE_LOW)
"""Codes of the light of power that name the battery by what was measured of it."""


def choose_next_step(headline: Fact, lights: NamedFacts) -> Fact:
    """Returns what the pilot should do after a flight: repair what is wrong, log what is missing, or keep the log.

    Args:
        headline: the most serious fact of the flight.
        lights: the facts of the status lights (judgements of motors, power, log and so on) by name.

    Returns:
        The first of these that applies, as a fact (a coded finding):

        1. Something is wrong: what the headline and some other bad lights need, such as to replace a propeller.
        2. A light is not good, and something helps: the advice of the first such light, such as to log faster.
        3. A light is not good, and nothing helps: ``KEEP_LOG``, to keep the log.
        4. All lights are good: ``KEEP_MODEL``, to keep the log as a standard for later flights.
    """
    if headline.code is not Headline.NOTHING_WRONG:
        return _step_against_faults(headline, lights)
    are_all_lights_good = True
    for name in (Light.LOG, *VEHICLE_LIGHTS):
        light = lights[name]
        if light.is_good:
            continue
        are_all_lights_good = False
        # No other log makes this light known: the vehicle is not a multirotor.
        if light.code is Unjudged.MULTIROTORS_ONLY:
            continue
        advice = _advice_of_light(light)
        if advice is not None:
            return Fact(NextStep.DO_AS_ADVISED, reason=advice)
    return Fact(NextStep.KEEP_MODEL if are_all_lights_good else NextStep.KEEP_LOG)


def _advice_of_light(light: Fact) -> Fact | None:
    """Returns the fact whose remedy helps against a status light that is not good.

    Args:
        light: the fact of the light, which is unknown or to be watched.

    Returns:
        The light itself or, if it was not judged for a reason, that reason; None if the light is unknown and that has
        no remedy, since a reason alone is no step.
    """
    is_unjudged = light.code is Unjudged.NOT_JUDGED and light.figures["reason"] is not None
    fact: Fact = light.figures["reason"] if is_unjudged else light
    return fact if fact.remedy or light.is_watch_or_bad else None


def _step_against_faults(headline: Fact, lights: NamedFacts) -> Fact:
    """Returns the next step: to do what the fault in the headline needs, and what some other bad lights need.

    The advice of another bad light is added only if the fault in the headline cannot be the cause of that light:

    - After a loss of the vehicle every bad light may be the reason for the loss, and its advice is added. A motor that
      is bad, or was found weak, is named as the suspect.
    - The power is bad for reasons of its own under any other headline. Even a battery that is only to be watched has
      its advice, such as to land earlier, except after a loss.
    - The vibration is bad for reasons of its own if the power is the headline.

    It is left out if the advice of the headline covers it (:func:`_is_covered_by_headline`).

    If the headline is the autopilot's report on a battery, and a battery was measured to be bad, the only advice is
    about the measured one.

    Args:
        headline: headline of the judgement, with a fault.
        lights: all status lights by name: facts with a level.

    Returns:
        The fact that advises the step, with the headline as ``reason`` and the facts of the other lights as ``also``.
    """
    power = lights[Light.POWER]
    is_battery_measured = power.is_bad and power.code in MEASURED_BATTERY
    if headline.code in REPORTS_OF_BATTERY and is_battery_measured:
        return Fact(NextStep.DO_AS_ADVISED, headline.level, reason=power, also=())
    is_loss = headline.code in Ending
    reason = headline
    if is_loss:
        unexplained_lights = VEHICLE_LIGHTS
        motors = lights[Light.MOTORS]
        if motors.is_bad or "weak_motor" in headline.figures:
            reason = headline.replace(suspect=motors.subject)
    elif headline == power:
        unexplained_lights = [Light.POWER, Light.VIBRATION]
    else:
        unexplained_lights = [Light.POWER]
    other_facts = []
    for name in unexplained_lights:
        fact = lights[name]
        # The fact of a light may be the loss itself, or the motion that led to it, which is in the headline already.
        shows_loss = fact.code in EVENTS_BY_LIGHT[Light.TRACKING]
        needs_advice = fact.is_bad or (not is_loss and _is_low_battery(fact, headline))
        if not needs_advice or shows_loss or _advises_other_step_first(fact):
            continue
        if not _is_covered_by_headline(fact, reason):
            other_facts.append(fact)
    return Fact(NextStep.DO_AS_ADVISED, headline.level, reason=reason, also=tuple(other_facts))


def _is_covered_by_headline(light: Fact, headline: Fact) -> bool:
    """Returns whether the advice of the headline covers a bad light, so that the advice of the light is not added.

    It covers the part that the headline is about. If the fault has a cause with advice, this is the advice of the
    headline: it covers the parts that the cause names, such as "motor 2", and faults of the same kind as the cause, or
    as the cause of that cause. Otherwise it covers the part that is suspected.

    Args:
        light: the fact of the light.
        headline: the fault in the headline. Its figures ``cause``, a fact, and ``suspect``, the name of a part, may be
            missing.
    """
    covered_parts = [headline.subject]
    covered_codes = []
    cause = _advised_cause(headline)
    if cause is None:
        covered_parts.append(headline.figures.get("suspect", ""))
    else:
        covered_parts += [cause.subject, *cause.figures.get("names", ())]
        covered_codes.append(cause.code)
        first_cause = _advised_cause(cause)
        if first_cause is not None:
            covered_codes.append(first_cause.code)
    is_of_covered_part = bool(light.subject) and light.subject in covered_parts
    return is_of_covered_part or light.code in covered_codes


def _advised_cause(fault: Fact) -> Fact | None:
    """Returns the cause of a fault if it is known, and there is advice against it; otherwise None."""
    cause = fault.figures.get("cause")
    has_advice = isinstance(cause, Fact) and bool(cause.remedy)
    return cause if has_advice else None


def _is_low_battery(light: Fact, headline: Fact) -> bool:
    """Returns whether a status light warns of a low battery, of which the headline does not warn already."""
    battery_codes = (*MEASURED_BATTERY, *REPORTS_OF_BATTERY)
    return (
        light.is_watch_or_bad and light.code in battery_codes and headline.code not in battery_codes
    )


def _advises_other_step_first(light: Fact) -> bool:
    """Returns whether a light only advises to follow the advice of the headline or of another light first."""
    action = light.figures.get("action")
    return isinstance(action, Fact) and action.code is LoopAction.DO_FIRST
