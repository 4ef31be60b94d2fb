"""The most important result of a tuning, such as that roll lacks phase margin, and how bad it is."""

from typing import NamedTuple

from mavdem.assessment.axis.loop_decision import DecisionsByAxis, LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.tuning import Tuning
from mavdem.assessment.event_lights import LIGHT_OF_EVENT
from mavdem.assessment.faults_before_gains import faults_besides_loops
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.limits import worst_fact
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.loops import GainFact, LoopFact
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import Advice
from mavdem.report.tuning.outcomes import has_doubtful_margins
from mavdem.report.tuning.slower import facts_on_slower_attitude


def tuning_result(tuning: Tuning) -> Fact:
    """Returns the most important result of a tuning, with which the report of ``mavdem tune`` begins.

    It is a fact (a coded finding), the first of these that applies:

    1. The headline of the flight's judgement, if it is bad or about control loops; with all axes that lack the same
       margin.
    2. That there is room for higher gains on axes whose margins are good, and for which other gains are advised.
    3. The worst rating of margins, if each axis has a rating that no measurement contradicts.
    4. The headline of the judgement, whatever it says.

    Args:
        tuning: advice for each axis, with the judgement of the flight.
    """
    flight_headline = _headline_by_decision(tuning.judgement)
    if flight_headline.is_bad or is_about_loops(flight_headline, tuning.judgement):
        result = _headline_on_all_axes(flight_headline, tuning.judgement.loop_decisions)
        return _headline_with_thrust_reserve(result, tuning)
    advice_with_room = _advice_with_room_for_gains(tuning)
    if advice_with_room:
        slower_axes = []
        for axis, advice in advice_with_room.items():
            if facts_on_slower_attitude(advice):
                slower_axes.append(axis)
        return Fact(GainFact.ROOM_FOR_GAINS, names=[*advice_with_room], slower_axes=slower_axes)
    return _worst_rating(tuning) or flight_headline


def is_about_loops(fact: Fact, judgement: Judgement) -> bool:
    """Returns whether a headline or a next step is about the control loops, and not about something else in the flight.

    Args:
        fact: headline or next step, a coded finding with figures.
        judgement: the judgement of the vehicle, with a status light (a judgement with a level) for each of its subjects
            such as tracking.
    """
    # A next step has a figure "reason", the finding that it follows from. A headline is its own reason.
    reason = fact.figures.get("reason") or fact
    # A loss of the vehicle or an impact is not about the loops, though it may also be the judgement of the tracking.
    is_loss_or_impact = reason.code in LIGHT_OF_EVENT
    if is_loss_or_impact:
        return False
    is_step_on_gains = fact.code in (
        NextStep.LOAD_GAINS,
        NextStep.FLY_BEFORE_GAINS,
        NextStep.FLY_FOR_GAINS,
        NextStep.KEEP_OR_CONFIRM_GAINS,
        NextStep.TUNE_OTHER_AXES,
    )
    # A finding on margins whose model a measured response contradicts has that as its figure "reason".
    is_finding_on_loops = isinstance(reason.code, GainFact | LoopFact) or isinstance(
        fact.code, MarginsLight
    )
    lights_on_loops = (judgement.lights[Light.TRACKING], judgement.lights[Light.MARGINS])
    return is_step_on_gains or is_finding_on_loops or reason in lights_on_loops


def _headline_by_decision(judgement: Judgement) -> Fact:
    """Returns the headline of a flight or, where it is about margins by a model, the resonance that was measured.

    Where a resonance decides what to do about an axis, the model that the margins come from is doubtful.

    Args:
        judgement: the judgement of the flight, with the decision on the loops of each axis.

    Returns:
        The reason of the decision on the same axis, such as a resonance, with its action; the headline itself if it
        is about something else, or if no measurement decided on the axis.
    """
    flight_headline = judgement.headline
    if flight_headline.code is not MarginsLight.LOOP_MARGINS:
        return flight_headline
    decision = judgement.loop_decisions.get(flight_headline.figures["axis"])
    if decision is None or decision.reason.code is not MarginsLight.RESONATES:
        return flight_headline
    return decision.reason.replace(action=decision.action)


def _headline_on_all_axes(flight_headline: Fact, decisions: DecisionsByAxis) -> Fact:
    """Extends a headline on a too small margin of one axis to all axes on which the same margin is too small.

    The headline of a flight names only the axis with the smallest margin, such as roll. If pitch lacks the same margin,
    a pilot who reads of roll alone would take pitch for sound.

    Args:
        flight_headline: the headline of a flight, a coded finding.
        decisions: decision on the loops by axis, each with the fact on its margins as the reason.

    Returns:
        The headline with the facts on the other axes as its figure ``alike``; unchanged if there are none, or if it is
        about something else.
    """
    if flight_headline.code is MarginsLight.RESONATES:
        return _resonance_on_all_axes(flight_headline, decisions)
    missed_goal = _missed_goal(flight_headline)
    if missed_goal is None:
        return flight_headline
    facts_on_other_axes = []
    for axis, decision in decisions.items():
        is_other_axis = axis != flight_headline.figures["axis"]
        if is_other_axis and _missed_goal(decision.reason) == missed_goal:
            facts_on_other_axes.append(decision.reason)
    if not facts_on_other_axes:
        return flight_headline
    return flight_headline.replace(alike=tuple(facts_on_other_axes))


def _resonance_on_all_axes(resonance: Fact, decisions: DecisionsByAxis) -> Fact:
    """Extends a headline on the measured resonance of one axis to other axes whose rate loops lack margin.

    Args:
        resonance: the headline, a coded finding.
        decisions: decision on the loops by axis, with the fact that it was made by as the reason.

    Returns:
        The headline with the facts on the margins of the other axes as its figure ``alike``.
    """
    facts_on_other_axes = []
    for axis, decision in decisions.items():
        lacks_margin = decision.diagnosis is LoopDiagnosis.BELOW_GOAL
        is_of_rate = decision.reason.subject != "attitude"
        if axis != resonance.figures["axis"] and lacks_margin and is_of_rate:
            facts_on_other_axes.append(decision.reason)
    return resonance.replace(alike=tuple(facts_on_other_axes))


def _headline_with_thrust_reserve(result: Fact, tuning: Tuning) -> Fact:
    """Extends a headline that the margins reach their goal if they probably miss it with more or less thrust.

    Args:
        result: the headline, a coded finding.
        tuning: advice on the gains of each axis.

    Returns:
        The headline with the smallest share of models that reach the goal at all thrusts as its figure
        ``share_at_all_thrusts``; unchanged if most models do, or if it is no headline on a goal that is met.
    """
    is_goal_met = result.code is MarginsLight.LOOP_MARGINS and not result.figures["reason"]
    if not is_goal_met or result.figures["rating"] == Level.BAD:
        return result
    shares = [advice.sure for advice in tuning.advice if not advice.parameters]
    smallest_share = min(shares, default=1.0)
    if smallest_share >= 1 / 2:
        return result
    return result.replace(share_at_all_thrusts=smallest_share)


class _MissedGoal(NamedTuple):
    """Which goal the margins of an identified loop miss, and how badly; the same for axes that share a sentence."""

    loop_name: str
    """"rate" or "attitude"."""
    margin_name: str
    """The margin that is too small: "phase_margin" or "gain_margin"; or "ms", the maximum sensitivity, if too large."""
    level: Level
    """How bad that is for the vehicle."""
    rating: Level
    """Whether the goal of the margins is probably missed (bad), or may be missed (watch)."""


def _missed_goal(fact: Fact) -> _MissedGoal | None:
    """Returns which goal the margins of a loop miss by a fact, such as the phase margin of the rate loop.

    Args:
        fact: a coded finding, such as the headline of a flight.

    Returns:
        The goal; None if the fact is about something else, if the margins are sufficient, and if a measured response
        contradicts the loop, so that its margins are in doubt.
    """
    if fact.code is not MarginsLight.LOOP_MARGINS or not fact.is_watch_or_bad:
        return None
    contradiction = fact.figures["reason"]
    if contradiction is not None:
        return None
    return _MissedGoal(
        loop_name=fact.subject,
        margin_name=fact.figures["lacking"],
        level=fact.level,
        rating=fact.figures["rating"],
    )


def _advice_with_room_for_gains(tuning: Tuning) -> dict[str, Advice]:
    """Selects the axes whose gains can be higher: their margins are good, and other gains are advised for them.

    Axes are left out whose margins a measurement contradicts.

    Args:
        tuning: advice for each axis, with the decisions on their loops.

    Returns:
        The advice on these axes, by their names.
    """
    advice_with_room = {}
    for axis, advice in tuning.axes.items():
        is_doubtful = axis in tuning.doubtful_axes
        if isinstance(advice, Fact) or is_doubtful:
            continue
        ratings = rating_unless_contradicted(advice, tuning.judgement.loop_decisions.get(axis))
        has_good_margins = all(rating.is_good for rating in ratings)
        if advice.conclusion.code is GainFact.SET_GAINS and has_good_margins:
            advice_with_room[axis] = advice
    return advice_with_room


def _worst_rating(tuning: Tuning) -> Fact | None:
    """Returns the worst rating of the stability margins of all axes; of equal ones the first.

    Args:
        tuning: advice for each axis, with the decisions on their loops.

    Returns:
        The rating, with the axis in its subject; None if the margins of an axis are not known. They are unknown if no
        loop was identified, if the loop is too unreliable for advice on gains, or if a measured response contradicts
        it.
    """
    ratings = []
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Fact) or has_doubtful_margins(tuning, axis):
            return None
        decision = tuning.judgement.loop_decisions.get(axis)
        for rating in rating_unless_contradicted(advice, decision):
            ratings.append(rating.replace(subject=f"{axis} {rating.subject}"))
    for level in (Level.BAD, Level.WATCH, Level.UNKNOWN, Level.GOOD):
        for rating in ratings:
            if rating.level is level:
                return rating
    return None


def rating_unless_contradicted(advice: Advice, decision: LoopDecision | None) -> list[Fact]:
    """Returns the rating of an axis' stability margins, such that it does not contradict the decision on the axis.

    The rating says only whether the margins are large enough. The decision also knows whether the axis oscillates, and
    whether it follows its setpoint in flight. A report with both must not call an axis good and bad.

    Args:
        advice: advice on the gains of the axis, with the rating of the margins of its identified loop.
        decision: decision on the loops of the axis; None if there is none.

    Returns:
        A list with the rating. If the axis does not follow its setpoint, the rating is "watch" at best, and its
        sentence says that the margins are not enough. The list is empty if the loop cannot be relied on, so that no
        gains are advised, and the decision was made for another reason than the margins.
    """
    rating = advice.rating
    if decision is None:
        return [rating]
    is_decided_by_margins = decision.reason.code is MarginsLight.LOOP_MARGINS
    if advice.refusals and not is_decided_by_margins:
        return []
    if decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY:
        level = Level.BAD if rating.is_bad else Level.WATCH
        # The figure ``follows`` = False adds to the sentence "but the axis does not follow its setpoint".
        return [rating.replace(level, follows=False)]
    return [rating]


def states_max_sensitivity(result: Fact) -> bool:
    """Returns whether a result of a tuning is about the maximum sensitivity Ms, and not about another margin.

    Args:
        result: a fact (a coded finding). One on a measured resonance has the interval of Ms as a figure; one on an
            identified loop also has the name of the margin that is ``lacking``.
    """
    return "ms_interval" in result.figures and result.figures.get("lacking", "ms") == "ms"


def is_headline_of_tuning(tuning: Tuning, result: Fact) -> bool:
    """Returns whether the most important result is the headline of a tuning's report: if it is about loops, or bad.

    Args:
        tuning: the advice for each axis, with the judgement of the flight.
        result: the most important result. It is about the loops unless it is the headline of the flight, which may be
            about anything, such as the wind (:func:`tuning_result`).
    """
    is_of_whole_flight = result is tuning.judgement.headline
    if not is_of_whole_flight or result.is_bad:
        return True
    return is_about_loops(result, tuning.judgement)


def level_of_summary(tuning: Tuning, result: Fact) -> Level:
    """Returns the level of the worst finding in the summary of a tuning report, such as "bad".

    The summary states the result of the tuning, and faults of the flight that are not about control loops, such as a
    weak motor. A flight with such a fault is marked as bad even if its gains are good.

    Args:
        tuning: the advice on the gains of each axis, with the judgement of the whole flight.
        result: the most important result of the tuning (:func:`tuning_result`), a fact with a level.
    """
    findings = [result, *faults_of_flight(tuning)]
    return worst_fact(findings).level


def faults_of_flight(tuning: Tuning) -> list[Fact]:
    """Returns what the flight shows to be watch or bad about anything but its control loops, each finding once."""
    return faults_besides_loops(tuning.judgement.headline, tuning.judgement.lights)
