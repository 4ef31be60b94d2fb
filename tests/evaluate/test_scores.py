"""Scores: what counts at which horizon, and beside what."""

from __future__ import annotations

import numpy as np
import pytest

from mavdem import Flight, baselines, evaluate
from mavdem.evaluate import HORIZONS, horizons
from mavdem.evaluate.comparison import Method, evaluate_window
from mavdem.evaluate.scores import KNOWN, by_horizon, ratio, score, score_values
from mavdem.evaluate.windows import Window

RNG = np.random.default_rng(0)
WALK = RNG.standard_normal((850, 2)).cumsum(axis=0) * [1, 10]
FLIGHT = Flight(0.01 * np.arange(850), RNG.standard_normal((850, 2)), WALK)
TRAIN, TEST = FLIGHT[:700], FLIGHT[700:]


def scores_of(model, flight: Flight = FLIGHT) -> np.ndarray:
    return evaluate_window(Method("", model), Window("", 0, flight[:700], flight[700:])).of(KNOWN)


def test_mspe_is_per_output_and_summed():
    error = evaluate.mspe([[0.0, 0.0], [2.0, 1.0]], np.zeros((2, 2)))
    np.testing.assert_array_equal(error.per_output, [2.0, 0.5])
    assert error.total == 2.5


@pytest.mark.parametrize("shape", [(2,), (3, 2), (2, 1), (0, 2)])
def test_shapes_that_disagree_are_refused(shape):
    with pytest.raises(ValueError, match=r"must be \(H, m\) alike"):
        evaluate.mspe(np.zeros((2, 2)) if shape != (0, 2) else np.zeros(shape), np.zeros(shape))


@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf, 1e200])
def test_a_prediction_beyond_all_numbers_errs_infinitely(wild):
    error = evaluate.mspe(np.zeros((3, 2)), [[0.0, 1.0], [wild, 1.0], [0.0, 1.0]])
    assert error.per_output.tolist() == [np.inf, 1.0] and error.total == np.inf
    assert evaluate.relative_mspe(TRAIN, TEST, np.full_like(TEST.outputs, wild)) == np.inf


def test_the_constant_mean_has_one_at_every_horizon_and_the_truth_none():
    scores = scores_of(baselines.constant_mean)
    np.testing.assert_allclose(ratio(scores), 1)
    for row in scores:
        np.testing.assert_allclose(score_values(row)["relative_per_output"], 1)
    assert evaluate.relative_mspe(TRAIN, TEST, TEST.outputs) == 0.0


def test_outputs_count_in_units_of_their_training_variance():
    wrong = TEST.outputs + TRAIN.outputs.std(axis=0)
    half_wrong = TEST.outputs + TRAIN.outputs.std(axis=0) * [1, 0]
    assert evaluate.relative_mspe(TRAIN, TEST, wrong) == pytest.approx(
        2 * evaluate.relative_mspe(TRAIN, TEST, half_wrong)
    )
    scaled = Flight(FLIGHT.time, FLIGHT.inputs, FLIGHT.outputs * [57.3, 0.01] + 5)
    np.testing.assert_allclose(ratio(scores_of(baselines.hold)), ratio(scores_of(baselines.hold, scaled)))


def test_an_output_that_is_constant_in_training_has_no_unit_of_error():
    train = Flight(TRAIN.time, TRAIN.inputs, TRAIN.outputs * [1, 0] + [0, 0.1])
    with pytest.raises(ValueError, match="^train must vary"):
        evaluate.relative_mspe(train, TEST, TEST.outputs)


def test_each_sample_counts_once_and_the_last_horizon_is_the_mspe():
    hold, scores = baselines.hold(TRAIN), scores_of(baselines.hold)
    assert [int(rows["steps"][0]) for rows in by_horizon(scores)] == list(HORIZONS)
    before = np.vstack([TRAIN.outputs[-1:], TEST.outputs[24:-1:25]])
    errors = (TEST.outputs - np.repeat(before, 25, axis=0)) ** 2
    row = scores[HORIZONS.index(25)]
    np.testing.assert_allclose(row["squared_error"], errors.mean(axis=0))
    assert score_values(row)["total"] == pytest.approx((errors / TRAIN.outputs.var(axis=0)).mean(axis=0).sum())
    whole = hold.forecast(TEST.inputs)
    assert ratio(scores)[-1] == pytest.approx(evaluate.relative_mspe(TRAIN, TEST, whole))
    np.testing.assert_allclose(scores[-1]["squared_error"], evaluate.mspe(TEST.outputs, whole).per_output)


def test_a_random_walk_held_errs_more_the_longer():
    """Of a walk of unit steps the error k steps on is k, so their mean up to it (k + 1) / 2."""
    walks = np.random.default_rng(1).standard_normal((850, 40)).cumsum(axis=0)
    scores = scores_of(baselines.hold, Flight(0.01 * np.arange(850), FLIGHT.inputs, walks))
    # Of 40 walks of 150/k pieces: errors within a piece are one, so five deviations of a χ² of so many, at most.
    for steps, row in zip((1, 5, 10, 25), scores, strict=False):
        expected = pytest.approx((steps + 1) / 2, rel=5 * np.sqrt(2 / (40 * 150 / steps)))
        assert row["squared_error"].mean() == expected


def test_neither_erring_is_alike():
    still = Flight(TEST.time, TEST.inputs, np.tile(TRAIN.outputs.mean(axis=0), (150, 1)))
    assert ratio(score(TRAIN, still, still.outputs)).tolist() == [1]


def test_horizons_are_those_of_the_test_part():
    assert horizons(150, 0.01) == HORIZONS
    assert horizons(100, 1 / 120) == (1, 5, 10, 25, 50, 100)
    assert horizons(200, 0.02) == (*HORIZONS, 200)
    assert horizons(1, 0.01) == (1,)
    assert horizons(600, 1 / 400) == (4, 20, 40, 100, 200, 600)
