"""The flights of a log as a pilot counts them: flight time, distance over ground, height above the take-off."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed
from pytest import approx

from mavdem.assessment.flown_flights import flown_flights, largest_height, total_distance
from mavdem.dataset.signals import Signals

HOVER = Hover(hovering=20.0)
SPEED = 3.0
"""m/s to the north, from take-off to landing."""


def flying_north(shift=0.0):
    """A hover that flies north at ``SPEED``, with noise of its position, which jumps by ``shift`` m at 20 s."""
    telemetry = HOVER.telemetry()
    time = HOVER.stamps(10.0)
    north = SPEED * np.clip(time, 6.0, HOVER.landed) + shift * (time > 20.0)
    noise = 0.1 * np.random.default_rng(1).standard_normal(len(time))
    height = np.cumsum(HOVER.climb(time)) / 10.0
    return changed(
        telemetry, "LOCAL_POSITION_NED", x=north, y=noise, z=-height, vz=-HOVER.climb(time)
    )


def test_a_flight_has_time_distance_and_height():
    (flight,) = flown_flights(Signals(flying_north()))
    assert flight.start == approx(6.0, abs=1.0) and flight.end == approx(HOVER.landed, abs=1.0)
    assert flight.distance == approx(SPEED * flight.duration, rel=0.05)
    assert flight.height == approx(10.0, abs=1.0)


def test_a_reset_of_the_position_is_no_distance():
    assert total_distance(flown_flights(Signals(flying_north(shift=500.0)))) == approx(
        total_distance(flown_flights(Signals(flying_north()))), abs=2 * SPEED
    )


def test_each_boot_has_its_flights_and_without_a_position_no_distance_is_known():
    telemetry = HOVER.telemetry(without=("LOCAL_POSITION_NED",))
    messages = {}
    for name, table in telemetry.messages.items():
        twice = {field: np.concatenate([values, values]) for field, values in table.items()}
        twice["boot"] = np.repeat([0, 1], len(table["time"]))
        messages[name] = twice
    flights = flown_flights(Signals(replace(telemetry, messages=messages)))
    assert [flight.boot for flight in flights] == [0, 1]
    assert total_distance(flights) is None and largest_height(flights) is None


def test_an_estimator_that_stays_at_its_origin_gives_no_distance():
    telemetry = changed(flying_north(), "LOCAL_POSITION_NED", x=0.0, y=0.0)
    assert total_distance(flown_flights(Signals(telemetry))) is None
