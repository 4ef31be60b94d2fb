"""Whether a fact asks for a repair before the next flight, which comes before all advice on gains."""

from mavdem.assessment.axis.tuning import Tuning
from mavdem.facts import Fact
from mavdem.facts.margins import MarginsLight


def forbids_flight(fact: Fact) -> bool:
    """Returns whether a fact, or any fact that it gives as a reason, forbids to fly before something is repaired.

    Args:
        fact: a coded finding. A next step has the fact that it follows from as its figure ``reason``; the fact that
            there are no gains has several as ``reasons``. These may have reasons of their own.
    """
    if fact.forbids_flight:
        return True
    reasons = [fact.figures.get("reason"), *fact.figures.get("reasons", ())]
    # A figure "reason" is None where it is missing, and a text in some facts.
    facts_given_as_reasons = [reason for reason in reasons if isinstance(reason, Fact)]
    return any(forbids_flight(reason) for reason in facts_given_as_reasons)


def needs_check_before_gains(next_step: Fact) -> bool:
    """Returns whether something is to be repaired or checked before gains are loaded, such as the order of the motors.

    A vehicle that oscillated but stayed upright needs no check: the gains to load are lower ones, which end that.

    Args:
        next_step: the next step, a coded finding, with the fact that it follows from as its figure ``reason``.
    """
    reason = next_step.figures.get("reason")
    if isinstance(reason, Fact) and reason.code is MarginsLight.OSCILLATES:
        return not reason.figures["was_upright"]
    return forbids_flight(next_step)


def next_step_has_priority(tuning: Tuning, fact: Fact) -> bool:
    """Returns whether what a fact advises is left out, since the vehicle must first be repaired for another reason.

    That is so if the next step of the flight and the fact both ask for a repair before any flight. The report then
    states the repair of the next step only, which is the more urgent one.

    Args:
        tuning: the judgement of the flight, with its next step.
        fact: why there are no gains for an axis, or what to do about its loops; a coded finding with advice.
    """
    return forbids_flight(tuning.judgement.next_step) and forbids_flight(fact)
