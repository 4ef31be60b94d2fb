"""The report of a learnt flight: a bad result never looks good, and every figure is that of evaluate.report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from simulated import simulated

import mavdem
from mavdem import evaluate
from mavdem.dem.graybox import DetectedGust
from mavdem.dem.uncertainty import Direction
from mavdem.report.blocks import Sentence, Table
from mavdem.report.learned import _entry, _poles, learned_report

DT = 0.01


def flight(samples: int = 500) -> mavdem.Flight:
    rng = np.random.default_rng(0)
    motors = 1500 + 50 * gaussian_filter1d(rng.standard_normal((samples, 2)), 6, axis=0)
    rate = np.cumsum((motors - 1500) @ [0.02, -0.02]) * DT
    return mavdem.Flight(
        DT * np.arange(samples),
        motors,
        np.stack([np.cumsum(rate) * DT, rate], axis=1),
        input_units=("µs", "µs"),
        output_names=("roll", "roll rate"),
        output_units=("rad", "rad/s"),
    )


TRAIN, TEST = flight()[:400], flight()[400:]


@pytest.fixture(scope="module")
def learned() -> mavdem.Learned:
    return mavdem.learn(TRAIN, mavdem.Settings(window=9, parameter_precision=1.0))


def altered(learned: mavdem.Learned, **fields: object) -> mavdem.Learned:
    """With other fields, and its physical parameters, which take time to fit and are of the data alone."""
    other = replace(learned, **fields)
    vars(other)["physical"] = learned.physical
    return other


def told(learned: mavdem.Learned, **relative: float) -> list[Sentence | Table]:
    """The report, with the relative errors of forecasts replaced by name."""
    report = evaluate.report(TRAIN, TEST, learned)
    errors = report["forecast_mspe"]
    for name, value in relative.items():
        errors[name.replace("_", " ")]["relative"] = value
    ranked = sorted(errors.items(), key=lambda named: named[1]["relative"])
    return learned_report({**report, "forecast_mspe": dict(ranked)}, TRAIN, TEST, learned)


def words(blocks: list[Sentence | Table]) -> str:
    return "\n".join(f"{block.lead} {block.text}" for block in blocks if isinstance(block, Sentence))


@pytest.mark.parametrize(
    ("dem", "hold_last", "verdict"),
    [
        (0.171, 2.0, "error ratio 0.171."),
        (0.9, 0.55, "“hold last”, a forecast without a model, has a lower one (0.55)."),
        (1.09, 0.55, "Do not use this model: it forecasts no better than a constant."),
        (np.inf, 2.0, "Do not use this model: it forecasts no better than a constant."),
    ],
)
def test_the_verdict_comes_first_and_repeats_the_table(learned, dem, hold_last, verdict):
    blocks = told(learned, DEM=dem, hold_last=hold_last, zero=9.0)
    assert verdict in blocks[0].lead and f"error ratio {dem:.3g}." in blocks[0].lead
    forecasts = next(block for block in blocks if isinstance(block, Table))
    assert forecasts.header[-1] == "error ratio"
    assert {row[0]: row[-1] for row in forecasts.rows} == {
        "DEM": f"{dem:.3g}",
        "hold last": f"{hold_last:.3g}",
        "constant mean": "1",
        "zero": "9",
    }


@pytest.mark.slow
def test_which_rotors_work_against_which_is_reported():
    made = simulated(wind=0.5, lag=0.05)
    train, test = made[:700], made[700:]
    learned = mavdem.learn(train, mavdem.Settings(order=3, d=2, window=9, parameter_precision=1.0))
    told = words(learned_report(evaluate.report(train, test, learned), train, test, learned))
    assert "input 1 and input 4 against input 2 and input 3." in told


def test_cautions_are_reported_before_the_figures(learned):
    blocks = told(altered(learned, cautions=("It is raining.",)))
    assert blocks[1] == Sentence("It is raining.", "Caution:")


def test_the_model_can_be_used_from_what_is_reported(learned):
    blocks = told(learned)
    model = [block for block in blocks if isinstance(block, Table) and block.header[0] == "variable"][-1]
    assert model.header == ["variable", "d roll/dt", "d roll rate/dt", "d hidden 1/dt"]
    rows = {row[0]: row[1:] for row in model.rows}
    assert list(rows) == ["roll", "roll rate", "hidden 1", "input 1", "input 2", "constant"]
    known = learned.known[:9].reshape(3, 3)
    sd = learned.model_interval(0.9).A
    for column, cause in enumerate(("roll", "roll rate", "hidden 1")):
        for row, cell in enumerate(rows[cause]):
            assert cell.endswith(" fixed") == known[row, column]
            assert float(cell.split()[0]) == pytest.approx(learned.model.A[row, column], abs=0.6 * sd[row, column])
    trims = next(block.text for block in blocks if isinstance(block, Sentence) and block.lead == "Trim:")
    assert trims.startswith(f"roll {TRAIN.outputs[:, 0].mean():.4g} rad (")
    assert trims.endswith(f"input 2 {TRAIN.inputs[:, 1].mean():.4g} µs.")


def test_what_is_not_known_of_the_parameters_is_not_reported(learned):
    def of_the_model(one: mavdem.Learned) -> str:
        blocks = told(one)
        physical = [i for i, block in enumerate(blocks) if isinstance(block, Sentence) and "gray-box" in block.lead]
        return words([block for i, block in enumerate(blocks) if i not in (*physical, *(k + 1 for k in physical))])

    assert "±" in of_the_model(learned)
    unknown = of_the_model(altered(learned, scatter=None))
    assert "±" not in unknown and "nan" not in unknown


@pytest.mark.slow
def test_the_least_determined_combination_is_named(learned):
    weights = np.zeros(len(learned.known))
    weights[[9, 10]] = -0.8, 0.6  # B: roll from inputs 1 and 2
    blocks = told(altered(learned, undetermined=tuple(Direction(weights, share, (3, 2, 2)) for share in (0.1, 0.2))))
    text = next(block.text for block in blocks if isinstance(block, Sentence) and block.lead == "Not identifiable:")
    assert "2 combinations of parameters" in text
    assert "0.8 (B: roll from input 1) - 0.6 (B: roll from input 2)" in text
    assert "Not identifiable" not in words(told(altered(learned, undetermined=())))


def test_outputs_are_reported_where_c_is_free_and_only_there(learned):
    def headers(one: mavdem.Learned) -> list[list[str]]:
        return [block.header for block in told(one) if isinstance(block, Table) and block.header[0] == "variable"]

    paper = headers(mavdem.learn(TRAIN, mavdem.Settings.paper()))
    assert paper[-2:] == [["variable", "d state 1/dt", "d state 2/dt"], ["variable", "roll", "roll rate"]]
    assert ["variable", "roll", "roll rate"] not in headers(learned)


@pytest.mark.parametrize(
    ("value", "sd", "entry"),
    [
        (-5.0, 0.07, "-5.00 ± 0.07"),
        (0.00155, 0.009, "0.002 ± 0.009"),
        (-0.0001, 0.01, "0.00 ± 0.01"),
        (1.0, 0.096, "1.0 ± 0.1"),
        (1234.0, 32.0, "1230 ± 30"),
        (-2.457e-8, 3e-10, "(-24.6 ± 0.3)e-9"),
        (7.5e6, 2e4, "(7.50 ± 0.02)e6"),
        (0.25, np.nan, "0.25"),
    ],
)
def test_an_estimate_has_the_digits_of_its_standard_deviation(value, sd, entry):
    assert _entry(value, sd, fixed=False) == entry


def test_poles_have_a_frequency_and_a_damping_ratio_or_a_time_constant():
    swing = 2 * np.pi * 1.5
    assert _poles(np.diag([-2.0, -0.1])) == "-0.1: time constant 10 s; -2: time constant 0.5 s. The model is stable."
    assert _poles(np.array([[-4.0, swing], [-swing, -4.0]])) == (
        "-4 ± 9.42j: 1.6 Hz, damping ratio 0.39. The model is stable."
    )
    assert _poles(np.array([[0.5, swing], [-swing, 0.5]])) == (
        "0.5 ± 9.42j: 1.5 Hz, damping ratio -0.053. The model is unstable."
    )
    assert _poles(np.diag([0.5, 0.0, -1.0])) == (
        "0.5: grows with time constant 2 s; 0: integrator; -1: time constant 1 s. The model is unstable."
    )


def test_it_says_how_far_ahead_predictions_without_the_inputs_are_worth_something(learned):
    steps = learned.prediction.useful_steps(0.5)
    assert (steps > 0).all()
    expected = f"roll up to {steps[0] * DT:.2g} s ahead, roll rate up to {steps[1] * DT:.2g} s ahead"
    assert f"they explain at least half of the variance of {expected}, by predictions inside" in words(told(learned))
    report = evaluate.report(TRAIN, TEST, learned)
    report["prediction"]["half_explained_seconds"] = [0.2, 0.0]
    said = words(learned_report(report, TRAIN, TEST, learned))
    assert "of roll up to 0.2 s ahead, roll rate at no horizon, by predictions" in said


@pytest.mark.slow
def test_the_wind_s_torque_is_reported_or_why_it_is_not():
    windy = simulated(samples=1500, wind=4.0, lag=0.05)
    learned = mavdem.learn(windy[:1400], mavdem.Settings(window=9, parameter_precision=1.0))

    def said(**changes: object) -> str:
        changed = replace(learned)
        changed.__dict__["physical"], changed.__dict__["wind"] = learned.physical, replace(learned.wind, **changes)
        return words(
            learned_report(evaluate.report(windy[:1400], windy[1400:], changed), windy[:1400], windy[1400:], changed)
        )

    known = said(reason=None, gusts=(DetectedGust(120, 1.2, 0.4, -9.0),), answered=0.5, answered_slow=0.9)
    assert f"standard deviation {np.rad2deg(learned.wind.sd):.3g} °/s²" in known
    assert "1 gust beyond" in known and "the largest -516 °/s², 0.4 s long, 1.2 s after" in known
    assert "had answered 50 % of its variance, and 90 % of that below 1 Hz" in known
    assert "No gusts" in said(reason=None, gusts=(), answered=float("nan"))
    uncertain = said(reason=None, scale_error=0.4)
    assert "uncertain by 40 %" in uncertain and "uncertain by" not in said(reason=None, scale_error=0.05)
    assert "is not resolved" in said(resolved=False, reason="The wind's torque is not resolved: why.")
