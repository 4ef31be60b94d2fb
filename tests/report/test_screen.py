"""The screen: a bad result never looks good, and numbers have the digits of their intervals."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated

import mavdem
from mavdem.analysis.findings import GOOD, LIMITED, NONE, PURPOSES, Finding, findings, next_step, warnings_of
from mavdem.condition.hover import hover_figures
from mavdem.dem.graybox import DetectedGust
from mavdem.dem.graybox.parameters import Physical
from mavdem.evaluate import HeldOut, held_out_test
from mavdem.ingest.motors import OutputScale
from mavdem.report.blocks import Sentence, Table, text_of
from mavdem.report.numbers import plus_minus, rounded
from mavdem.report.screen import key_figures, screen, summary

FLIGHT = simulated(samples=1500, wind=4.0, lag=0.05)
TRAIN, TEST = FLIGHT[:1400], FLIGHT[1400:]


@pytest.fixture(scope="module")
def learned() -> mavdem.Learned:
    return mavdem.learn(TRAIN, mavdem.Settings(window=9, parameter_precision=1.0))


def with_parts(learned: mavdem.Learned, physical: object = None, wind: object = None) -> mavdem.Learned:
    other = replace(learned)
    vars(other)["physical"] = learned.physical if physical is None else physical
    vars(other)["wind"] = learned.wind if wind is None else wind
    return other


def held_out(forecast: float = 0.1, last: float = 0.5, band: float = 1.0, expected: float = 0.01) -> HeldOut:
    """Forty windows in which the forecast and the last sample err by so much, and the mean by 1."""
    measured = np.zeros((40, 10, 2))
    errors = {"forecast": forecast, "prediction": 0.9, "constant mean": 1.0, "hold last": last}
    return HeldOut(
        np.arange(400.0).reshape(40, 10),
        measured,
        {name: measured + error for name, error in errors.items()},
        measured + band,
        measured + expected,
        np.ones(2),
    )


def read(learned: mavdem.Learned, share: float = 0.05, **status: str) -> Physical:
    """Physical parameters with a relative standard deviation of ``share``, each of this status."""
    found = learned.physical
    estimates = np.array([*found.effect, found.damping, found.lag, found.delay])
    names = {name: status.get(name, "reported") for name in found.status}
    reasons = {name: "" if value == "reported" else f"Why {name}. And more." for name, value in names.items()}
    return found._replace(covariance=np.diag((share * estimates) ** 2), status=names, reasons=reasons, bias=0.0)


@pytest.mark.parametrize(
    ("figures", "grade", "reason"),
    [
        ({}, GOOD, "0.04 times the squared error of “hold last”; worse than the mean in 0 % of 40 windows."),
        ({"forecast": 0.45}, LIMITED, "0.81 times the squared error of “hold last”"),
        ({"forecast": 0.6}, NONE, "1.4 times the squared error of “hold last”"),
        ({"forecast": np.nan}, NONE, "No model of a part could be learnt"),
        ({"band": 0.05}, LIMITED, "0.04 times"),
    ],
)
def test_prediction_is_good_only_beside_the_better_baseline_and_with_a_band_that_holds(learned, figures, grade, reason):
    found = findings(learned, held_out(**figures))[-1]
    assert (found.purpose, found.grade) == ("prediction", grade)
    assert found.reason.startswith(reason)


@pytest.mark.parametrize(
    ("share", "status", "grades"),
    [
        (0.05, {}, (GOOD, GOOD)),
        (0.3, {}, (LIMITED, LIMITED)),
        (0.05, {"effect": "biased"}, (LIMITED, GOOD)),
        (0.05, {"effect": "not identifiable"}, (NONE, GOOD)),
        (0.05, {"lag": "not identifiable"}, (GOOD, LIMITED)),
        (0.05, {"damping": "biased"}, (GOOD, LIMITED)),
        (0.05, {"damping": "not identifiable", "lag": "not identifiable"}, (GOOD, NONE)),
    ],
)
def test_parameters_are_good_as_far_as_their_intervals_and_status_say(learned, share, status, grades):
    found = findings(with_parts(learned, read(learned, share, **status)), None)
    assert tuple(one.grade for one in found[:2]) == grades
    for one in found[:2]:
        assert ("Why" in one.reason) == any(
            name in one.purpose.replace("motor effectiveness", "effect") for name in status
        )
        assert "And more" not in one.reason


@pytest.mark.parametrize(
    ("grades", "advice"),
    [
        ((NONE, NONE, NONE, GOOD), "calm air"),
        ((LIMITED, GOOD, GOOD, GOOD), "calm air"),
        ((GOOD, LIMITED, GOOD, GOOD), "for longer"),
        ((GOOD, GOOD, GOOD, NONE), "mavdem compare"),
        ((GOOD, GOOD, LIMITED, LIMITED), "reference"),
        ((GOOD, GOOD, GOOD), "reference"),
    ],
)
def test_the_next_step_is_that_of_the_first_purpose_that_is_not_served(grades, advice):
    found = [Finding(purpose, grade, "") for purpose, grade in zip(PURPOSES, grades, strict=False)]
    assert advice in next_step(found)


def test_a_reason_is_given_once(learned):
    known = read(learned, effect="not identifiable", damping="not identifiable", lag="not identifiable")
    same = known._replace(reasons={**known.reasons, "damping": "Why effect. And otherwise."})
    assert findings(with_parts(learned, same), None)[1].reason == "For the same reason as control effectiveness."


def test_the_wind_is_good_only_where_it_is_resolved_and_its_size_known(learned):
    for changes, grade in (
        ({"reason": None, "resolved": True, "scale_error": 0.05}, GOOD),
        ({"reason": None, "resolved": True, "scale_error": 0.4}, LIMITED),
        ({"reason": "The wind's torque is not resolved: why.", "resolved": False}, NONE),
    ):
        wind = replace(learned.wind, **changes)
        assert findings(with_parts(learned, read(learned), wind), None)[2].grade == grade
        # It is what is left when the motors' torque is taken away.
        for doubtful in ("effect", "damping", "lag"):
            biased = findings(with_parts(learned, read(learned, **{doubtful: "biased"}), wind), None)[2].grade
            assert biased == (NONE if grade == NONE else LIMITED)
        unknown = with_parts(learned, read(learned, effect="not identifiable"), wind)
        assert findings(unknown, None)[2].grade == NONE
        assert "Wind on this axis" not in text_of(screen(unknown))


def test_warnings_are_only_where_they_mean_something(learned):
    assert learned.stable and not warnings_of(learned, held_out())
    (band,) = warnings_of(learned, held_out(band=0.05))
    assert "held 0 % of the held-out samples" in band
    (surprise,) = warnings_of(learned, held_out(expected=0.002))
    assert "5.0 times the squared error that was to be expected" in surprise
    unstable = SimpleNamespace(stable=False, physical=None)
    assert warnings_of(unstable, None) == ("The model is unstable: long forecasts grow without bound.",)


def test_a_few_windows_are_never_good(learned):
    forty = held_out()
    for count, grade in ((1, LIMITED), (4, LIMITED), (5, GOOD)):
        parts = {name: getattr(forty, name)[:count] for name in ("time", "measured", "band", "expected")}
        forecasts = {name: values[:count] for name, values in forty.forecasts.items()}
        found = findings(learned, replace(forty, **parts, forecasts=forecasts))[-1]
        assert found.grade == grade, found.reason


def test_the_screen_has_a_row_a_motor_and_fits_a_screen(learned):
    scale = OutputScale("PWM", "µs", 1000.0, 2000.0, 1.0)
    hover = hover_figures([TRAIN], scale)
    blocks = screen(with_parts(learned, read(learned)), held_out(), hover)
    vehicle = next(block for block in blocks if isinstance(block, Table) and block.header[0] == "vehicle")
    assert [row[0] for row in vehicle.rows] == list(TRAIN.input_names)
    assert vehicle.header[2:] == ["trim (µs)", "beyond the mean (%)", "headroom (%)", "saturated (% of time)"]
    errors = next(block for block in blocks if isinstance(block, Table) and "held-out" in block.header[0])
    assert [row[0] for row in errors.rows] == [
        "forecast, motors recorded",
        "hold last",
        "prediction, motors unknown",
        "constant mean",
    ]
    assert len(text_of(blocks).splitlines()) < 40


def test_what_is_not_identifiable_has_no_number(learned):
    nothing = read(learned, effect="not identifiable", damping="not identifiable", lag="not identifiable")
    blocks = screen(with_parts(learned, nothing))
    vehicle = next(block for block in blocks if isinstance(block, Table) and block.header[0] == "vehicle")
    assert [row[1] for row in vehicle.rows] == ["-"] * 4
    assert "Damping not identifiable; lag of the motors not identifiable; delay" in text_of(blocks)
    assert dict(key_figures(with_parts(learned, nothing)))["motor effect"] == "not identifiable"


def test_the_wind_s_torque_and_its_gusts_are_reported(learned):
    def said(**changes: object) -> str:
        return text_of(screen(with_parts(learned, read(learned), replace(learned.wind, **changes))))

    known = said(reason=None, gusts=(DetectedGust(120, 1.2, 0.4, -9.0),))
    assert f"torque {rounded(np.rad2deg(learned.wind.sd))} °/s² (standard deviation)" in known
    assert "1 gust beyond" in known and "the largest -516 °/s², 0.4 s long, 1.2 s after" in known
    assert "No gusts" in said(reason=None, gusts=())
    uncertain = said(reason=None, scale_error=0.4)
    assert "uncertain by 40 %" in uncertain and "uncertain by" not in said(reason=None, scale_error=0.05)
    assert "is not resolved" in said(resolved=False, reason="The wind's torque is not resolved: why.")


def test_a_model_alone_has_a_summary_without_windows(learned):
    said = summary(replace(learned, cautions=("It is raining.",)))
    assert "motor effectiveness" in said and "Caution: It is raining." in said and "prediction" not in said


@pytest.mark.parametrize(
    ("value", "half", "shown"),
    [
        (-5.0, 0.07, "-5.00 ± 0.07"),
        (0.00155, 0.009, "0.002 ± 0.009"),
        (-0.0001, 0.01, "0.000 ± 0.010"),
        (3.5123, 1.149, "3.5 ± 1.1"),
        (1234.0, 32.0, "1230 ± 30"),
        (-2.457e-8, 3e-10, "(-24.6 ± 0.3)e-9"),
        (7.5e6, 2e4, "(7.500 ± 0.020)e6"),
        (0.25, np.nan, "-"),
        (0.25, 0.0, "0.25"),
    ],
)
def test_an_estimate_has_the_digits_of_its_interval(value, half, shown):
    assert plus_minus(value, half) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "0"), (1234.5, "1234"), (0.0123, "0.012"), (9.96, "10.0"), (np.inf, "infinite"), (1e9, "1e+09")],
)
def test_numbers_without_an_interval_have_two_digits(value, shown):
    assert rounded(value) == shown


def test_a_test_after_training_is_one_window(learned):
    blocks = screen(learned, held_out_test(TRAIN, TEST, learned))
    sentences = [block.text for block in blocks if isinstance(block, Sentence)]
    assert "one held-out window" in text_of(blocks)
    assert not any("in the median" in text for text in sentences)
