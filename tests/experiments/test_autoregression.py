"""Trivial forecasts and the joint VAR, whose model and paths are tested in tests/dem/test_var.py."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from peculiar_flights import TEST, TRAIN, back_from_other_units, in_other_units
from pytest import fixture, mark, raises
from simulated import simulated

from mavdem import Forecaster, baselines

APART = [TRAIN[:300], TRAIN[400:]]


@fixture(scope="module")
def model():
    return baselines.var(TRAIN)


def test_no_lag_of_var_reaches_across_a_gap():
    """Each segment begins with what is known without a past."""
    again = baselines.var([*APART, APART[0]], order=4).one_step()
    assert again.shape == (900, 2)
    assert_allclose(again[:300], again[600:], rtol=1e-12)


@mark.slow
def test_units_do_not_matter_to_it(model):
    """The same flight in other units gives the same forecasts in those units."""
    model_in_other_units = baselines.var(in_other_units(TRAIN))
    test_in_other_units = in_other_units(TEST)
    for smooth in (False, True):
        forecast = back_from_other_units(
            model_in_other_units.forecast(test_in_other_units.inputs, smooth=smooth)
        )
        assert_allclose(
            forecast, model.forecast(TEST.inputs, smooth=smooth), atol=1e-6 * TRAIN.outputs.std()
        )
    assert_allclose(
        back_from_other_units(model_in_other_units.predict(50)), model.predict(50), atol=1e-9
    )


@mark.parametrize(
    "ask, said",
    [
        (lambda model: baselines.var(TRAIN, 0), "order must"),
        (lambda model: baselines.var(TRAIN[:10]), "more than 10 samples"),
        (lambda model: model.forecast(TEST.inputs[:, :3]), "inputs must"),
        (lambda model: model.simulate(TEST.inputs), r"use Learned\.simulate"),
    ],
)
def test_what_cannot_be_is_named(model, ask, said):
    with raises(ValueError, match=said):
        ask(model)


FLIGHT = simulated(wind=2.0)
SEGMENTS = [FLIGHT[:300], FLIGHT[400:650]]


@mark.parametrize(
    "method, expected",
    [
        (baselines.hold, FLIGHT.outputs[699]),
        (baselines.constant_mean, FLIGHT.outputs[:700].mean(axis=0)),
        (baselines.zero, np.zeros(2)),
    ],
)
def test_forecasts_are_the_trivial_ones(method, expected):
    """The baselines hold the last sample, forecast the mean, or forecast zero."""
    forecaster = method(FLIGHT[:700])
    assert_allclose(
        forecaster.forecast(FLIGHT.inputs[700:]), np.tile(expected, (150, 1)), atol=1e-14
    )
    assert isinstance(forecaster, Forecaster)
    assert forecaster.stable and not forecaster.cautions


def test_one_step_begins_anew_in_each_segment():
    held = baselines.hold(SEGMENTS)
    outputs = np.vstack([segment.outputs for segment in SEGMENTS])
    average = outputs.mean(axis=0)
    expected = np.vstack([average, outputs[:-1]])
    expected[300] = average
    assert_allclose(held.one_step(), expected, atol=1e-14)
    assert_allclose(held.forecast(np.zeros((3, 4)), from_zero=True), np.tile(average, (3, 1)))


def test_models_that_need_the_inputs_say_so_and_what_to_use():
    """A subspace model has no model of the inputs, so that it cannot forecast without them."""
    forecast = baselines.subspace(FLIGHT[:700], 2)
    for answer in (
        lambda: forecast.predict(3),
        lambda: forecast.predict_every(3, FLIGHT.inputs[700:], FLIGHT.outputs[700:]),
    ):
        with raises(
            ValueError,
            match=r"^subspace\(2\) needs the inputs of the time it forecasts: use forecast",
        ):
            answer()
    ahead = FLIGHT.inputs[700:]
    assert_array_equal(forecast.simulate(ahead), forecast.forecast(ahead))
    assert_array_equal(forecast.forecast(ahead, smooth=True), forecast.forecast(ahead))
