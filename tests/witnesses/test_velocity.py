"""Whether a vehicle lost its speed at once, as at an obstacle, or braked."""

import numpy as np
from hover import changed, columns
from instrumented import EVENT, instrumented
from pytest import mark

from mavdem.dataset.signals import Signals
from mavdem.witnesses.velocity import stopped_at


def stopped_within(seconds, rate):
    """Whether a loss of 2 m/s within so many seconds is a stop, in a stream of this rate, Hz."""
    time = np.arange(0.0, 60.0, 1 / rate)
    north = np.interp(time, [EVENT - seconds / 2, EVENT + seconds / 2], [2.0, 0.0])
    telemetry = changed(
        instrumented(), "LOCAL_POSITION_NED", **columns(time, vx=north, vy=0.0, vz=0.0)
    )
    return stopped_at(Signals(telemetry, inputs="motors"), 0, EVENT)


@mark.parametrize("seconds, has_stopped", [(0.2, True), (1.0, False)])
@mark.parametrize("rate", [10.0, 20.0])
def test_only_a_loss_of_the_speed_within_half_a_second_is_a_stop(seconds, rate, has_stopped):
    assert stopped_within(seconds, rate) is has_stopped


def test_a_slow_stream_does_not_show_how_fast_the_speed_was_lost():
    assert stopped_within(0.2, 1.3) is None
