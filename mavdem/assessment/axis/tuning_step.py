"""The next step of a pilot after tuning: to load new gains, to mend a fault before, or to fly for a better log.

It is a fact (a coded finding) that replaces the next step of the *judgement* of the flight. A judgement also has a
*headline*, its most serious fact, and *status lights*, each the fact about one part of the vehicle, such as its motors.
"""

from collections.abc import Container, Iterable, Sequence
from dataclasses import replace

from mavdem.assessment.axis.loop_decision import (
    ADVICE_TO_TUNE,
    advises_to_tune,
    common_action,
)
from mavdem.assessment.axis.lowered_gains import lowered_gains, reductions_by_a_third
from mavdem.assessment.axis.parameter_sets import stage_to_load, waits_for_stage
from mavdem.assessment.faults_before_gains import faults_before_gains, faults_besides_loops
from mavdem.assessment.judgement import Judgement
from mavdem.containers import Names
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.loops import LoopAction
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import Advice, AdviceByAxis
from mavdem.loops.gain_design import SURE_SHARE


def judgement_with_tuning_step(
    judgement: Judgement,
    advice_by_axis: AdviceByAxis,
    arguments: Sequence[str],
    flight_for_gains: Fact | None,
    *,
    has_new_gains: bool,
    is_written: bool,
    must_be_repaired: bool,
) -> Judgement:
    """Returns the judgement of a vehicle with the next step that follows from the advice on its gains.

    The first of these that applies decides:

    1. New gains may be loaded, or another flight or other axes come before them (:func:`_step_with_new_gains`).
    2. Something must be repaired: the next step stays, for example to replace a propeller.
    3. Gains are lowered, kept or confirmed, or a flight is needed (:func:`_step_without_loading_gains`).
    4. Otherwise the next step stays.

    Args:
        judgement: judgement of the vehicle before tuning.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
        flight_for_gains: the flight from which gains of more axes could be computed; None if none is needed.
        has_new_gains: whether the advice changes any gain, or sets a notch filter.
        is_written: whether the gains will be written to a file.
        must_be_repaired: whether something about the vehicle must be mended before it is tuned.

    Returns:
        The judgement, with its headline and lights unchanged.
    """
    next_step = None
    if has_new_gains:
        next_step = _step_with_new_gains(
            judgement, advice_by_axis, arguments, flight_for_gains, is_written=is_written
        )
    if next_step is None and not must_be_repaired and not _asks_for_repair(judgement):
        next_step = _step_without_loading_gains(
            judgement, advice_by_axis, arguments, flight_for_gains, has_new_gains=has_new_gains
        )
    return judgement if next_step is None else replace(judgement, next_step=next_step)


def _step_with_new_gains(
    judgement: Judgement,
    advice_by_axis: AdviceByAxis,
    arguments: Sequence[str],
    flight_for_gains: Fact | None,
    *,
    is_written: bool,
) -> Fact | None:
    """Returns the next step of a vehicle for which there are new gains; None if a worse fault comes before them.

    Args:
        judgement: judgement of the vehicle before tuning.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
        flight_for_gains: the flight from which gains of more axes could be computed; None if none is needed.
        is_written: whether the gains will be written to a file.
    """
    advice_on_loops = [advice for advice in advice_by_axis.values() if isinstance(advice, Advice)]
    other_axes = _other_axes_to_tune(judgement, advice_by_axis)
    if _must_tune_other_axes_first(judgement, advice_on_loops, other_axes):
        return _step_to_tune_other_axes_first(judgement, advice_by_axis, other_axes, arguments)
    headline = judgement.headline
    if not _allows_new_gains(headline) and not _has_gains_for_uncertain_margin(
        headline, advice_by_axis
    ):
        return None
    changed_loops = _advice_on_changed_loops(advice_on_loops)
    if any(advice.is_sound for advice in changed_loops):
        # This step also names gains that must be lowered on an axis for which the flight is no basis.
        return _step_to_load_gains(
            judgement, changed_loops, other_axes, arguments, is_written=is_written
        )
    # The flight is no basis for the new gains of any axis, so another flight must confirm them. Gains that are too
    # high are lowered before it: nobody flies a resonance for longer to learn more of it.
    return _step_to_lower_gains(judgement, advice_by_axis) or _step_to_fly_before_gains(
        judgement, changed_loops, flight_for_gains
    )


def _step_without_loading_gains(
    judgement: Judgement,
    advice_by_axis: AdviceByAxis,
    arguments: Sequence[str],
    flight_for_gains: Fact | None,
    *,
    has_new_gains: bool,
) -> Fact | None:
    """Returns the next step of a vehicle that needs no repair, but loads no new gains; None if its step stays.

    Args:
        judgement: judgement of the vehicle before tuning.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
        flight_for_gains: the flight from which gains of more axes could be computed; None if none is needed.
        has_new_gains: whether there are new gains, which the headline of the flight does not allow to load.
    """
    # Axes that lack stability margin by a measurement are made safe first.
    step_to_lower_gains = _step_to_lower_gains(judgement, advice_by_axis)
    if step_to_lower_gains is not None:
        return step_to_lower_gains
    advice_on_loops = [advice for advice in advice_by_axis.values() if isinstance(advice, Advice)]
    if not has_new_gains and _is_uncertain_margin(judgement.headline):
        return _step_to_keep_or_confirm_gains(judgement, advice_on_loops, arguments)
    if not has_new_gains and advises_to_tune(judgement.next_step):
        # This run has computed the gains, so that the advice to tune would lead back to it.
        other_axes = _other_axes_to_tune(judgement, advice_by_axis)
        return _next_step_without_new_gains(advice_by_axis, other_axes, arguments, flight_for_gains)
    if flight_for_gains is not None and _is_flight_with_doublets(judgement.next_step):
        # It is the same flight, but names all axes whose gains it makes known.
        return flight_for_gains
    has_known_gains = any(advice.gains for advice in advice_on_loops)
    if not has_known_gains and _leads_to_tuning(judgement.headline):
        return flight_for_gains or _next_step_towards_gains(judgement, advice_by_axis)
    return None


def _other_axes_to_tune(judgement: Judgement, requested_axes: Container[str]) -> list[str]:
    """Returns the axes that should be tuned by the decisions on their loops, but were not requested.

    Args:
        judgement: judgement of the vehicle before tuning, with the decision on the loops of each axis.
        requested_axes: axes that the user requested.
    """
    axes = []
    for axis, decision in judgement.loop_decisions.items():
        is_to_be_tuned = decision.action is not None and decision.action.code in ADVICE_TO_TUNE
        if is_to_be_tuned and axis not in requested_axes:
            axes.append(axis)
    return axes


def _asks_for_repair(judgement: Judgement) -> bool:
    """Returns whether the most serious fact of a flight asks for a repair or a setting on the ground.

    A weak motor does. A fault of the control loops does not, since gains are its remedy. Nor does a fault that only
    another flight can clear up.

    Args:
        judgement: judgement of the flight, whose headline is its most serious fact.
    """
    headline = judgement.headline
    if headline not in faults_besides_loops(judgement.headline, judgement.lights):
        return False
    # A remedy that is left without the advice to fly is work on the ground.
    remedy_on_ground = headline.without_flight_advice.remedy
    return bool(remedy_on_ground)


def _step_to_lower_gains(judgement: Judgement, axes: Iterable[str]) -> Fact | None:
    """Returns the advice to lower gains before the next flight; None if no gains must be lowered.

    Args:
        judgement: judgement of the flight. Its next step is returned if it lowers gains. Otherwise the decisions on the
            loops may lower gains of axes that lack stability margin.
        axes: the requested axes.
    """
    if lowered_gains(judgement.next_step):
        return judgement.next_step
    decisions = judgement.loop_decisions
    reductions = reductions_by_a_third(decisions[axis] for axis in axes if axis in decisions)
    action = common_action(reductions)
    if action is None:
        return None
    return Fact(NextStep.DO_AS_ADVISED, judgement.headline.level, reason=action)


def _is_flight_with_doublets(next_step: Fact) -> bool:
    """Returns whether the next step after a flight is to fly doublets, from which the loops can be identified.

    Args:
        next_step: the next step, a fact (coded finding). It advises doublets by its figure ``reason``, or by the action
            of that reason.
    """
    reason = next_step.figures.get("reason")
    if next_step.code is not NextStep.DO_AS_ADVISED or not isinstance(reason, Fact):
        return False
    action = reason.figures.get("action") or reason
    return isinstance(action, Fact) and action.code is LoopAction.FLY_DOUBLETS


def _must_tune_other_axes_first(
    judgement: Judgement, advice_on_loops: Sequence[Advice], other_axes: Sequence[str]
) -> bool:
    """Returns whether axes that the user did not request must be tuned before those that he requested.

    For example, the user asks to tune roll. Roll has its stability margins, and pitch lacks them. Then pitch comes
    first: it is not safe yet, and new gains of roll, which only make it faster, can wait.

    Args:
        judgement: judgement of the flight, with the decision on the loops of each axis and the reason for it.
        advice_on_loops: advice on the loops of the requested axes.
        other_axes: axes that were not requested, but whose gains should change.
    """
    other_axis_lacks_margin = any(
        judgement.loop_decisions[axis].reason.code is MarginsLight.LOOP_MARGINS
        for axis in other_axes
    )
    # The rating is bad if the axis lacks the required margins with its present gains.
    new_gains_restore_margins = any(
        advice.parameters and advice.rating.is_bad for advice in advice_on_loops
    )
    return other_axis_lacks_margin and not new_gains_restore_margins


def _step_to_tune_other_axes_first(
    judgement: Judgement,
    requested_axes: Iterable[str],
    other_axes: Iterable[str],
    arguments: Sequence[str],
) -> Fact:
    """Returns the advice to tune other axes, which lack stability margin, before the axes that the user requested.

    Args:
        judgement: judgement of the flight, with its headline.
        requested_axes: the axes of this run of ``mavdem tune``.
        other_axes: the axes that come first.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.

    Returns:
        The fact (coded finding) ``TUNE_OTHER_AXES`` with the arguments of a run that tunes the other axes. They lack
        "--more", which would also raise the gains of axes with enough margin.
    """
    return Fact(
        NextStep.TUNE_OTHER_AXES,
        judgement.headline.level,
        names=tuple(requested_axes),
        others=tuple(other_axes),
        arguments=tuple(argument for argument in arguments if argument != "--more"),
        are_first=True,
    )


def _allows_new_gains(headline: Fact) -> bool:
    """Returns whether the most serious fact of a flight (its headline) permits new gains as the next step.

    A weak motor does not: it must be replaced before. The rules are:

    - A headline about the control loops allows new gains if the action that it advises is to change gains, to lower
      them, or to fly once more before they are loaded.
    - A headline about anything else allows them unless it is bad.

    Args:
        headline: the most serious fact of the flight; if it is about loops, its figure ``action`` is the advised
            action.
    """
    action = headline.figures.get("action")
    if action is not None:
        return action.code in (
            *ADVICE_TO_TUNE,
            LoopAction.FLY_BEFORE_GAINS,
            LoopAction.LOWER_BY_A_THIRD,
        )
    return not headline.is_bad


def _is_uncertain_margin(headline: Fact) -> bool:
    """Returns whether the worst finding of a flight is that an axis probably, but not certainly, has its margins.

    The margins are computed with many models of the vehicle that fit the flight. If 80 % of the models have the
    required margins, for example, the axis probably has them. It is False if a measured response contradicts the
    models, or if wind biases them: then nothing is known of the margins.

    Args:
        headline: the worst finding of the flight.
    """
    if headline.code is not MarginsLight.LOOP_MARGINS or headline.figures["reason"] is not None:
        return False
    return headline.figures["rating"] is Level.WATCH and not headline.figures["is_biased"]


def _has_gains_for_uncertain_margin(headline: Fact, advice_by_axis: AdviceByAxis) -> bool:
    """Returns whether the headline of a flight is an uncertain margin, and there are new gains to load for that axis.

    For example, roll has its required margins in 80 % of the models of the vehicle, and in 95 % with the new gains. An
    uncertain margin is usually no reason for new gains, but the user may ask for them by ``mavdem tune --more``.

    Args:
        headline: the most serious fact of the flight.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known.
    """
    if not _is_uncertain_margin(headline):
        return False
    advice = advice_by_axis.get(headline.figures["axis"])
    if not isinstance(advice, Advice):
        return False
    has_new_gains = bool(advice.parameters)
    # Gains for which this flight is no sound basis wait for another flight.
    return has_new_gains and advice.is_sound


def _step_to_keep_or_confirm_gains(
    judgement: Judgement, advice_on_loops: Sequence[Advice], arguments: Sequence[str]
) -> Fact:
    """Returns the next step if the margins probably reach their goal: to keep the gains, or to make sure of them.

    Args:
        judgement: judgement of the flight, whose headline is that the margins of an axis are uncertain.
        advice_on_loops: advice on the loops of the requested axes, which changes no gains.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.

    Returns:
        The fact (coded finding) ``KEEP_OR_CONFIRM_GAINS`` with these figures, among others:

        - ``names``: the axes whose margins are uncertain;
        - ``can_go_on``: whether ``mavdem tune --more`` can compute other gains for all of them;
        - ``least_rate``: rate of messages, Hz, that their loops need, if this log is slower; otherwise None;
        - ``is_steering_slow``: whether the setpoints of one of them end below its crossover.
    """
    uncertain_axes = []
    slowly_steered_axes = []
    conclusions_on_few_models = []
    needed_log_rates = []
    for advice in advice_on_loops:
        is_log_slow = advice.rating.figures["is_log_slow"]
        reaches_goal_in_few_models = advice.sure < SURE_SHARE
        if reaches_goal_in_few_models:
            conclusions_on_few_models.append(advice.conclusion)
        if reaches_goal_in_few_models or is_log_slow:
            uncertain_axes.append(advice.before.axis)
            if advice.before.is_steered_slowly:
                slowly_steered_axes.append(advice.before.axis)
        if is_log_slow and advice.before.least_log_rate is not None:
            needed_log_rates.append(advice.before.least_log_rate)
    # Other gains reach the goal in more models, but do not make a slow log faster.
    is_slow_log_only_cause = bool(uncertain_axes) and not conclusions_on_few_models
    # The conclusion that an axis gets no gains does not have the figure.
    can_compute_other_gains = all(
        conclusion.figures.get("can_go_on", False) for conclusion in conclusions_on_few_models
    )
    return Fact(
        NextStep.KEEP_OR_CONFIRM_GAINS,
        judgement.headline.level,
        names=tuple(uncertain_axes) or (judgement.headline.figures["axis"],),
        can_go_on=can_compute_other_gains and not is_slow_log_only_cause,
        needed=SURE_SHARE,
        least_rate=max(needed_log_rates, default=None),
        is_steering_slow=bool(slowly_steered_axes),
        arguments=tuple(arguments),
    )


def _leads_to_tuning(headline: Fact) -> bool:
    """Returns whether a pilot may work towards new gains next, after a flight that gave none.

    Args:
        headline: the most serious fact of the flight. It must permit new gains, or advise to fly doublets (quick stick
            movements), from which gains can be computed.
    """
    action = headline.figures.get("action")
    flies_doublets = action is not None and action.code is LoopAction.FLY_DOUBLETS
    return flies_doublets or _allows_new_gains(headline)


def _advice_on_changed_loops(advice_on_loops: Sequence[Advice]) -> list[Advice]:
    """Selects the advice on those axes whose control loops behave differently once the new parameters are set.

    These are the axes whose gains change. If none do, the new parameters are those of a notch filter alone, which
    delays the gyro's signal on every axis: then all axes with known gains are selected.

    Args:
        advice_on_loops: advice on the loops of all axes.
    """
    changed_loops = [advice for advice in advice_on_loops if advice.parameters]
    return changed_loops or [advice for advice in advice_on_loops if advice.gains]


def _step_to_fly_before_gains(
    judgement: Judgement, changed_loops: Sequence[Advice], flight_for_gains: Fact | None
) -> Fact:
    """Returns the next step "fly once more", since this flight does not show clearly enough that gains should change.

    Args:
        judgement: the flight's most serious finding (headline), and what was found about its motors, power and so on.
        changed_loops: for each axis whose gains should change, the advice with the new gains.
        flight_for_gains: the next step for the axes on which this flight allows no advice on gains, which is to fly
            doublets about them; None if there are no such axes.

    Returns:
        The fact (coded finding) ``FLY_BEFORE_GAINS``. Its ``reason`` says which flight is needed, and names all these
        axes; ``also`` is what is to be mended before.
    """
    # One flight serves all axes. The advice with the strongest case for new gains describes it.
    advice_with_strongest_case = max(changed_loops, key=_certainty_of_change)
    axes: Names = tuple(advice.before.axis for advice in changed_loops)
    if flight_for_gains is not None:
        axes += flight_for_gains.figures["axes"]
    needed_flight = advice_with_strongest_case.flight_before_gains.replace(names=axes)
    return Fact(
        NextStep.FLY_BEFORE_GAINS,
        judgement.headline.level,
        reason=needed_flight,
        also=faults_before_gains(judgement.headline, judgement.lights),
    )


def _certainty_of_change(advice: Advice) -> float:
    """Returns the fraction, 0 to 1, of the posterior models of a vehicle that speak for new gains on one axis.

    A model speaks for them if it has its stability margins with the new gains, or if it lacks them with the present
    ones. The larger of both fractions counts.
    """
    return max(advice.sure, advice.fraction_without_margins_before)


def _step_to_load_gains(
    judgement: Judgement,
    changed_loops: Sequence[Advice],
    other_axes: Sequence[str],
    arguments: Sequence[str],
    *,
    is_written: bool,
) -> Fact:
    """Returns the next step to load those new gains for which the flight is a basis, and which need no earlier stage.

    Args:
        judgement: headline, next step and status lights of the flight, and decisions on its loops.
        changed_loops: advice on the loops that change. The flight is a basis for the new gains of one at least.
        other_axes: axes that were not requested, but whose gains should change too.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
        is_written: whether the gains are written to a file.

    Returns:
        The fact (coded finding) ``LOAD_GAINS`` with these figures, among others:

        - ``share``: the fraction of the models that fit the flight with which the gains to load have the required
          margins with 20 % more or less thrust, too, the lowest of all loops, and ``share_as_flown`` with the thrust of
          this flight;
        - ``flights``: the number of flights, each with a bounded change of the gains, until the design of this stage;
        - ``also``: what is to be mended before the gains are loaded;
        - ``needed``: the fraction from which on the gains count as certain;
        - ``is_biased``: whether wind biased the control effectiveness of a loop;
        - ``fit``: the fit of a measured response that barely confirms a loop, 0 to 1, the lowest; None without one;
        - ``missing``: the status lights that should be known before;
        - ``names``: the axes whose gains are loaded, if not those of all axes with new gains are;
        - ``waiting``: the axes whose gains are of a later stage.
    """
    first_stage = stage_to_load(changed_loops)
    # Gains of a later stage, and those that another flight is to confirm, are not loaded now.
    loops_to_load = []
    waiting_axes = []
    for advice in changed_loops:
        if waits_for_stage(advice, first_stage):
            waiting_axes.append(advice.before.axis)
        elif advice.is_sound:
            loops_to_load.append(advice)
    weak_confirmations = [advice.weak_confirmation for advice in loops_to_load]
    axes_to_load: Names = ()
    if len(loops_to_load) < len(changed_loops):
        axes_to_load = tuple(advice.before.axis for advice in loops_to_load)
        reductions = reductions_by_a_third(judgement.loop_decisions.values())
        axes_to_load += tuple(reduction.figures["axis"] for reduction in reductions)
    return Fact(
        NextStep.LOAD_GAINS,
        judgement.headline.level,
        is_written=is_written,
        share=min(advice.sure for advice in loops_to_load),
        share_as_flown=min(advice.after.share_meeting(advice.target) for advice in loops_to_load),
        flights=max(advice.flights for advice in loops_to_load),
        also=faults_before_gains(judgement.headline, judgement.lights),
        needed=SURE_SHARE,
        is_biased=any(advice.before.has_biased_effectiveness for advice in loops_to_load),
        fit=min(
            (fact.figures["share"] for fact in weak_confirmations if fact is not None), default=None
        ),
        missing=_unknown_lights_for_higher_gains(judgement, loops_to_load),
        names=axes_to_load,
        waiting=tuple(waiting_axes),
        others=tuple(other_axes),
        arguments=tuple(arguments),
    )


def _unknown_lights_for_higher_gains(
    judgement: Judgement, changed_loops: Sequence[Advice]
) -> tuple[str, ...]:
    """Returns which of the status lights of motors and vibration are unknown, if any gain is to be raised.

    Higher gains strain the motors and amplify vibration, so that both should be known before.

    Args:
        judgement: headline, next step and status lights of the flight, and decisions on its loops.
        changed_loops: advice on the axes whose gains change.

    Returns:
        The names of these lights; empty if no gain is raised.
    """
    raises_gain = False
    for advice in changed_loops:
        for gain in advice.gains.values():
            if gain.set > gain.now:
                raises_gain = True
    if not raises_gain:
        return ()
    unknown_lights = []
    for name in (Light.MOTORS, Light.VIBRATION):
        light = judgement.lights.get(name)
        if light is not None and light.level is Level.UNKNOWN:
            unknown_lights.append(str(name))
    return tuple(unknown_lights)


def _next_step_without_new_gains(
    advice_by_axis: AdviceByAxis,
    other_axes: Sequence[str],
    arguments: Sequence[str],
    flight_for_gains: Fact | None,
) -> Fact:
    """Returns the next step for the pilot if the advice changes no gains of the requested axes.

    1. If gains of other axes should change, the next step is to tune these.
    2. Otherwise it is the flight from which gains follow, if one is needed.
    3. Otherwise it is the remedy of the first axis that has one.
    4. Without a remedy it is the conclusion on the first axis, such as to keep its gains.

    Args:
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known. None
            has new gains.
        other_axes: axes that were not requested, but whose gains should change.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
        flight_for_gains: the flight from which gains of more axes could be computed; None if none is needed.
    """
    if other_axes:
        return Fact(
            NextStep.TUNE_OTHER_AXES,
            names=tuple(advice_by_axis),
            others=tuple(other_axes),
            arguments=tuple(arguments),
        )
    if flight_for_gains is not None:
        return flight_for_gains
    conclusions = [_conclusion(advice) for advice in advice_by_axis.values()]
    for conclusion in conclusions:
        if conclusion.remedy:
            return Fact(NextStep.DO_AS_ADVISED, reason=conclusion)
    return Fact(NextStep.DO_AS_ADVISED, reason=conclusions[0])


def _next_step_towards_gains(judgement: Judgement, advice_by_axis: AdviceByAxis) -> Fact:
    """Returns the next step if no gains can be advised, and no flight leads to them: the remedy of the first axis.

    Args:
        judgement: judgement of the flight, whose next step stays if no axis has a remedy.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known. None
            advises gains.
    """
    for advice in advice_by_axis.values():
        conclusion = _conclusion(advice)
        if conclusion.remedy:
            return Fact(NextStep.DO_AS_ADVISED, reason=conclusion)
    return judgement.next_step


def _conclusion(advice: Advice | Fact) -> Fact:
    """Returns the fact that sums up the advice on an axis: what to do with its gains or, without a loop, why not.

    Args:
        advice: the advice, or the fact (coded finding) that says why the loop is not known.
    """
    return advice if isinstance(advice, Fact) else advice.conclusion
