"""Gains that the next step after a flight, and the decisions on the loops of its axes, advise to lower."""

from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType

from mavdem.assessment.axis.loop_decision import LoopDecision
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.loops.advice import Gain

NO_GAINS: Mapping[str, Gain] = MappingProxyType({})
"""No gains to lower."""

LOWERING = (GainFact.LOWER_GAINS, LoopAction.LOWER_BY_A_THIRD)
"""Facts whose ``changes`` are gains to lower: name, value now and value to set."""


def lowered_gains(next_step: Fact, decisions: Iterable[LoopDecision] = ()) -> dict[str, Gain]:
    """Returns the gains to lower before the next flight, by the autopilot's names.

    The next step may advise to lower gains, for example against an oscillation. On axes whose loops were measured to
    lack stability margin, the decisions advise it.

    Args:
        next_step: what to do next, a fact (a coded finding). The advice is this fact or one that it contains, such as
            its reason.
        decisions: decisions on the loops of the axes whose gains are set together with those of the next step.

    Returns:
        Each gain with its value now and the value to set; empty if none is to be lowered.
    """
    advice = [fact for fact in fact_and_contained_facts(next_step) if fact.code in LOWERING]
    advice += reductions_by_a_third(decisions)
    gains = {}
    for fact in advice:
        for name, present_value, new_value in fact.figures["changes"]:
            gains[name] = Gain(present_value, new_value)
    return gains


def reductions_by_a_third(decisions: Iterable[LoopDecision]) -> list[Fact]:
    """Returns the advice to lower gains by a third, for each of some axes that needs it.

    Args:
        decisions: what was decided for the loops of each axis, with an action, or None if nothing is to be done.

    Returns:
        The actions as facts (coded findings), each with the name of the ``axis`` and the ``changes`` of its gains.
    """
    actions = [decision.action for decision in decisions if decision.action is not None]
    return [action for action in actions if action.code is LoopAction.LOWER_BY_A_THIRD]


def fact_and_contained_facts(fact: Fact) -> Iterator[Fact]:
    """Yields a fact (coded finding), the facts among its figures, and in turn those among their figures."""
    yield fact
    for figure in fact.figures.values():
        # A figure is a value or a tuple of values.
        values = figure if isinstance(figure, tuple) else (figure,)
        for value in values:
            if isinstance(value, Fact):
                yield from fact_and_contained_facts(value)
