"""Tuning of the control loops of an assessed vehicle: which gains to set, with a notch filter, and what to do next.

The results are facts (coded findings), in these roles:

- The *advice* on the loop of one axis has the gains to set, or a conclusion why they stay.
- The *decision* on the loops of one axis, made by the assessment, says what is wrong with them, and which action helps.
- The *judgement* of the flight has a *headline*, its most serious fact, and the *next step* of the pilot. Tuning may
  change the next step, for example to load the new gains.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from mavdem.assessment.axis.gains import loop_at_end_of_log
from mavdem.assessment.axis.loop_decision import (
    ADVICE_TO_TUNE,
    LoopDecision,
    LoopDiagnosis,
    advises_to_tune,
)
from mavdem.assessment.axis.margins import axes_with_doubtful_loop
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.judgement import Judgement, repairs_before_tuning
from mavdem.assessment.lights import OTHER_LIGHTS
from mavdem.assessment.record import Assessment
from mavdem.containers import Names, group_by
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.assessment import NextStep, Override
from mavdem.facts.lights import Light
from mavdem.facts.loops import ControllerFact, GainFact, LoopAction, LoopFact
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.immutable import freeze
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.loops.advice import Advice, AdviceByAxis, Gain, advise, reasons_for_no_gains
from mavdem.loops.axis_loops import Loop
from mavdem.loops.gain_design import SURE_SHARE, Stage
from mavdem.loops.resonance import controller_if_known

STAGE_HEADINGS = {
    Stage.RATE: "Stage 1, rate P, I and D: load, hover one minute, fly ten doublets, mavdem tune",
    Stage.ANGLE: "Stage 2, angle P: load, hover one minute, fly ten doublets, mavdem tune",
}
"""First line of the parameter files of each stage that is the next to be loaded."""
WAITING_HEADING = (
    "Stage 2, angle P: load after a flight with stage 1, if its log advises them again"
)
"""First line of the parameter files of the second stage, if those of the first are to be flown before."""
LOWERED_GAINS_HEADING = "Gains to lower before the next flight"
"""First line of the parameter files of gains to lower, if no other gains are set with them."""
NOTCH_HEADING = "Notch filter, with the gains of the log"
"""First line of the parameter files of a notch filter alone."""
PRESENT_HEADING = "The values of the log, to go back to"
"""First line of the parameter files with the values that advised ones replace."""
PRESENT_SUFFIX = ".before"
"""End of the name of these files, before the ending."""

NO_GAINS: Mapping[str, Gain] = MappingProxyType({})
"""No gains to lower."""

LOWERING = (GainFact.LOWER_GAINS, LoopAction.LOWER_BY_A_THIRD)
"""Facts whose ``changes`` are gains to lower: name, value now and value to set."""

LIGHTS_BEFORE_GAINS = (Light.MOTORS, Light.VIBRATION, Light.POWER)
"""Lights whose faults are mended before new gains are loaded: motors, vibration and battery change the loops."""


def present_parameter_files(names: Iterable[str], vehicle: Telemetry) -> dict[str, str]:
    """Returns the contents of the parameter files that set what new parameters replace, to go back to it.

    Args:
        names: names of the new parameters.
        vehicle: vehicle that they are for, with its parameters at the end of the recording.

    Returns:
        The text of each file by the ending of its name, such as ``.before.params``; empty if the log has none of the
        parameters.
    """
    present = vehicle.present_parameters
    values = {name: present[name] for name in names if name in present}
    if not values:
        return {}
    texts = parameter_files(values, vehicle, PRESENT_HEADING)
    return {f"{PRESENT_SUFFIX}{ending}": text for ending, text in texts.items()}


class ParameterSet(NamedTuple):
    """Parameters that are loaded together, before one flight."""

    parameters: Parameters
    """Their values, by the autopilot's names."""
    heading: str
    """First line of their parameter files."""
    suffix: str
    """End of the name of their files, before the ending."""
    stage: Stage | None = None
    """The stage of tuning that they belong to; None for gains to lower, or for a notch filter, alone."""


def lowered_gains(next_step: Fact, decisions: Iterable[LoopDecision] = ()) -> dict[str, Gain]:
    """Returns the gains that the next step and the decisions on some axes advise to lower, by the autopilot's names.

    Args:
        next_step: what to do next, a coded finding. The advice to lower gains is this fact or one that it contains,
            such as its reason.
        decisions: decisions on the loops of the axes whose gains are set with those of the next step. Of these, the
            gains of a loop with a measured lack of margin are lowered; against a limit cycle the next step lowers all.

    Returns:
        Each gain with its value now and the value to set; empty if none is to be lowered.
    """
    advice = [fact for fact in _fact_and_contained_facts(next_step) if fact.code in LOWERING]
    advice += _reductions_by_a_third(decisions)
    gains = {}
    for fact in advice:
        for name, present_value, new_value in fact.figures["changes"]:
            gains[name] = Gain(present_value, new_value)
    return gains


def _reductions_by_a_third(decisions: Iterable[LoopDecision]) -> list[Fact]:
    """Returns the advice, of decisions on loops, to lower the gains of an axis by a third.

    Args:
        decisions: decisions on the loops of some axes.

    Returns:
        The advice (coded findings), each with the name of the ``axis`` and the ``changes`` of its gains.
    """
    actions = [decision.action for decision in decisions if decision.action is not None]
    return [action for action in actions if action.code is LoopAction.LOWER_BY_A_THIRD]


def _fact_and_contained_facts(fact: Fact) -> Iterator[Fact]:
    """Yields a fact (coded finding), the facts among its figures, and in turn those among their figures."""
    yield fact
    for figure in fact.figures.values():
        # A figure is a value or a tuple of values.
        values = figure if isinstance(figure, tuple) else (figure,)
        for value in values:
            if isinstance(value, Fact):
                yield from _fact_and_contained_facts(value)


def parameter_sets(
    advice_on_loops: Sequence[Advice],
    notch_parameters: Parameters,
    gains_to_lower: Mapping[str, Gain] = NO_GAINS,
) -> list[ParameterSet]:
    """Returns the parameters that may be loaded, as one set for each flight, in the order of the flights.

    Computed gains are flown stage by stage. Gains to lower and a notch filter are set with the first of them, or alone
    if no others are to be loaded. Gains that another flight is to confirm first are in no set (``Advice.is_sound``).

    Args:
        advice_on_loops: the advice on each axis whose loops are known.
        notch_parameters: parameters that set a notch filter; empty without one.
        gains_to_lower: gains of axes for which none can be computed, by the autopilot's names (:func:`lowered_gains`).
    """
    sets = list[ParameterSet]()
    parameters_of_first_set = {name: gain.set for name, gain in gains_to_lower.items()}
    parameters_of_first_set |= notch_parameters
    for stage, heading in STAGE_HEADINGS.items():
        parameters_of_stage = dict[str, float]()
        for advice in advice_on_loops:
            if advice.stage is stage and advice.is_sound:
                parameters_of_stage |= advice.parameters
        if parameters_of_stage:
            parameters_of_stage |= parameters_of_first_set
            parameters_of_first_set = {}
            # Gains of the second stage wait only if there are some of the first.
            heading_of_set = WAITING_HEADING if sets else heading
            suffix = f".stage{stage:d}"
            sets.append(ParameterSet(parameters_of_stage, heading_of_set, suffix, stage))
    if parameters_of_first_set and gains_to_lower:
        sets.append(ParameterSet(parameters_of_first_set, LOWERED_GAINS_HEADING, ".lower"))
    elif parameters_of_first_set:
        sets.append(ParameterSet(parameters_of_first_set, NOTCH_HEADING, ".notch"))
    return sets


def stage_to_load(advice_on_loops: Sequence[Advice]) -> Stage | None:
    """Returns the stage of tuning whose gains are loaded before the next flight, which all axes fly together.

    Args:
        advice_on_loops: the advice on each axis whose loops are known.

    Returns:
        The earliest stage of all axes: that of the rate gains before that of the angle gain; None if no gains are to be
        loaded.
    """
    sets = parameter_sets(advice_on_loops, notch_parameters={})
    return sets[0].stage if sets else None


def waits_for_stage(advice: Advice, first_stage: Stage | None) -> bool:
    """Returns whether the new gains of an axis wait for the flight with the gains of an earlier stage.

    Args:
        advice: the advice on the loops of the axis.
        first_stage: the stage whose gains are loaded before the next flight (:func:`stage_to_load`).
    """
    if first_stage is None or advice.stage is None or not advice.is_sound:
        return False
    return advice.stage > first_stage


class Tuning(NamedTuple):
    """The tuning of a vehicle: gains to set for each axis, or facts (coded findings) why there are none."""

    axes: AdviceByAxis
    """The advice on each requested axis, or why its loop is not known."""
    advice: Sequence[Advice]
    """The advice on the axes whose loops are known; empty if none is."""
    parameters: Parameters
    """The parameters that change, by the autopilot's names; empty if no gains are advised."""
    notch_parameters: Parameters
    """Those of ``parameters`` that set a notch filter; empty without one."""
    notch: Fact | None
    """The notch filter to set, or why there is none; None if it was not requested."""
    judgement: Judgement
    """The judgement of the flight, whose next step is to load the new gains, unless something else is bad."""
    doubtful_axes: frozenset[str] = frozenset()
    """The axes whose measured response contradicts the identified loop, so that its margins may be wrong."""
    axes_without_controller: frozenset[str] = frozenset()
    """The axes whose controller or mixer the logged parameters do not describe, so that no flight leads to gains."""
    no_loop: Fact | None = None
    """Why the loops of no axis are known; None if those of at least one axis are."""
    gains_to_lower: Mapping[str, Gain] = NO_GAINS
    """Gains to lower, of axes for which none can be computed; they are among ``parameters``."""

    @property
    def has_computed_gains(self) -> bool:
        """Whether gains that are computed from the loop of an axis change; gains that are only lowered do not count."""
        return any(advice.parameters for advice in self.advice)

    @property
    def sets(self) -> list[ParameterSet]:
        """The parameters to load, as one set for each flight (:func:`parameter_sets`)."""
        return parameter_sets(self.advice, self.notch_parameters, self.gains_to_lower)

    def lowers_gains_of(self, axis: str) -> bool:
        """Returns whether gains of an axis are lowered because it oscillates or lacks margin by a measurement."""
        decision = self.judgement.loop_decisions.get(axis)
        if decision is None or decision.diagnosis is LoopDiagnosis.UNKNOWN:
            return False
        action = decision.action
        if action is None or action.code not in LOWERING:
            return False
        return any(name in self.gains_to_lower for name, _, _ in action.figures["changes"])

    @property
    def refusal(self) -> Fact | None:
        """The fact (coded finding) why no gains are advised on any axis; None if some are."""
        if self.no_loop is not None:
            return self.no_loop
        if any(advice.gains for advice in self.advice):
            return None
        # The gains of each axis stay for a reason of its own. The reason on the first axis is stated for all.
        reason_on_first_axis = self.advice[0].conclusion
        return reason_on_first_axis

    def files(self, vehicle: Telemetry) -> dict[str, str]:
        """Returns the contents of the parameter files that set the advised gains, to be loaded by a ground station.

        There is a pair of files, in two formats, for each of the ``sets``.

        Args:
            vehicle: the vehicle that will load the files.

        Returns:
            The text of each file by the ending of its name, such as ``.stage1.params``.
        """
        text_by_ending = {}
        for parameter_set in self.sets:
            texts = parameter_files(parameter_set.parameters, vehicle, parameter_set.heading)
            for ending, text in texts.items():
                text_by_ending[f"{parameter_set.suffix}{ending}"] = text
        return text_by_ending

    def waits(self, advice: Advice) -> bool:
        """Returns whether the new gains of an axis wait for the flight with the gains of an earlier stage."""
        return waits_for_stage(advice, stage_to_load(self.advice))


def tune_loops(
    assessment: Assessment,
    axes: Sequence[str],
    margins: str = "default",
    *,
    is_written: bool,
    raises_sound_gains: bool = False,
    filters: bool = False,
) -> Tuning:
    """Designs the gains to set for some axes of an assessed vehicle.

    Gains are advised for every axis with an identified loop. They are not raised if anything about the vehicle or the
    loop is doubtful. A notch filter is set only if nothing about the vehicle is doubtful, and only together with gains
    that compensate for the phase lag of the filter.

    Args:
        assessment: all results on the vehicle: events, status lights, model, loops and wind.
        axes: the requested ones of "roll", "pitch" and "yaw".
        margins: name of the required margins, such as "default" or "sharp".
        is_written: whether the gains will be written to a file.
        raises_sound_gains: whether the gains of loops that have enough margin are raised, to make them faster.
        filters: whether to set a notch filter as well.

    Returns:
        The advice on each axis, the parameters to set, and the judgement with its next step.
    """
    evidence = assessment.evidence
    assert evidence is not None
    judgement = assessment.judgement
    reasons_of_vehicle = _reasons_against_higher_gains(evidence, judgement)
    notch = assessment.noise.notch if filters and not reasons_of_vehicle else None
    # The fact about the notch filter contains the parameters to set; a fact that states why there is none has none.
    notch_parameters = dict(notch.figures.get("settings", ())) if notch else {}
    advice_by_axis = _advice_on_axes(
        assessment,
        axes,
        margins,
        reasons_of_vehicle,
        notch_parameters,
        raises_sound_gains=raises_sound_gains,
    )
    advice_on_loops = [advice for advice in advice_by_axis.values() if isinstance(advice, Advice)]
    no_loop = None
    if not advice_on_loops:
        refusals = {axis: fact for axis, fact in advice_by_axis.items() if isinstance(fact, Fact)}
        no_loop = _reason_for_no_loop(evidence, judgement, refusals)
    parameters = dict[str, float]()
    for advice in advice_on_loops:
        # A notch adds phase lag. It is known only for loops with new gains that their phase margin is sufficient.
        if advice.gains:
            parameters |= {**advice.parameters, **notch_parameters}
    decisions = judgement.loop_decisions
    decisions_on_axes = [decisions[axis] for axis in axes if axis in decisions]
    gains_to_lower = lowered_gains(judgement.next_step, decisions_on_axes)
    arguments = _arguments_of_command(
        evidence, margins, raises_sound_gains=raises_sound_gains, filters=filters
    )
    tuning_judgement = _judgement_with_tuning_step(
        judgement,
        advice_by_axis,
        arguments,
        has_new_gains=bool(parameters),
        is_written=is_written,
        must_be_repaired=bool(reasons_of_vehicle),
    )
    tuning = Tuning(
        axes=advice_by_axis,
        advice=advice_on_loops,
        parameters=parameters | {name: gain.set for name, gain in gains_to_lower.items()},
        notch_parameters=notch_parameters if parameters else {},
        notch=notch,
        judgement=tuning_judgement,
        doubtful_axes=axes_with_doubtful_loop(assessment.margins, evidence.loops),
        axes_without_controller=_axes_without_controller(evidence, axes),
        no_loop=no_loop,
        gains_to_lower=gains_to_lower,
    )
    return freeze(tuning)


def _arguments_of_command(
    evidence: Evidence, margins: str, *, raises_sound_gains: bool, filters: bool
) -> list[str]:
    """Returns the arguments of ``mavdem tune`` for the same log and options, to be advised for other axes.

    Args:
        evidence: evidence of the log, with the arguments by which it was opened.
        margins: name of the required margins, such as "default" or "sharp".
        raises_sound_gains: whether the gains of loops that have enough margin are raised.
        filters: whether to set a notch filter as well.

    Returns:
        The arguments without the axes, such as ["flight.ulg", "--margins", "sharp"].
    """
    arguments = [*evidence.command_arguments]
    if margins != "default":
        arguments += ["--margins", margins]
    if raises_sound_gains:
        arguments.append("--more")
    if filters:
        arguments.append("--filters")
    return arguments


def _axes_without_controller(evidence: Evidence, axes: Iterable[str]) -> frozenset[str]:
    """Selects the axes whose controller or mixer the logged parameters do not describe.

    Without both no margins can be computed, so that another flight would not lead to gains either.

    Args:
        evidence: signals of the vehicle with its parameters; and its loops, or why they are not known.
        axes: axes to select from: "roll", "pitch" and "yaw".
    """
    axes_without_controller = set[str]()
    for axis in axes:
        loop_or_reason = evidence.loops[axis]
        # A reason with such a code says what the parameters lack, such as the mixer.
        lacks_parameters = isinstance(loop_or_reason, Fact) and isinstance(
            loop_or_reason.code, ControllerFact
        )
        if lacks_parameters or controller_if_known(evidence.signals.for_axis(axis)) is None:
            axes_without_controller.add(axis)
    return frozenset(axes_without_controller)


def _judgement_with_tuning_step(
    judgement: Judgement,
    advice_by_axis: AdviceByAxis,
    arguments: Sequence[str],
    *,
    has_new_gains: bool,
    is_written: bool,
    must_be_repaired: bool,
) -> Judgement:
    """Replaces the next step of a judgement if the advice on the gains changes what the pilot should do next.

    There are five cases:

    - There are new gains, but of axes with enough margin, while others lack it: the next step is to tune those first.
    - There are new gains, and no other fault comes before them: the next step is to load the gains, with any that are
      to be lowered on another axis.
    - There are none, although the next step was to tune the vehicle: it becomes to tune other axes or, if their gains
      need no change, what the advice on the loops says instead, such as to fly doublets.
    - No gains can be advised at all, and no fault is the reason: the next step is what leads to advice, such as to log
      the setpoint of the rate.
    - Otherwise the next step stays, for example to replace a propeller.

    Args:
        judgement: judgement of the vehicle before tuning.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
        has_new_gains: whether the advice changes any gain.
        is_written: whether the gains will be written to a file.
        must_be_repaired: whether something about the vehicle must be mended before it is tuned.

    Returns:
        The judgement, with its headline and lights unchanged.
    """
    other_axes_to_tune = []
    for axis, decision in judgement.loop_decisions.items():
        is_to_be_tuned = decision.action is not None and decision.action.code in ADVICE_TO_TUNE
        if axis not in advice_by_axis and is_to_be_tuned:
            other_axes_to_tune.append(axis)
    advice_on_loops = [advice for advice in advice_by_axis.values() if isinstance(advice, Advice)]
    is_refused = not any(advice.gains for advice in advice_on_loops)
    if has_new_gains and _raises_gains_while_others_lack_margin(
        judgement, advice_on_loops, other_axes_to_tune
    ):
        # The axes that lack margin come first, with a run that does not raise the gains of others.
        next_step = Fact(
            NextStep.TUNE_OTHER_AXES,
            judgement.headline.level,
            names=tuple(advice_by_axis),
            others=tuple(other_axes_to_tune),
            arguments=tuple(argument for argument in arguments if argument != "--more"),
            are_first=True,
        )
    elif has_new_gains and _allows_new_gains(judgement.headline):
        next_step = _next_step_with_new_gains(
            judgement, advice_on_loops, other_axes_to_tune, arguments, is_written=is_written
        )
    elif not has_new_gains and advises_to_tune(judgement.next_step):
        next_step = _next_step_without_new_gains(advice_by_axis, other_axes_to_tune, arguments)
    elif is_refused and not must_be_repaired and _allows_new_gains(judgement.headline):
        next_step = _next_step_towards_gains(judgement, advice_by_axis)
    else:
        return judgement
    return replace(judgement, next_step=next_step)


def _raises_gains_while_others_lack_margin(
    judgement: Judgement, advice_on_loops: Sequence[Advice], other_axes: Sequence[str]
) -> bool:
    """Returns whether an axis that was not requested is to be tuned first, since it has too little stability margin.

    So it is if all new gains are for axes that have enough margin, and only make them faster.

    Args:
        judgement: judgement of the flight, with the decision on the loops of each axis and the reason for it.
        advice_on_loops: advice on the loops of the requested axes.
        other_axes: axes that were not requested, but whose gains should change.
    """
    other_axis_lacks_margin = any(
        judgement.loop_decisions[axis].reason.code is MarginsLight.LOOP_MARGINS
        for axis in other_axes
    )
    changed_loops = [advice for advice in advice_on_loops if advice.parameters]
    changed_loops_have_margin = not any(advice.rating.is_bad for advice in changed_loops)
    return other_axis_lacks_margin and changed_loops_have_margin


def _advice_on_axes(
    assessment: Assessment,
    axes: Sequence[str],
    margins: str,
    reasons_of_vehicle: Facts,
    notch_parameters: Parameters,
    *,
    raises_sound_gains: bool,
) -> AdviceByAxis:
    """Returns the advice on the gains of each axis, or the reason why its loop is not known.

    Args:
        assessment: all results on the vehicle: events, status lights, model, loops and wind.
        axes: the requested ones of "roll", "pitch" and "yaw".
        margins: name of the required margins, such as "default" or "sharp".
        reasons_of_vehicle: reasons why no gains of any axis may be raised.
        notch_parameters: parameters that set a notch filter; empty if no filter is set.
        raises_sound_gains: whether the gains of loops that have enough margin are raised.

    Returns:
        For each axis the advice, or the fact (coded finding) that its loop is not known, with the reasons.
    """
    # A vehicle that is tuned was judged, and so has evidence.
    assert assessment.evidence is not None
    loops = assessment.evidence.loops
    loop_decisions = assessment.judgement.loop_decisions
    reasons_without_loop = _reasons_without_loop(assessment, axes)
    attitude_doubts = {
        axis_margins.axis: axis_margins.attitude_contradiction
        for axis_margins in assessment.margins
    }
    advice_by_axis = AdviceByAxis()
    for axis in axes:
        loop = loops[axis]
        if isinstance(loop, Loop):
            advice_by_axis[axis] = _advice_on_loop(
                loop,
                margins,
                reasons_of_vehicle,
                notch_parameters,
                loop_decisions.get(axis),
                attitude_doubts.get(axis),
                raises_sound_gains=raises_sound_gains,
            )
        else:
            # A vehicle that must not be tuned needs no further reason on a single axis.
            reasons = reasons_of_vehicle or (reasons_without_loop[axis],)
            advice_by_axis[axis] = Fact(LoopFact.NO_LOOP, reasons=reasons)
    return advice_by_axis


def _reason_for_no_loop(
    evidence: Evidence, judgement: Judgement, refusals: Mapping[str, Fact]
) -> Fact:
    """Returns the finding that no control loop could be identified, with the reasons.

    If the flight went badly, the first reason is its most serious finding (headline). If the vehicle must be repaired,
    the reasons on the axes say so already.

    Args:
        evidence: signals, events and measurements of the vehicle.
        judgement: judgement of the vehicle, with its headline and what was found about its motors.
        refusals: for each axis the reason why its loop is not known.
    """
    reasons = _joined_by_reason(refusals)
    must_be_repaired = repairs_before_tuning(evidence, judgement.lights[Light.MOTORS])
    if judgement.headline.is_bad and not must_be_repaired:
        reasons.insert(0, judgement.headline)
    return Fact(LoopFact.NO_LOOP, reasons=tuple(reasons))


def _reasons_without_loop(assessment: Assessment, axes: Sequence[str]) -> dict[str, Fact]:
    """Returns for each axis without an identified loop the fact (coded finding) that says why it has none.

    If the autopilot injected a test signal on such an axis, the margins that were measured with it come first.

    Args:
        assessment: all results on the vehicle, with the loops that were identified in its flight.
        axes: the axes whose gains were requested.
    """
    evidence = assessment.evidence
    # Gains are advised only for a vehicle that was judged, and so has evidence.
    assert evidence is not None
    margins_by_injection = {}
    for axis_margins in assessment.margins:
        if axis_margins.injected:
            margins_by_injection[axis_margins.axis] = axis_margins.facts[0]
    reasons = {}
    for axis in axes:
        loop_or_reason = evidence.loops[axis]
        if isinstance(loop_or_reason, Loop):
            continue
        reasons[axis] = loop_or_reason
        if axis in margins_by_injection:
            both_facts = (margins_by_injection[axis], loop_or_reason)
            reasons[axis] = Fact(LoopFact.NO_LOOP, reasons=both_facts)
    return reasons


def _next_step_with_new_gains(
    judgement: Judgement,
    advice_on_loops: Sequence[Advice],
    other_axes: Sequence[str],
    arguments: Sequence[str],
    *,
    is_written: bool,
) -> Fact:
    """Returns the next step if gains change: to load them or, if they are too uncertain, to fly first.

    Args:
        judgement: headline, next step and status lights of the flight, and decisions on its loops.
        advice_on_loops: advice on the loops of the requested axes.
        other_axes: axes that were not requested, but whose gains should change too.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
        is_written: whether the gains are written to a file.

    Returns:
        The fact (coded finding) ``LOAD_GAINS`` if the flight is a basis for the new gains of an axis
        (``Advice.is_sound``). Otherwise the next step of the judgement if it lowers gains, and ``FLY_BEFORE_GAINS`` if
        not.
    """
    changed_loops = _advice_on_changed_loops(advice_on_loops)
    if any(advice.is_sound for advice in changed_loops):
        return _step_to_load_gains(
            judgement, changed_loops, other_axes, arguments, is_written=is_written
        )
    if lowered_gains(judgement.next_step):
        return judgement.next_step
    return _step_to_fly_before_gains(judgement, changed_loops)


def _step_to_fly_before_gains(judgement: Judgement, changed_loops: Sequence[Advice]) -> Fact:
    """Returns the advice to fly once more, since this flight is too uncertain a basis for new gains on any axis.

    Args:
        judgement: the flight's most serious finding (headline), and what was found about its motors, power and so on.
        changed_loops: for each axis whose gains should change, the advice with the new gains.

    Returns:
        The fact (coded finding) ``FLY_BEFORE_GAINS``. Its ``reason`` says which flight is needed, and names all these
        axes; ``also`` is what is to be mended before.
    """
    # One flight serves all axes. The advice with the strongest case for new gains describes it.
    advice_with_strongest_case = max(changed_loops, key=_certainty_of_change)
    axes = tuple(advice.before.axis for advice in changed_loops)
    needed_flight = advice_with_strongest_case.flight_before_gains.replace(names=axes)
    return Fact(
        NextStep.FLY_BEFORE_GAINS,
        judgement.headline.level,
        reason=needed_flight,
        also=_faults_before_gains(judgement),
    )


def _certainty_of_change(advice: Advice) -> float:
    """Returns the fraction, 0 to 1, of the posterior models of a vehicle that speak for new gains on one axis.

    A model speaks for them if it has its stability margins with the new gains, or if it lacks them with the present
    ones. The larger of both fractions counts.
    """
    return max(advice.sure, advice.fraction_without_margins_before)


def faults_besides_loops(judgement: Judgement) -> list[Fact]:
    """Returns what a flight shows to be watch or bad about anything but its control loops, each finding once.

    Args:
        judgement: headline of the flight, and its status lights: a fact (coded finding with a level) for each of eight
            subjects such as the motors.

    Returns:
        The headline, if it is such a finding, and the facts of the lights in their order.
    """
    candidates = [judgement.headline]
    for name, light in judgement.lights.items():
        # As in a headline, lights of the log and of the weather count only if they are bad.
        if light.is_bad or name not in OTHER_LIGHTS:
            candidates.append(light)
    faults: list[Fact] = []
    for fact in candidates:
        is_about_loops = isinstance(fact.code, MarginsLight | TrackingLight)
        if fact.is_watch_or_bad and not is_about_loops and fact not in faults:
            faults.append(fact)
    return faults


def _faults_before_gains(judgement: Judgement) -> Facts:
    """Returns the faults of a vehicle that a pilot mends before loading new gains, such as a weak motor.

    New gains fit the vehicle as it flew, and mending the motors, the vibration or the battery changes its control
    loops. So these are the status lights (judgements of one part with a level) of ``LIGHTS_BEFORE_GAINS`` and the
    headline of the flight, as far as they are watch or bad, are not about the loops, and can be mended.

    Args:
        judgement: headline and status lights of the flight.

    Returns:
        The faults, coded findings; empty if nothing is to be mended.
    """
    facts_that_matter = [judgement.headline]
    for name in LIGHTS_BEFORE_GAINS:
        if name in judgement.lights:
            facts_that_matter.append(judgement.lights[name])
    faults_to_mend = []
    for fault in faults_besides_loops(judgement):
        # What only another flight can clear up is nothing to mend.
        is_mendable = bool(fault.without_flight_advice.remedy)
        if fault in facts_that_matter and is_mendable:
            faults_to_mend.append(fault)
    return tuple(faults_to_mend)


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
        reductions = _reductions_by_a_third(judgement.loop_decisions.values())
        axes_to_load += tuple(reduction.figures["axis"] for reduction in reductions)
    return Fact(
        NextStep.LOAD_GAINS,
        judgement.headline.level,
        is_written=is_written,
        share=min(advice.sure for advice in loops_to_load),
        share_as_flown=min(advice.after.share_meeting(advice.target) for advice in loops_to_load),
        flights=max(advice.flights for advice in loops_to_load),
        also=_faults_before_gains(judgement),
        needed=SURE_SHARE,
        is_biased=any(_has_biased_effectiveness(advice.before) for advice in loops_to_load),
        fit=min(
            (fact.figures["share"] for fact in weak_confirmations if fact is not None), default=None
        ),
        missing=_unknown_lights_for_higher_gains(judgement, loops_to_load),
        names=axes_to_load,
        waiting=tuple(waiting_axes),
        others=tuple(other_axes),
        arguments=tuple(arguments),
    )


def _has_biased_effectiveness(loop: Loop) -> bool:
    """Returns whether wind biased the control effectiveness of an identified loop, as one of its cautions says."""
    return any(caution.code is LoopFact.EFFECT_BIASED for caution in loop.cautions)


def _advice_on_changed_loops(advice_on_loops: Sequence[Advice]) -> list[Advice]:
    """Selects the advice on those loops that behave differently once the new parameters are set.

    Args:
        advice_on_loops: advice on all loops.

    Returns:
        The advice that changes parameters. If no advice does, only a notch filter is new, whose delay affects every
        loop: then all advice on loops with known gains.
    """
    changed_loops = [advice for advice in advice_on_loops if advice.parameters]
    return changed_loops or [advice for advice in advice_on_loops if advice.gains]


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
    advice_by_axis: AdviceByAxis, other_axes: Sequence[str], arguments: Sequence[str]
) -> Fact:
    """Returns the next step for the pilot if the advice changes no gains of the requested axes.

    1. If gains of other axes should change, the next step is to tune these.
    2. Otherwise it is the remedy of the first axis that has one, such as a flight with doublets.
    3. Without a remedy it is the conclusion on the first axis, such as to keep its gains.

    Args:
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known. None
            has new gains.
        other_axes: axes that were not requested, but whose gains should change.
        arguments: arguments of ``mavdem tune`` that repeat this run, without its axes.
    """
    if other_axes:
        return Fact(
            NextStep.TUNE_OTHER_AXES,
            names=tuple(advice_by_axis),
            others=tuple(other_axes),
            arguments=tuple(arguments),
        )
    conclusions = [_conclusion(advice) for advice in advice_by_axis.values()]
    for conclusion in conclusions:
        if conclusion.remedy:
            return Fact(NextStep.DO_AS_ADVISED, reason=conclusion)
    return Fact(NextStep.DO_AS_ADVISED, reason=conclusions[0])


def _next_step_towards_gains(judgement: Judgement, advice_by_axis: AdviceByAxis) -> Fact:
    """Returns the next step if no gains can be advised: what leads to gains of the first axis for which that is known.

    The decision on the loops of an axis names the flight to make. An axis without one has the remedy of the reason why
    its loop is not known, such as what to log.

    Args:
        judgement: headline, next step and status lights of the flight, and decisions on its loops.
        advice_by_axis: the advice on each requested axis, or the fact (coded finding) that its loop is not known. None
            advises gains.
    """
    for axis, advice in advice_by_axis.items():
        decision = judgement.loop_decisions.get(axis)
        if decision is not None and decision.action is not None:
            # Doublets are quick stick movements to one side and then to the other, from which a loop can be identified.
            if decision.action.code is LoopAction.FLY_DOUBLETS:
                return Fact(NextStep.DO_AS_ADVISED, reason=decision.action)
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


def _advice_on_loop(
    flown_loop: Loop,
    margins: str,
    reasons_of_vehicle: Facts,
    notch_parameters: Parameters,
    decision: LoopDecision | None,
    attitude_doubt: Fact | None,
    *,
    raises_sound_gains: bool,
) -> Advice:
    """Returns the advice on the gains of one identified loop, with a notch filter if one is to be set.

    The advice is for the gains at the end of the log, with which the next flight begins. If a notch filter is to be
    set, whose phase lag costs margin, the advice is computed again for the loop with the filter.

    Args:
        flown_loop: rate and attitude loop of the axis, with the gains that flew.
        margins: name of the margins to have, in ``MARGIN_TARGETS``.
        reasons_of_vehicle: reasons why no gains of any axis may be raised; a decision has them too.
        notch_parameters: parameters that set the notch filter; empty without one.
        decision: what was decided on the loop, with the reasons against new gains, and the advice if it was made; None
            for an axis without a decision.
        attitude_doubt: that the measured response of the angle differs from the predicted one; None if it does not.
        raises_sound_gains: whether the user wants higher gains even if the loop has the wanted margins already.
    """
    reasons_against_gains = (
        reasons_of_vehicle if decision is None else decision.reasons_against_gains
    )
    # An axis that follows its setpoint too slowly has its gains raised in any case.
    is_too_slow = decision is not None and decision.is_too_slow
    loop = loop_at_end_of_log(flown_loop)
    if loop is not flown_loop:
        # A measured response, which may contradict the identified loop, was measured with the gains that flew.
        reasons_against_gains = (*reasons_against_gains, *reasons_for_no_gains(flown_loop))
    raises_gains = raises_sound_gains or is_too_slow
    advise_gains = partial(advise, tune=margins, attitude_doubt=attitude_doubt)
    is_request_of_decision = (
        margins == "default" and raises_gains == is_too_slow and not reasons_against_gains
    )
    if decision is not None and decision.advice is not None and is_request_of_decision:
        # The same advice was computed for the decision.
        advice = decision.advice
    else:
        advice = advise_gains(loop, doubts=reasons_against_gains, raises_sound_gains=raises_gains)
    if is_too_slow and not raises_sound_gains and advice.stage is Stage.ANGLE:
        # A higher angle gain would only demand more of a rate loop that is too slow, so no gain is raised.
        raises_gains = False
        advice = advise_gains(loop, doubts=reasons_against_gains, raises_sound_gains=False)
    may_be_advised = not advice.refusals
    if notch_parameters and may_be_advised:
        # Doubts would have been among the refusals: there are none to pass on.
        loop_with_notch = loop.with_parameters(notch_parameters)
        advice = advise_gains(loop_with_notch, raises_sound_gains=raises_gains)
    return advice


def _allows_new_gains(headline: Fact) -> bool:
    """Returns whether new gains may be the next step after a flight, or whether another fault must be mended before.

    - A headline about the loops allows new gains if its own advice is to change gains, which may be to lower those of
      an axis for which none can be computed, or to fly before they are loaded.
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


def _reasons_against_higher_gains(evidence: Evidence, judgement: Judgement) -> Facts:
    """Returns why the gains may not be raised on any axis: repairs that the vehicle needs, or a limit cycle.

    A limit cycle is a lasting oscillation of the loops. Three facts (coded findings) may be about the same one: a
    repair, the reason of the decision on the axis that oscillates, and the gains to lower. A reader needs one of them:
    if an axis is known to oscillate, the reason of its decision replaces the repair. Otherwise the gains to lower are
    added.

    Args:
        evidence: signals, events and measurements of the vehicle.
        judgement: judgement of the vehicle, with its status lights and the decisions on its loops.

    Returns:
        The reasons as facts; empty if gains may be raised.
    """
    repairs = repairs_before_tuning(evidence, judgement.lights[Light.MOTORS])
    gains_to_lower = evidence.gain_reduction
    if gains_to_lower is None:
        # There is no limit cycle.
        return repairs
    for decision in judgement.loop_decisions.values():
        if decision.reason.code is MarginsLight.OSCILLATES:
            other_repairs = [fact for fact in repairs if fact.code is not Override.OSCILLATION]
            return (*other_repairs, decision.reason)
    return (*repairs, gains_to_lower)


def _joined_by_reason(refusals: Mapping[str, Fact]) -> list[Fact]:
    """Joins the axes whose loops are not known for the same reason, so that each reason is read once.

    Reasons are the same if their text with its advice (``Fact.sentence_and_remedy``) is the same. Facts cannot be
    compared as such, since figures, such as intervals, differ from axis to axis.

    Args:
        refusals: why the loop is not known, by axis, at least one.

    Returns:
        One fact (coded finding) for each reason: the fact of the first axis with this reason. Its figure ``names`` are
        the axes with this reason; it is absent if all axes have the same.
    """
    axes_by_text = group_by(refusals, lambda axis: refusals[axis].sentence_and_remedy)
    reasons = []
    for axes_with_reason in axes_by_text.values():
        reason = refusals[axes_with_reason[0]]
        is_reason_of_all = len(axes_with_reason) == len(refusals)
        if not is_reason_of_all:
            reason = reason.replace(names=axes_with_reason)
        reasons.append(reason)
    return reasons
