"""Forecasts with the motors known: the plant's, joint autoregressions' and the mean, by the error each is to expect."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop_flight import in_closed_loop

from mavdem import Flight, Learned, Settings, learn
from mavdem.dem.closed_loop.autoregression import ChannelUnits, LagStatistics, autoregression
from mavdem.dem.closed_loop.folds import folds, without
from mavdem.dem.closed_loop.gaussian_path import filtered
from mavdem.dem.closed_loop.left_out import left_out_errors
from mavdem.dem.closed_loop.mixture import MEAN_WEIGHT, WEIGHT_POWER, mixed, running_mean
from mavdem.dem.forecasts import Forecast
from mavdem.dem.record import Record
from mavdem.evaluate import relative_mspe

FLIGHT = in_closed_loop(850)
TRAIN, TEST = FLIGHT[:700], FLIGHT[700:]
PLANT = Settings(closed_loop=False)


@pytest.fixture(scope="module")
def learned():
    return learn(TRAIN)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 5])
def test_the_motors_are_measurements_of_the_motion(seed):
    """The autopilot hardly errs here: its motors tell more of the motion than the plant alone can know of the wind."""
    flight = in_closed_loop(850, seed)
    train, test = flight[:700], flight[700:]
    ours, plants = (
        relative_mspe(train, test, learn(train, each).forecast(test.inputs)) for each in (Settings(), PLANT)
    )
    assert ours < plants


def test_smoothing_uses_motors_that_come_later(learned):
    causal, smooth = (learned.forecast(TEST.inputs, smooth=later) for later in (False, True))
    changed = TEST.inputs.copy()
    changed[100:] += 5.0
    np.testing.assert_array_equal(learned.forecast(changed)[:100], causal[:100])
    assert np.abs(learned.forecast(changed, smooth=True)[95:100] - smooth[95:100]).max() > 1e-6
    assert relative_mspe(TRAIN, TEST, smooth) < 1.1 * relative_mspe(TRAIN, TEST, causal)


def test_from_zero_is_the_plant_alone(learned):
    plant = learn(TRAIN, PLANT)
    np.testing.assert_array_equal(learned.forecast(TEST.inputs, True), plant.forecast(TEST.inputs, True))


def test_a_forecast_is_one_piece_of_forecasts_from_every_sample(learned):
    forecast = learned.forecast(TEST.inputs)
    every = learned.forecast_every(len(TEST), TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(every, forecast, rtol=1e-9, atol=1e-12)
    pieces = learned.forecast_every(40, TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(pieces[:40], learned.forecast(TEST.inputs[:40]), rtol=1e-9, atol=1e-12)


def test_a_document_forecasts_what_the_model_did(learned):
    again = Learned.from_json(learned.to_json())
    np.testing.assert_array_equal(again.forecast(TEST.inputs), learned.forecast(TEST.inputs))


def test_weights_fall_with_the_expected_error():
    one, other = (Forecast(np.full((4, 1), value), np.full((4, 1), error)) for value, error in ((1.0, 0.1), (3.0, 0.2)))
    constant = Forecast(np.zeros((4, 1)), np.ones((4, 1)))
    weights = np.array([0.1**-WEIGHT_POWER, 0.2**-WEIGHT_POWER, MEAN_WEIGHT])
    weights /= weights.sum()
    found = mixed((one, other), constant, 4)
    mean = weights @ [1.0, 3.0, 0.0]
    np.testing.assert_allclose(found.mean, mean)
    expected = weights @ ([0.1, 0.2, 1.0] + (np.array([1.0, 3.0, 0.0]) - mean) ** 2)
    np.testing.assert_allclose(found.variance, expected)


@pytest.mark.parametrize("lost", [(np.nan, 0.1), (np.inf, 0.1), (1.0, np.nan), (1.0, np.inf)])
def test_a_forecast_that_overflows_has_no_weight(lost):
    good, constant = Forecast(np.ones((2, 1)), np.full((2, 1), 0.5)), Forecast(np.zeros((2, 1)), np.ones((2, 1)))
    bad = Forecast(*(np.full((2, 1), value) for value in lost))
    for found, expected in zip(mixed((bad, good), constant, 2), mixed((good,), constant, 2), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_the_running_mean_begins_anew_with_each_forecast():
    values = np.array([[1.0], [3.0], [5.0], [7.0], [9.0]])
    np.testing.assert_allclose(running_mean(values, 2)[:, 0], [1.0, 2.0, 5.0, 6.0, 9.0])


def test_left_out_errors_are_of_models_that_have_not_seen_the_samples():
    record = Record.of([FLIGHT[:300], FLIGHT[320:500]])
    units, lags = ChannelUnits.of(record), 5
    segments = units.segments(record)
    whole, squares = LagStatistics.of(segments, lags), []
    for fold in folds(segments):
        model = autoregression(without(whole, lags, fold), lags, 1e-4)
        for channels, first, stop in fold:
            # One step ahead, from as many samples as the function takes.
            begins = np.unique(np.linspace(max(first, lags), stop - 1, 8).astype(int))
            pasts = np.array([channels[begin - lags : begin] for begin in begins])
            mean = filtered(model, pasts, channels[begins, None, 2:]).mean[:, 0]
            squares.append((channels[begins, :2] - mean) ** 2)
    np.testing.assert_allclose(left_out_errors(record, lags, 1e-4, 1), [np.concatenate(squares).mean(axis=0)])


def test_noise_that_no_model_foresees_is_left_to_the_mean():
    rng = np.random.default_rng(0)
    record = Record.of(Flight(FLIGHT.time[:400], rng.standard_normal((400, 4)), rng.standard_normal((400, 2))))
    errors = left_out_errors(record, 10, 1e-4, 50)
    assert (errors[10:].mean(axis=0) > 0.9).all()


def test_a_record_too_short_for_it_is_forecast_by_the_plant_alone():
    assert left_out_errors(Record.of(FLIGHT[:20]), 20, 1e-4, 5) is None
    short = Record.of([FLIGHT[start : start + 15] for start in range(0, 150, 20)])
    assert left_out_errors(short, 20, 1e-4, 5) is None


@pytest.mark.slow
def test_bands_hold_nine_of_ten_samples():
    inside = []
    for seed in range(8):
        flight = in_closed_loop(850, 50 + seed)
        learned = learn(flight[:700])
        errors = np.abs(flight.outputs[700:] - learned.forecast(flight.inputs[700:]))
        inside.append(np.mean(errors <= learned.forecast_band(flight.inputs[700:])))
    # Samples of a flight err together, so the flights are what is counted.
    assert 0.9 - 3 * np.std(inside) / np.sqrt(len(inside)) < np.mean(inside) < 0.99


def test_a_gust_that_training_has_not_seen_widens_the_band(learned):
    gust = TEST.inputs + 100 * (TEST.inputs - TRAIN.inputs.mean(axis=0))
    usual, wide = (learned.forecast_variance(inputs).mean(axis=0) for inputs in (TEST.inputs, gust))
    assert (wide > 10 * usual).all()
    assert np.isfinite(learned.forecast(1e6 * TEST.inputs)).all()


def test_settings_without_it_have_no_members():
    assert learn(TRAIN, replace(PLANT, iterations=2))._forecasts.members == ()
    assert Settings.paper().closed_loop is False
