"""Findings: a bad result never looks good, and each limit holds at its edge."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_up_analysis import HOVER, analysis, held_out, model, physical

from mavdem import Flight
from mavdem.analysis.findings import (
    GOOD,
    LIMITED,
    NONE,
    PURPOSES,
    Finding,
    Residuals,
    findings_of,
    next_step,
    warnings_of,
)
from mavdem.condition.oscillation import Oscillation
from mavdem.dem.graybox.identifiability import PARAMETERS, IdentifiabilityFigures, identifiability
from mavdem.evaluate import HeldOut
from mavdem.health.in_flight import MotorAlarm
from mavdem.report.screen import parameter_reasons


def grades(*found: object) -> tuple[str, ...]:
    return tuple(one.grade for one in findings_of(*found).purposes)


@pytest.mark.parametrize(
    ("figures", "grade", "reason"),
    [
        (
            {},
            GOOD,
            "0.04 times the squared error of “hold last”; worse than the mean in 0 % of 40 windows, than",
        ),
        ({"forecast": 0.353}, GOOD, "0.5 times the squared error of “hold last”"),
        ({"forecast": 0.354}, LIMITED, "0.5 times the squared error of “hold last”"),
        ({"forecast": 0.6}, NONE, "1.4 times the squared error of “hold last”"),
        ({"forecast": np.nan}, NONE, "No model of a part could be learned"),
        ({"band": 0.05}, LIMITED, "0.04 times"),
        ({"count": 5}, GOOD, "0.04 times"),
        ({"count": 4}, LIMITED, "0.04 times"),
    ],
)
def test_prediction_is_good_only_beside_the_better_baseline_and_with_a_band_that_holds(
    figures, grade, reason
):
    found = findings_of(model(physical()), held_out(**figures)).purposes[3]
    assert (found.purpose, found.grade) == ("prediction", grade)
    assert found.reason.startswith(reason)


def worse_in(share: float, covered: float = 1.0) -> HeldOut:
    """A forecast that is worse than the mean in this share of windows; this share of the samples is in its band."""
    made = held_out(forecast=0.01, last=1.0)
    made.forecasts["forecast"][: round(share * 40)] = 1.01
    made.band[:] = np.where(
        np.arange(made.band.size).reshape(made.band.shape) < covered * made.band.size, 2.0, 0.0
    )
    return made


@pytest.mark.parametrize(("share", "covered"), [(0.1, 1.0), (0.0, 0.75)])
def test_a_few_worse_windows_and_a_band_that_holds_most_are_still_good(share, covered):
    assert grades(model(physical()), worse_in(share, covered))[3] == GOOD
    assert (
        grades(model(physical()), worse_in(share and 0.125, covered and covered - 0.01))[3]
        == LIMITED
    )


@pytest.mark.parametrize(
    ("share", "status", "expected"),
    [
        (0.149, {}, (GOOD, GOOD)),
        (0.151, {}, (LIMITED, GOOD)),
        (0.333, {}, (LIMITED, GOOD)),
        (0.334, {}, (LIMITED, LIMITED)),
        (0.05, {"effect": "biased"}, (LIMITED, GOOD)),
        (0.05, {"effect": "not identifiable"}, (NONE, GOOD)),
        (0.05, {"lag": "not identifiable"}, (GOOD, LIMITED)),
        (0.05, {"damping": "biased"}, (GOOD, LIMITED)),
        (0.05, {"damping": "not identifiable", "lag": "not identifiable"}, (GOOD, NONE)),
    ],
)
def test_parameters_are_good_as_far_as_their_intervals_and_status_say(share, status, expected):
    found = findings_of(model(physical(share, **status)), None).purposes
    assert tuple(one.grade for one in found[:2]) == expected
    for one, names in zip(found, ({"effect"}, {"damping", "lag"}), strict=False):
        assert ("why" in one.reason.lower()) == bool(
            names & set(status)
        ) and "And more" not in one.reason


def test_a_reason_is_given_once():
    known = physical(effect="not identifiable", damping="not identifiable", lag="not identifiable")
    known.reasons["damping"] = "Why effect. And otherwise."
    assert (
        findings_of(model(known)).purposes[1].reason
        == "For the same reason as control effectiveness."
    )


@pytest.mark.parametrize(
    ("changes", "grade"),
    [
        ({"scale_error": 0.151}, GOOD),
        ({"scale_error": 0.153}, LIMITED),  # 1.645 times that is more than 0.25
        ({"reason": "It is not resolved: why.", "resolved": False}, NONE),
    ],
)
def test_the_wind_is_good_only_where_it_is_resolved_and_its_size_known(changes, grade):
    assert grades(model(physical(), **changes), None)[2] == grade
    # It is what is left when the motors' torque is taken away.
    for doubtful in ("effect", "damping", "lag"):
        biased = grades(model(physical(**{doubtful: "biased"}), **changes), None)[2]
        assert biased == (NONE if grade == NONE else LIMITED)
    assert grades(model(physical(effect="not identifiable"), **changes), None)[2] == NONE


def test_the_next_step_is_that_of_the_first_purpose_that_is_not_served():
    for given, advice in (
        ((LIMITED, GOOD, GOOD, NONE), "calm air"),
        ((GOOD, LIMITED, GOOD, NONE), "for longer"),
        ((GOOD, GOOD, GOOD, NONE), "mavdem compare"),
        ((GOOD, GOOD, LIMITED), "reference"),
    ):
        found = [
            Finding(purpose, grade, "") for purpose, grade in zip(PURPOSES, given, strict=False)
        ]
        assert advice in next_step(found)


def saturated(share: float) -> SimpleNamespace:
    return SimpleNamespace(
        hover=replace(HOVER, at_upper_limit=(0.0, 0.0, share, 0.0)), oscillation=None
    )


CYCLE = Oscillation(
    axis="roll", frequency=7.1, rate=85.0, at_limit=0.4, growing=False, seconds=12.0
)
WEAK = MotorAlarm(70.0, 66.4, 1, "motor 1 (front right)", 0.24, 0.99, loss=(0.17, 0.39))


@pytest.mark.parametrize(
    ("known", "headline", "following"),
    [
        (
            {"alarms": (WEAK,)},
            "Motor 1 (front right) lost 17 to 39 % of its thrust at 66 s.",
            "Do not fly before motor 1",
        ),
        (
            {"condition": saturated(0.86)},
            "Motor 3 is at its upper limit 86 % of the time.",
            "Do not fly in wind before",
        ),
        (
            {"consistency": 0.7},
            "Angle and rate contradict each other.",
            "Log attitude and rates faster",
        ),
        (
            {"condition": SimpleNamespace(hover=HOVER, oscillation=CYCLE)},
            "Oscillates at 7.1 Hz: do not fly.",
            "Do not fly: check frame type, gains and motor order.",
        ),
    ],
)
def test_what_overrides_leaves_nothing_good_and_decides_what_to_do(known, headline, following):
    sound = findings_of(
        model(physical()), held_out(), SimpleNamespace(hover=HOVER, oscillation=None), watched=True
    )
    assert {one.grade for one in sound.purposes} == {GOOD} and "reference" in sound.next_step
    assert sound.headline == "Healthy."
    found = findings_of(
        model(physical()),
        held_out(),
        **({"condition": SimpleNamespace(hover=HOVER, oscillation=None)} | known),
    )
    assert found.headline == headline and found.next_step.startswith(following)
    assert GOOD not in {one.grade for one in found.purposes} and "reference" not in found.next_step


def test_a_motor_beyond_the_size_of_a_fault_is_no_reference_and_limits_are_no_reason_beside_an_oscillation():
    uneven = replace(HOVER, trim_share=(0.97, 0.97, 1.09, 0.97))
    found = findings_of(
        model(physical()), held_out(), SimpleNamespace(hover=uneven, oscillation=None), watched=True
    )
    assert (
        found.headline == "Motor 3 works 9 % harder than the mean of all."
        and found.next_step.startswith("Inspect")
    )
    assert GOOD not in {one.grade for one in found.purposes}
    even = replace(HOVER, trim_share=(0.98, 0.98, 1.06, 0.98))
    assert not findings_of(condition=SimpleNamespace(hover=even, oscillation=None)).overrides
    stopped = SimpleNamespace(
        hover=replace(uneven, at_upper_limit=(0.0, 0.3, 0.0, 0.0)), oscillation=CYCLE
    )
    found = findings_of(model(physical(effect="not identifiable")), None, stopped)
    assert {one.reason for one in found.purposes} == {"Oscillates at 7.1 Hz: do not fly."} and len(
        found.overrides
    ) == 1


def test_a_step_of_the_torque_leaves_neither_effectiveness_nor_wind_good():
    known = SimpleNamespace(hover=replace(HOVER, trim_share=(1.0,) * 4), oscillation=None)
    flights = [
        Flight(
            27.0 + 0.5 * np.arange(9),
            np.zeros((9, 4)),
            np.random.default_rng(0).standard_normal((9, 2)),
        )
    ]
    found = findings_of(
        model(physical(), step=(2, -5.7)), held_out(), known, flights=flights, watched=True
    )
    assert [one.grade for one in found.purposes[:4]] == [LIMITED, GOOD, LIMITED, GOOD]
    assert "by -327 °/s² at 28 s" in found.headline
    assert "propellers and the load" in found.next_step and "ealthy" not in found.headline


def test_the_limit_of_saturation_is_a_twentieth_of_the_time():
    assert (
        findings_of(condition=saturated(0.05)).overrides
        == ()
        != findings_of(condition=saturated(0.051)).overrides
    )


def test_residuals_that_are_far_from_white_are_said():
    learned = model(physical())
    slow = np.convolve(learned.record.outputs[:, 1], np.ones(10) / 3, "same")
    learned.record.outputs[:, 1] = slow
    found = findings_of(learned, held_out())
    assert found.purposes[-1].grade == LIMITED and found.purposes[-1].reason.startswith(
        "Not white: "
    )
    # held-out windows count more
    assert "reference" in found.next_step and "forecasts" not in found.next_step


def test_residuals_are_not_white_beyond_three_times_the_bound():
    for size in (0.087, 0.093):
        auto = np.array([1.0, size, 0.0])
        none = np.zeros(3)
        assert Residuals(none, none, auto, none, (0.03, 0.04)).white == (size < 0.09)


def test_a_model_alone_says_nothing_of_motors_that_it_does_not_know():
    assert findings_of(model(physical())).headline == ""
    flight = Flight(
        0.1 * np.arange(999), np.zeros((999, 4)), np.random.default_rng(0).standard_normal((999, 2))
    )
    assert findings_of(model(physical()), flights=[flight]).headline == "Well damped."
    assert (
        findings_of(condition=SimpleNamespace(hover=None, oscillation=None)).headline
        == "Motor outputs not known."
    )


def test_under_what_overrides_reasons_keep_their_figures_and_ask_for_nothing():
    sds, none, ranges = (dict.fromkeys(PARAMETERS, size) for size in (0.6, 0.0, 0.3))
    statuses, reasons = identifiability(
        IdentifiabilityFigures(0.46, 0.5, sds, none, ranges, 1.0, 0.0, 0.02)
    )
    assert "have at most 25 %" in reasons["effect"] and "%" not in " ".join(
        reasons.values()
    ).replace(" %", "")
    known = physical(**{name: status for name, status in statuses.items() if status != "reported"})
    known.reasons |= reasons
    free = findings_of(model(known), held_out()).purposes
    found = findings_of(model(known), held_out(), saturated(0.86))
    assert found.purposes[0].reason.startswith("Wind and noise have 46 % of the torque's")
    assert (
        found.purposes[3].reason == f"{free[3].reason} {found.headline}" and "fly" in free[0].reason
    )
    said = [one.reason for one in found.purposes] + parameter_reasons(known, doubted=True)
    assert not re.search(r"\b(fly|steer|record|log)\b", " ".join(said), re.IGNORECASE)


def test_warnings_are_only_where_they_mean_something():
    learned = model(physical())
    assert not warnings_of(learned, held_out()) and not warnings_of(
        learned, held_out(expected=0.00334)
    )
    (band,) = warnings_of(learned, held_out(band=0.05))
    assert "held 0 % of the held-out samples" in band
    (surprise,) = warnings_of(learned, held_out(expected=0.00333))
    assert "3.0 times the expected squared error" in surprise
    unstable = SimpleNamespace(stable=False, physical=None)
    assert warnings_of(unstable, None) == (
        "The model is unstable: long forecasts grow without bound.",
    )


def test_why_there_is_no_model_begins_with_what_overrides_and_advises_no_flight():
    found = replace(
        analysis(physical()), learned=None, reason="No settled flight.", remedy="Fly half a minute."
    )
    found = replace(found, condition=SimpleNamespace(hover=HOVER, oscillation=CYCLE))
    assert found.refusal.reason == "Oscillates at 7.1 Hz: do not fly. No settled flight."
    assert found.refusal.remedy == "Do not fly: check frame type, gains and motor order."
