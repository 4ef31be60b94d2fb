"""What to do about each axis besides loading gains, such as to set a parameter, each remedy stated once."""

from collections.abc import Iterable
from itertools import chain

from mavdem.assessment.axis.flight_for_gains import is_removed_by_flight
from mavdem.assessment.axis.loop_decision import ADVICE_TO_TUNE
from mavdem.assessment.axis.tuning import Tuning
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import LoopAction, StepResponseFact
from mavdem.loops.advice import Advice
from mavdem.report.tuning.advice import conclusion_for_report, conclusion_on_gains
from mavdem.report.tuning.outcomes import OUTCOMES_WITHOUT_GAINS, gain_outcome
from mavdem.report.tuning.repairs import next_step_has_priority
from mavdem.report.tuning.result import faults_of_flight

STEPS_WITH_DOUBLETS = (
    NextStep.LOAD_GAINS,
    NextStep.KEEP_OR_CONFIRM_GAINS,
    NextStep.FLY_BEFORE_GAINS,
    NextStep.FLY_FOR_GAINS,
)
"""Next steps of a tuning that name a flight with doublets themselves."""


def ground_steps_by_axis(tuning: Tuning) -> dict[str, list[str]]:
    """Returns for each axis what to do on the ground so that the next log gives its gains, such as to set a parameter.

    Args:
        tuning: advice on the gains of each axis, and the judgement of the flight with the next step.

    Returns:
        Sentences by axis, without what the next step states. An axis that gets gains from this log, or for which there
        is nothing to do, is left out.
    """
    steps_by_axis = {}
    for axis in tuning.axes:
        gets_gains = gain_outcome(tuning, axis) not in OUTCOMES_WITHOUT_GAINS
        if gets_gains or _is_advised_flight_useless(tuning, axis):
            continue
        steps = _remedies_besides_next_step(tuning, _remedies_besides_flight(tuning, axis))
        if steps:
            steps_by_axis[axis] = steps
    return steps_by_axis


def _is_advised_flight_useless(tuning: Tuning, axis: str) -> bool:
    """Returns whether another flight is all that is advised for an axis, and cannot lead to its gains.

    No flight can if the log does not describe the controller, for example because it lacks parameters.

    Args:
        tuning: advice on the gains of each axis, and the axes whose controllers are not known (``controller_faults``).
        axis: "roll", "pitch" or "yaw".
    """
    is_controller_unknown = axis in tuning.controller_faults
    return is_controller_unknown and conclusion_on_gains(tuning.axes[axis]).advises_only_flight


def _remedies_besides_next_step(tuning: Tuning, remedies: Iterable[str]) -> list[str]:
    """Returns remedies, each once, without empty ones and those that the next step contains.

    Args:
        tuning: the judgement of the flight with its next step, such as "Fix motor 2. Then lower ATC_RAT_RLL_P.".
        remedies: what to do, one or several sentences each, such as "Lower ATC_RAT_RLL_P.".
    """
    next_step = tuning.judgement.next_step.sentence.lower()
    new_remedies = []
    for remedy in dict.fromkeys(remedies):
        # A sentence becomes a clause after "Then".
        if remedy and remedy.removesuffix(".").lower() not in next_step:
            new_remedies.append(remedy)
    return new_remedies


def _remedies_besides_flight(tuning: Tuning, axis: str) -> list[str]:
    """Returns what to do about one axis, such as a parameter to set, without the flight that would give its gains.

    That flight (``Tuning.flight_for_gains``) serves several axes and is stated once.

    Args:
        tuning: for each axis the advice on its gains, or the finding that says why there is none.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The remedies towards gains, and against another fault of the loops; one or several sentences each, maybe empty.
    """
    conclusion = conclusion_on_gains(tuning.axes[axis])
    if not next_step_has_priority(tuning, conclusion):
        return [*_remedies_towards_gains(tuning, axis), *remedies_besides_tuning(tuning, axis)]
    remedies = remedies_besides_tuning(tuning, axis)
    # After a repair another flight gives the gains if the log then describes the controller.
    controller_fault = tuning.controller_faults.get(axis)
    if controller_fault is not None and controller_fault.remedy:
        remedies.append(controller_fault.sentence_and_remedy)
    return remedies


def _remedies_towards_gains(tuning: Tuning, axis: str) -> list[str]:
    """Returns what leads to gains of an axis, such as to load new ones, or to set a parameter before the next flight.

    Args:
        tuning: for each axis the advice on its gains, or the finding that says why there is none.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The remedies; empty if a flight with doublets or the remedies of the flight's faults, stated above, are all.
    """
    conclusion = conclusion_on_gains(tuning.axes[axis])
    if axis in tuning.axes_to_fly_for_gains:
        # An axis that keeps its gains has no reasons against other ones.
        reasons = conclusion.figures.get("reasons", ())
        return [reason.remedy for reason in reasons if not is_removed_by_flight(reason)]
    advice = tuning.axes[axis]
    if isinstance(advice, Advice):
        return [remedy_of_gains(tuning, advice)]
    remedies_of_flight = [fault.remedy for fault in faults_of_flight(tuning)]
    reasons = conclusion.figures.get("reasons", (conclusion,))
    return [reason.remedy for reason in reasons if reason.remedy not in remedies_of_flight]


def remedy_of_gains(tuning: Tuning, advice: Advice) -> str:
    """Returns what to do with the gains of an axis, such as "Load them, and hover."; empty if the next step says so.

    Args:
        tuning: advice on the gains of all axes, and the next step.
        advice: advice on the gains of the axis.
    """
    next_step = tuning.judgement.next_step.code
    are_loaded_now = advice.parameters and advice.is_sound and not tuning.waits(advice)
    if next_step is NextStep.KEEP_OR_CONFIRM_GAINS:
        return ""
    if are_loaded_now and next_step in (NextStep.LOAD_GAINS, NextStep.TUNE_OTHER_AXES):
        return ""
    return conclusion_for_report(tuning, advice).remedy


def remedies_besides_tuning(tuning: Tuning, axis: str) -> list[str]:
    """Returns what to do about the control loops of an axis besides changing gains, such as to set a parameter.

    Args:
        tuning: for each axis the advice on its gains, or the fact that its loop is not known; and the decision on its
            loops, whose action is the remedy.
        axis: "roll", "pitch" or "yaw".

    Returns:
        A list with one sentence; empty if there is nothing else to do, or if the report says it in another place.
    """
    decision = tuning.judgement.loop_decisions.get(axis)
    if decision is None or decision.action is None:
        return []
    action = decision.action
    if action.code in (*ADVICE_TO_TUNE, LoopAction.FLY_BEFORE_GAINS):
        # The remedy is about the gains, which the report's conclusion on the axis states.
        return []
    if tuning.lowers_gains_of(axis) or tuning.lowers_gains_on_trial(axis):
        # The table of gains to load has the lower ones.
        return []
    if isinstance(tuning.axes[axis], Fact) and decision.reason.is_watch_or_bad:
        # The sentence on an axis whose loop is not known states the fault of the loop with its remedy.
        return []
    if is_removed_by_flight(action) and _is_flight_advised(tuning, axis):
        # The report advises the flight already that would make the remedy needless.
        return []
    if next_step_has_priority(tuning, action):
        # Both are repairs before any flight, of which the report states the more urgent one alone.
        return []
    return [action.sentence_and_remedy]


def _is_flight_advised(tuning: Tuning, axis: str) -> bool:
    """Returns whether the summary or the report of a tuning advises a flight with doublets that serves an axis.

    Args:
        tuning: the next step, the flight for gains, and the advice on each axis or the fact that its loop is not known.
        axis: "roll", "pitch" or "yaw".
    """
    return (
        axis in tuning.axes_to_fly_for_gains
        or tuning.judgement.next_step.code in STEPS_WITH_DOUBLETS
        or conclusion_on_gains(tuning.axes[axis]).advises_only_flight
    )


def remedies_to_show(tuning: Tuning, axis: str) -> list[str]:
    """Returns what the report says to do about one axis, such as "Set LOG_BITMASK to 65535.".

    Args:
        tuning: for each axis the advice on its gains, or the finding that says why there is none.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The remedies, which may be several sentences each; without those that the summary above the report states.
    """
    remedies = _remedies_besides_flight(tuning, axis)
    if axis in tuning.axes_to_fly_for_gains:
        remedies += _remedies_until_flight(tuning.axes[axis])
    return remedies_besides_summary(tuning, remedies)


def remedies_besides_summary(tuning: Tuning, remedies: Iterable[str]) -> list[str]:
    """Returns remedies without those in the summary of a tuning: in its next step, and in its steps towards gains.

    Args:
        tuning: for each axis the advice on its gains, and the judgement with the next step.
        remedies: what to do, one or several sentences each.
    """
    steps_in_summary = [*chain.from_iterable(ground_steps_by_axis(tuning).values())]
    new_remedies = _remedies_besides_next_step(tuning, remedies)
    return [remedy for remedy in new_remedies if remedy not in steps_in_summary]


def _remedies_until_flight(advice: Advice | Fact) -> list[str]:
    """Returns which measurement to trust until the next flight, if the response that a loop predicts is doubtful.

    Args:
        advice: the advice on the axis, or the fact (coded finding) that says why its loop is not known.

    Returns:
        The remedies against the doubt, without the advice to fly anew; empty if there is no such doubt.
    """
    if isinstance(advice, Fact):
        return []
    remedies = []
    for reason in advice.refusals:
        if reason.code is StepResponseFact.PREDICTION_DOUBTED:
            remedies.append(reason.replace(is_flight_stated=True).remedy)
    return remedies
