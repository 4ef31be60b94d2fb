"""Forecasts begun anew along what follows the training data: of every method alike."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from pytest import fixture, mark, raises
from simulated import simulated

from mavdem import Settings, baselines, learn
from mavdem.dem.record import Record

FLIGHT = simulated(wind=2.0)
TRAIN = FLIGHT[:700]
TEST = FLIGHT[700:820]
METHODS = {
    "joint VAR (Bayesian)": lambda: learn(TRAIN, Settings(window=9)),
    "DEM plant": lambda: learn(TRAIN, Settings(window=9, forecasts="plant")),
    "DEM paper": lambda: learn(TRAIN, Settings.paper()),
    "subspace": lambda: baselines.subspace(TRAIN, 2),
    "joint VAR": lambda: baselines.var(TRAIN),
}


@fixture(params=METHODS, scope="module")
def model(request):
    return METHODS[request.param]()


def having_seen(model, samples):
    """Returns the model with a shorter record, as if the flight had come to this sample.

    Its learned parts are not learned again.
    """
    model_after_samples = replace(model, record=Record.from_flights(FLIGHT[:samples]))
    if "joint" in vars(model):
        channels = np.hstack([FLIGHT.outputs, FLIGHT.inputs @ model.joint.mixer])[:samples]
        vars(model_after_samples)["joint"] = replace(
            model.joint, last_samples=channels[-model.joint.hyperparameters.lags :]
        )
    return model_after_samples


def assert_same(actual, expected):
    """But for rounding."""
    assert_allclose(actual, expected, rtol=0, atol=1e-6 * TEST.outputs.std())


@mark.slow
@mark.parametrize("steps", [1, 7, 50])
def test_each_piece_is_the_forecast_of_a_model_that_has_seen_all_before_it(model, steps):
    pieces = model.forecast_every(steps, TEST.inputs, TEST.outputs)
    assert pieces.shape == TEST.outputs.shape
    for begin in (0, steps, 2 * steps):
        piece = slice(begin, begin + steps)
        assert_same(pieces[piece], having_seen(model, 700 + begin).forecast(TEST.inputs[piece]))


@mark.slow
@mark.parametrize("steps", [120, 10**9])
def test_one_piece_is_the_forecast(model, steps):
    whole = model.forecast_every(steps, TEST.inputs, TEST.outputs)
    assert_same(whole, model.forecast(TEST.inputs))
    assert model.forecast_every(5, TEST.inputs[:0], TEST.outputs[:0]).shape == (0, 2)


@mark.parametrize(
    "steps, inputs, outputs, named",
    [
        (0, TEST.inputs, TEST.outputs, "^steps"),
        (1.5, TEST.inputs, TEST.outputs, "^steps"),
        (5, TEST.inputs[:, :1], TEST.outputs, "^inputs must have shape"),
        (5, TEST.inputs, TEST.outputs[:, 0], "^outputs must have shape"),
        (5, TEST.inputs, TEST.outputs[1:], "the same samples"),
        (5, TEST.inputs, TEST.outputs * np.nan, "^outputs must be finite"),
    ],
)
def test_what_does_not_follow_is_refused(model, steps, inputs, outputs, named):
    with raises(ValueError, match=named):
        model.forecast_every(steps, inputs, outputs)
