"""The speed of a vehicle's clock against this computer's: measured, and reported once where it is slow."""

from math import nan

import numpy as np
from pytest import approx, mark

from mavdem.facts.session import RateFact
from mavdem.live.clock_speed import ClockSpeed


def measured(now, vehicle_times):
    """The measurement after all readings, and the facts that it reported."""
    facts = []
    clock_speed = ClockSpeed(facts.append)
    clock_speed.update(0.0, nan)
    for time, vehicle_time in zip(now, vehicle_times, strict=True):
        clock_speed.update(time, vehicle_time)
    return clock_speed, facts


@mark.parametrize("speed", [0.06, 0.5, 1.0, 8.0])
def test_the_speed_is_measured_and_a_slow_clock_is_reported_once(speed):
    now = np.arange(0.0, 60.0, 0.02)
    clock_speed, facts = measured(now, 30.0 + speed * now)
    assert clock_speed.speed == approx(speed)
    assert clock_speed.real_seconds(speed) == approx(1.0)
    assert [fact.code for fact in facts] == [RateFact.VEHICLE_CLOCK_SLOW] * (speed < 0.8)
    for fact in facts:
        assert f"runs at {speed} times the speed" in fact.sentence


def test_bursts_of_a_link_do_not_make_the_clock_slow():
    now = np.arange(0.0, 60.0, 0.1)
    clock_speed, facts = measured(now, 1.5 * np.floor(now / 1.5))
    assert clock_speed.speed == approx(1.0, abs=0.3) and not facts


def test_attitude_that_ends_and_jumps_of_the_clock_leave_the_speed_as_it_was():
    now = np.arange(0.0, 40.0, 0.1)
    vehicle_times = 100.0 + now
    vehicle_times[(now > 10) & (now < 14)] = 110.0
    vehicle_times[now > 20] += 1000.0
    vehicle_times[now > 30] -= 1120.0
    clock_speed, facts = measured(now, vehicle_times)
    assert clock_speed.speed == approx(1.0) and not facts
