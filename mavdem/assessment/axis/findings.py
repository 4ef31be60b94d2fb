"""Findings: what a flight says of its vehicle and what its model is good for, made once and shown everywhere.

docs/report.md has the scale. What is estimated is graded by the half width of its 90 % interval (``HALF_WIDTH``) and by
its status, forecasts by windows that no model saw (``PREDICTION_LIMITS``). What makes the flight itself doubtful
overrides all grades (``mavdem.assessment.axis.overrides``).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite, nan
from typing import NamedTuple

from mavdem.assessment.axis.overrides import overrides_of
from mavdem.assessment.axis.residuals import residuals
from mavdem.assessment.condition import Condition
from mavdem.confidence import coverage_factor
from mavdem.dem import Learned
from mavdem.experiments.held_out import BASELINES, HeldOut
from mavdem.facts import Fact, Facts
from mavdem.facts.assessment import (
    Because,
    BoundTest,
    Caveat,
    Grade,
    NextStep,
    Override,
    Purpose,
)
from mavdem.facts.forecasts import Forecasts
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ParameterDoubt
from mavdem.motors.loss_detection import MotorAlarm
from mavdem.plant import Physical, WindTorque

HALF_WIDTH = {"effect": 0.15, "damping": 1 / 3, "lag": 1 / 3, "wind": 0.25}
"""Of the 90 % interval over the estimate, up to which it is GOOD; of the wind torque that of its standard deviation.
The effect decides what the wind torque is; damping and lag matter less and are harder to identify."""


DECIDING = (
    Purpose.CONTROL_EFFECTIVENESS,
    Purpose.DAMPING_AND_TIME_CONSTANT,
    Purpose.PREDICTION,
)
"""What decides the next step, the first first."""


class PredictionLimits(NamedTuple):
    """When a prediction is GOOD; each limit is from docs/report.md, and a test holds it at its edge."""

    ratio: float = 0.5  # of the squared error of the better baseline, at most
    worse: float = 0.1  # share of the windows that may be worse than the constant mean
    # and than the last sample held, which near the trim is hard to beat
    worse_than_last: float = 0.25
    coverage: float = 0.75  # of a 90 % band, at least; below, a warning says so
    # squared error over the one to expect, above which a warning says so
    over_expected: float = 3.0
    windows: int = 5  # fewest; where in a flight a single one is decides its error


PREDICTION_LIMITS = PredictionLimits()


class Finding(NamedTuple):
    """A ``purpose``, whether the model serves it, and why."""

    purpose: Purpose
    grade: Grade
    reason: Fact


class Findings(NamedTuple):
    """What a model is good for, as every screen, page and document shows it."""

    overrides: Facts  # what makes the flight itself doubtful, the worst first
    purposes: tuple[Finding, ...]  # graded; none without a model
    warnings: Facts  # what must be known before the model is used

    def grade(self, purpose: Purpose) -> Grade | None:
        """Returns how well the model serves a ``purpose``; None where that was not judged."""
        return next((rated.grade for rated in self.purposes if rated.purpose is purpose), None)


def findings_of(
    learned: Learned | None = None,
    held_out: HeldOut | None = None,
    condition: Condition | None = None,
    alarms: Sequence[MotorAlarm] = (),
    consistency: float | None = None,
    trim: Fact | None = None,
) -> Findings:
    """Returns the findings of a flight, of which each part may be missing.

    Args:
        learned, held_out: the model, and forecasts of windows that no model saw.
        condition: of the vehicle.
        alarms: lasting changes of the motors' balance.
        consistency: share of the angle's changes that the rates explain.
        trim: how even the motors work.
    """
    overrides = overrides_of(condition, alarms, None if learned is None else consistency, trim)
    if learned is None:
        return Findings(overrides, (), ())
    purposes = tuple(_purposes(learned, held_out))
    if overrides:
        purposes = tuple(_doubted(finding, overrides[0]) for finding in purposes)
    return Findings(overrides, purposes, tuple(warnings_of(learned, held_out)))


def disown_torque(learned: Learned, is_own: bool) -> Learned:
    """Returns ``learned``, whose wind torque, where it ``is_own``, has the reason why it is not the wind's."""
    torque = learned.wind_torque
    if not is_own or torque is None:
        return learned
    return learned.with_wind_torque(replace(torque, reason=Fact(Because.OWN_TORQUE)))


def _doubted(finding: Finding, override: Fact) -> Finding:
    """Not GOOD, and what the override is where it was; of a flight that oscillates without figures of its own."""
    is_good = finding.grade is Grade.GOOD
    oscillates = override.code is Override.OSCILLATION
    reason = Fact(
        Because.FLIGHT_DOUBTED,
        because=None if oscillates else finding.reason,
        override=override if oscillates or is_good else None,
    )
    return finding._replace(grade=Grade.LIMITED if is_good else finding.grade, reason=reason)


def _purposes(learned: Learned, held_out: HeldOut | None) -> Iterator[Finding]:
    """The findings on each purpose; on prediction only with ``held_out`` windows."""
    physical = learned.physical
    if physical is None:
        unknown = Grade.NOT_IDENTIFIABLE, _because(learned.physical_reason)
        yield Finding(Purpose.CONTROL_EFFECTIVENESS, *unknown)
        yield Finding(Purpose.DAMPING_AND_TIME_CONSTANT, *unknown)
        yield Finding(Purpose.WIND_TORQUE, *unknown)
    else:
        yield _effect(physical)
        yield _motion(physical)
        yield _wind(learned.wind_torque, physical)
    if held_out is not None:
        yield _prediction(held_out)
    shown = residuals(learned)
    autocorrelation, across = shown.largest
    reason = Fact(
        Because.RESIDUALS_TESTED,
        outcome=shown.outcome,
        autocorrelation=autocorrelation,
        correlation=across,
        bounds=shown.bounds,
    )
    is_white = shown.outcome is not BoundTest.FAILED
    yield Finding(Purpose.RESIDUALS, Grade.GOOD if is_white else Grade.LIMITED, reason)


def _grade(name: str, share: float, status: Status = Status.REPORTED) -> Grade:
    """The grade of an estimate by its ``status`` and the half width of its interval, as a ``share`` of it."""
    if status == Status.NOT_IDENTIFIABLE:
        return Grade.NOT_IDENTIFIABLE
    is_limited = status == Status.BIASED or share > HALF_WIDTH[name]
    return Grade.LIMITED if is_limited else Grade.GOOD


def _because(reason: Fact | None) -> Fact:
    """The ``reason`` of what is not reported: there always is one; the first of several."""
    assert reason is not None
    first = reason
    if reason.code is ParameterDoubt.SEVERAL_DOUBTS:
        first = reason.figures["because"][0]
    return first


def _effect(physical: Physical) -> Finding:
    mean, half = physical.mean_effect()
    status = physical.status["effect"]
    reason = Fact(Because.EFFECT_KNOWN, share=half / mean)
    if status != Status.REPORTED:
        reason = _because(physical.reasons["effect"])
    return Finding(Purpose.CONTROL_EFFECTIVENESS, _grade("effect", half / mean, status), reason)


def _motion(physical: Physical) -> Finding:
    half = physical.interval()
    values = {"damping": physical.damping, "lag": physical.lag}
    shares = {name: getattr(half, name) / value if value else nan for name, value in values.items()}
    grades = {_grade(name, share, physical.status[name]) for name, share in shares.items()}
    if grades == {Grade.NOT_IDENTIFIABLE}:
        reason = _because(physical.reasons["damping"] or physical.reasons["lag"])
        effect = physical.reasons["effect"]
        if effect is not None and reason == _because(effect):
            reason = Fact(Because.SAME_AS_EFFECT)
        return Finding(Purpose.DAMPING_AND_TIME_CONSTANT, Grade.NOT_IDENTIFIABLE, reason)
    doubts = dict[tuple[Status, Fact], list[str]]()
    for name in values:
        if (status := physical.status[name]) != Status.REPORTED:
            doubts.setdefault((status, _because(physical.reasons[name])), []).append(name)
    reason = Fact(
        Because.MOTION_KNOWN,
        shares=[share for share in shares.items() if isfinite(share[1])],
        doubts=[
            Fact(Because.PARAMETERS_DOUBTED, names=names, status=status, because=because)
            for (status, because), names in doubts.items()
        ],
    )
    grade = Grade.GOOD if grades == {Grade.GOOD} else Grade.LIMITED
    return Finding(Purpose.DAMPING_AND_TIME_CONSTANT, grade, reason)


def known_wind(wind: WindTorque | None, physical: Physical | None) -> WindTorque | None:
    """Returns the ``wind`` torque where it is resolved and the effect among ``physical`` is identifiable."""
    if wind is None or wind.reason is not None or physical is None or not physical.identifiable:
        return None
    return wind


def _wind(wind: WindTorque | None, physical: Physical) -> Finding:
    grade = Grade.NOT_IDENTIFIABLE
    if not physical.identifiable:
        # The torque of the wind is what is left when that of the motors is taken away.
        reason = Fact(Because.EFFECT_UNKNOWN)
    elif wind is None:
        reason = Fact(Because.WIND_NOT_ESTIMATED)
    elif wind.reason is not None:
        reason = wind.reason
    elif doubted := [name for name, status in physical.status.items() if status != Status.REPORTED]:
        grade = Grade.LIMITED
        reason = Fact(Because.FOLLOWS_FROM_DOUBTED, names=doubted)
    else:
        half = coverage_factor() * wind.scale_error
        grade = _grade("wind", half)
        reason = Fact(Because.WIND_SIZE_KNOWN, share=half)
    return Finding(Purpose.WIND_TORQUE, grade, reason)


def _prediction(held_out: HeldOut) -> Finding:
    limits = PREDICTION_LIMITS
    best = held_out.best_baseline
    ratio = held_out.error_ratio() / held_out.error_ratio(best)
    worse, than_last = (float((held_out.error_ratios(name) > 1).mean()) for name in BASELINES)
    reason = Fact(
        Because.FORECASTS_COMPARED,
        name=best,
        ratio=ratio if isfinite(ratio) else None,
        windows=len(held_out),
        worse=worse,
        worse_than_last=than_last,
    )
    is_good = (
        ratio <= limits.ratio
        and worse <= limits.worse
        and than_last <= limits.worse_than_last
        and held_out.coverage >= limits.coverage
        and len(held_out) >= limits.windows
    )
    grade = Grade.GOOD if is_good else Grade.LIMITED if ratio < 1 else Grade.NOT_IDENTIFIABLE
    return Finding(Purpose.PREDICTION, grade, reason)


def warnings_of(learned: Learned, held_out: HeldOut | None) -> Iterator[Fact]:
    """Yields what must be known before the model is used; mostly nothing."""
    limits = PREDICTION_LIMITS
    if held_out is not None:
        for failure in held_out.failures:
            yield Fact(Forecasts.PART_NOT_LEARNED, because=failure)
        if held_out.coverage < limits.coverage:
            few = len(held_out) < limits.windows
            share = held_out.coverage
            yield Fact(Caveat.BAND_TOO_NARROW, share=share, windows_are_few=few)
        if held_out.over_expected > limits.over_expected:
            ratio = held_out.over_expected
            yield Fact(Caveat.ERRORS_LARGER_THAN_EXPECTED, ratio=ratio)
    if not learned.stable:
        yield Fact(Caveat.UNSTABLE_MODEL)


def next_step(purposes: Sequence[Finding]) -> Fact:
    """Returns what to do next, by the graded ``purposes``: the first that is not served decides."""
    grades = {finding.purpose: finding.grade for finding in purposes}
    effect, motion, prediction = (grades.get(purpose, Grade.GOOD) for purpose in DECIDING)
    if effect is not Grade.GOOD or motion is Grade.NOT_IDENTIFIABLE:
        return Fact(NextStep.FLY_MOVEMENTS)
    if motion is not Grade.GOOD:
        return Fact(NextStep.FLY_LONGER)
    return Fact(NextStep.KEEP_MODEL if prediction is Grade.GOOD else NextStep.KEEP_PARAMETERS)
