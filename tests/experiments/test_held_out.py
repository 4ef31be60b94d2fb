from dataclasses import replace
from itertools import chain, repeat
from math import ceil
from unittest.mock import DEFAULT, Mock

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, mark, raises
from simulated import SIGNS, simulated

import mavdem
from mavdem.evaluate import relative_mspe
from mavdem.experiments import held_out as module
from mavdem.experiments.held_out import (
    CONSTANT_MEAN,
    FOLDS,
    HOLD_LAST,
    held_out_test,
    held_out_windows,
)

pytestmark = mark.slow
FLIGHT = simulated(samples=1500, wind=0.5)
QUICK = mavdem.Settings(order=2, window=5, parameter_precision=1.0, horizon=None, iterations=4)
STEPS = 60


@fixture(scope="module")
def held_out():
    return held_out_windows([FLIGHT], QUICK, STEPS)


def test_every_sample_after_the_first_windows_is_held_out_once(held_out):
    time = held_out.time.ravel()
    assert len(np.unique(time)) == len(time) and (np.diff(time) > 0).all()
    lead = STEPS * ceil(1.5 / FLIGHT.dt / STEPS)
    assert time[0] == FLIGHT.time[lead]
    # Up to a window is lost at the end of each part.
    assert len(time) > len(FLIGHT) - lead - FOLDS * STEPS
    at = np.searchsorted(FLIGHT.time, time)
    assert_array_equal(held_out.measured.reshape(-1, 2), FLIGHT.outputs[at])


def test_nothing_after_a_sample_is_used_to_forecast_it(held_out):
    """Samples after the last window are changed: its forecasts stay the same."""
    changed_outputs = FLIGHT.outputs.copy()
    changed_inputs = FLIGHT.inputs.copy()
    last = np.searchsorted(FLIGHT.time, held_out.time[-1, 0])
    # Of the last part, which only its own model does not see.
    changed_outputs[last:] += 0.1
    changed_inputs[last:] += 30.0 * SIGNS
    forecasts_of_changed_outputs = held_out_windows(
        [replace(FLIGHT, outputs=changed_outputs)], QUICK, STEPS
    )
    for name in ("forecast", "prediction"):
        assert_array_equal(
            forecasts_of_changed_outputs.forecasts[name][-1], held_out.forecasts[name][-1]
        )
    # A prediction does not know the motors of its window either; a forecast does.
    forecasts_of_changed_inputs = held_out_windows(
        [replace(FLIGHT, inputs=changed_inputs)], QUICK, STEPS
    )
    assert_array_equal(
        forecasts_of_changed_inputs.forecasts["prediction"][-1],
        held_out.forecasts["prediction"][-1],
    )
    assert not np.array_equal(
        forecasts_of_changed_inputs.forecasts["forecast"][-1], held_out.forecasts["forecast"][-1]
    )


def test_the_test_after_training_is_one_window_of_the_models_own_forecast():
    train = FLIGHT[:600]
    test = FLIGHT[600:700]
    learned = mavdem.learn(train, QUICK)
    window = held_out_test(train, test, learned)
    assert_allclose(window.forecasts["forecast"][0], learned.forecast(test.inputs), rtol=1e-7)
    assert_array_equal(window.forecasts[HOLD_LAST][0], np.tile(train.outputs[-1], (100, 1)))
    assert window.error_ratio() == approx(relative_mspe(train, test, learned.forecast(test.inputs)))


def test_a_model_that_cannot_be_learnt_errs_infinitely_and_says_why(held_out, monkeypatch):
    """Learning fails in all folds, and then in the first fold only."""
    refused = ValueError("the outputs must vary")
    learn = Mock(side_effect=refused)
    learn_after_first_failure = Mock(
        wraps=module.learn_forecasts, side_effect=chain([refused], repeat(DEFAULT))
    )
    monkeypatch.setattr(module, "learn_forecasts", learn)
    without_model = held_out_windows([FLIGHT], QUICK, STEPS)
    assert [failure.figures["text"] for failure in without_model.failures] == [
        "the outputs must vary"
    ]
    assert without_model.error_ratio() == np.inf and without_model.coverage == 0.0
    held_out_windows([FLIGHT, FLIGHT], QUICK, STEPS)
    trained = [sum(map(len, call.args[0])) for call in learn.call_args_list[-FOLDS:]]
    assert trained == [approx(2 * len(FLIGHT) * (1 - 1 / FOLDS), abs=1)] * FOLDS
    # The baselines need no model, and the band is judged by what was forecast.
    for name in (CONSTANT_MEAN, HOLD_LAST):
        assert_allclose(without_model.forecasts[name], held_out.forecasts[name])
    monkeypatch.setattr(module, "learn_forecasts", learn_after_first_failure)
    with_most_models = held_out_windows([FLIGHT], QUICK, STEPS)
    lost_windows = int(np.isnan(with_most_models.band[:, 0, 0]).sum())
    inside = abs(held_out.measured - held_out.forecasts["forecast"]) <= held_out.band
    assert 0 < lost_windows < len(with_most_models) and with_most_models.coverage == approx(
        inside[lost_windows:].mean()
    )


def test_a_flight_without_room_for_a_window_is_refused():
    with raises(ValueError, match="no held-out window of 60 samples fits"):
        held_out_windows([FLIGHT[:150]], QUICK, STEPS)
