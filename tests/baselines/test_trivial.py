import numpy as np
import pytest
from simulated import simulated

from mavdem import Forecaster, baselines

FLIGHT = simulated(wind=2.0)
SEGMENTS = [FLIGHT[:300], FLIGHT[400:650]]


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        (baselines.hold, FLIGHT.outputs[699]),
        (baselines.constant_mean, FLIGHT.outputs[:700].mean(axis=0)),
        (baselines.zero, np.zeros(2)),
    ],
)
def test_forecasts_are_the_trivial_ones(method, expected):
    forecaster = method(FLIGHT[:700])
    np.testing.assert_allclose(forecaster.forecast(FLIGHT.inputs[700:]), np.tile(expected, (150, 1)), atol=1e-14)
    assert isinstance(forecaster, Forecaster)
    assert forecaster.stable and not forecaster.cautions
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
    np.testing.assert_allclose(held.forecast(np.zeros((3, 4)), from_zero=True), np.tile(average, (3, 1)))


def test_models_that_need_the_inputs_say_so_and_what_to_use():
    arx = baselines.arx(FLIGHT[:700], 2)
    for answer in (lambda: arx.predict(3), lambda: arx.predict_every(3, FLIGHT.inputs[700:], FLIGHT.outputs[700:])):
        with pytest.raises(ValueError, match=r"^ARX\(2\) needs the inputs of the time it forecasts: use forecast"):
            answer()
    ahead = FLIGHT.inputs[700:]
    np.testing.assert_array_equal(arx.simulate(ahead), arx.forecast(ahead))
    np.testing.assert_array_equal(arx.forecast(ahead, smooth=True), arx.forecast(ahead))
