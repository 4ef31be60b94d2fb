"""Level flight: without climb-out and landing, as far as the vertical speed can be trusted."""

import numpy as np
from pytest import approx

from mavdem.dataset.phases import TRANSIENT_SECONDS, without_transients
from mavdem.dataset.time_series import TimeSeries, averaged_series

TIME = np.arange(0.0, 60.0, 0.1)
USUAL = approx((TRANSIENT_SECONDS, 60.0 - TRANSIENT_SECONDS))


def level(climb_rate, flight=(0.0, 60.0)):
    """The level part of a flight with a vertical speed, m/s."""
    speed = np.broadcast_to(climb_rate, TIME.shape).astype(np.float64)
    climb_rate = TimeSeries(TIME, np.zeros(len(TIME)), speed)
    return without_transients(flight, averaged_series(climb_rate))


def test_climb_out_and_landing_last_while_the_vehicle_rises_and_sinks():
    speed = np.select([TIME < 12.0, TIME > 48.0], [1.0, -1.0], 0.0)
    assert level(speed) == approx((12.0, 48.0), abs=1.0)
    assert level(0.0) == USUAL


def test_a_flight_that_only_sinks_has_a_diverged_estimate_of_the_height():
    assert level(-2.0) == USUAL


def test_the_end_of_a_flight_may_only_sink():
    assert level(-2.0, (-np.inf, 60.0)) is None
