"""Findings: a bad result never looks good, and each limit holds at its edge."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_up_analysis import held_out, model, physical

from mavdem.analysis.findings import GOOD, LIMITED, NONE, PURPOSES, Finding, findings, next_step, warnings_of
from mavdem.evaluate import HeldOut


def grades(*found: object) -> tuple[str, ...]:
    return tuple(one.grade for one in findings(*found))


@pytest.mark.parametrize(
    ("figures", "grade", "reason"),
    [
        ({}, GOOD, "0.04 times the squared error of “hold last”; worse than the mean in 0 % of 40 windows."),
        ({"forecast": 0.353}, GOOD, "0.5 times the squared error of “hold last”"),
        ({"forecast": 0.354}, LIMITED, "0.5 times the squared error of “hold last”"),
        ({"forecast": 0.6}, NONE, "1.4 times the squared error of “hold last”"),
        ({"forecast": np.nan}, NONE, "No model of a part could be learned"),
        ({"band": 0.05}, LIMITED, "0.04 times"),
        ({"count": 5}, GOOD, "0.04 times"),
        ({"count": 4}, LIMITED, "0.04 times"),
    ],
)
def test_prediction_is_good_only_beside_the_better_baseline_and_with_a_band_that_holds(figures, grade, reason):
    found = findings(model(physical()), held_out(**figures))[-1]
    assert (found.purpose, found.grade) == ("prediction", grade)
    assert found.reason.startswith(reason)


def worse_in(share: float, covered: float = 1.0) -> HeldOut:
    """A forecast that is worse than the mean in this share of windows; this share of the samples is in its band."""
    made = held_out(forecast=0.01, last=1.0)
    made.forecasts["forecast"][: round(share * 40)] = 1.01
    made.band[:] = np.where(np.arange(made.band.size).reshape(made.band.shape) < covered * made.band.size, 2.0, 0.0)
    return made


@pytest.mark.parametrize(("share", "covered"), [(0.1, 1.0), (0.0, 0.75)])
def test_a_few_worse_windows_and_a_band_that_holds_most_are_still_good(share, covered):
    assert grades(model(physical()), worse_in(share, covered))[-1] == GOOD
    assert grades(model(physical()), worse_in(share and 0.125, covered and covered - 0.01))[-1] == LIMITED


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
    found = findings(model(physical(share, **status)), None)
    assert tuple(one.grade for one in found[:2]) == expected
    for one, names in zip(found, ({"effect"}, {"damping", "lag"}), strict=False):
        assert ("Why" in one.reason) == bool(names & set(status)) and "And more" not in one.reason


def test_a_reason_is_given_once():
    known = physical(effect="not identifiable", damping="not identifiable", lag="not identifiable")
    known.reasons["damping"] = "Why effect. And otherwise."
    assert findings(model(known), None)[1].reason == "For the same reason as control effectiveness."


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
        found = [Finding(purpose, grade, "") for purpose, grade in zip(PURPOSES, given, strict=False)]
        assert advice in next_step(found)


def test_warnings_are_only_where_they_mean_something():
    learned = model(physical())
    assert not warnings_of(learned, held_out()) and not warnings_of(learned, held_out(expected=0.00334))
    (band,) = warnings_of(learned, held_out(band=0.05))
    assert "held 0 % of the held-out samples" in band
    (surprise,) = warnings_of(learned, held_out(expected=0.00333))
    assert "3.0 times the squared error that was to be expected" in surprise
    unstable = SimpleNamespace(stable=False, physical=None)
    assert warnings_of(unstable, None) == ("The model is unstable: long forecasts grow without bound.",)
