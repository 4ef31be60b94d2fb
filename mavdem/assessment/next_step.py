"""The next step of a judgement, a fact (a coded finding): what to repair, to log or to fly, by headline and lights.

It does not depend on a learned model. A flight that was received live is judged without one, and the same flight has
the same next step at the end of its session, in the library and in the review of its log.
"""

from mavdem.assessment.axis.loop_decision import advises_to_tune
from mavdem.assessment.event_lights import EVENTS_BY_LIGHT
from mavdem.assessment.faults_before_gains import faults_before_gains
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.facts import Fact, Facts, NamedFacts
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
    """Returns the fact with the advice for one part of the vehicle that was not judged to be good.

    A fact has its advice as its remedy. If the part was not judged, the remedy of the reason helps: to log the battery
    voltage, for example, if the log has none.

    Args:
        light: the judgement of the part, such as its battery: a fact whose level is unknown or to be watched.

    Returns:
        The reason if the part was not judged for a reason, and otherwise the light itself. None if the level is unknown
        and that fact has no remedy: nothing can be advised then. A warning is returned even without a remedy, since the
        pilot is to see it.
    """
    is_unjudged = light.code is Unjudged.NOT_JUDGED and light.figures["reason"] is not None
    fact: Fact = light.figures["reason"] if is_unjudged else light
    return fact if fact.remedy or light.is_watch_or_bad else None


def _step_against_faults(headline: Fact, lights: NamedFacts) -> Fact:
    """Returns the next step after a flight in which something was wrong, such as to replace the propeller of motor 2.

    The pilot should do what the headline advises, and what some other lights advise besides. If the headline is the
    autopilot's battery warning, and the battery was also measured to be bad, only the advice on the measured battery
    counts: it has numbers.

    Args:
        headline: the most serious fact of the flight, a fault.
        lights: all status lights (judgements of motors, power and so on) by name: facts with a level.

    Returns:
        The fact ``DO_AS_ADVISED``, with the headline as its figure ``reason`` and the facts of the other lights as
        ``also``. Before new gains are loaded, the faults to mend first are the figure ``before`` instead. After a loss
        of the vehicle, the figure ``suspect`` of the reason names the motor that is bad or was found weak.
    """
    power = lights[Light.POWER]
    is_battery_measured = power.is_bad and power.code in MEASURED_BATTERY
    step = Fact(NextStep.DO_AS_ADVISED, headline.level, reason=headline, also=())
    if headline.code in REPORTS_OF_BATTERY and is_battery_measured:
        return step.replace(reason=power)
    if advises_to_tune(step):
        # ``mavdem tune`` advises to mend the same faults before its gains are loaded.
        return step.replace(before=faults_before_gains(headline, lights))
    motors = lights[Light.MOTORS]
    has_weak_motor = motors.is_bad or "weak_motor" in headline.figures
    is_loss = headline.code in Ending
    reason = headline.replace(suspect=motors.subject) if is_loss and has_weak_motor else headline
    return step.replace(reason=reason, also=_other_lights_with_advice(reason, lights))


def _other_lights_with_advice(headline: Fact, lights: NamedFacts) -> Facts:
    """Returns the status lights, besides the headline, whose advice the pilot should follow too.

    These are lights whose fault is not a consequence of the one in the headline:

    - After a loss of the vehicle every bad light may be the reason for the loss.
    - The power is bad for reasons of its own under any other headline. Even a battery that is only to be watched has
      its advice, such as to land earlier, except after a loss.
    - The vibration is bad for reasons of its own if the power is the headline.

    A light is left out if the advice of the headline covers it (:func:`_is_covered_by_headline`).

    Args:
        headline: the most serious fact of the flight, a fault; after a loss with the suspected motor.
        lights: all status lights by name: facts with a level.
    """
    is_loss = headline.code in Ending
    if is_loss:
        unexplained_lights = VEHICLE_LIGHTS
    elif headline == lights[Light.POWER]:
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
        if not _is_covered_by_headline(fact, headline):
            other_facts.append(fact)
    return tuple(other_facts)


def _is_covered_by_headline(light: Fact, headline: Fact) -> bool:
    """Returns whether who follows the advice of the headline also mends the fault of a bad light.

    For example, the vehicle crashed since motor 2 was weak: the headline advises to check motor 2, and so does the
    light of the motors. The advice of a headline covers

    - the part that the headline is about;
    - if its fault has a cause with advice: the parts that the cause names, faults of the same kind as the cause, and
      those of the same kind as the cause of that cause;
    - otherwise the part that is suspected.

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
