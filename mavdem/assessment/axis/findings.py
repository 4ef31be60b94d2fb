"""Findings on a flight and its model: a grade for each purpose, with the fact (a coded finding) that is its reason.

Estimates are graded by their status and by the half width of their 90 % interval, forecasts by windows that no model
was trained on; docs/report.md has the scale. What makes the flight itself doubtful overrides all grades
(:mod:`mavdem.assessment.axis.overrides`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite, nan
from typing import NamedTuple

from mavdem.assessment.axis.overrides import flight_overrides
from mavdem.assessment.axis.residuals import residuals
from mavdem.assessment.condition import Condition
from mavdem.confidence import coverage_factor
from mavdem.dem import Learned
from mavdem.experiments.held_out import CONSTANT_MEAN, HOLD_LAST, HeldOut
from mavdem.facts import Fact, Facts
from mavdem.facts.assessment import (
    BoundTest,
    Caveat,
    Grade,
    GradeReason,
    NextStep,
    Override,
    Purpose,
)
from mavdem.facts.forecasts import ForecastFact
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ParameterDoubt
from mavdem.motors.motor_changes import MotorChange
from mavdem.plant import Physical, WindTorque

MAX_RELATIVE_HALF_WIDTHS = {"effect": 0.15, "damping": 1 / 3, "lag": 1 / 3, "wind": 0.25}
"""Half width of the 90 % interval, over the estimate, up to which it is GOOD; for the wind torque that of its standard
deviation.

The control effectiveness decides what the wind torque is. Damping and time constant matter less, and are harder to
identify.
"""


class PredictionLimits(NamedTuple):
    """Limits of a GOOD prediction, from docs/report.md; a test holds each at its edge."""

    ratio: float = 0.5
    """Largest squared error over that of the better baseline."""
    worse: float = 0.1
    """Largest fraction of windows with a larger error than the constant mean."""
    worse_than_last: float = 0.25
    """Largest fraction of windows with a larger error than the last sample held, which is hard to beat in a hover."""
    coverage: float = 0.75
    """Least coverage of a 90 % band; below it there is a warning."""
    over_expected: float = 3.0
    """Squared error over the expected one above which there is a warning."""
    windows: int = 5
    """Least number of windows: a single one is decided by where in the flight it is."""


PREDICTION_LIMITS = PredictionLimits()
"""The limits in use."""


class Finding(NamedTuple):
    """How well a model serves one purpose."""

    purpose: Purpose
    grade: Grade
    reason: Fact
    """Why it has this grade."""


class Findings(NamedTuple):
    """What a model is good for, as every screen, page and document shows it."""

    overrides: Facts
    """What makes the flight itself doubtful, the worst first."""
    purposes: tuple[Finding, ...]
    """Grades of the model by purpose; empty without a model."""
    warnings: Facts
    """What must be known before the model is used."""

    def grade(self, purpose: Purpose) -> Grade | None:
        """Returns the grade with which the model serves a ``purpose``; None if that was not judged."""
        for finding in self.purposes:
            if finding.purpose is purpose:
                return finding.grade
        return None


def model_findings(
    learned: Learned | None = None,
    held_out: HeldOut | None = None,
    condition: Condition | None = None,
    alarms: Sequence[MotorChange] = (),
    consistency: float | None = None,
    trim: Fact | None = None,
) -> Findings:
    """Returns the findings on a flight: what makes it doubtful, the grades of its model, and warnings on the model.

    A doubtful flight makes its model doubtful too, so that no purpose is graded GOOD if there is an override. Every
    argument may be missing, and then is not judged.

    Args:
        learned: the model; without it there are only overrides.
        held_out: forecasts of windows that no model was trained on.
        condition: condition of the vehicle.
        alarms: lasting changes of the motors' balance.
        consistency: fraction of the angle's changes that the recorded rates explain, 0 to 1.
        trim: fact about the deviations of the motors' commands from their mean.

    Returns:
        The overrides, which make the flight doubtful; the grades; and the warnings, both empty without a model.
    """
    if learned is None:
        # Whether rates and angles agree matters to a model only.
        overrides = flight_overrides(condition, alarms, consistency=None, trim=trim)
        return Findings(overrides, purposes=(), warnings=())
    overrides = flight_overrides(condition, alarms, consistency, trim)
    purposes = _purpose_findings(learned, held_out)
    if overrides:
        worst_override = overrides[0]
        purposes = [_finding_lowered_by_override(finding, worst_override) for finding in purposes]
    warnings = model_warnings(learned, held_out)
    return Findings(overrides, tuple(purposes), tuple(warnings))


def with_vehicle_made_torque_marked(learned: Learned, *, vehicle_made_torque: bool) -> Learned:
    """Marks the wind torque of a model as not caused by the wind, if the vehicle itself caused it.

    The wind torque is the torque that the motors' commands do not explain. In a limit cycle, or with a weak motor, the
    vehicle itself causes most of it.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        vehicle_made_torque: whether the vehicle was in a limit cycle or had a weak motor.

    Returns:
        A copy of the model whose wind torque has a ``reason``, which says that the wind did not cause it. The same
        model if the vehicle did not cause the torque, or there is no wind torque.
    """
    if not vehicle_made_torque:
        return learned
    wind_torque = learned.wind_torque
    if wind_torque is None:
        return learned
    return learned.with_wind_torque(replace(wind_torque, reason=Fact(GradeReason.OWN_TORQUE)))


def _finding_lowered_by_override(finding: Finding, override: Fact) -> Finding:
    """Lowers the grade of a model from GOOD to LIMITED, since the flight that it was learned from is doubtful.

    Any lower grade is kept. The reason of the finding is made of two parts, of which one may be None:

    - The model's own reason for its grade. It is left out if the vehicle oscillates, since the estimates of the model
      then mean nothing.
    - The fault of the flight. It is left out if it did not lower the grade, unless it is an oscillation.

    Args:
        finding: the finding on the model alone: its grade for one purpose, and the reason.
        override: the fault that makes the flight doubtful, however good its model is.

    Returns:
        The finding. Its reason is a fact (coded finding) with both parts as the figures ``reason`` and ``override``.
    """
    is_lowered = finding.grade is Grade.GOOD
    is_oscillation = override.code is Override.OSCILLATION
    grade = Grade.LIMITED if is_lowered else finding.grade
    reason_of_model = None if is_oscillation else finding.reason
    stated_fault = override if is_lowered or is_oscillation else None
    reason = Fact(GradeReason.FLIGHT_DOUBTED, reason=reason_of_model, override=stated_fault)
    return finding._replace(grade=grade, reason=reason)


def _purpose_findings(learned: Learned, held_out: HeldOut | None) -> list[Finding]:
    """Judges what a model is good for: a finding, with a grade and a reason, for each purpose.

    Purposes are control effectiveness, damping and time constant, wind torque, prediction, and residuals. Without
    physical parameters the first three are not identifiable, for one reason.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        held_out: forecasts of windows that it was not trained on; without them, prediction is not judged.

    Returns:
        Findings in the order of these purposes.
    """
    physical = learned.physical
    if physical is None:
        reason = _first_reason(learned.physical_reason)
        not_identifiable = Grade.NOT_IDENTIFIABLE
        findings = [
            Finding(Purpose.CONTROL_EFFECTIVENESS, not_identifiable, reason),
            Finding(Purpose.DAMPING_AND_TIME_CONSTANT, not_identifiable, reason),
            Finding(Purpose.WIND_TORQUE, not_identifiable, reason),
        ]
    else:
        findings = [
            _effectiveness_finding(physical),
            _damping_finding(physical),
            _wind_finding(learned.wind_torque, physical),
        ]
    if held_out is not None:
        findings.append(_prediction_finding(held_out))
    findings.append(_residual_finding(learned))
    return findings


def _grade(parameter: str, relative_half_width: float, status: Status = Status.REPORTED) -> Grade:
    """Grades an estimate by its status and the width of its interval.

    It is GOOD if it is reported without bias and its interval is narrow, LIMITED if it is biased or uncertain, and NOT
    IDENTIFIABLE if the flight does not show it. A relative half width that is NaN, of an estimate of 0, counts as
    narrow.

    Args:
        parameter: name of the estimate, a key of ``MAX_RELATIVE_HALF_WIDTHS``.
        relative_half_width: half width of its 90 % interval over the estimate.
        status: status of the estimate.

    Returns:
        GOOD, LIMITED or NOT_IDENTIFIABLE.
    """
    if status == Status.NOT_IDENTIFIABLE:
        return Grade.NOT_IDENTIFIABLE
    is_uncertain = relative_half_width > MAX_RELATIVE_HALF_WIDTHS[parameter]
    return Grade.LIMITED if status == Status.BIASED or is_uncertain else Grade.GOOD


def _first_reason(reason: Fact | None) -> Fact:
    """Returns the most important reason why a physical parameter is not reported.

    Args:
        reason: the only reason, or a fact with the code ``SEVERAL_DOUBTS``, whose figure ``reason`` is the list of all
            reasons, the most important first. The type allows None, but a parameter that is not reported has a reason.
    """
    assert reason is not None
    if reason.code is ParameterDoubt.SEVERAL_DOUBTS:
        main_reason: Fact = reason.figures["reason"][0]
        return main_reason
    return reason


def _effectiveness_finding(physical: Physical) -> Finding:
    """Grades how well a flight shows the control effectiveness, the angular acceleration per motor command.

    The half width of the 90 % interval of the effectiveness, averaged over the motors, is compared with the estimate
    itself. The estimate may also be biased, or not identifiable from the flight (its status).

    Args:
        physical: estimates of the control effectiveness ("effect"), damping, motor time constant and delay of an axis.

    Returns:
        The finding: a grade and its reason. The reason is the relative half width, as the figure ``share``, or the most
        important doubt about the estimate, if there is one.
    """
    mean, half_width = physical.mean_effect()
    relative_half_width = half_width / mean
    status = physical.status["effect"]
    grade = _grade("effect", relative_half_width, status)
    if status == Status.REPORTED:
        reason = Fact(GradeReason.EFFECT_KNOWN, share=relative_half_width)
    else:
        reason = _first_reason(physical.reasons["effect"])
    return Finding(Purpose.CONTROL_EFFECTIVENESS, grade, reason)


def _damping_finding(physical: Physical) -> Finding:
    """Grades together how well a flight shows the rate damping and the motor time constant ("lag").

    Both describe how the rate follows a change of the command, and are identified together. The grade is GOOD if both
    are good, NOT IDENTIFIABLE if neither is identifiable, and LIMITED otherwise.

    Args:
        physical: control effectiveness, damping, motor time constant and delay of the axis.

    Returns:
        The finding: the grade and its reason. The reason has the half widths of the 90 % intervals divided by the
        estimates, as far as they are known, and the doubts about each. If neither parameter is identifiable, it is why.
    """
    half_widths = physical.interval()
    # A parameter whose estimate is 0 has no relative half width.
    relative_half_widths = {"damping": nan, "lag": nan}
    if physical.damping:
        relative_half_widths["damping"] = half_widths.damping / physical.damping
    if physical.lag:
        relative_half_widths["lag"] = half_widths.lag / physical.lag
    grades = [
        _grade(name, relative_half_width, physical.status[name])
        for name, relative_half_width in relative_half_widths.items()
    ]
    if all(grade is Grade.NOT_IDENTIFIABLE for grade in grades):
        reason = _why_motion_is_not_identifiable(physical)
        return Finding(Purpose.DAMPING_AND_TIME_CONSTANT, Grade.NOT_IDENTIFIABLE, reason)
    known_half_widths = []
    for name, relative_half_width in relative_half_widths.items():
        if isfinite(relative_half_width):
            known_half_widths.append((name, relative_half_width))
    reason = Fact(
        GradeReason.MOTION_KNOWN,
        shares=known_half_widths,
        doubts=_doubts_about(physical, names=list(relative_half_widths)),
    )
    are_both_good = all(grade is Grade.GOOD for grade in grades)
    grade = Grade.GOOD if are_both_good else Grade.LIMITED
    return Finding(Purpose.DAMPING_AND_TIME_CONSTANT, grade, reason)


def _why_motion_is_not_identifiable(physical: Physical) -> Fact:
    """Returns why a flight shows neither the rate damping nor the motor time constant.

    Args:
        physical: physical parameters of the axis, with the reasons why they are not identifiable.

    Returns:
        The most important reason, as a fact (coded finding). If it is that of the control effectiveness too, whose
        finding is shown above, the fact only says so, and the reason is not repeated.
    """
    reason = _first_reason(physical.reasons["damping"] or physical.reasons["lag"])
    effect_reason = physical.reasons["effect"]
    if effect_reason is not None and reason == _first_reason(effect_reason):
        return Fact(GradeReason.SAME_AS_EFFECT)
    return reason


def _doubts_about(physical: Physical, names: Sequence[str]) -> list[Fact]:
    """Lists why estimates of physical parameters are in doubt; those with the same reason are named together.

    Args:
        physical: physical parameters of the axis, with the status of each and the reason for it.
        names: names of the parameters to examine, such as "damping".

    Returns:
        A fact for each different doubt, with the names of the parameters; empty if all are reported without one.
    """
    names_by_doubt = dict[tuple[Status, Fact], list[str]]()
    for name in names:
        status = physical.status[name]
        if status != Status.REPORTED:
            doubt = (status, _first_reason(physical.reasons[name]))
            names_by_doubt.setdefault(doubt, []).append(name)
    return [
        Fact(GradeReason.PARAMETERS_DOUBTED, names=doubted_names, status=status, reason=reason)
        for (status, reason), doubted_names in names_by_doubt.items()
    ]


def _wind_finding(wind_torque: WindTorque | None, physical: Physical) -> Finding:
    """Judges how well the wind torque is known: the fraction of the torque that the motors do not make.

    It is NOT IDENTIFIABLE without the control effectiveness, and LIMITED if any physical parameter is doubtful.
    Otherwise the half width of the 90 % interval of its standard deviation decides, relative to that standard
    deviation.

    Args:
        wind_torque: the estimate, with its own ``reason`` if it is not resolved from the noise; None if the estimation
            failed.
        physical: the parameters with which the torque of the motors was computed.

    Returns:
        The grade, with its reason.
    """
    grade = Grade.NOT_IDENTIFIABLE
    doubtful_parameters = [
        name for name, status in physical.status.items() if status != Status.REPORTED
    ]
    if not physical.identifiable:
        reason = Fact(GradeReason.EFFECT_UNKNOWN)
    elif wind_torque is None:
        reason = Fact(GradeReason.WIND_NOT_ESTIMATED)
    elif wind_torque.reason is not None:
        reason = wind_torque.reason
    elif doubtful_parameters:
        grade = Grade.LIMITED
        reason = Fact(GradeReason.FOLLOWS_FROM_DOUBTED, names=doubtful_parameters)
    else:
        relative_half_width = coverage_factor() * wind_torque.scale_error
        grade = _grade("wind", relative_half_width)
        reason = Fact(GradeReason.WIND_SIZE_KNOWN, share=relative_half_width)
    return Finding(Purpose.WIND_TORQUE, grade, reason)


def _prediction_finding(held_out: HeldOut) -> Finding:
    """Judges how well a model predicts, by its forecasts of windows of the flight that it was not trained on.

    They are compared with two baselines, which forecast the constant mean, or hold the last sample. The grade is GOOD
    within all of the ``PREDICTION_LIMITS``, and NOT IDENTIFIABLE if the squared error is no less than the error of the
    better baseline. Otherwise it is LIMITED.

    Args:
        held_out: forecasts and baselines in the held-out windows.

    Returns:
        The grade, with the error ratio and the fractions of windows that were forecast worse than by each baseline.
    """
    best_baseline = held_out.best_baseline
    # Both error ratios are relative to the error of the constant mean, which cancels.
    error_ratio = held_out.error_ratio() / held_out.error_ratio(best_baseline)
    fraction_worse_than_mean = held_out.worse_shares[CONSTANT_MEAN]
    fraction_worse_than_last = held_out.worse_shares[HOLD_LAST]
    reason = Fact(
        GradeReason.FORECASTS_COMPARED,
        name=best_baseline,
        ratio=error_ratio if isfinite(error_ratio) else None,
        windows=len(held_out),
        worse=fraction_worse_than_mean,
        worse_than_last=fraction_worse_than_last,
    )
    limits = PREDICTION_LIMITS
    has_small_errors = (
        error_ratio <= limits.ratio
        and fraction_worse_than_mean <= limits.worse
        and fraction_worse_than_last <= limits.worse_than_last
    )
    has_honest_intervals = held_out.coverage >= limits.coverage
    has_enough_windows = len(held_out) >= limits.windows
    if has_small_errors and has_honest_intervals and has_enough_windows:
        grade = Grade.GOOD
    elif error_ratio < 1:
        grade = Grade.LIMITED
    else:
        grade = Grade.NOT_IDENTIFIABLE
    return Finding(Purpose.PREDICTION, grade, reason)


def _residual_finding(learned: Learned) -> Finding:
    """Judges a model by the residuals of its one-step predictions.

    The residuals of a model without missing dynamics are white, and not correlated with the command (L. Ljung, System
    Identification, 2nd ed., sec. 16.6). If they fail a test of that, the grade is LIMITED, and otherwise GOOD.

    Args:
        learned: the linear model that was learned from a flight, with its training data.

    Returns:
        The finding, with the largest correlations and the bounds that they were compared with.
    """
    rate_residuals = residuals(learned)
    outcome = rate_residuals.outcome
    autocorrelation, command_correlation = rate_residuals.largest_correlations
    reason = Fact(
        GradeReason.RESIDUALS_TESTED,
        outcome=outcome,
        autocorrelation=autocorrelation,
        correlation=command_correlation,
        bounds=rate_residuals.bounds,
    )
    grade = Grade.LIMITED if outcome is BoundTest.FAILED else Grade.GOOD
    return Finding(Purpose.RESIDUALS, grade, reason)


def model_warnings(learned: Learned, held_out: HeldOut | None) -> Iterator[Fact]:
    """Yields warnings that must be known before the model is used; nothing for most models.

    They are: folds of the cross-validation that failed, a 90 % band that holds too few samples, errors far above those
    that the model expects, and a model that is unstable.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        held_out: forecasts of windows that it was not trained on; None without them.
    """
    limits = PREDICTION_LIMITS
    if held_out is not None:
        for failure in held_out.failures:
            yield Fact(ForecastFact.PART_NOT_LEARNED, reason=failure)
        if held_out.coverage < limits.coverage:
            yield Fact(
                Caveat.BAND_TOO_NARROW,
                share=held_out.coverage,
                windows_are_few=len(held_out) < limits.windows,
            )
        if held_out.ratio_to_expected_error > limits.over_expected:
            yield Fact(Caveat.ERRORS_LARGER_THAN_EXPECTED, ratio=held_out.ratio_to_expected_error)
    if not learned.stable:
        yield Fact(Caveat.UNSTABLE_MODEL)


def next_step_for_model(purposes: Sequence[Finding]) -> Fact:
    """Returns the next step towards a better model, as a fact: a code from which reports make a sentence.

    Parameters that the flight did not excite come first: they need movements. Then come wide intervals, which more data
    narrow, and last bad forecasts, with which only the physical parameters are of use.

    Args:
        purposes: the grade of the model for each purpose. A purpose that was not judged counts as good.

    Returns:
        To fly movements that excite the axis, to fly longer, or to keep the physical parameters or the whole model.
    """
    grades = {finding.purpose: finding.grade for finding in purposes}
    effectiveness = grades.get(Purpose.CONTROL_EFFECTIVENESS, Grade.GOOD)
    damping = grades.get(Purpose.DAMPING_AND_TIME_CONSTANT, Grade.GOOD)
    prediction = grades.get(Purpose.PREDICTION, Grade.GOOD)
    if effectiveness is not Grade.GOOD or damping is Grade.NOT_IDENTIFIABLE:
        return Fact(NextStep.FLY_MOVEMENTS)
    if damping is not Grade.GOOD:
        return Fact(NextStep.FLY_LONGER)
    if prediction is not Grade.GOOD:
        return Fact(NextStep.KEEP_PARAMETERS)
    return Fact(NextStep.KEEP_MODEL)
