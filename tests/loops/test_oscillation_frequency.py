"""The frequency of an oscillation by messages that come more slowly than it oscillates."""

import numpy as np
from pytest import approx, mark

from mavdem.dataset.segments import Segment
from mavdem.dataset.time_series import TimeSeries
from mavdem.loops.oscillation_frequency import unaliased_frequency

SPAN = Segment(0, 0.0, 16.0)


def samples(oscillation, message_rate):
    """An oscillation, a function of time, in messages at so many Hz."""
    time = np.arange(0.0, SPAN.end, 1 / message_rate)
    return TimeSeries(time, np.zeros(len(time), int), oscillation(time))


@mark.parametrize("frequency", [4.0, 15.0, 22.0])
def test_messages_at_two_rates_and_the_angle_show_the_frequency(frequency):
    """Messages at 10 and at 25 Hz fold 15 Hz to 5 and to 10 Hz."""
    turn = 2 * np.pi * frequency
    slow_rate = samples(lambda time: np.cos(turn * time + 0.3), 10.3)
    gyro = samples(lambda time: np.cos(turn * time + 0.3), 25.0)
    angle = samples(lambda time: np.sin(turn * time + 0.3) / turn, 10.3)
    assert unaliased_frequency([slow_rate, gyro], angle, SPAN) == approx(frequency, abs=0.1)
    # A gyro that shows another motion agrees with no frequency.
    noise = samples(lambda time: np.random.default_rng(1).normal(size=len(time)), 25.0)
    assert unaliased_frequency([slow_rate, noise], angle, SPAN) is None
    short = Segment(0, 0.0, 1.0)
    assert unaliased_frequency([slow_rate, gyro], angle, short) is None
