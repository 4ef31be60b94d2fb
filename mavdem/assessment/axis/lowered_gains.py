"""Gains that the next step after a flight, and the decisions on the loops of its axes, advise to lower."""

from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from types import MappingProxyType
from typing import NamedTuple

from mavdem.assessment.axis.loop_decision import LoopDecision
from mavdem.assessment.judgement import Judgement
from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.facts import Fact, Figure
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.immutable import ReadOnlyDict
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import Gain
from mavdem.loops.controllers import gain_names

NO_GAINS: Mapping[str, Gain] = MappingProxyType({})
"""No gains to lower."""

LOWERING = (GainFact.LOWER_GAINS, LoopAction.LOWER_BY_A_THIRD)
"""Facts whose ``changes`` are gains to lower for good: name, value now and value to set."""

LOWERING_ON_TRIAL = LoopAction.HOVER_WITH_LOWER_GAINS
"""Code of a fact whose ``changes`` are gains to lower for one hover, which shows the cause of a peak of the rate."""


def lowered_gains(next_step: Fact, decisions: Iterable[LoopDecision] = ()) -> dict[str, Gain]:
    """Returns the gains to lower before the next flight, by the autopilot's names.

    The next step may advise to lower gains, for example against an oscillation, or on trial. On axes whose loops were
    measured to lack stability margin, the decisions advise it.

    Args:
        next_step: what to do next, a fact (a coded finding). The advice is this fact or one that it contains, such as
            its reason.
        decisions: decisions on the loops of the axes whose gains are set together with those of the next step.

    Returns:
        Each gain with its value now and the value to set; empty if none is to be lowered.
    """
    codes = (*LOWERING, LOWERING_ON_TRIAL)
    advice = [fact for fact in fact_and_contained_facts(next_step) if fact.code in codes]
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


class LimitedJudgement(NamedTuple):
    """The judgement of a flight that lowers only gains of the requested axes, and the axes that were left out."""

    judgement: Judgement
    """The judgement, whose facts (coded findings) lower no gains of other axes."""
    other_axes: Names
    """The other axes whose gains should be lowered, too."""


def limited_to_axes(
    judgement: Judgement, axes: Container[str], parameters: Parameters
) -> LimitedJudgement:
    """Removes from a judgement the advice to lower gains of axes that were not requested.

    If several axes oscillate, one fact (coded finding) advises to lower the gains of all of them. A pilot who asks for
    the gains of roll alone should get only these.

    Args:
        judgement: the judgement of a flight, whose headline, next step, lights and decisions may lower gains.
        axes: the requested axes.
        parameters: parameters of the log, which show how the autopilot names the gains of each axis.

    Returns:
        The judgement without these gains, and their axes. It is unchanged, with no axes, if only gains of requested
        axes are to be lowered. So it is if only gains of other axes are: without them the next step would say nothing.
    """
    names_by_axis = gain_names_by_axis(lowered_gains(judgement.next_step), parameters)
    other_axes = tuple(axis for axis in names_by_axis if axis not in axes)
    if not other_axes or len(other_axes) == len(names_by_axis):
        return LimitedJudgement(judgement, ())
    other_gains = [*chain.from_iterable(names_by_axis[axis] for axis in other_axes)]
    decisions = {}
    for axis, decision in judgement.loop_decisions.items():
        decisions[axis] = replace(
            decision,
            reason=_without_gains(decision.reason, other_gains),
            action=_without_gains(decision.action, other_gains),
            reasons_against_gains=_without_gains(decision.reasons_against_gains, other_gains),
        )
    lights = {name: _without_gains(light, other_gains) for name, light in judgement.lights.items()}
    limited = replace(
        judgement,
        headline=_without_gains(judgement.headline, other_gains),
        next_step=_without_gains(judgement.next_step, other_gains),
        lights=ReadOnlyDict(lights),
        loop_decisions=ReadOnlyDict(decisions),
    )
    return LimitedJudgement(limited, other_axes)


def gain_names_by_axis(names: Iterable[str], parameters: Parameters) -> dict[str, list[str]]:
    """Groups the names of gains by the axis whose rate or attitude controller has them.

    Args:
        names: names of the gains, such as "ATC_RAT_RLL_P". Names of other parameters are left out.
        parameters: parameters of the log, which show how the autopilot names the gains of each axis.

    Returns:
        The names by axis, such as "roll"; without the axes that have none of them.
    """
    all_names = [*names]
    names_by_axis = {}
    for axis in AXES:
        controller = gain_names(parameters, axis)
        if controller is None:
            continue
        names_of_axis = [
            name
            for name in all_names
            if name.startswith(controller.rate_prefix) or name == controller.angle_gain
        ]
        if names_of_axis:
            names_by_axis[axis] = names_of_axis
    return names_by_axis


def _without_gains(figure: Figure, names: Container[str]) -> Figure:
    """Returns a fact (coded finding) without the advice to lower some gains, in it and in the facts it contains.

    Args:
        figure: the fact, or a tuple of facts. Any other value, such as a number in a fact, is returned unchanged.
        names: names of the gains.
    """
    if isinstance(figure, tuple):
        return tuple(_without_gains(element, names) for element in figure)
    if not isinstance(figure, Fact):
        return figure
    figures = {name: _without_gains(value, names) for name, value in figure.figures.items()}
    if figure.code in (*LOWERING, LOWERING_ON_TRIAL):
        figures["changes"] = tuple(
            change for change in figures["changes"] if change[0] not in names
        )
    return figure.replace(**figures)


def fact_and_contained_facts(fact: Fact) -> Iterator[Fact]:
    """Yields a fact (coded finding), the facts among its figures, and in turn those among their figures."""
    yield fact
    for figure in fact.figures.values():
        # A figure is a value or a tuple of values.
        values = figure if isinstance(figure, tuple) else (figure,)
        for value in values:
            if isinstance(value, Fact):
                yield from fact_and_contained_facts(value)
