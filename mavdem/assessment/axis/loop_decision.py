"""Decision on the loops of an axis by facts (coded findings): what is wrong, what to do, what forbids new gains.

It is made once, from limit cycles, margins, the measured response, tracking, and the repairs that the vehicle needs.
What a fact (a coded finding) advises is its remedy. Lights, screen, pages, dashboards, `mavdem tune`, live sessions,
fleets and documents show this decision, and no other advice on gains. Whether `mavdem tune` advises to load any, or to
fly before, is decided here, by the same rule (``Advice.is_sound``).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from mavdem.assessment.axis.gains import loop_at_end_of_log
from mavdem.assessment.axis.margins import AxisMargins
from mavdem.containers import Names
from mavdem.dataset.parameter_history import ParametersInFlight
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import LoopAction
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.loops.advice import Advice, advise, gains_to_lower, reasons_for_no_gains
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop, margin_rating
from mavdem.loops.controllers import gain_names
from mavdem.loops.gain_design import SURE_SHARE
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE, Oscillation

ADVICE_TO_TUNE = (LoopAction.LOAD_ADVISED_GAINS, LoopAction.RAISE_AS_ADVISED)
"""What to do about loops by running ``mavdem tune``, which the report of that command does not repeat."""


REDUCTIONS_OF_RATE_GAINS = (LoopAction.LOWER_BY_A_THIRD, LoopAction.HOVER_WITH_LOWER_GAINS)
"""Actions with gains to lower, which are lowered on all axes before the same flight."""


class LoopDiagnosis(StrEnum):
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
    diagnosis: LoopDiagnosis
    """What is wrong."""
    reason: Fact
    """The observation that shows it, such as low margins. If its remedy is the action, it has that as a figure."""
    action: Fact | None = None
    """What to do about it, as a sentence; None if nothing is to be done."""
    reasons_against_gains: Facts = ()
    """Why gains must not be computed from the identified loop; empty if they may be."""
    repairs: Facts = ()
    """Those of these reasons that are repairs of the vehicle; they do not question the margins in flight."""
    is_too_slow: bool = False
    """Whether gains may be raised although the loop has its margins, since the axis is too slow."""
    advice: Advice | None = None
    """The advice on gains with the usual margins, if it was needed to decide; `mavdem tune` would give the same."""

    @property
    def fact(self) -> Fact:
        """The decision as a fact (a code with figures), from which pages and documents make their sentences.

        The sentence states the observation that led to the diagnosis, such as low margins; the remedy, what the fact
        advises, is the action. The level of the fact, from good to bad, is that of the observation.
        """
        return Fact(
            LoopAction.LOOPS_JUDGED,
            self.reason.level,
            subject=self.axis,
            axis=self.axis,
            verdict=self.diagnosis,
            reason=self.reason,
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
    vehicle_repairs: Facts
    """Why the vehicle must be repaired before it is tuned; empty if nothing is wrong with it."""
    parameters: ParametersInFlight
    """The autopilot's parameters in the flight that shows the margins and the tracking."""
    tune_arguments: Names
    """Arguments with which `mavdem tune` reads the log."""
    attitude_swing: Fact | None = None
    """The event that this axis swung to and fro in an automatic mode or, without one, the other of roll and pitch; None
    if neither did."""


def decide_on_loops(observations: LoopObservations) -> LoopDecision:
    """Decides what is wrong with the control loops of an axis, and what to change.

    The first of these cases that applies decides:

    1. A limit cycle: lower the gains that drive it, on the axes that oscillate. Nothing else is known before it ends.
    2. An axis so far from its setpoint that no loop explains it: check the vehicle.
    3. Margins below the goal: load the gains that `mavdem tune` advises if the loop is identified reliably.
       Otherwise lower P, I and D by a third if the margins were measured, or first do what makes the loop known.
    4. The axis follows its setpoint badly although its loops have their margins, or these are not known.
    5. Nothing is wrong, or it is not known whether something is.

    If the vehicle must be repaired, the diagnosis of cases 2 to 5 stays, but the action is the repair, and no gains are
    computed.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.

    Returns:
        The decision, with the observation that is its reason and the advised action.
    """
    if observations.oscillation is not None:
        return _decision_on_oscillation(observations, observations.oscillation)
    tracking = observations.tracking
    is_far_from_setpoint = tracking.code is TrackingLight.MISSES_SETPOINT and tracking.is_bad
    decision = None
    # Margins of the loop do not matter for an axis that is far from its setpoint: no loop explains that.
    if not is_far_from_setpoint:
        decision = _decision_by_margins(observations)
    if decision is None:
        decision = _decision_by_tracking(observations)
    if decision is None:
        decision = _decision_without_fault(observations)
    if observations.vehicle_repairs:
        return _decision_to_repair_first(decision, observations.vehicle_repairs)
    return decision


def _decision_to_repair_first(decision: LoopDecision, repairs: Facts) -> LoopDecision:
    """Returns the decision on an axis of a vehicle that needs a repair: to repair it, and to compute no gains before.

    The diagnosis of the loop, such as that its margins are too small, stays.

    Args:
        decision: what would be decided if the vehicle needed no repair. If nothing is to be done about the loop, the
            repair is not named either.
        repairs: why the vehicle must be repaired, at least one reason; the action is the remedy of the first one.
    """
    action = None
    if decision.action is not None:
        action = _action_to_remedy(repairs[0])
    return LoopDecision(
        decision.axis,
        decision.diagnosis,
        decision.reason,
        action,
        reasons_against_gains=(*repairs, *decision.reasons_against_gains),
        repairs=repairs,
    )


def _action_to_remedy(reason: Fact) -> Fact:
    """Returns the advice to remove the cause of a fact first, before any gain is changed.

    Args:
        reason: a fact whose remedy says how, such as that the loop is not reliable, or that motor 2 is weak.
    """
    return Fact(LoopAction.DO_FIRST, reason=reason)


def _decision_on_oscillation(
    observations: LoopObservations, oscillation: Oscillation
) -> LoopDecision:
    """Returns the decision on an axis of a vehicle that is in a limit cycle.

    The diagnosis is that the axis oscillates, or, if only other axes do, that its loops are not known: a limit cycle
    moves the whole vehicle, and hides the margins of every axis. The action is the same for all axes: to lower the
    gains that keep up the limit cycle. No gains are computed from a loop until they have been lowered.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.
        oscillation: the limit cycle of the axis with the largest body rates, with the limit cycles of other axes.
    """
    axis = observations.margins.axis
    gain_reduction = observations.gain_reduction
    # The sentence of this fact ends with the gains to lower, which it has under the name "reason".
    reason = Fact(MarginsLight.OSCILLATES, reason=gain_reduction, **oscillation.figures)
    oscillating_axes = [oscillation.axis]
    for other_oscillation in oscillation.other_axes:
        oscillating_axes.append(other_oscillation.axis)
    if axis in oscillating_axes:
        diagnosis = LoopDiagnosis.OSCILLATES
    else:
        diagnosis = LoopDiagnosis.UNKNOWN
    # The advice to lower gains at once also keeps `mavdem tune` from computing other gains.
    reasons_against_gains = observations.vehicle_repairs
    if gain_reduction is not None:
        reasons_against_gains = (*reasons_against_gains, gain_reduction)
    return LoopDecision(
        axis, diagnosis, reason, action=gain_reduction, reasons_against_gains=reasons_against_gains
    )


def _decision_by_margins(observations: LoopObservations) -> LoopDecision | None:
    """Returns the decision on an axis whose margins are below the goal, or may be.

    The sources of the margins are examined in this order, and the first that warns decides:

    1. The response of the loop to an injected signal, which measures the margins without a model.
    2. The identified loop, if its estimated margins are below the goal, and no measured response contradicts it.
    3. A resonance in the measured response to the setpoint: a loop with enough margin has none.
    4. The identified loop, if its margins are uncertain (:func:`_decision_on_uncertain_loop`).

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.

    Returns:
        The decision; None if no source warns.
    """
    facts_by_code = {fact.code: fact for fact in observations.margins.facts}
    injected = facts_by_code.get(MarginsLight.LOOP_MEASURED)
    loop_fact = facts_by_code.get(MarginsLight.LOOP_MARGINS)
    resonance = facts_by_code.get(MarginsLight.RESONATES)
    loop_below_goal = _loop_below_goal(observations.margins)
    if injected is not None and injected.is_watch_or_bad:
        return _decision_by_measurement(observations, injected)
    if loop_fact is not None and loop_below_goal is not None:
        return _decision_by_identified_loop(observations, loop_below_goal, loop_fact)
    if resonance is not None:
        return _decision_by_measurement(observations, resonance)
    if loop_fact is not None and loop_fact.is_watch_or_bad:
        return _decision_on_uncertain_loop(observations, loop_fact)
    return None


def _loop_below_goal(margins: AxisMargins) -> Loop | None:
    """Returns the identified loop of an axis if its estimated margins are below the goal.

    Args:
        margins: margins of the axis, and whether a measured response contradicts its loop.

    Returns:
        The loop; None if it has its margins, if it was not identified, or if a measured response contradicts it.
    """
    loop = margins.loop
    if not isinstance(loop, Loop) or margins.contradiction is not None:
        return None
    return loop if margin_rating(loop).is_bad else None


def _decision_on_uncertain_loop(
    observations: LoopObservations, loop_fact: Fact
) -> LoopDecision | None:
    """Returns the decision to fly doublets on an axis whose stability margins are not certain.

    They are not certain if too many models that fit the flight as well as the identified loop have smaller margins, or
    if a measured response contradicts the loop. Doublets (quick stick inputs to both sides) show the margins better.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.
        loop_fact: the fact (a coded finding) that the margins of the identified loop may be below the goal.

    Returns:
        The decision, with the diagnosis "unknown". None if a response contradicts the loop and the axis follows its
        setpoint badly: then the tracking, which is measured, decides.
    """
    margins = observations.margins
    contradiction = margins.contradiction
    if contradiction is not None and observations.tracking.is_watch_or_bad:
        return None
    action = _advice_to_fly_doublets(margins, loop_fact)
    # From a loop that is only uncertain, gains may be computed: ``Advice.is_sound`` tells whether they may be loaded.
    reasons_against_gains = () if contradiction is None else (contradiction,)
    return LoopDecision(
        margins.axis,
        LoopDiagnosis.UNKNOWN,
        reason=loop_fact.replace(action=action),
        action=action,
        reasons_against_gains=reasons_against_gains,
    )


def _decision_by_measurement(
    observations: LoopObservations, measurement_fact: Fact
) -> LoopDecision:
    """Returns the decision on an axis whose margins are below the goal by a measurement that needs no model.

    The action is to lower P, I and D of the rate loop by a third: that lowers its gain at all frequencies, and leaves
    its phase as it is. Even if an identified loop has good margins, no gains are computed from it, since the
    measurement contradicts it.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.
        measurement_fact: the fact about the measured margins, or about the measured resonance.

    Returns:
        The decision, with the diagnosis "below the goal".
    """
    return _decision_against_new_gains(
        observations.margins.axis,
        LoopDiagnosis.BELOW_GOAL,
        measurement_fact,
        action=_advice_to_lower_gains(observations, "rate"),
    )


def _decision_against_new_gains(
    axis: str, diagnosis: LoopDiagnosis, observation: Fact, action: Fact
) -> LoopDecision:
    """Returns a decision whose observation is also the reason why no gains are computed from the identified loop.

    Args:
        axis: "roll", "pitch" or "yaw".
        diagnosis: what is wrong.
        observation: the fact (a coded finding) that shows it.
        action: what to do about it.
    """
    reason = observation.replace(action=action)
    return LoopDecision(axis, diagnosis, reason, action, reasons_against_gains=(reason,))


def _decision_by_identified_loop(
    observations: LoopObservations, loop: Loop, loop_fact: Fact
) -> LoopDecision:
    """Returns the decision on an axis whose identified loop has margins below the goal.

    :func:`_decision_to_change_gains`, which also serves loops that respond too slowly, chooses one of three actions:

    - usually, load the gains that `mavdem tune` advises;
    - fly once more, if the flight does not show clearly enough that the gains should change;
    - if no gains may be computed from the loop, remove the cause. One cause is an identified loop that is too
      uncertain. Another is an angle that responded otherwise than the loop predicts, while its gain would change.

    Args:
        observations: margins of the axis, how well it follows its setpoint, and the repairs that the vehicle needs.
        loop: the identified loop, which no measured response contradicts.
        loop_fact: fact (a coded finding) on the stability margins of that loop.

    Returns:
        The decision, with the diagnosis "below the goal".
    """
    return _decision_to_change_gains(
        observations.margins,
        loop,
        LoopDiagnosis.BELOW_GOAL,
        loop_fact,
        action_to_tune=Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=observations.tune_arguments),
        is_too_slow=False,
    )


def _decision_to_change_gains(
    margins: AxisMargins,
    loop: Loop,
    diagnosis: LoopDiagnosis,
    observation: Fact,
    *,
    action_to_tune: Fact,
    is_too_slow: bool,
) -> LoopDecision:
    """Returns the decision on a loop whose gains should change: to tune it, or what to do before if that is too early.

    Args:
        margins: margins of the axis, and whether the measured response of the angle contradicts the predicted one.
        loop: rate and attitude loop of the axis, with the plant that was identified in flight.
        diagnosis: what is wrong.
        observation: the fact (a coded finding) that shows it.
        action_to_tune: the action if the gains may be changed after this flight: to run ``mavdem tune``.
        is_too_slow: whether the gains are raised although the loop has its margins, since it is too slow.
    """
    reasons_against_gains = reasons_for_no_gains(loop, for_higher_gains=is_too_slow)
    advice = None
    if reasons_against_gains:
        action = _action_to_remedy(reasons_against_gains[0])
    else:
        advice = _advice_if_basis_is_uncertain(
            loop, margins.attitude_contradiction, raises_sound_gains=is_too_slow
        )
        advice_to_fly_first = _advice_to_fly_first(advice)
        action = action_to_tune if advice_to_fly_first is None else advice_to_fly_first
    return LoopDecision(
        margins.axis,
        diagnosis,
        observation.replace(action=action),
        action,
        reasons_against_gains,
        is_too_slow=is_too_slow,
        advice=advice,
    )


def _advice_if_basis_is_uncertain(
    loop: Loop, attitude_doubt: Fact | None, *, raises_sound_gains: bool
) -> Advice | None:
    """Designs new gains, as `mavdem tune` does, unless the flight is certainly a sufficient basis for them.

    The design itself shows whether the flight is a basis for its gains, but it takes time. It is skipped if nearly all
    models that fit the flight have too little margin with the logged gains: then new gains are needed whatever the true
    model is, and the user is sent to `mavdem tune`, which designs them.

    Args:
        loop: rate and attitude loop of the axis, without reasons against new gains.
        attitude_doubt: the fact that the measured response of the angle differs from the predicted one, which forbids a
            new gain of the attitude controller; None if it does not differ.
        raises_sound_gains: whether the gains are raised although the loop has its margins.

    Returns:
        The advice on gains, which states whether the flight is a basis for them; None if the design was skipped.
    """
    loop_with_last_gains = loop_at_end_of_log(loop)
    # Fractions of the models that fit the flight.
    fraction_with_margins = loop_with_last_gains.share_meeting(MARGIN_TARGETS["default"])
    surely_lacks_margin = 1 - fraction_with_margins >= SURE_SHARE
    if surely_lacks_margin and attitude_doubt is None:
        return None
    return advise(
        loop_with_last_gains,
        attitude_doubt=attitude_doubt,
        raises_sound_gains=raises_sound_gains,
    )


def _advice_to_fly_first(advice: Advice | None) -> Fact | None:
    """Returns the advice to fly once more before gains are changed, if this flight does not show that they should be.

    Args:
        advice: the gains that `mavdem tune` advises. None if they were not computed, since the flight certainly shows
            that the gains should be changed (:func:`_advice_if_basis_is_uncertain`).

    Returns:
        The advice to fly first or, if the gains may not be changed, to do what the reason for that advises. None if
        neither is needed, or if no gain would change.
    """
    if advice is None:
        return None
    if advice.refusals:
        return _action_to_remedy(advice.refusals[0])
    changes_gains = bool(advice.parameters)
    # Whether the flight shows clearly enough that the gains should be changed.
    flight_is_sufficient = advice.is_sound
    if changes_gains and not flight_is_sufficient:
        return advice.flight_before_gains
    return None


def _decision_by_tracking(observations: LoopObservations) -> LoopDecision | None:
    """Returns the decision on an axis that follows its setpoint badly, although its margins are not below the goal.

    A loop with enough margin follows well. So the loop that was identified must be wrong, and no gains are computed
    from it. The exception is an axis whose body rate falls short of its setpoint: its loop may be right, but slow.

    Args:
        observations: margins of the axis, how well it follows its setpoint, and the repairs that the vehicle needs.

    Returns:
        The decision; None if the axis follows well, or if that is not known.
    """
    tracking = observations.tracking
    if not tracking.is_watch_or_bad:
        return None
    if tracking.code is TrackingLight.RATE_FALLS_SHORT:
        return _decision_on_slow_rate(observations)
    return _decision_against_new_gains(
        observations.margins.axis,
        LoopDiagnosis.FOLLOWS_BADLY,
        tracking,
        action=_action_by_tracking(observations),
    )


def _action_by_tracking(observations: LoopObservations) -> Fact:
    """Returns what to do about an axis whose angle follows its setpoint badly.

    - If the angle overshoots: lower the gains of the attitude loop.
    - If the angle amplifies its setpoint: fly doublets, which show the margins.
    - If a swing of the vehicle explains the error: the remedy of the swing.
    - If the error is large for another reason: check the vehicle.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.
    """
    tracking = observations.tracking
    if tracking.code is TrackingLight.OVERSHOOTS_SETPOINT:
        return _advice_to_lower_gains(observations, "attitude")
    if tracking.code is TrackingLight.AMPLIFIES_SETPOINT:
        return Fact(LoopAction.FLY_DOUBLETS, axis=observations.margins.axis, is_biased=False)
    swing = observations.attitude_swing
    if swing is not None and _swing_explains_error(swing, observations):
        return _action_to_remedy(swing)
    return Fact(
        LoopAction.CHECK_VEHICLE,
        # Both are None for a vehicle that flies by setpoints of the rate alone.
        angle_error=tracking.figures.get("angle_error"),
        offset_angle=tracking.figures.get("offset_angle"),
        axis=observations.margins.axis,
        # None if the axis did not turn fast enough to show whether motors limit it.
        at_limit_share=tracking.figures.get("at_limit_share"),
    )


def _swing_explains_error(swing: Fact, observations: LoopObservations) -> bool:
    """Returns whether an axis is far from its setpoint because the vehicle swung to and fro in an automatic mode.

    In a swing the position control leans the vehicle by tens of degrees to one side and the other, and roll or pitch
    may be far from its setpoint meanwhile. If it was, the swing explains the error. If not, it explains the error only
    of the axis that swung, and only if that error is not bad.

    Args:
        swing: the fact (coded finding) that roll or pitch swung.
        observations: margins and tracking of the axis.
    """
    # Only such a swing has this figure.
    was_far_from_setpoint = "angle_error" in swing.figures
    if was_far_from_setpoint:
        return True
    is_swing_of_axis = swing.subject == observations.margins.axis
    return is_swing_of_axis and not observations.tracking.is_bad


def _decision_on_slow_rate(observations: LoopObservations) -> LoopDecision:
    """Returns the decision on an axis whose body rate falls short of its setpoint in turns.

    The first of these cases that applies decides:

    1. A motor was at a limit in the turns, so no gain helps: fly slower turns.
    2. The loop is not identified: first do what identifies it.
    3. The rate loop is too slow (:func:`_decision_to_raise_gains`).

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.

    Returns:
        The decision, with the diagnosis that the axis follows badly.
    """
    axis = observations.margins.axis
    loop = observations.margins.loop
    tracking = observations.tracking
    # Fraction of the time in the turns that a motor was at a limit; None if the limits are not known.
    at_limit_share = tracking.figures["at_limit_share"]
    is_limited_by_motors = at_limit_share is not None and at_limit_share > MIN_AT_LIMIT_SHARE
    if isinstance(loop, Loop) and not is_limited_by_motors:
        return _decision_to_raise_gains(observations, loop)
    if is_limited_by_motors:
        action = Fact(LoopAction.SLOWER_TURNS, axis=axis)
    else:
        action = _action_to_remedy(_reason_for_no_margins(observations))
    # In both cases the slow rate itself is the reason against computing gains.
    return _decision_against_new_gains(axis, LoopDiagnosis.FOLLOWS_BADLY, tracking, action)


def _decision_to_raise_gains(observations: LoopObservations, loop: Loop) -> LoopDecision:
    """Returns the decision on an axis whose rate loop is too slow.

    The action is to raise its gains as far as the margins allow, as `mavdem tune` advises. If there are reasons against
    higher gains, the action is the remedy of the first one.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.
        loop: rate and attitude loop of the axis, with the plant that was identified in flight.

    Returns:
        The decision, with the diagnosis that the axis follows badly because it is too slow.
    """
    return _decision_to_change_gains(
        observations.margins,
        loop,
        LoopDiagnosis.FOLLOWS_BADLY,
        observations.tracking,
        action_to_tune=Fact(
            LoopAction.RAISE_AS_ADVISED,
            axis=observations.margins.axis,
            arguments=observations.tune_arguments,
        ),
        is_too_slow=True,
    )


def _decision_without_fault(observations: LoopObservations) -> LoopDecision:
    """Returns the decision on an axis with which nothing is known to be wrong.

    Nothing is wrong if the stability margins are known to be good: by an injected signal, by the loop that was
    identified in flight, or by the measured response to the setpoint. Otherwise it is not known.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.

    Returns:
        The decision, with the diagnosis "nothing wrong" or "unknown", and the reasons why no new gains may be computed.
    """
    margins = observations.margins
    good_facts = [fact for fact in margins.facts if fact.is_good]
    if not good_facts and margins.margins_by_slow_log is not None:
        return _decision_on_slow_log(margins, margins.margins_by_slow_log)
    if not good_facts:
        return _decision_without_margins(observations)
    # A fact (a coded finding) on the margins themselves comes before one on the measured response.
    best_fact = good_facts[0]
    reasons_against_gains: Facts = ()
    if best_fact.code is MarginsLight.LOOP_MEASURED:
        # The margins were measured with an injected signal. It moves the vehicle, so that no gains are computed from
        # such a flight.
        reasons_against_gains = (best_fact,)
    elif isinstance(margins.loop, Fact):
        # Without a loop that was identified there is no basis for gains; the fact in its place says why.
        reasons_against_gains = (margins.loop,)
    return LoopDecision(
        margins.axis,
        LoopDiagnosis.NOTHING_WRONG,
        best_fact,
        reasons_against_gains=reasons_against_gains,
    )


def _decision_on_slow_log(margins: AxisMargins, loop_fact: Fact) -> LoopDecision:
    """Returns the decision on an axis that seems to have its margins, but whose log is too slow to be sure of them.

    Args:
        margins: margins of the axis.
        loop_fact: the fact about the margins of the identified loop, of the level "unknown".

    Returns:
        The decision, with the diagnosis "unknown". Its action is to fly doublets with a faster log.
    """
    action = _advice_to_fly_doublets(margins, loop_fact)
    return LoopDecision(
        margins.axis, LoopDiagnosis.UNKNOWN, loop_fact.replace(action=action), action
    )


def _decision_without_margins(observations: LoopObservations) -> LoopDecision:
    """Returns the decision on an axis with which nothing is known to be wrong, but whose margins are not known either.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.

    Returns:
        The decision, with the diagnosis "unknown". Its action is what would show more, or None if nothing would:

        - If the spectrum of the body rate has a high peak, which little margin or vibration may cause: hover with lower
          gains. If the peak becomes lower, the margin was too little.
        - Otherwise the remedy of the reason why the margins are not known, such as to log the setpoint.
    """
    reason = _reason_for_no_margins(observations)
    action = None
    has_peak_of_unknown_cause = reason.code is MarginsLight.RATE_STANDS_OUT
    if has_peak_of_unknown_cause:
        action = _advice_to_find_cause_of_peak(observations, reason)
    elif reason.remedy:
        action = _action_to_remedy(reason)
    # A loop whose margins are not known to be good is not a basis for new gains.
    return LoopDecision(
        observations.margins.axis,
        LoopDiagnosis.UNKNOWN,
        reason,
        action,
        reasons_against_gains=(reason,),
    )


def _reason_for_no_margins(observations: LoopObservations) -> Fact:
    """Returns the fact that says why the margins of an axis are not known.

    The first of these that exists is returned: a fact about margins that leaves them uncertain, such as a peak in the
    spectrum of the rate; the reason why no loop was identified; or how the axis follows its setpoint.

    Args:
        observations: margins and tracking of the axis, and the repairs that the vehicle needs.
    """
    margins = observations.margins
    if margins.facts:
        # This fact is preferred to the reason why there is no loop, because its remedy depends on what was logged.
        return margins.facts[0]
    if isinstance(margins.loop, Fact):
        return margins.loop
    return observations.tracking


def _advice_to_fly_doublets(margins: AxisMargins, loop_fact: Fact) -> Fact:
    """Returns the advice to fly doublets, so that the next log shows the margins of an axis better.

    A doublet is a push of the stick to one side and at once to the other.

    Args:
        margins: margins of the axis; its loop is identified.
        loop_fact: the fact about the margins of the loop. Its figure ``is_biased`` is whether wind biases them, which
            the advice then gives as its reason; ``is_log_slow`` is whether the log is too slow for the loop, and the
            advice then states the ``least_rate`` of the next log, Hz.
    """
    least_rate = None
    if isinstance(margins.loop, Loop) and loop_fact.figures["is_log_slow"]:
        least_rate = margins.loop.least_log_rate
    return Fact(
        LoopAction.FLY_DOUBLETS,
        axis=margins.axis,
        is_biased=loop_fact.figures["is_biased"],
        least_rate=least_rate,
    )


def _advice_to_lower_gains(observations: LoopObservations, loop_name: str) -> Fact:
    """Returns the advice to lower the gains of one loop of an axis by a third.

    Args:
        observations: observations of the axis, with the parameters of the autopilot in the flight.
        loop_name: the loop: "rate", with the gains P, I and D, or "attitude", with the gain of the angle only.

    Returns:
        A fact (coded finding) with ``changes``: name, value and new value of each gain. They are empty if the gains are
        not known; its sentence then says "P, I and D" instead.
    """
    axis = observations.margins.axis
    parameters = observations.parameters
    names_of_axis = gain_names(parameters.any_values, axis)
    names: Names = ()
    if names_of_axis is not None and loop_name == "rate":
        names = names_of_axis.rate_gains
    elif names_of_axis is not None:
        names = (names_of_axis.angle_gain,)
    reduction = gains_to_lower(names, parameters)
    return Fact(LoopAction.LOWER_BY_A_THIRD, subject=loop_name, axis=axis, **reduction.figures)


def _advice_to_find_cause_of_peak(observations: LoopObservations, peak_fact: Fact) -> Fact:
    """Returns the advice to hover with lower gains, which shows whether the loop makes a peak in the rate's spectrum.

    A peak that comes from too little margin becomes lower, since a lower gain moves the loop away from its stability
    limit. A peak that comes from vibration or a test signal stays.

    Args:
        observations: observations of the axis, with the parameters of the autopilot.
        peak_fact: the fact about the peak; its remedy is what makes the loop known.

    Returns:
        A fact with the ``changes`` of the gains, and the fact about the peak as ``reason``.
    """
    reduction = _advice_to_lower_gains(observations, "rate")
    return Fact(LoopAction.HOVER_WITH_LOWER_GAINS, **reduction.figures, reason=peak_fact)


def common_action(actions: Sequence[Fact | None]) -> Fact | None:
    """Returns the one action that a status light advises for several axes: the action of the first that needs one.

    The other axes wait, since the flight after this action will show what they still need. There are two exceptions:

    - If the first action is to lower gains, for good or for one hover that shows the cause of a peak, the gains of all
      axes that need the same are lowered before the next flight. One action has the changes of all these axes.
    - Gains that one axis surely needs are not put off because another axis is to fly first.

    Args:
        actions: the action of each axis; None if nothing is to be done.

    Returns:
        The action; None if no axis needs one.
    """
    needed_actions = [action for action in actions if action is not None]
    if not needed_actions:
        return None
    first_action = needed_actions[0]
    if first_action.code is LoopAction.FLY_BEFORE_GAINS:
        for action in needed_actions:
            if action.code in ADVICE_TO_TUNE:
                return action
        return first_action
    if first_action.code in REDUCTIONS_OF_RATE_GAINS:
        return _joined_reductions(
            [action for action in needed_actions if action.code is first_action.code]
        )
    return first_action


def _joined_reductions(reductions: Sequence[Fact]) -> Fact:
    """Joins the advice to lower gains of roll and the advice to lower gains of pitch, say, to one piece of advice.

    Args:
        reductions: the advice for each axis, at least one. Its figures are the ``axis``, the ``changes`` of gains, each
            with name, present and lower value, and, if gains changed in flight, the facts about that as ``changed``.

    Returns:
        The advice with the changes of all axes, whose names are its figure ``names``. Advice for a single axis stays as
        it is.
    """
    first_reduction = reductions[0]
    if len(reductions) == 1:
        return first_reduction
    gain_changes = []
    facts_on_changed_gains: list[Fact] = []
    axes = []
    for reduction in reductions:
        gain_changes += reduction.figures["changes"]
        facts_on_changed_gains += reduction.figures.get("changed", ())
        axes.append(reduction.figures["axis"])
    joined_reduction = first_reduction.replace(changes=gain_changes, names=axes)
    if facts_on_changed_gains:
        return joined_reduction.replace(changed=facts_on_changed_gains)
    return joined_reduction


def advises_to_tune(next_step: Fact) -> bool:
    """Returns whether a next step is to run ``mavdem tune``, or to load the gains that it advises.

    Args:
        next_step: the fact that says what the pilot should do. Its figure ``reason`` may be a decision on the loops of
            an axis, whose figure ``action`` is then the advice.
    """
    reason = next_step.figures.get("reason")
    if not isinstance(reason, Fact):
        return False
    action = reason.figures.get("action")
    return isinstance(action, Fact) and action.code in ADVICE_TO_TUNE
