"""Findings: a bad result never looks good, and each limit holds at its edge."""

from dataclasses import replace

import numpy as np
from made_up_analysis import HOVER, held_out, model, physical
from partial_records import partial_record
from pytest import approx, mark
from refusals import prose

from mavdem.assessment.axis.findings import (
    Finding,
    model_findings,
    model_warnings,
    next_step_for_model,
    with_vehicle_made_torque_marked,
)
from mavdem.assessment.axis.residuals import Residuals
from mavdem.assessment.condition import Condition
from mavdem.dataset.segments import Segment
from mavdem.dem import Learned
from mavdem.documents import vehicle
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import (
    BoundTest,
    Caveat,
    Grade,
    GradeReason,
    InShort,
    NextStep,
    Override,
    Purpose,
)
from mavdem.facts.forecasts import ForecastFact
from mavdem.facts.identifiability import Status
from mavdem.facts.motors import TrimFact
from mavdem.loops.limit_cycles import Oscillation
from mavdem.motors.motor_changes import MotorChange
from mavdem.report.screen import parameter_reasons

GOOD, LIMITED, NONE = Grade
EFFECT, MOTION, WIND, PREDICTION, RESIDUALS = Purpose


def purpose_finding_of(purpose, *arguments, **options):
    """Returns the finding on one purpose of a model; the other arguments are those of ``model_findings``."""
    return next(
        purpose_finding
        for purpose_finding in model_findings(*arguments, **options).purposes
        if purpose_finding.purpose is purpose
    )


def condition_with(oscillation=None, **hover):
    """Returns the condition of a vehicle whose hover has other figures of its motors."""
    return Condition(60.0, hover=replace(HOVER, **hover), oscillation=oscillation)


@mark.parametrize(
    "figures, grade, ratio",
    [
        ({}, GOOD, 0.04),
        ({"forecast": 0.353}, GOOD, 0.498),
        ({"forecast": 0.354}, LIMITED, 0.501),
        ({"forecast": 0.6}, NONE, 1.44),
        ({"forecast": np.nan}, NONE, None),
        ({"band": 0.05}, LIMITED, 0.04),
        ({"count": 5}, GOOD, 0.04),
        ({"count": 4}, LIMITED, 0.04),
    ],
)
def test_prediction_is_good_only_beside_the_better_baseline_with_a_band_that_holds(
    figures, grade, ratio
):
    """The error of the forecasts, the share within their band or their number differs in each case."""
    finding = purpose_finding_of(PREDICTION, model(physical()), held_out(**figures))
    assert (finding.grade, finding.reason.code) == (grade, GradeReason.FORECASTS_COMPARED)
    assert finding.reason.figures["ratio"] == (ratio and approx(ratio, abs=0.001))
    if ratio is not None:
        assert finding.reason.figures["name"] == "hold last"


@mark.parametrize(
    "share, covered, grade",
    [(0.1, 1.0, GOOD), (0.125, 1.0, LIMITED), (0.0, 0.75, GOOD), (0.0, 0.74, LIMITED)],
)
def test_a_few_worse_windows_and_a_band_that_holds_most_are_still_good(share, covered, grade):
    windows = held_out(forecast=0.01, last=1.0)
    forecast = windows.forecasts["forecast"].copy()
    forecast[: round(share * 40)] = 1.01
    samples = np.arange(windows.band.size).reshape(windows.band.shape)
    band = np.where(samples < covered * windows.band.size, 2.0, 0.0)
    forecasts = windows.forecasts | {"forecast": forecast}
    windows = replace(windows, forecasts=forecasts, band=band)
    assert purpose_finding_of(PREDICTION, model(physical()), windows).grade is grade


@mark.parametrize(
    "share, expected",
    {
        0.149: (GOOD, GOOD),
        0.151: (LIMITED, GOOD),
        0.333: (LIMITED, GOOD),
        0.334: (LIMITED, LIMITED),
    }.items(),
)
def test_parameters_are_good_up_to_a_width_of_their_intervals(share, expected):
    """The grade depends on the half width of the intervals relative to the values."""
    learned = model(physical(share))
    assert (
        purpose_finding_of(EFFECT, learned).grade,
        purpose_finding_of(MOTION, learned).grade,
    ) == expected


def test_parameters_doubted_for_one_reason_are_named_together_and_the_reason_once():
    parameters = physical(damping=Status.BIASED, lag=Status.BIASED)
    parameters.reasons.update(dict.fromkeys(("damping", "lag"), prose("Why.")))
    doubted = purpose_finding_of(MOTION, model(parameters))
    assert doubted.grade is LIMITED
    (doubt,) = doubted.reason.figures["doubts"]
    assert (doubt.code, doubt.figures["names"]) == (
        GradeReason.PARAMETERS_DOUBTED,
        ("damping", "lag"),
    )
    parameters = physical(**dict.fromkeys(("effect", "damping", "lag"), Status.NOT_IDENTIFIABLE))
    parameters.reasons["damping"] = parameters.reasons["effect"]
    assert purpose_finding_of(MOTION, model(parameters)).reason.code is GradeReason.SAME_AS_EFFECT


@mark.parametrize(
    "changes, grade, code",
    [
        ({"scale_error": 0.151}, GOOD, GradeReason.WIND_SIZE_KNOWN),
        ({"scale_error": 0.153}, LIMITED, GradeReason.WIND_SIZE_KNOWN),  # 1.645 times: above 0.25
        ({"reason": Fact(GradeReason.OWN_TORQUE), "resolved": False}, NONE, GradeReason.OWN_TORQUE),
    ],
)
def test_the_wind_is_good_only_where_it_is_resolved_and_its_size_known(changes, grade, code):
    """The wind torque is graded by the error of its scale, and by the parameters that it follows from."""
    finding = purpose_finding_of(WIND, model(physical(), **changes))
    assert (finding.grade, finding.reason.code) == (grade, code)
    # It is what is left when the motors' torque is taken away.
    for doubtful in ("effect", "damping", "lag"):
        biased = purpose_finding_of(WIND, model(physical(**{doubtful: Status.BIASED}), **changes))
        assert biased.grade is (NONE if grade is NONE else LIMITED)
        if grade is not NONE:
            assert biased.reason.code is GradeReason.FOLLOWS_FROM_DOUBTED
        else:
            assert biased.reason.code is not GradeReason.FOLLOWS_FROM_DOUBTED
    unknown = purpose_finding_of(WIND, model(physical(effect=Status.NOT_IDENTIFIABLE), **changes))
    assert (unknown.grade, unknown.reason.code) == (NONE, GradeReason.EFFECT_UNKNOWN)
    learned = model(physical())
    learned = learned.with_wind_torque(None)
    assert purpose_finding_of(WIND, learned).reason.code is GradeReason.WIND_NOT_ESTIMATED


@mark.parametrize(
    "grades, code",
    [
        ((LIMITED, GOOD, GOOD, NONE), NextStep.FLY_MOVEMENTS),
        ((GOOD, NONE, GOOD, NONE), NextStep.FLY_MOVEMENTS),
        ((GOOD, LIMITED, GOOD, NONE), NextStep.FLY_LONGER),
        ((GOOD, GOOD, GOOD, NONE), NextStep.KEEP_PARAMETERS),
        ((GOOD, GOOD, LIMITED), NextStep.KEEP_MODEL),
    ],
)
def test_the_next_step_is_that_of_the_first_purpose_that_is_not_served(grades, code):
    purposes = zip(Purpose, grades, strict=False)
    assert next_step_for_model([Finding(*finding, prose("")) for finding in purposes]).code is code


CYCLE = Oscillation(
    axis="roll",
    frequency=7.1,
    rate=85.0,
    at_limit=0.4,
    growing=False,
    seconds=12.0,
    span=Segment(0, 10.0, 22.0),
)
WEAK = MotorChange(70.0, 66.4, 1, "motor 1 (front right)", 0.24, 0.99, loss=(0.17, 0.39))
SATURATED = {"at_upper_limit": (0.0, 0.0, 0.86, 0.0), "trim_share": (0.9, 0.9, 1.3, 0.9)}
DEVIATION = {"worst": "motor 3 (front left)", "deviation": 0.17, "half": 0.03}
TWISTED = Fact(
    TrimFact.TRIM_OF_YAW, Level.WATCH, share=0.16, probability=0.97, assumed=False, **DEVIATION
)


@mark.parametrize(
    "known, code, subject",
    [
        ({"alarms": (WEAK,)}, Override.MOTORS, "motor 1 (front right)"),
        ({"condition": condition_with(**SATURATED)}, Override.SATURATION, "motor 3 (front left)"),
        ({"trim": TWISTED}, Override.TRIM, ""),
        ({"consistency": 0.7}, Override.DATA, ""),
        (
            {"condition": condition_with(CYCLE, **SATURATED), "trim": TWISTED},
            Override.OSCILLATION,
            "roll",
        ),
    ],
)
def test_what_overrides_leaves_nothing_good_and_decides_what_to_do(known, code, subject):
    """A model is good for each purpose.

    A fault of the vehicle or of the data limits every purpose and becomes the headline.
    """
    free = {"condition": condition_with()}
    sound = model_findings(model(physical()), held_out(), **free)
    assert {purpose_finding.grade for purpose_finding in sound.purposes} == {GOOD}
    assert next_step_for_model(sound.purposes).code is NextStep.KEEP_MODEL
    doubted = model_findings(model(physical()), held_out(), **(free | known))
    (override,) = doubted.overrides  # It explains the other faults.
    assert (override.code, override.subject) == (code, subject)
    summary = str(Fact(InShort.OVERRIDDEN, reason=override))
    assert vehicle.Override.model_validate(override).headline == summary
    for before, after in zip(sound.purposes, doubted.purposes, strict=True):
        assert (after.grade, after.reason.code) == (LIMITED, GradeReason.FLIGHT_DOUBTED)
        reason = None if code is Override.OSCILLATION else before.reason
        assert dict(after.reason.figures) == {"reason": reason, "override": override}


def test_the_largest_of_what_a_motor_lost_is_said_with_its_own_time_and_its_end():
    worse = WEAK._replace(time=90.0, onset_time=80.0, size=0.4, loss=(0.3, 0.5))
    sound = WEAK._replace(time=95.0, onset_time=94.0, size=0.0)
    smaller_loss = WEAK._replace(motor=2, name="motor 2 (rear left)", size=0.3)
    first, second = model_findings(alarms=(WEAK, worse, smaller_loss, sound)).overrides
    assert (first.time, first.end_time, first.figures["loss"]) == (80.0, 94.0, (0.3, 0.5))
    assert (second.subject, second.end_time) == (smaller_loss.name, None)


@mark.parametrize(
    "hover, overridden",
    [
        ({"at_upper_limit": (0.0, 0.0, 0.05, 0.0)}, False),
        ({"at_upper_limit": (0.0, 0.0, 0.051, 0.0)}, True),
        ({"trim_share": (0.98, 0.98, 1.06, 0.98)}, False),
    ],
)
def test_saturation_and_trim_override_grades_beyond_their_limits(hover, overridden):
    if overridden:
        assert model_findings(condition=condition_with(**hover)).overrides
    else:
        assert not model_findings(condition=condition_with(**hover)).overrides


def test_residuals_far_from_white_are_a_finding():
    learned = model(physical())
    slow = np.convolve(learned.record.outputs[:, 1], np.ones(10) / 3, "same")
    learned.record.outputs[:, 1] = slow
    findings = model_findings(learned, held_out())
    assert findings.grade(RESIDUALS) is LIMITED
    reason = findings.purposes[-1].reason
    assert (
        reason.code is GradeReason.RESIDUALS_TESTED
        and reason.figures["outcome"] is BoundTest.FAILED
    )
    # Held-out windows count more than the test of the residuals.
    assert next_step_for_model(findings.purposes).code is NextStep.KEEP_MODEL


@mark.parametrize(
    "size, outcome",
    [(0.03, BoundTest.PASSED), (0.087, BoundTest.NEARLY), (0.093, BoundTest.FAILED)],
)
def test_residuals_are_not_white_beyond_three_times_the_bound(size, outcome):
    none = np.zeros(3)
    assert Residuals(none, none, np.array([1.0, size, 0.0]), none, (0.03, 0.04)).outcome is outcome


def test_under_what_overrides_reasons_keep_their_figures_and_ask_for_nothing():
    biased = physical(effect=Status.BIASED)
    biased.reasons["effect"] = prose("Wind has 46 % of it.", "Fly in calm air.")
    assert "calm air" in str(parameter_reasons(biased))
    assert parameter_reasons(biased, is_doubtful=True) == [
        "Control effectiveness biased: Wind has 46 % of it."
    ]
    doubted = purpose_finding_of(EFFECT, model(biased), None, condition_with(**SATURATED)).reason
    assert doubted.figures["reason"] == biased.reasons["effect"] and doubted.remedy == ""


def test_warnings_are_only_where_they_mean_something():
    """A narrow band, errors larger than expected, a failed part or an unstable model give one warning each."""
    learned = model(physical())
    assert not [
        *model_warnings(learned, held_out()),
        *model_warnings(learned, held_out(expected=0.00334)),
    ]
    (band,) = model_warnings(learned, held_out(band=0.05))
    assert (band.code, band.figures["share"]) == (Caveat.BAND_TOO_NARROW, 0.0)
    (larger,) = model_warnings(learned, held_out(expected=0.00333))
    assert larger.code is Caveat.ERRORS_LARGER_THAN_EXPECTED
    assert larger.figures["ratio"] == approx(3.0, abs=0.01)
    failed = replace(held_out(), failures=(prose("It is too short."),))
    assert [warning.code for warning in model_warnings(learned, failed)] == [
        ForecastFact.PART_NOT_LEARNED
    ]
    unstable = partial_record(Learned, stable=False, physical=None)
    assert [warning.code for warning in model_warnings(unstable, None)] == [Caveat.UNSTABLE_MODEL]


def test_the_torque_of_a_vehicle_that_oscillates_is_not_the_winds():
    learned = model(physical())
    assert with_vehicle_made_torque_marked(learned, vehicle_made_torque=False) is learned
    marked = with_vehicle_made_torque_marked(learned, vehicle_made_torque=True)
    assert marked.wind_torque.reason == Fact(GradeReason.OWN_TORQUE)
