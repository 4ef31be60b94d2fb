"""The joint VAR as a forecaster; its model and its paths are tested in tests/dem/test_var.py."""

import numpy as np
import pytest
from peculiar_flights import TEST, TRAIN, back_from_other_units, in_other_units
from simulated import in_closed_loop

from mavdem import baselines, evaluate

SEGMENTS = [TRAIN[:300], TRAIN[400:]]


@pytest.fixture(scope="module")
def model():
    return baselines.var(TRAIN)


def test_motors_show_the_motion_and_later_ones_show_more():
    """In closed loop motors are the autopilot's measurement of the motion, so that they help even as measurements."""
    flight = in_closed_loop(1000)
    train, test = flight[:700], flight[700:]
    model = baselines.var(train)
    forecasts = (model.forecast(test.inputs, smooth=True), model.forecast(test.inputs), model.predict(len(test)))
    smooth, causal, unknown = (evaluate.relative_mspe(train, test, each) for each in forecasts)
    assert smooth < causal < 0.3 < unknown < 1.2


def test_forecasts_and_predictions_begin_anew_at_every_so_many_samples(model):
    past = np.hstack([TEST.outputs, TEST.inputs])[10:20]
    every = model.forecast_every(20, TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(every[:20], model.forecast(TEST.inputs)[:20], rtol=1e-9)
    np.testing.assert_allclose(every[20:40], model.model.infer(past, TEST.inputs[20:40]).mean, rtol=1e-9)
    np.testing.assert_allclose(model.forecast_every(999, TEST.inputs, TEST.outputs), model.forecast(TEST.inputs))
    every = model.predict_every(20, TEST.inputs, TEST.outputs)
    np.testing.assert_allclose(every[:20], model.predict(20), rtol=1e-9)
    np.testing.assert_allclose(every[20:40], model.model.predict(past, 20).mean[:, :2], rtol=1e-9)


def test_no_lag_reaches_across_a_gap():
    """Each segment begins with what is known without a past."""
    again = baselines.var([*SEGMENTS, SEGMENTS[0]], order=4).one_step()
    assert again.shape == (900, 2)
    np.testing.assert_allclose(again[:300], again[600:], rtol=1e-12)


def test_units_do_not_matter(model):
    other = baselines.var(in_other_units(TRAIN))
    moved = in_other_units(TEST)
    for smooth in (False, True):
        found = back_from_other_units(other.forecast(moved.inputs, smooth=smooth))
        np.testing.assert_allclose(found, model.forecast(TEST.inputs, smooth=smooth), atol=1e-6 * TRAIN.outputs.std())
    np.testing.assert_allclose(back_from_other_units(other.predict(50)), model.predict(50), atol=1e-9)


def test_bands_are_those_of_the_gaussian_path(model):
    np.testing.assert_allclose(
        model.predict_band(30), 1.6449 * np.sqrt(model.model.predict(model._past, 30).variance[:, :2]), rtol=1e-4
    )
    variance = model.forecast_variance(TEST.inputs)
    np.testing.assert_allclose(model.forecast_band(TEST.inputs, 0.5), 0.67449 * np.sqrt(variance), rtol=1e-4)
    assert (model.predict_band(30)[-1] > model.predict_band(30)[0]).all()


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda model: baselines.var(TRAIN, 0), "order must"),
        (lambda model: baselines.var(TRAIN, 4, 0.0), "ridge must"),
        (lambda model: baselines.var(TRAIN[:10]), "more than 10 samples"),
        (lambda model: model.forecast(TEST.inputs[:, :3]), "inputs must"),
        (lambda model: model.simulate(TEST.inputs), r"use Learned\.simulate"),
    ],
)
def test_what_cannot_be_is_named(model, ask, said):
    with pytest.raises(ValueError, match=said):
        ask(model)
