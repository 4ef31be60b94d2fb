"""Predictions without inputs: what they are made of, and what they are worth beside the last sample and the mean."""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop_flight import in_closed_loop

import mavdem
from mavdem import Flight, Learned, Settings, baselines, evaluate
from mavdem.dem.closed_loop.autoregression import LagStatistics
from mavdem.dem.closed_loop.folds import folds, without
from mavdem.dem.closed_loop.gaussian_path import predicted
from mavdem.dem.closed_loop.prediction import LAGS, Prediction
from mavdem.dem.record import Record

FLIGHT = in_closed_loop(850)
TRAIN, TEST = FLIGHT[:700], FLIGHT[700:]
FOUND = Prediction.of(Record.of(TRAIN))


@pytest.fixture(scope="module")
def learned():
    return mavdem.learn(TRAIN, Settings(order=3, window=9, parameter_precision=10.0))


def test_it_is_the_weighted_mean_of_the_models_paths():
    assert [model.lags for model in FOUND.models] == list(LAGS)
    paths = [predicted(model, FOUND.past[-model.lags :], 50).mean[:, :2] for model in FOUND.models]
    mean, held = TRAIN.outputs.mean(axis=0), FOUND.held[:50]
    expected = mean + (1 - held) * TRAIN.outputs.std(axis=0) * FOUND.weight[:50] * np.mean(paths, axis=0)
    expected += held * (TRAIN.outputs[-1] - mean)
    np.testing.assert_allclose(FOUND.after(FOUND.past, 50), expected, rtol=1e-9)
    assert (held >= 0).all() and (held <= 1).all() and (held[0] < 0.05).all()
    assert (FOUND.weight >= 0).all() and (FOUND.weight <= 1).all()
    assert FOUND.weight[0] == pytest.approx(1, abs=0.02) and (FOUND.weight[-1] < 0.8).all()


def test_beyond_the_longest_prediction_inside_the_training_data_weight_and_error_stay():
    longest = len(FOUND.weight)
    assert longest == 150
    np.testing.assert_array_equal(FOUND.after(FOUND.past, 300)[:200], FOUND.after(FOUND.past, 200))
    half = FOUND.half_width(300, 0.9)
    np.testing.assert_array_equal(half[longest:], np.broadcast_to(half[longest - 1], (150, 2)))


def test_a_part_that_is_predicted_is_not_in_the_models_that_predict_it():
    segments = [np.random.default_rng(0).standard_normal((number, 3)) for number in (100, 7, 60)]
    parts = folds(segments)
    assert [sum(stop - start for _, start, stop in part) for part in parts] == [41, 42, 42, 42]
    channels, start, stop = parts[1][0]
    kept = [channels[:start], channels[stop - 4 :], *segments[1:]]
    # A row of which a sample of the part is a lag stays: it is the target that is left out.
    others = without(LagStatistics.of(segments, 4), 4, parts[1])
    expected = LagStatistics.of(kept, 4)
    assert others.rows == expected.rows
    np.testing.assert_allclose(others.gram, expected.gram, atol=1e-9)


def test_every_so_many_samples_a_prediction_begins_anew(learned):
    every = learned.predict_every(40, TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(every[:40], learned.predict(40), rtol=1e-12)
    seen = np.hstack([TEST.outputs, TEST.inputs])[40 - max(LAGS) : 40]
    np.testing.assert_allclose(
        every[40:80], learned.prediction.after(learned.prediction.units.scaled(seen), 40), rtol=1e-9
    )
    np.testing.assert_allclose(learned.predict_every(999, TEST.inputs, TEST.outputs), learned.predict(150))
    # What comes after a prediction's beginning does not matter to it.
    other = learned.predict_every(40, TEST.inputs[::-1], np.vstack([TEST.outputs[:40], TEST.outputs[:39:-1]]))
    np.testing.assert_array_equal(other[:40], every[:40])


def test_a_document_predicts_what_the_model_did(learned):
    again = Learned.from_json(learned.to_json())
    np.testing.assert_array_equal(again.predict(60), learned.predict(60))
    np.testing.assert_array_equal(again.predict_band(60, 0.5), learned.predict_band(60, 0.5))


@pytest.mark.parametrize(("steps", "level"), [(0, 0.9), (1.5, 0.9), (10, 1.0)])
def test_what_is_no_number_of_steps_or_no_level_is_named(learned, steps, level):
    with pytest.raises(ValueError, match="^(steps|level) must"):
        learned.predict_band(steps, level)
    with pytest.raises(ValueError, match="^steps must"):
        learned.predict(-1)


def test_it_is_better_than_the_last_sample_and_the_mean_at_every_horizon():
    errors = {steps: [] for steps in (1, 5, 10, 25, 50, 150)}
    for seed in range(6):
        flight = in_closed_loop(850, seed)
        train, test = flight[:700], flight[700:]
        found = Prediction.of(Record.of(train))
        for steps, of_steps in errors.items():
            predictions = (
                found.every(steps, test.inputs, test.outputs),
                baselines.hold(train).predict_every(steps, test.inputs, test.outputs),
                baselines.var(train, 4).predict_every(steps, test.inputs, test.outputs),
            )
            of_steps.append([evaluate.relative_mspe(train, test, each) for each in predictions])
    for steps, of_steps in errors.items():
        own, held, four_lags = np.median(of_steps, axis=0)
        assert own < 1.02 * min(held, 1.0), steps
        assert own < 1.05 * four_lags, steps


@pytest.mark.slow
def test_bands_hold_nine_samples_in_ten_at_every_horizon():
    inside = []
    for seed in range(30):
        flight = in_closed_loop(850, 100 + seed)
        train, test = flight[:700], flight[700:]
        found = Prediction.of(Record.of(train))
        inside.append(np.abs(found.after(found.past, 150) - test.outputs) <= found.half_width(150, 0.9))
    share = np.array(inside).mean(axis=(0, 2))
    for steps in (10, 50, 150):
        assert 0.83 < share[:steps].mean() < 0.97


def test_noise_is_predicted_by_its_mean():
    rng = np.random.default_rng(0)
    noise = Flight(0.01 * np.arange(700), rng.standard_normal((700, 4)), rng.standard_normal((700, 2)))
    found = Prediction.of(Record.of(noise))
    ahead = found.every(1, noise.inputs, noise.outputs)
    # The last sample errs twice as much as the mean, and has a share of (1/3)².
    assert found.held == pytest.approx(1 / 9, abs=0.06)
    added = np.mean((ahead - noise.outputs) ** 2, axis=0) / noise.outputs.var(axis=0) - 1
    assert (added < 0.06).all()
    assert (found.useful_steps(0.9) == 0).all()
    assert (FOUND.useful_steps(0.9) > 10).all() and (FOUND.useful_steps(0.1) < FOUND.useful_steps(0.9)).all()


def test_what_grows_overflows_nothing():
    time = 0.01 * np.arange(400)
    growing = np.exp(np.outer(time, [5.0, 5.5])) * np.random.default_rng(0).choice([-1, 1], (400, 1))
    found = Prediction.of(Record.of(Flight(time, growing[:, :1], growing)))
    assert np.isfinite(found.after(found.past, 5000)).all()
    assert np.isfinite(found.half_width(5000, 0.9)).all()


@pytest.mark.parametrize("lengths", [(12, 9), (3, 2), (2,), (45, 1)])
def test_short_segments_suffice_for_something(lengths):
    parts = [FLIGHT[60 * number : 60 * number + length] for number, length in enumerate(lengths)]
    found = Prediction.of(Record.of(parts))
    assert found.after(found.past, 20).shape == found.half_width(20, 0.9).shape == (20, 2)
    assert np.isfinite(found.after(found.past, 20)).all() and not np.isnan(found.half_width(20, 0.9)).any()
