"""Forecasts with the motors known and unknown: the plant's, autoregressions', the last sample and the mean, mixed."""

import numpy as np
import pytest
from mavdem.dem.forecast.forecasts import (
    DOUBLING_DEVIATION,
    FOLDS,
    MEASURED_RIDGE,
    PREDICTED_RIDGE,
    WEIGHT_POWER,
    Forecast,
    Forecasts,
    PlantForecasts,
    expected_error,
    left_out_errors,
    mixture,
    prior_variance,
    running_mean,
    shrunk,
)
from simulated import in_closed_loop

from mavdem import Flight, baselines, evaluate, learn
from mavdem.dem.forecast.var import ChannelUnits, LagStatistics, Var
from mavdem.dem.record import Record, folds
from mavdem.evaluate import relative_mspe

FLIGHT = in_closed_loop(850)
TRAIN, TEST = FLIGHT[:700], FLIGHT[700:]
TURNING = np.array([1.0, -1.0, -1.0, 1.0])


def without_plant(train) -> Forecasts:
    """What comes next, of a record without a model."""
    record = Record.of(train)
    plant = PlantForecasts(record, None, None, None, None, False)
    return Forecasts(plant, TURNING[: record.inputs.shape[1]], False)


@pytest.fixture(scope="module")
def learned():
    return learn(TRAIN)


@pytest.mark.slow
def test_smoothing_uses_motors_that_come_later(learned):
    causal, smooth = (learned.forecast(TEST.inputs, smooth=later) for later in (False, True))
    changed = TEST.inputs.copy()
    changed[100:] += 5.0
    np.testing.assert_array_equal(learned.forecast(changed)[:100], causal[:100])
    assert np.abs(learned.forecast(changed, smooth=True)[95:100] - smooth[95:100]).max() > 1e-6
    assert relative_mspe(TRAIN, TEST, smooth) < 1.1 * relative_mspe(TRAIN, TEST, causal)


def test_a_forecast_is_one_piece_of_forecasts_from_every_sample(learned):
    forecast = learned.forecast(TEST.inputs)
    every = learned.forecast_every(len(TEST), TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(every, forecast, rtol=1e-9, atol=1e-12)
    pieces = learned.forecast_every(40, TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(pieces[:40], learned.forecast(TEST.inputs[:40]), rtol=1e-9, atol=1e-12)


def test_weights_fall_with_the_expected_error():
    parts = [(1.0, 0.1), (3.0, 0.2), (0.0, 1.0)]
    found = mixture([Forecast(np.full((4, 1), value), np.full((4, 1), error)) for value, error in parts], 4)
    means, errors = np.array(parts).T
    weights = errors**-WEIGHT_POWER / np.sum(errors**-WEIGHT_POWER)
    np.testing.assert_allclose(found.mean, weights @ means)
    np.testing.assert_allclose(found.variance, weights @ (errors + (means - weights @ means) ** 2))


@pytest.mark.parametrize("lost", [(np.nan, 0.1), (np.inf, 0.1), (1.0, np.nan), (1.0, np.inf)])
def test_a_forecast_that_overflows_has_no_weight(lost):
    good, constant = Forecast(np.ones((2, 1)), np.full((2, 1), 0.5)), Forecast(np.zeros((2, 1)), np.ones((2, 1)))
    bad = Forecast(*(np.full((2, 1), value) for value in lost))
    for found, expected in zip(mixture((bad, good, constant), 2), mixture((good, constant), 2), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_the_running_mean_begins_anew_with_each_forecast():
    values = np.array([[1.0], [3.0], [5.0], [7.0], [9.0]])
    np.testing.assert_allclose(running_mean(values, 2)[:, 0], [1.0, 2.0, 5.0, 6.0, 9.0])


def test_left_out_errors_are_of_models_that_have_not_seen_the_samples():
    record, lags = Record.of([FLIGHT[:300], FLIGHT[320:500]]), 5
    units = ChannelUnits.of(record)
    segments = units.segments(record)
    whole, squares, measured = LagStatistics.of(segments, lags), [], []
    lengths = [len(channels) for channels in segments]
    for fold in ([(segments[n], *span) for n, *span in part] for part in folds(lengths, FOLDS)):
        left_out = LagStatistics.of([channels[max(0, first - lags) : stop] for channels, first, stop in fold], lags)
        models = [Var.fit(whole - left_out, lags, ridge) for ridge in (MEASURED_RIDGE, PREDICTED_RIDGE)]
        for channels, first, stop in fold:
            # One step ahead, from as many samples as the function takes.
            first = max(first, lags)
            whole_ones = np.unique(np.linspace(first, max(first, stop - 150), 8).astype(int))
            for begins, table in ((whole_ones, measured), (np.arange(first, stop, 6), squares)):
                pasts = np.array([channels[begin - lags : begin] for begin in begins])
                known = models[0].infer(pasts, channels[begins, None, 2:]).mean[:, 0]
                unknown = models[1].predict(pasts, 1).mean[:, 0, :2]
                table.append((channels[begins, :2] - np.array([known, unknown, pasts[:, -1, :2]])) ** 2)
    errors = left_out_errors(record, lags)
    variance = record.outputs.var(axis=0)
    np.testing.assert_allclose(errors.known[0], np.concatenate(measured, axis=1)[0].mean(axis=0) * variance)
    for table, expected in zip(errors[1:3], np.concatenate(squares, axis=1)[1:].mean(axis=1), strict=True):
        np.testing.assert_allclose(table[0], expected * variance)
    assert (errors.known[0] < errors.unknown[0]).all() and (errors.mean[0] > record.outputs.var(axis=0)).all()


def test_noise_that_no_model_foresees_is_left_to_the_mean():
    rng = np.random.default_rng(0)
    noise = Flight(0.01 * np.arange(700), rng.standard_normal((700, 4)), rng.standard_normal((700, 2)))
    assert (left_out_errors(Record.of(noise), 10).known[10:].mean(axis=0) > 0.9).all()
    found = without_plant(noise)
    ahead = found.unknown_every(1, noise.inputs, noise.outputs).mean
    added = np.mean((ahead - noise.outputs) ** 2, axis=0) / noise.outputs.var(axis=0) - 1
    assert (added < 0.06).all() and (found.useful_steps(0.7) == 0).all()
    flight = without_plant(TRAIN)
    assert (flight.useful_steps(0.9) > 10).all() and (flight.useful_steps(0.1) < flight.useful_steps(0.9)).all()


@pytest.mark.slow
def test_bands_hold_nine_of_ten_samples():
    known, unknown = [], []
    for seed in range(8):
        flight = in_closed_loop(850, 50 + seed)
        learned = learn(flight[:700])
        errors = np.abs(flight.outputs[700:] - learned.forecast(flight.inputs[700:]))
        known.append(np.mean(errors <= learned.forecast_band(flight.inputs[700:])))
    for seed in range(30):
        flight = in_closed_loop(850, 100 + seed)
        found = without_plant(flight[:700])
        mean, variance = found.unknown(150)
        unknown.append(np.abs(mean - flight.outputs[700:]) <= found.half_widths(variance, 0.9, motors=False))
    # Samples of a flight err together, so the flights are what is counted.
    assert 0.9 - 3 * np.std(known) / np.sqrt(len(known)) < np.mean(known) < 0.99
    share = np.array(unknown).mean(axis=(0, 2))
    for steps in (10, 50, 150):
        assert 0.83 < share[:steps].mean() < 0.97


def test_every_so_many_samples_a_prediction_begins_anew(learned):
    every = learned.predict_every(40, TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(every[:40], learned.predict(40), rtol=1e-12)
    np.testing.assert_allclose(learned.predict_every(999, TEST.inputs, TEST.outputs), learned.predict(150))
    # What comes after a prediction's beginning does not matter to it.
    other = learned.predict_every(40, TEST.inputs[::-1], np.vstack([TEST.outputs[:40], TEST.outputs[:39:-1]]))
    np.testing.assert_array_equal(other[:40], every[:40])
    half = learned.predict_band(300)
    assert half.shape == (300, 2) and (half[-1] > half[0]).all()
    with pytest.raises(ValueError, match="^steps must"):
        learned.predict_band(0)


@pytest.mark.slow
def test_it_is_better_than_the_last_sample_and_the_mean_at_every_horizon():
    errors = {steps: [] for steps in (1, 5, 10, 25, 50, 150)}
    for seed in range(6):
        flight = in_closed_loop(850, seed)
        train, test = flight[:700], flight[700:]
        found = without_plant(train)
        for steps, row in errors.items():
            predictions = (
                found.unknown_every(steps, test.inputs, test.outputs).mean,
                baselines.hold(train).predict_every(steps, test.inputs, test.outputs),
                baselines.var(train, 4).predict_every(steps, test.inputs, test.outputs),
            )
            row.append([evaluate.relative_mspe(train, test, each) for each in predictions])
    for steps, row in errors.items():
        ours, held, four_lags = np.median(row, axis=0)
        assert ours < 1.02 * min(held, 1.0), steps
        assert ours < 1.05 * four_lags, steps


@pytest.mark.parametrize("lengths", [(12, 9), (3, 2), (2,), (45, 1)])
def test_short_segments_suffice_for_something(lengths):
    parts = [FLIGHT[60 * number : 60 * number + length] for number, length in enumerate(lengths)]
    assert left_out_errors(Record.of(parts), 20) is None or max(lengths) > 40
    found = without_plant(parts)
    mean, variance = found.unknown(20)
    assert mean.shape == variance.shape == (20, 2)
    assert np.isfinite(mean).all() and not np.isnan(found.half_widths(variance, 0.9, motors=False)).any()


def test_a_certain_forecast_is_kept_and_an_uncertain_one_is_shrunk():
    deviation = np.array([[2.0]])
    assert shrunk(deviation, np.zeros((1, 1)), np.ones((1, 1))) == 2.0
    assert expected_error(deviation, np.zeros((1, 1)), np.ones((1, 1))) == 0.0
    for variance in (1e12, np.inf):
        assert shrunk(deviation, variance * np.ones((1, 1)), np.ones((1, 1))) == pytest.approx(0.0, abs=1e-9)
        assert expected_error(deviation, variance * np.ones((1, 1)), np.ones((1, 1))) == pytest.approx(1.0)
    assert shrunk(np.inf * np.ones((1, 1)), np.inf * np.ones((1, 1)), np.ones((1, 1))) == 0.0


def test_near_the_trim_it_is_the_mean_of_a_gaussian_posterior():
    """Of a deviation of variance S beforehand, seen with an error of variance V."""
    rng = np.random.default_rng(0)
    S, V = 1e-4, 5e-5
    true = rng.standard_normal((200_000, 1)) * np.sqrt(S)
    seen = true + rng.standard_normal(true.shape) * np.sqrt(V)
    slope = float((true * seen).sum() / (seen**2).sum())
    ours = shrunk(seen, np.full_like(seen, V), np.full_like(seen, S))
    near = np.abs(seen) < 0.3 * DOUBLING_DEVIATION * np.sqrt(S)
    np.testing.assert_allclose((ours / seen)[near], slope, atol=0.03)


def test_what_the_motors_are_asked_for_is_the_size_of_what_may_come():
    inputs = np.vstack([0.1 * np.ones((3, 2)), 4.0 * np.ones((2, 2))])
    np.testing.assert_array_equal(prior_variance(inputs, 3)[:, 0], [1, 1, 1, 16, 16])
    np.testing.assert_allclose(prior_variance(inputs, 5)[:, 0], (3 * 0.01 + 2 * 16) / 5)
    assert prior_variance(inputs[:0], 5).shape == (0, 1)
    wide, narrow = (shrunk(8 * np.ones((1, 1)), 0.5 * np.ones((1, 1)), size * np.ones((1, 1))) for size in (16.0, 1.0))
    assert wide > 2 * narrow
