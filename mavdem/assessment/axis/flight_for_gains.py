"""The flight that shows the loops of axes without sure margins: what to log, and about which axes to fly doublets.

Doublets are quick stick movements to one side and then to the other. A control loop can be identified from them if its
messages are logged fast enough. One such flight serves all axes.
"""

from collections.abc import Container, Iterable
from itertools import chain
from math import inf

from mavdem.assessment.axis.loop_decision import DecisionsByAxis, LoopDecision
from mavdem.assessment.axis.lowered_gains import LOWERING, fact_and_contained_facts
from mavdem.assessment.evidence import Evidence
from mavdem.dataset.rate_advice import names_setting, rate_advice
from mavdem.dataset.signals import rate_between_outages
from mavdem.facts import Fact, Facts
from mavdem.facts.assessment import NextStep
from mavdem.facts.learnability import NotLearnableReason, Remedy
from mavdem.facts.loops import (
    ADVISED_STREAM_RATE,
    GainFact,
    LoopAction,
    LoopFact,
    ResponseFact,
    StepResponseFact,
)
from mavdem.facts.model import ParameterDoubt
from mavdem.loops.advice import Advice, AdviceByAxis
from mavdem.loops.axis_loops import SLOW_LOG

REMOVED_BY_DOUBLETS = (
    LoopAction.FLY_DOUBLETS,
    LoopFact.LOOP_TOO_SHORT,
    LoopFact.NO_RATE_SETPOINT,
    LoopFact.NOT_STEERED,
    LoopFact.STEERING_SLOW,
    ResponseFact.RESPONSE_DISAGREES,
    ResponseFact.RESPONSE_UNEXPLAINED,
    StepResponseFact.PREDICTION_DOUBTED,
    GainFact.LOOP_UNSTABLE,
    GainFact.STABILITY_UNKNOWN,
    NotLearnableReason.OUTPUT_ROUNDED,
    NotLearnableReason.COMMAND_ROUNDED,
    NotLearnableReason.RATE_CONTRADICTS_ANGLE,
    ParameterDoubt.WIND_SHARE_HIGH,
    ParameterDoubt.INPUTS_TOO_SLOW,
    ParameterDoubt.DEPENDS_ON_WIND_SPECTRUM,
)
"""Reasons for no gains that doublets remove: too little motion by the commands, or a loop that other motion biases."""

REMOVED_BY_LOGGING = (
    NotLearnableReason.STREAMS_TOO_SLOW,
    NotLearnableReason.SLOWER_THAN_LONGEST,
    NotLearnableReason.VALUES_REPEATED,
)
"""Reasons for no gains that faster messages remove, with what to set for that as their remedy."""

SETTINGS_ON_BOARD = (Remedy.LOG_FAST_ATTITUDE, Remedy.LOG_HIGH_RATE)
"""Advice on what autopilots log on board: ArduPilot's RATE and PX4's high rate have the setpoint of the rate, too."""


def flight_for_gains(
    evidence: Evidence,
    advice_by_axis: AdviceByAxis,
    decisions: DecisionsByAxis,
    axes_without_controller: Container[str],
    *,
    is_after_repair: bool,
) -> Fact | None:
    """Returns the advice to fly doublets about the axes for which this log gives no gains, or only doubtful ones.

    For example: fly doublets about roll and pitch, with the attitude logged at 100 Hz. Axes are left out whose gains
    are to be lowered first.

    Args:
        evidence: the log with its signals, and the loops that were identified, or why they are not known.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known.
        decisions: the decision on the loops of each axis.
        axes_without_controller: axes whose controller the log does not describe, so that no flight leads to gains.
        is_after_repair: whether the vehicle must be repaired before, so that all its loops are to be flown anew.

    Returns:
        The fact ``FLY_FOR_GAINS`` with these figures; None if no axis needs such a flight:

        - ``axes``: the axes about which doublets are to be flown;
        - ``is_after_repair``: as given; a repaired vehicle hovers first, since its loops may have less margin;
        - ``also``: facts with what to set before the flight, so that it is logged fast enough;
        - ``names`` and ``rates``, Hz, of messages that came too slowly, if the log shows no setting to change;
        - ``least_rate``, Hz, that the loops of these axes need of the log, if it was too slow for one; otherwise None.
    """
    reasons_by_axis: dict[str, Facts] = {}
    for axis, advice in advice_by_axis.items():
        if axis in axes_without_controller or _lowers_gains(decisions.get(axis)):
            continue
        reasons = _reasons_for_no_gains(evidence, axis, advice)
        is_flight_useful = is_after_repair or any(map(is_removed_by_flight, reasons))
        if reasons and is_flight_useful:
            reasons_by_axis[axis] = reasons
    if not reasons_by_axis:
        return None
    all_reasons = _facts_and_contained_facts(reasons_by_axis.values())
    logging_steps = _logging_steps(evidence, all_reasons)
    if is_after_repair and not logging_steps:
        # No loop is sought in the flight of a vehicle to be repaired, so no reason says that its log is slow.
        logging_steps = _steps_against_slow_attitude(evidence)
    slowest = None if logging_steps else _slowest_messages(all_reasons)
    return Fact(
        NextStep.FLY_FOR_GAINS,
        axes=tuple(reasons_by_axis),
        is_after_repair=is_after_repair,
        also=logging_steps,
        names=() if slowest is None else slowest.figures["names"],
        rates=() if slowest is None else slowest.figures["rates"],
        least_rate=_log_rate_for_all_loops(all_reasons),
    )


def hover_before_tuning(evidence: Evidence) -> Fact:
    """Returns the advice to hover shortly with lowered gains, after a flight in which the vehicle oscillated.

    Nothing shows beforehand whether the gains are low enough. So this hover comes before the doublets (quick stick
    movements), from which gains are computed.

    Args:
        evidence: the log with its signals, and the autopilot's parameters.

    Returns:
        The fact ``HOVER_TO_TUNE``. If this log is slow, its figure ``also`` has the setting that makes the next one
        faster, such as the bit of LOG_BITMASK for fast attitude; otherwise it is empty.
    """
    return Fact(NextStep.HOVER_TO_TUNE, also=_steps_against_slow_attitude(evidence))


def is_removed_by_flight(reason: Fact) -> bool:
    """Returns whether a flight with doublets, logged fast enough, removes a reason why an axis gets no gains.

    It does so if the commands moved the vehicle too little, or if messages were missing or too slow. It does not if the
    vehicle is to be repaired, for example.

    Args:
        reason: the reason, or an action on it; a coded finding that may contain others as its figures.
    """
    for fact in fact_and_contained_facts(reason):
        if fact.code in (*REMOVED_BY_DOUBLETS, *SLOW_LOG):
            return True
        if _advises_to_log(fact) or _has_slow_messages(fact):
            return True
        # Margins that stay uncertain although the axis was steered do not become sure by more doublets.
        if fact.code is LoopFact.MARGIN_UNCERTAIN and not fact.figures["is_steered"]:
            return True
    return False


def _facts_and_contained_facts(groups: Iterable[Facts]) -> list[Fact]:
    """Returns all facts (coded findings) of some groups, and the facts that these contain as figures, each once."""
    facts: list[Fact] = []
    for reason in chain.from_iterable(groups):
        for fact in fact_and_contained_facts(reason):
            if fact not in facts:
                facts.append(fact)
    return facts


def _reasons_for_no_gains(evidence: Evidence, axis: str, advice: Advice | Fact) -> Facts:
    """Returns why this log gives no gains for an axis, or only doubtful ones, as facts (coded findings).

    Gains are doubtful if they stay although their margins are uncertain, because wind biases the estimate, the log is
    slow, or setpoints end below the crossover.

    Args:
        evidence: the identified loops, or why they are not known.
        axis: "roll", "pitch" or "yaw".
        advice: the advice on the axis, or the fact that its loop is not known.

    Returns:
        The reasons; empty if the axis gets gains, or keeps them by margins that are sure or that only other models of
        the vehicle lack.
    """
    if isinstance(advice, Advice):
        if advice.refusals or advice.parameters:
            return advice.refusals
        return () if advice.rating.is_good else _causes_of_uncertain_margins(advice)
    loop_or_reason = evidence.loops[axis]
    if isinstance(loop_or_reason, Fact):
        return (advice, loop_or_reason)
    # The loop is identified, but the vehicle must be repaired first, which the fact in place of the advice says.
    return (advice,)


def _causes_of_uncertain_margins(advice: Advice) -> Facts:
    """Returns why the margins of an axis are uncertain: wind that biases the loop, a slow log, or slow setpoints.

    Args:
        advice: the advice on the axis, to keep its gains although its margins are not surely good.

    Returns:
        The cautions of the loop that say so, as facts (coded findings); empty if there is no such cause.
    """
    causes = []
    for caution in advice.before.cautions:
        # A log may be slow and still show whether this axis has its margins.
        is_log_too_slow = caution.code in SLOW_LOG and advice.rating.figures["is_log_slow"]
        if caution.code in (LoopFact.EFFECT_BIASED, LoopFact.STEERING_SLOW) or is_log_too_slow:
            causes.append(caution)
    return tuple(causes)


def _lowers_gains(decision: LoopDecision | None) -> bool:
    """Returns whether the decision on the loops of an axis is to lower its gains."""
    return decision is not None and decision.action is not None and decision.action.code in LOWERING


def _advises_to_log(fact: Fact) -> bool:
    """Returns whether the remedy of a fact (coded finding) is to log more or faster messages, such as the setpoint.

    Args:
        fact: a reason why an axis gets no gains.
    """
    if fact.code is LoopFact.NO_RATE_SETPOINT:
        return not fact.figures["is_logged"]
    if fact.code is LoopFact.CROSSOVER_UNSEEN:
        # Without a rate of messages the loop itself is too slow, and no log shows it.
        return fact.figures["rate"] is not None
    return fact.code in REMOVED_BY_LOGGING


def _has_slow_messages(fact: Fact) -> bool:
    """Returns whether a fact about a loop (a coded finding) states rates of messages that are below the advised one.

    Args:
        fact: a reason why an axis gets no gains. Its figure ``rates``, if any, has the rates in this log, Hz.
    """
    rates: tuple[float, ...] = fact.figures.get("rates", ())
    return isinstance(fact.code, LoopFact) and min(rates, default=inf) < ADVISED_STREAM_RATE


def _logging_steps(evidence: Evidence, reasons: Iterable[Fact]) -> Facts:
    """Returns what to set so that the next flight is logged fast enough, as facts (coded findings).

    Args:
        evidence: the log with its signals, and the autopilot's parameters, which show what is set now.
        reasons: why axes get no gains.

    Returns:
        Facts whose remedy, or else sentence, is what to set, such as a bit of LOG_BITMASK, each once. Their texts do
        not say to fly anew, which the advice on the flight says already.
    """
    advice = rate_advice(evidence.signals.telemetry, components=evidence.log.components)
    is_setting_named = names_setting(advice)
    steps = []
    for fact in reasons:
        if _advises_to_log(fact):
            steps.append(fact)
        # One setting makes all messages faster, which several reasons may ask for.
        is_log_slow = fact.code in SLOW_LOG or _has_slow_messages(fact)
        is_advice_needed = is_log_slow or _adds_setpoint(advice, fact)
        if is_setting_named and is_advice_needed and advice not in steps:
            steps.append(advice)
    return tuple(_without_sentence_to_fly_anew(step) for step in steps)


def _steps_against_slow_attitude(evidence: Evidence) -> Facts:
    """Returns what to set so that the attitude of the next flight is logged fast enough to identify loops.

    Args:
        evidence: the log with its signals, and the autopilot's parameters, which show what is set now.

    Returns:
        The fact (coded finding) with the setting. Empty if this log has the attitude at ``ADVISED_STREAM_RATE``, or
        shows no setting that makes it faster.
    """
    attitude = evidence.signals.attitude
    if attitude is not None and rate_between_outages(attitude.rate_series) >= ADVISED_STREAM_RATE:
        return ()
    advice = rate_advice(evidence.signals.telemetry, components=evidence.log.components)
    # An autopilot that logs as fast as it can has no setting to change.
    return (_without_sentence_to_fly_anew(advice),) if names_setting(advice) else ()


def _adds_setpoint(advice: Fact, reason: Fact) -> bool:
    """Returns whether advice on faster messages also brings the setpoint of the rate into the log, which lacks it.

    Args:
        advice: the advice (:func:`rate_advice`).
        reason: a reason why an axis gets no gains, a coded finding.
    """
    lacks_setpoint = reason.code is LoopFact.NO_RATE_SETPOINT and _advises_to_log(reason)
    return lacks_setpoint and advice.code in SETTINGS_ON_BOARD


def _without_sentence_to_fly_anew(fact: Fact) -> Fact:
    """Returns advice on logging whose text does not end with "then fly again": the advice around it says that already.

    Args:
        fact: the advice, a coded finding. The same holds for its figure ``remedy``, if that is a fact.
    """
    remedy = fact.figures.get("remedy")
    if isinstance(remedy, Fact):
        fact = fact.replace(remedy=_without_sentence_to_fly_anew(remedy))
    return fact.replace(is_flight_stated=True)


def _slowest_messages(reasons: Iterable[Fact]) -> Fact | None:
    """Returns the reason with the slowest messages of all; None if no reason is that messages were logged too slowly.

    Args:
        reasons: why axes get no gains, as facts (coded findings). The figure ``rates`` has the rates of messages, Hz.
    """
    slow_facts = [fact for fact in reasons if _has_slow_messages(fact)]
    return min(slow_facts, key=lambda fact: min(fact.figures["rates"]), default=None)


def _log_rate_for_all_loops(reasons: Iterable[Fact]) -> float | None:
    """Returns how fast the next log must be to show the margins of all loops, Hz; None if this log is fast enough.

    Args:
        reasons: why axes get no gains, as facts (coded findings). If the log was too slow for a loop, one of them has
            the rate that this loop needs as its figure ``least_rate``, Hz.
    """
    rates = [fact.figures["least_rate"] for fact in reasons if fact.code in SLOW_LOG]
    return max(rates, default=None)
