"""Tuning of the control loops of an assessed vehicle: which gains to set on each axis, with a notch filter if needed.

The results are facts (coded findings), in these roles:

- The *advice* on the loop of one axis has the gains to set, or a conclusion why they stay.
- The *decision* on the loops of one axis, made by the assessment, says what is wrong with them, and which action helps.
- The *judgement* of the flight has a *headline*, its most serious fact, and the *next step* of the pilot, which tuning
  may change (``tuning_step.py``).
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from mavdem.assessment.axis.feedforward import feedforward_finding
from mavdem.assessment.axis.flight_for_gains import flight_for_gains, hover_before_tuning
from mavdem.assessment.axis.gains import loop_at_end_of_log
from mavdem.assessment.axis.loop_decision import DecisionsByAxis, LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.loops import controller_fault
from mavdem.assessment.axis.lowered_gains import (
    LOWERING,
    LOWERING_ON_TRIAL,
    NO_GAINS,
    fact_and_contained_facts,
    limited_to_axes,
    lowered_gains,
)
from mavdem.assessment.axis.margins import axes_with_doubtful_loop
from mavdem.assessment.axis.parameter_sets import (
    ParameterSet,
    parameter_sets,
    stage_to_load,
    waits_for_stage,
)
from mavdem.assessment.axis.tuning_step import judgement_with_tuning_step
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.judgement import Judgement, repairs_before_tuning
from mavdem.assessment.noise_spectra import gyro_noise_by_axis
from mavdem.assessment.record import Assessment
from mavdem.containers import Names, group_by
from mavdem.facts import Fact, Facts
from mavdem.facts.assessment import Override
from mavdem.facts.lights import Light
from mavdem.facts.loops import ControllerFact, LoopFact
from mavdem.facts.margins import MarginsLight
from mavdem.immutable import freeze
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.loops.advice import Advice, AdviceByAxis, Gain, advise, reasons_for_no_gains
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop
from mavdem.loops.gain_design import Stage
from mavdem.loops.gyro_cutoff import gyro_cutoff_advice
from mavdem.loops.gyro_filter_lag import gyro_filter_lag

NO_FAULTS: Mapping[str, Fact] = MappingProxyType({})
"""The faults of controllers that the logged parameters describe."""

NO_PARAMETERS: Parameters = MappingProxyType({})
"""No gains that are only tried."""


class Tuning(NamedTuple):
    """The tuning of a vehicle: gains to set for each axis, or facts (coded findings) why there are none."""

    axes: AdviceByAxis
    """The advice on each requested axis, or why its loop is not known."""
    advice: Sequence[Advice]
    """The advice on the axes whose loops are known; empty if none is."""
    parameters: Parameters
    """The parameters to load, by the autopilot's names, as in the files; empty if no gains are advised."""
    notch_parameters: Parameters
    """Those of ``parameters`` that set a notch filter; empty without one."""
    notch: Fact | None
    """The notch filter to set, or why there is none; None if it was not requested."""
    judgement: Judgement
    """The judgement of the flight, whose next step is to load the new gains, unless something else is bad."""
    doubtful_axes: frozenset[str] = frozenset()
    """The axes whose measured response contradicts the identified loop, so that its margins may be wrong."""
    controller_faults: Mapping[str, Fact] = NO_FAULTS
    """By axis, what the logged parameters lack of its controller or mixer, so that no flight leads to its gains."""
    no_loop: Fact | None = None
    """Why the loops of no axis are known; None if those of at least one axis are."""
    gains_to_lower: Mapping[str, Gain] = NO_GAINS
    """Gains to lower, of axes for which none can be computed; they are among ``parameters``."""
    gyro_cutoff: Fact | None = None
    """A higher cut-off of the gyro's low-pass to try after a flight with lower gains; None if that is not advised."""
    gyro_filter_lag: Fact | None = None
    """That the gyro's low-pass takes most of the phase that a loop lacks; None if it does not, or no gains change."""
    tried_parameters: Parameters = NO_PARAMETERS
    """Computed gains that another flight is to confirm (``Advice.is_sound``), which are in no file."""
    axes_also_to_lower: Names = ()
    """Axes that were not requested, but whose gains the flight advises to lower, too."""
    feedforward: Facts = ()
    """For each axis that exceeds its setpoint mostly by feed-forward, the finding that it does."""
    flight_for_gains: Fact | None = None
    """The flight from which gains of more axes could be computed (:func:`flight_for_gains`); None if none is needed."""

    hover_to_tune: Fact | None = None
    """The first flight with gains that are lowered because the vehicle oscillates; None if it may fly as it is."""

    @property
    def has_computed_gains(self) -> bool:
        """Whether gains that are computed from the loop of an axis change; gains that are only lowered do not count."""
        return any(advice.parameters for advice in self.advice)

    @property
    def sets(self) -> list[ParameterSet]:
        """The parameters to load, as one set for each flight (:func:`parameter_sets`)."""
        return parameter_sets(self.advice, self.notch_parameters, self.gains_to_lower)

    @property
    def axes_to_fly_for_gains(self) -> Names:
        """The axes about which doublets are to be flown, so that the next log gives their gains; empty without any."""
        if self.flight_for_gains is None:
            return ()
        axes: Names = self.flight_for_gains.figures["axes"]
        return axes

    def lowers_gains_of(self, axis: str) -> bool:
        """Returns whether gains of an axis are lowered because it oscillates, or was measured to lack stability margin.

        It is False for an axis whose gains are lowered only because another axis oscillates.

        Args:
            axis: "roll", "pitch" or "yaw".
        """
        decision = self.judgement.loop_decisions.get(axis)
        if decision is None or decision.diagnosis is LoopDiagnosis.UNKNOWN:
            return False
        action = decision.action
        if action is None or action.code not in LOWERING:
            return False
        names_of_changed_gains = [name for name, _, _ in action.figures["changes"]]
        return any(name in self.gains_to_lower for name in names_of_changed_gains)

    def lowers_gains_on_trial(self, axis: str) -> bool:
        """Returns whether the next step is a hover with lower gains of an axis, which shows why its rate has a peak.

        It is False if another step, such as a repair, comes before that hover.

        Args:
            axis: "roll", "pitch" or "yaw".
        """
        decision = self.judgement.loop_decisions.get(axis)
        if decision is None or decision.action is None:
            return False
        is_advised = decision.action.code is LOWERING_ON_TRIAL
        codes_in_next_step = [
            fact.code for fact in fact_and_contained_facts(self.judgement.next_step)
        ]
        return is_advised and LOWERING_ON_TRIAL in codes_in_next_step

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

    @property
    def failure(self) -> Fact | None:
        """The fact why the gains of no axis are to be set, lowered or kept; None if those of some axis are.

        Gains that another flight is to confirm are not to be set.
        """
        advice_with_gains = [advice for advice in self.advice if advice.gains]
        is_confirmed = any(not each.parameters or each.is_sound for each in advice_with_gains)
        is_kept = any(each.refuses_only_higher_gains for each in self.advice)
        if self.gains_to_lower or is_confirmed or is_kept:
            return None
        if not advice_with_gains:
            return self.refusal
        return advice_with_gains[0].conclusion

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
    judgement, also_to_lower = limited_to_axes(
        assessment.judgement, axes, evidence.signals.telemetry.parameters
    )
    reasons_of_vehicle = _reasons_against_higher_gains(evidence, judgement)
    notch = assessment.noise.notch if filters and not reasons_of_vehicle else None
    # The fact about the notch filter contains the parameters to set; a fact that states why there is none has none.
    notch_parameters = dict(notch.figures.get("settings", ())) if notch else {}
    advice_by_axis = _advice_on_axes(
        assessment,
        judgement.loop_decisions,
        axes,
        margins,
        reasons_of_vehicle,
        notch_parameters,
        raises_sound_gains=raises_sound_gains,
    )
    advice_on_loops = [advice for advice in advice_by_axis.values() if isinstance(advice, Advice)]
    no_loop = None
    if not advice_on_loops:
        no_loop = _reason_for_no_loop(evidence, judgement, advice_by_axis)
    computed_parameters = _computed_parameters(advice_on_loops, notch_parameters)
    decisions = judgement.loop_decisions
    decisions_on_axes = [decisions[axis] for axis in axes if axis in decisions]
    gains_to_lower = lowered_gains(judgement.next_step, decisions_on_axes)
    arguments = _arguments_of_command(
        evidence, margins, raises_sound_gains=raises_sound_gains, filters=filters
    )
    controller_faults = _controller_faults(evidence, axes)
    flight = flight_for_gains(
        evidence,
        advice_by_axis,
        decisions,
        controller_faults,
        is_after_repair=bool(reasons_of_vehicle),
    )
    tuning_judgement = judgement_with_tuning_step(
        judgement,
        advice_by_axis,
        arguments,
        flight,
        has_new_gains=bool(computed_parameters),
        is_written=is_written,
        must_be_repaired=bool(reasons_of_vehicle),
    )
    doubtful_axes = axes_with_doubtful_loop(assessment.margins, evidence.loops)
    gyro_cutoff = None
    filter_lag = None
    if computed_parameters and not notch_parameters and not reasons_of_vehicle:
        loops = [advice.before for advice in advice_on_loops]
        gyro_cutoff = gyro_cutoff_advice(loops, MARGIN_TARGETS[margins])
        sure_advice = [
            advice for advice in advice_on_loops if advice.before.axis not in doubtful_axes
        ]
        filter_lag = gyro_filter_lag(sure_advice, gyro_noise_by_axis(assessment.noise, loops))
    hover_to_tune = None
    if gains_to_lower and judgement.headline.forbids_flight:
        hover_to_tune = hover_before_tuning(evidence)
    if not computed_parameters:
        notch_parameters = {}
    parameters = dict[str, float]()
    for parameter_set in parameter_sets(advice_on_loops, notch_parameters, gains_to_lower):
        parameters |= parameter_set.parameters
    tried_parameters = {
        name: value for name, value in computed_parameters.items() if name not in parameters
    }
    tuning = Tuning(
        axes=advice_by_axis,
        advice=advice_on_loops,
        parameters=parameters,
        tried_parameters=tried_parameters,
        notch_parameters=notch_parameters,
        notch=notch,
        judgement=tuning_judgement,
        doubtful_axes=doubtful_axes,
        controller_faults=controller_faults,
        no_loop=no_loop,
        gains_to_lower=gains_to_lower,
        gyro_cutoff=gyro_cutoff,
        gyro_filter_lag=filter_lag,
        axes_also_to_lower=also_to_lower,
        feedforward=_feedforward_findings(evidence, axes),
        flight_for_gains=flight,
        hover_to_tune=hover_to_tune,
    )
    return freeze(tuning)


def _feedforward_findings(evidence: Evidence, axes: Iterable[str]) -> Facts:
    """Returns for each axis that overshoots its setpoint because of feed-forward the fact that says so.

    Args:
        evidence: signals, loops and tracking of the vehicle.
        axes: the requested axes; most have no such fact (:func:`feedforward_finding`).
    """
    findings = [feedforward_finding(evidence, axis) for axis in axes]
    return tuple(finding for finding in findings if finding is not None)


def _reasons_against_higher_gains(evidence: Evidence, judgement: Judgement) -> Facts:
    """Returns why the gains may not be raised on any axis: repairs that the vehicle needs, or a limit cycle.

    A limit cycle is a lasting oscillation of the control loops. It may be among the repairs. Where the axis that
    oscillates is known, the reason of the decision on that axis says more, and replaces the repair. Where it is not
    known, the advice to lower gains is added.

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


def _computed_parameters(
    advice_on_loops: Iterable[Advice], notch_parameters: Mapping[str, float]
) -> dict[str, float]:
    """Returns the computed gains that change, by name, with the parameters of the notch filter that they presuppose.

    Some of them may be for another flight to confirm.

    A notch adds phase lag. That the phase margin stays sufficient is known only for loops whose gains were designed
    with it, so that the notch is set only with such gains.

    Args:
        advice_on_loops: advice on each axis with an identified loop.
        notch_parameters: parameters of the notch filter; empty without one.
    """
    parameters = dict[str, float]()
    for advice in advice_on_loops:
        if advice.gains:
            parameters |= {**advice.parameters, **notch_parameters}
    return parameters


def _advice_on_axes(
    assessment: Assessment,
    decisions: DecisionsByAxis,
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
        decisions: what was decided on the loops of each axis.
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
                decisions.get(axis),
                attitude_doubts.get(axis),
                raises_sound_gains=raises_sound_gains,
            )
        else:
            # A vehicle that must not be tuned needs no further reason on a single axis.
            reasons = reasons_of_vehicle or (reasons_without_loop[axis],)
            advice_by_axis[axis] = Fact(LoopFact.NO_LOOP, reasons=reasons)
    return advice_by_axis


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
    # An axis that follows its setpoint too slowly has its gains raised in any case.
    is_too_slow = decision is not None and decision.is_too_slow
    loop = loop_at_end_of_log(flown_loop)
    reasons_against_gains = _reasons_against_gains(
        flown_loop, reasons_of_vehicle, decision, have_gains_changed=loop is not flown_loop
    )
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


def _reasons_against_gains(
    flown_loop: Loop,
    reasons_of_vehicle: Facts,
    decision: LoopDecision | None,
    *,
    have_gains_changed: bool,
) -> Facts:
    """Returns why no gains may be computed from an identified loop, such as a repair that the vehicle needs.

    :func:`advise` looks for reasons of the loop itself, such as a measured response that contradicts it, only if there
    are no others. Here they are added beside a repair, so that the pilot knows of both, and if gains changed after the
    flight, since :func:`advise` is then not given the loop that flew.

    Args:
        flown_loop: rate and attitude loop of the axis, with the gains that flew.
        reasons_of_vehicle: reasons why no gains of any axis may be raised.
        decision: what was decided on the loop, with all reasons against new gains; None for an axis without a decision.
        have_gains_changed: whether the vehicle now has other gains than those that flew.

    Returns:
        The reasons, each once.
    """
    reasons = reasons_of_vehicle if decision is None else decision.reasons_against_gains
    must_be_repaired = decision is not None and bool(decision.repairs)
    if not have_gains_changed and not must_be_repaired:
        return reasons
    reasons_of_loop = reasons_for_no_gains(flown_loop)
    return (*reasons, *(reason for reason in reasons_of_loop if reason not in reasons))


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


def _reason_for_no_loop(
    evidence: Evidence, judgement: Judgement, advice_by_axis: AdviceByAxis
) -> Fact:
    """Returns the finding that no control loop could be identified, with the reasons on the axes.

    If the headline of the flight, its most serious finding, is bad, it is the first reason. It is left out if the
    vehicle must be repaired, since the reasons on the axes say so already.

    Args:
        evidence: signals, events and measurements of the vehicle.
        judgement: judgement of the vehicle, with its headline and what was found about its motors.
        advice_by_axis: for each axis, in the place of advice, the fact that says why its loop is not known.
    """
    refusals = {axis: fact for axis, fact in advice_by_axis.items() if isinstance(fact, Fact)}
    reasons = _joined_by_reason(refusals)
    must_be_repaired = repairs_before_tuning(evidence, judgement.lights[Light.MOTORS])
    if judgement.headline.is_bad and not must_be_repaired:
        reasons.insert(0, judgement.headline)
    return Fact(LoopFact.NO_LOOP, reasons=tuple(reasons))


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


def _controller_faults(evidence: Evidence, axes: Iterable[str]) -> dict[str, Fact]:
    """Returns what the logged parameters lack of the controller or mixer of some axes.

    Without both no margins can be computed, so that another flight would not lead to gains either.

    Args:
        evidence: signals of the vehicle with its parameters; and its loops, or why they are not known.
        axes: the axes: "roll", "pitch" and "yaw".

    Returns:
        By axis, the fact (coded finding) that says so; an axis whose parameters are complete is left out. Missing
        parameters are those of all axes together, so that one sentence can report them.
    """
    faults = {}
    missing_names: list[str] = []
    for axis in axes:
        signals = evidence.signals.for_axis(axis, evidence.signals.inputs)
        fault = controller_fault(signals, evidence.loops[axis])
        if fault is None:
            continue
        faults[axis] = fault
        if fault.code is ControllerFact.PARAMETERS_MISSING:
            missing_names += [name for name in fault.figures["names"] if name not in missing_names]
    for axis, fault in faults.items():
        if fault.code is ControllerFact.PARAMETERS_MISSING:
            faults[axis] = fault.replace(names=tuple(missing_names))
    return faults


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
