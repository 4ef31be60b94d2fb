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
    changed = FLIGHT.outputs.copy()
    moved = FLIGHT.inputs.copy()
    last = np.searchsorted(FLIGHT.time, held_out.time[-1, 0])
    # Of the last part, which only its own model does not see.
    changed[last:] += 0.1
    moved[last:] += 30.0 * SIGNS
    again = held_out_windows([replace(FLIGHT, outputs=changed)], QUICK, STEPS)
    for name in ("forecast", "prediction"):
        assert_array_equal(again.forecasts[name][-1], held_out.forecasts[name][-1])
    # A prediction does not know the motors of its window either; a forecast does.
    driven = held_out_windows([replace(FLIGHT, inputs=moved)], QUICK, STEPS)
    assert_array_equal(driven.forecasts["prediction"][-1], held_out.forecasts["prediction"][-1])
    assert not np.array_equal(driven.forecasts["forecast"][-1], held_out.forecasts["forecast"][-1])


def test_the_test_after_training_is_one_window_of_the_models_own_forecast():
    train = FLIGHT[:600]
    test = FLIGHT[600:700]
    learned = mavdem.learn(train, QUICK)
    window = held_out_test(train, test, learned)
    assert_allclose(window.forecasts["forecast"][0], learned.forecast(test.inputs), rtol=1e-7)
    assert_array_equal(window.forecasts[HOLD_LAST][0], np.tile(train.outputs[-1], (100, 1)))
    assert window.error_ratio() == approx(relative_mspe(train, test, learned.forecast(test.inputs)))


def test_a_model_that_cannot_be_learnt_errs_infinitely_and_says_why(held_out, monkeypatch):
    refused = ValueError("the outputs must vary")
    learn = Mock(side_effect=refused)
    once = Mock(wraps=module.learn_forecasts, side_effect=chain([refused], repeat(DEFAULT)))
    monkeypatch.setattr(module, "learn_forecasts", learn)
    none = held_out_windows([FLIGHT], QUICK, STEPS)
    assert [failure.figures["text"] for failure in none.failures] == ["the outputs must vary"]
    assert none.error_ratio() == np.inf and none.coverage == 0.0
    held_out_windows([FLIGHT, FLIGHT], QUICK, STEPS)
    trained = [sum(map(len, call.args[0])) for call in learn.call_args_list[-FOLDS:]]
    assert trained == [approx(2 * len(FLIGHT) * (1 - 1 / FOLDS), abs=1)] * FOLDS
    # The baselines need no model, and the band is judged by what was forecast.
    for name in (CONSTANT_MEAN, HOLD_LAST):
        assert_allclose(none.forecasts[name], held_out.forecasts[name])
    monkeypatch.setattr(module, "learn_forecasts", once)
    some = held_out_windows([FLIGHT], QUICK, STEPS)
    lost = int(np.isnan(some.band[:, 0, 0]).sum())
    inside = abs(held_out.measured - held_out.forecasts["forecast"]) <= held_out.band
    assert 0 < lost < len(some) and some.coverage == approx(inside[lost:].mean())


def test_a_flight_without_room_for_a_window_is_refused():
    with raises(ValueError, match="no held-out window of 60 samples fits"):
        held_out_windows([FLIGHT[:150]], QUICK, STEPS)
