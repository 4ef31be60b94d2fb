import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, Forecaster, baselines, evaluate

FLIGHT = simulated(wind=2.0)
SEGMENTS = [FLIGHT[:300], FLIGHT[400:650]]


@pytest.mark.parametrize(
    ("method", "name"),
    [(baselines.hold, "hold last"), (baselines.constant_mean, "constant mean"), (baselines.zero, "zero")],
)
def test_forecasts_are_the_trivial_ones(method, name):
    forecaster = method(FLIGHT[:700])
    expected = evaluate.trivial_forecasts(FLIGHT[:700], 150)[name]
    np.testing.assert_allclose(forecaster.forecast(FLIGHT.inputs[700:]), expected, atol=1e-14)
    assert isinstance(forecaster, Forecaster)
    assert forecaster.stable and not forecaster.cautions and not forecaster.stabilised
    assert forecaster.forecast(FLIGHT.inputs[:0]).shape == (0, 2)


def test_one_step_begins_anew_in_each_segment():
    held, mean, zero = (method(SEGMENTS) for method in (baselines.hold, baselines.constant_mean, baselines.zero))
    outputs = np.vstack([segment.outputs for segment in SEGMENTS])
    average = outputs.mean(axis=0)
    expected = np.vstack([average, outputs[:-1]])
    expected[300] = average
    np.testing.assert_allclose(held.one_step(), expected, atol=1e-14)
    np.testing.assert_allclose(mean.one_step(), np.broadcast_to(average, outputs.shape))
    assert not zero.one_step().any() and zero.one_step().shape == outputs.shape
    np.testing.assert_allclose(held.forecast(np.zeros((3, 4))), np.tile(outputs[-1], (3, 1)))


def test_from_zero_nothing_is_held():
    np.testing.assert_allclose(
        baselines.hold(FLIGHT).forecast(np.zeros((3, 4)), from_zero=True), np.tile(FLIGHT.outputs.mean(axis=0), (3, 1))
    )


def test_outputs_that_stand_still_and_a_single_sample_are_no_trouble():
    single = Flight([0.0], [[1.0]], [[3.0]], dt=0.01)
    for method, value in ((baselines.hold, 3.0), (baselines.constant_mean, 3.0), (baselines.zero, 0.0)):
        np.testing.assert_array_equal(method(single).forecast([[1.0], [2.0]]), [[value], [value]])


@pytest.mark.parametrize("inputs", [np.zeros((5, 3)), np.full((5, 4), np.inf), np.zeros(5)])
def test_wrong_forecast_inputs_are_named(inputs):
    with pytest.raises(ValueError, match="^inputs must"):
        baselines.zero(FLIGHT).forecast(inputs)
