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
    """A judgement that lowers only gains of the requested axes."""

    judgement: Judgement
    """The judgement, whose facts name no gains of other axes."""
    other_axes: Names
    """The other axes whose gains the flight advises to lower, too."""


def limited_to_axes(
    judgement: Judgement, axes: Container[str], parameters: Parameters
) -> LimitedJudgement:
    """Leaves out the gains to lower of axes that were not requested, if it lowers some of requested ones.

    A vehicle that oscillates has the gains of all axes that oscillate lowered, in one fact (a coded finding).

    Args:
        judgement: the judgement of a flight, whose headline, next step, lights and decisions may lower gains.
        axes: the requested axes.
        parameters: parameters of the log, which show how the autopilot names the gains of each axis.

    Returns:
        The judgement without these gains, and their axes; unchanged, and no axes, if all or none were requested.
    """
    names_by_axis = gains_by_axis(lowered_gains(judgement.next_step), parameters)
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


def gains_by_axis(names: Iterable[str], parameters: Parameters) -> dict[str, list[str]]:
    """Groups gains by the axis whose rate or attitude controller has them; other parameters are left out.

    Args:
        names: names of the parameters.
        parameters: parameters of the log, which show how the autopilot names the gains of each axis.
    """
    all_names = [*names]
    names_by_axis = {}
    for axis in AXES:
        axis_names = gain_names(parameters, axis)
        if axis_names is None:
            continue
        of_axis = [
            name
            for name in all_names
            if name.startswith(axis_names.rate_prefix) or name == axis_names.angle_gain
        ]
        if of_axis:
            names_by_axis[axis] = of_axis
    return names_by_axis


def _without_gains(figure: Figure, names: Container[str]) -> Figure:
    """Returns a figure of a fact (coded finding) in which no fact lowers the gains of these names.

    Args:
        figure: a fact, a tuple of figures, or any other value, which is returned unchanged.
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
