"""What to do about each axis besides loading gains, such as to set a parameter, each remedy stated once."""

from collections.abc import Collection, Iterable

from mavdem.assessment.axis.flight_for_gains import is_removed_by_flight
from mavdem.assessment.axis.loop_decision import ADVICE_TO_TUNE, REDUCTIONS_OF_RATE_GAINS
from mavdem.assessment.axis.tuning import Tuning
from mavdem.containers import Names
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
        steps = _remedies_not_stated_yet(tuning, _remedies_besides_flight(tuning, axis))
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


def _remedies_not_stated_yet(tuning: Tuning, remedies: Iterable[str]) -> list[str]:
    """Returns remedies without those that the next step or the report's sentence on the flight already states.

    Args:
        tuning: the judgement of the flight, with its next step and with faults that are not about loops.
        remedies: what to do, one or several sentences each.

    Returns:
        The remedies, each once; one that is part of another one is left out.
    """
    stated_texts = texts_in_next_step(tuning)
    next_step = str(tuning.judgement.next_step).lower()
    remedies_of_flight = [fault.remedy for fault in faults_of_flight(tuning)]
    new_remedies = []
    for remedy in _without_contained_texts([*dict.fromkeys(remedies)]):
        is_in_next_step = remedy.removesuffix(".").lower() in next_step
        if is_in_next_step or remedy in stated_texts:
            continue
        new_part = without_repetition(remedy, remedies_of_flight)
        if new_part:
            new_remedies.append(new_part)
    return new_remedies


def _remedies_besides_flight(tuning: Tuning, axis: str) -> list[str]:
    """Returns what to do about one axis, such as a parameter to set, without the flight that would give its gains.

    That flight (``Tuning.flight_for_gains``) serves several axes and is stated once. There may be remedies of two
    kinds: towards gains, and against another fault of the loops. If the vehicle must be repaired first, what leads to
    gains is only to complete the parameters of the controller, so that a later flight gives them.

    Args:
        tuning: for each axis the advice on its gains, or the finding that says why there is none.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The remedies, one or several sentences each; some may be empty.
    """
    advice = tuning.axes[axis]
    advice_on_gains = advice if isinstance(advice, Fact) else conclusion_for_report(tuning, advice)
    remedies = remedies_besides_tuning(tuning, axis)
    if next_step_has_priority(tuning, advice_on_gains):
        controller_fault = tuning.controller_faults.get(axis)
        if controller_fault is not None and controller_fault.remedy:
            remedies.append(controller_fault.sentence_and_remedy)
        return remedies
    if axis not in tuning.axes_to_fly_for_gains:
        return [advice_on_gains.remedy, *remedies]
    # An axis that keeps its gains has no reasons against other ones.
    reasons = advice_on_gains.figures.get("reasons", ())
    other_reasons = [reason for reason in reasons if not is_removed_by_flight(reason)]
    remedies_towards_gains = [reason.remedy for reason in other_reasons]
    return [*remedies_towards_gains, *remedies]


def without_repetition(text: str, texts_beside: Iterable[str]) -> str:
    """Returns a text without the sentences that the reader finds beside it, such as "Fly doublets."; it may be empty.

    Args:
        text: one or several sentences.
        texts_beside: the sentences beside it. Each of them is removed where the text contains it as a whole.
    """
    for text_beside in texts_beside:
        text = text.replace(text_beside, "")
    return " ".join(text.split())


def remedies_besides_tuning(tuning: Tuning, axis: str) -> list[str]:
    """Returns what to do about the control loops of an axis besides changing gains, such as to fly doublets.

    The report of ``mavdem tune`` has its advice on gains in other sentences, and need not advise to run this command.

    Args:
        tuning: the advice on each axis, or the fact that its loop is not known; and the decision on its loops.
        axis: "roll", "pitch" or "yaw".

    Returns:
        A list with one sentence; empty if there is nothing else to do, or if the report says it in another place.
    """
    decision = tuning.judgement.loop_decisions.get(axis)
    if decision is None or decision.action is None:
        return []
    if decision.action.code in (*ADVICE_TO_TUNE, LoopAction.FLY_BEFORE_GAINS):
        return []
    is_loop_unknown = isinstance(tuning.axes[axis], Fact)
    if is_loop_unknown and decision.reason.is_watch_or_bad:
        # The remedy of a fault, such as that the axis swings, does not make the loop known. So it does not stand with
        # what leads to new gains, but in a sentence on the fault.
        return []
    conclusion = conclusion_on_gains(tuning.axes[axis])
    if decision.action.code is LoopAction.FLY_DOUBLETS and conclusion.advises_only_flight:
        # One flight is enough: the reason why no gains are advised names it already.
        return []
    if next_step_has_priority(tuning, decision.action):
        return []
    if axis in tuning.axes_to_fly_for_gains and is_removed_by_flight(decision.action):
        return []
    return [decision.action.sentence_and_remedy]


def texts_in_next_step(tuning: Tuning) -> set[str]:
    """Returns the texts that the report of a tuning leaves out, since its next step states them.

    The next step follows from other facts (coded findings), such as low margins on roll: they are its figures "reason"
    and "also". It states what to do about them, which is their remedy.

    Args:
        tuning: advice on the gains of each axis, and the judgement of the flight with the next step.

    Returns:
        The sentence of the next step and the remedies of its reasons. The empty text is among them, as the remedy of a
        fact that has none, so that the report leaves that out, too.
    """
    next_step = tuning.judgement.next_step
    texts = {"", next_step.sentence}
    main_reason = next_step.figures.get("reason")
    further_reasons = next_step.figures.get("also", ())
    for reason in (main_reason, *further_reasons):
        if reason is not None:
            texts.add(reason.remedy)
    if next_step.code is NextStep.KEEP_OR_CONFIRM_GAINS:
        texts |= {conclusion_for_report(tuning, advice).remedy for advice in tuning.advice}
    # Gains that can wait until other axes are tuned are not to be loaded now.
    if next_step.code in (NextStep.LOAD_GAINS, NextStep.TUNE_OTHER_AXES):
        for advice in tuning.advice:
            if advice.parameters and advice.is_sound and not tuning.waits(advice):
                texts.add(conclusion_for_report(tuning, advice).remedy)
    for axis, decision in tuning.judgement.loop_decisions.items():
        # The gains to lower are among those to load, or are joined to those of another axis.
        is_lowered_now = next_step.code is NextStep.LOAD_GAINS and tuning.lowers_gains_of(axis)
        if is_lowered_now or axis in _axes_of_joined_reduction(next_step):
            texts.add(decision.fact.remedy)
        # One flight with doublets serves all axes.
        flies_doublets = (
            decision.action is not None and decision.action.code is LoopAction.FLY_DOUBLETS
        )
        is_flown_next = main_reason is not None and main_reason.advises_only_flight
        is_step_with_doublets = is_flown_next or next_step.code in STEPS_WITH_DOUBLETS
        if flies_doublets and (is_step_with_doublets or axis in tuning.axes_to_fly_for_gains):
            texts.add(decision.fact.remedy)
    return texts


def _axes_of_joined_reduction(next_step: Fact) -> Names:
    """Returns the axes whose gains a next step lowers together; empty if it lowers those of one axis, or none."""
    reason = next_step.figures.get("reason")
    action = reason.figures.get("action") if isinstance(reason, Fact) else None
    if isinstance(action, Fact) and action.code in REDUCTIONS_OF_RATE_GAINS:
        return action.figures.get("names", ())
    return ()


def remedies_to_show(
    tuning: Tuning, axis: str, report: str, shown_remedies: Collection[str]
) -> list[str]:
    """Returns what to do about one axis, such as "Fly doublets.", unless the reader finds it elsewhere.

    A remedy is left out if the text on the axis, or another part of the page, has it already, or if another one
    contains it.

    Args:
        tuning: for each axis the advice on its gains, or the finding that says why there is none.
        axis: "roll", "pitch" or "yaw".
        report: text on the axis, which the remedies will follow.
        shown_remedies: the remedies in the next step and in the text on other axes.

    Returns:
        The remedies, which may be several sentences each.
    """
    candidates = _remedies_besides_flight(tuning, axis)
    if axis in tuning.axes_to_fly_for_gains:
        candidates += _remedies_until_flight(tuning.axes[axis])
    new_remedies = []
    for remedy in dict.fromkeys(candidates):
        if remedy not in shown_remedies and remedy not in report:
            new_remedies.append(remedy)
    return _without_contained_texts(new_remedies)


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


def _without_contained_texts(texts: list[str]) -> list[str]:
    """Returns some different texts without those that another one contains, so that nothing is read twice."""
    return [text for text in texts if most_complete(text, texts) == text]


def most_complete(text: str, texts: Collection[str]) -> str:
    """Returns the longest of some texts that contains a text; the text itself if none does.

    "Fly doublets, with rates logged at 100 Hz." contains "Fly doublets." but for its full stop.

    Args:
        text: the text, one or several sentences.
        texts: texts to choose from.
    """
    text_without_stop = text.removesuffix(".")
    containing_texts = [other for other in texts if text_without_stop in other]
    return max([text, *containing_texts], key=len)
