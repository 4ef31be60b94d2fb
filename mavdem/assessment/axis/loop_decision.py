"""The decision on the control loops of an axis: what is wrong with them, and what to change.

It is made once, from limit cycles, margins, the measured response, tracking, and what speaks against the vehicle.
Lights, screen, pages, dashboards, `mavdem tune`, live sessions, fleets and documents show this decision, and no other
advice on gains. Which gains `mavdem tune` advises is computed later (:mod:`mavdem.loops.advice`), since it takes long;
whether it advises any is decided here.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from mavdem.assessment.axis.margins import AxisMargins
from mavdem.containers import Names
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import LoopActions
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import GAIN_REDUCTION, reasons_for_no_gains
from mavdem.loops.axis_loops import Loop, margin_rating
from mavdem.loops.controllers import controller_from_parameters
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE, Oscillation

CONTROLLER_GAINS = {"rate": ("p", "d"), "attitude": ("angle_gain",)}
"""Gains that make a loop faster, by the loop and by the names of the controller's fields."""


class LoopVerdict(StrEnum):
    """What is wrong with the loops of an axis."""

    NOTHING_WRONG = "nothing_wrong"
    OSCILLATES = "oscillates"
    BELOW_GOAL = "below_goal"
    """The margins are smaller than the usual ones."""
    FOLLOWS_BADLY = "follows_badly"
    """The margins suffice or are not known, and the axis follows its setpoint badly."""
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class LoopDecision:
    """What is wrong with the loops of one axis, and what to do about it."""

    axis: str
    """"roll", "pitch" or "yaw"."""
    verdict: LoopVerdict
    """What is wrong."""
    reason: Fact
    """What shows it."""
    action: Fact | None = None
    """What to do about it, as a sentence; None if nothing is to be done."""
    doubts: Facts = ()
    """Why gains must not be computed from the identified loop; empty if they may be."""
    is_too_slow: bool = False
    """Whether gains may be raised although the loop has its margins, since the axis is too slow."""

    @property
    def fact(self) -> Fact:
        """The decision as a fact: its sentence is the reason, its remedy the action."""
        return Fact(
            LoopActions.LOOPS_JUDGED,
            self.reason.level,
            subject=self.axis,
            axis=self.axis,
            verdict=self.verdict,
            because=self.reason,
            action=self.action,
        )


DecisionsByAxis = Mapping[str, LoopDecision]
"""Decisions by "roll", "pitch" and "yaw"."""


class LoopObservations(NamedTuple):
    """What a flight shows of the loops of one axis, and of the vehicle that they fly."""

    margins: AxisMargins
    """The margins of the axis, by all sources."""
    tracking: Fact
    """How the axis follows its setpoint."""
    oscillation: Oscillation | None
    """The limit cycle of the vehicle; None if nothing oscillates."""
    gain_reduction: Fact | None
    """Which gains to lower against the limit cycle; None if nothing oscillates."""
    vehicle_doubts: Facts
    """Why the vehicle must be repaired before it is tuned; empty if nothing is wrong with it."""
    parameters: Parameters
    """The autopilot's parameters by name."""
    tune_arguments: Names
    """Arguments with which `mavdem tune` reads the log."""


def decide_on_loops(observations: LoopObservations) -> LoopDecision:
    """Decides what is wrong with the loops of an axis, and what to change.

    The cases, of which the first one that applies decides:

    1. A limit cycle: lower the gains that drive it, on the axes that oscillate. Nothing else is known before it ends.
    2. An axis so far from its setpoint that no response would be better: check the vehicle, since no loop explains it.
    3. Margins below the goal, measured by an injected signal or by the response to the setpoint, or identified: the
       gains that `mavdem tune` advises where the loop is identified and nothing speaks against it; otherwise lower P
       and D by a third where they were measured, or do first what an advice needs.
    4. The axis follows its setpoint badly although its loops have their margins, or these are not known.
    5. Nothing is wrong, or what is wrong is not known, and what shows it.

    A vehicle that must be repaired keeps its verdict, but the repair comes before any change of gains.

    Args:
        observations: what the flight shows.
    """
    if observations.oscillation is not None:
        return _decision_on_oscillation(observations, observations.oscillation)
    tracking = observations.tracking
    decision = None
    if not (tracking.code is TrackingLight.MISSES_SETPOINT and tracking.is_bad):
        decision = _decision_by_margins(observations)
    if decision is None:
        decision = _decision_by_tracking(observations)
    if decision is None:
        decision = _decision_without_fault(observations)
    doubts = observations.vehicle_doubts
    if not doubts:
        return decision
    action = Fact(LoopActions.DO_FIRST, because=doubts[0])
    return LoopDecision(decision.axis, decision.verdict, decision.reason, action, doubts)


def _decision_on_oscillation(
    observations: LoopObservations, oscillation: Oscillation
) -> LoopDecision:
    """Returns the decision in a limit cycle: it must be stopped, and hides the margins of all axes.

    Args:
        observations: what the flight shows.
        oscillation: the limit cycle of the axis that turns fastest, with those of other axes.
    """
    axis = observations.margins.axis
    action = observations.gain_reduction
    reason = Fact(MarginsLight.OSCILLATES, because=action, **oscillation.figures)
    oscillating_axes = [cycle.axis for cycle in (oscillation, *oscillation.other_axes)]
    verdict = LoopVerdict.OSCILLATES if axis in oscillating_axes else LoopVerdict.UNKNOWN
    doubts = observations.vehicle_doubts
    if action is not None:
        doubts = (*doubts, action)
    return LoopDecision(axis, verdict, reason, action, doubts)


def _decision_by_margins(observations: LoopObservations) -> LoopDecision | None:
    """Returns the decision on an axis whose margins are below the goal, or perhaps; None if they are not.

    An injected signal measures the margins without a model, so that it outranks the identified loop. The identified
    loop outranks the measured response, unless that resonates where the loop has its margins: then the loop is wrong.
    "Perhaps" is the case of a loop whose estimate has the margins, but not enough of the models that fit the flight.

    Args:
        observations: what the flight shows.
    """
    margins = observations.margins
    axis = margins.axis
    facts = {fact.code: fact for fact in margins.facts}
    loop_fact = facts.get(MarginsLight.LOOP_MARGINS)
    injected = facts.get(MarginsLight.LOOP_MEASURED)
    resonance = facts.get(MarginsLight.RESONATES)
    is_measured_good = injected is not None and not injected.warns
    if injected is not None and injected.warns:
        return _decision_by_measurement(observations, injected)
    if isinstance(margins.loop, Loop) and loop_fact is not None:
        if margin_rating(margins.loop).is_bad:
            return _decision_by_identified_loop(observations, margins.loop, loop_fact)
    if resonance is not None:
        return _decision_by_measurement(observations, resonance)
    if loop_fact is not None and loop_fact.warns and not is_measured_good:
        action = _doublets(axis, loop_fact)
        return LoopDecision(axis, LoopVerdict.UNKNOWN, loop_fact.replace(action=action), action)
    return None


def _decision_by_measurement(observations: LoopObservations, measured: Fact) -> LoopDecision:
    """Returns the decision on an axis whose margins were measured, without a model, to be below the goal.

    Args:
        observations: what the flight shows.
        measured: the fact of the measured margins, or of a measured resonance.
    """
    action = _lowered_gains(observations, "rate")
    reason = measured.replace(action=action)
    axis = observations.margins.axis
    # What was measured contradicts a loop that has its margins, so that no gains follow from that loop.
    return LoopDecision(axis, LoopVerdict.BELOW_GOAL, reason, action, doubts=(reason,))


def _decision_by_identified_loop(
    observations: LoopObservations, loop: Loop, loop_fact: Fact
) -> LoopDecision:
    """Returns the decision on an axis whose identified loop is below the margin goal.

    Args:
        observations: what the flight shows.
        loop: the identified loop, which no measurement refutes.
        loop_fact: the fact of its margins.
    """
    axis = observations.margins.axis
    doubts = reasons_for_no_gains(loop)
    if not doubts:
        action = Fact(LoopActions.LOAD_ADVISED_GAINS, arguments=observations.tune_arguments)
    elif loop.plant.bias < 0:
        action = _doublets(axis, loop_fact)
    else:
        action = Fact(LoopActions.DO_FIRST, because=doubts[0])
    reason = loop_fact.replace(action=action)
    return LoopDecision(axis, LoopVerdict.BELOW_GOAL, reason, action, doubts)


def _decision_by_tracking(observations: LoopObservations) -> LoopDecision | None:
    """Returns the decision on an axis that follows its setpoint badly; None if it follows well, or that is not known.

    Its margins are not below the goal, as far as they are known. So an identified loop does not explain the flight,
    unless the axis is just slow: no gains are computed from it.

    Args:
        observations: what the flight shows.
    """
    tracking = observations.tracking
    if not tracking.warns:
        return None
    axis = observations.margins.axis
    if tracking.code is TrackingLight.RATE_FALLS_SHORT:
        return _decision_on_slow_rate(observations)
    if tracking.code is TrackingLight.OVERSHOOTS_SETPOINT:
        action = _lowered_gains(observations, "attitude")
    elif tracking.code is TrackingLight.AMPLIFIES_SETPOINT:
        action = Fact(LoopActions.FLY_DOUBLETS, axis=axis, is_biased=False)
    else:
        action = Fact(
            LoopActions.CHECK_VEHICLE,
            angle_error=tracking.figures["angle_error"],
            offset_angle=tracking.figures["offset_angle"],
        )
    reason = tracking.replace(action=action)
    return LoopDecision(axis, LoopVerdict.FOLLOWS_BADLY, reason, action, doubts=(reason,))


def _decision_on_slow_rate(observations: LoopObservations) -> LoopDecision:
    """Returns the decision on an axis whose rate does not reach its setpoint in turns.

    No gain helps where a motor is at a limit. Otherwise the rate loop is slow, and gains may rise as far as the margins
    allow, if the loop is identified.

    Args:
        observations: what the flight shows.
    """
    axis = observations.margins.axis
    loop = observations.margins.loop
    at_limit_share = observations.tracking.figures["at_limit_share"]
    is_at_limit = at_limit_share is not None and at_limit_share > MIN_AT_LIMIT_SHARE
    may_be_raised = isinstance(loop, Loop) and not is_at_limit
    doubts: Facts = ()
    if is_at_limit:
        action = Fact(LoopActions.SLOWER_TURNS, axis=axis)
    elif isinstance(loop, Loop):
        doubts = reasons_for_no_gains(loop, more=True)
        action = Fact(
            LoopActions.RAISE_AS_ADVISED, axis=axis, arguments=observations.tune_arguments
        )
        if doubts:
            action = Fact(LoopActions.DO_FIRST, because=doubts[0])
    else:
        action = Fact(LoopActions.DO_FIRST, because=_reason_for_no_margins(observations))
    reason = observations.tracking.replace(action=action)
    if not may_be_raised:
        doubts = (reason,)
    return LoopDecision(axis, LoopVerdict.FOLLOWS_BADLY, reason, action, doubts, may_be_raised)


def _decision_without_fault(observations: LoopObservations) -> LoopDecision:
    """Returns the decision on an axis with which nothing is known to be wrong.

    Args:
        observations: what the flight shows.
    """
    margins = observations.margins
    for fact in margins.facts:
        if fact.is_good:
            # No gains follow from a flight with an injected signal, nor from a loop that was refuted.
            doubts: Facts = ()
            if fact.code is MarginsLight.LOOP_MEASURED:
                doubts = (fact,)
            elif isinstance(margins.loop, Fact):
                doubts = (margins.loop,)
            return LoopDecision(margins.axis, LoopVerdict.NOTHING_WRONG, fact, doubts=doubts)
    reason = _reason_for_no_margins(observations)
    action = Fact(LoopActions.DO_FIRST, because=reason) if reason.remedy else None
    # The reason may be why an identified loop does not count: no gains follow from it.
    return LoopDecision(margins.axis, LoopVerdict.UNKNOWN, reason, action, doubts=(reason,))


def _reason_for_no_margins(observations: LoopObservations) -> Fact:
    """Returns why the margins of an axis are not known.

    A peak of the spectrum comes first: its remedy allows for what was logged. How the axis is tracked stands for a
    reason where no loop was looked for.

    Args:
        observations: what the flight shows.
    """
    margins = observations.margins
    if margins.facts:
        return margins.facts[0]
    return margins.loop if isinstance(margins.loop, Fact) else observations.tracking


def _doublets(axis: str, loop_fact: Fact) -> Fact:
    """Returns the advice to fly doublets about an axis, whose margins are not known well enough."""
    return Fact(LoopActions.FLY_DOUBLETS, axis=axis, is_biased=loop_fact.figures["is_biased"])


def _lowered_gains(observations: LoopObservations, loop_name: str) -> Fact:
    """Returns the advice to lower the gains of one loop of an axis by a third.

    Args:
        observations: what the flight shows, with the parameters.
        loop_name: "rate" or "attitude".

    Returns:
        A fact with ``changes``: name, value and new value of each gain; empty where the gains are not known.
    """
    axis = observations.margins.axis
    changes = []
    # Without a known controller the sentence names the gains by what they are.
    with suppress(NotLearnable):
        # Only gains are of interest, so the mixer of one motor stands for any.
        controller = controller_from_parameters(observations.parameters, axis, (1.0,))
        for field in CONTROLLER_GAINS[loop_name]:
            name = controller.parameter_names[field]
            value = observations.parameters.get(name)
            if value:
                changes.append((name, value, GAIN_REDUCTION * value))
    return Fact(LoopActions.LOWER_BY_A_THIRD, subject=loop_name, axis=axis, changes=changes)


def common_action(actions: Sequence[Fact | None]) -> Fact | None:
    """Returns one action for several axes: the changes of gains together, or else the first action.

    Args:
        actions: of each axis; None where nothing is to be done.
    """
    known_actions = [action for action in actions if action is not None]
    if not known_actions:
        return None
    first = known_actions[0]
    same_kind = [action for action in known_actions if action.code is first.code]
    if first.code is not LoopActions.LOWER_BY_A_THIRD or len(same_kind) == 1:
        return first
    changes = [change for action in same_kind for change in action.figures["changes"]]
    return first.replace(changes=changes, names=[action.figures["axis"] for action in same_kind])
