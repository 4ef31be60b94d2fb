"""The speed of a vehicle's clock against this computer's: measured, and reported once where it is slow."""

from math import nan

import numpy as np
from pytest import approx, mark

from mavdem.facts.session import RateFact
from mavdem.live.clock_speed import ClockSpeed
from mavdem.live.rate_request import ArrivalRates


def measured_speed_and_facts(now, vehicle_times):
    """Returns the measurement of the clock's speed after all readings, and the facts that it reported."""
    facts = []
    clock_speed = ClockSpeed(facts.append)
    clock_speed.update(0.0, nan)
    for time, vehicle_time in zip(now, vehicle_times, strict=True):
        clock_speed.update(time, vehicle_time)
    return clock_speed, facts


@mark.parametrize("speed", [0.06, 0.5, 1.0, 8.0])
def test_the_speed_is_measured_and_a_slow_clock_is_reported_once(speed):
    """A simulated vehicle's clock may be slower or faster than real time.

    Below 0.8 times real time that is reported.
    """
    now = np.arange(0.0, 60.0, 0.02)
    clock_speed, facts = measured_speed_and_facts(now, 30.0 + speed * now)
    assert clock_speed.speed == approx(speed)
    assert clock_speed.real_seconds(speed) == approx(1.0)
    assert [fact.code for fact in facts] == [RateFact.VEHICLE_CLOCK_SLOW] * (speed < 0.8)
    for fact in facts:
        assert f"runs at {speed} times the speed" in fact.sentence


def test_bursts_of_a_link_do_not_make_the_clock_slow():
    now = np.arange(0.0, 60.0, 0.1)
    clock_speed, facts = measured_speed_and_facts(now, 1.5 * np.floor(now / 1.5))
    assert clock_speed.speed == approx(1.0, abs=0.3) and not facts


def test_attitude_that_ends_and_jumps_of_the_clock_leave_the_speed_as_it_was():
    """The vehicle's clock stands still for 4 s, jumps forward by 1000 s, and back by 1120 s."""
    now = np.arange(0.0, 40.0, 0.1)
    vehicle_times = 100.0 + now
    vehicle_times[(now > 10) & (now < 14)] = 110.0
    vehicle_times[now > 20] += 1000.0
    vehicle_times[now > 30] -= 1120.0
    clock_speed, facts = measured_speed_and_facts(now, vehicle_times)
    assert clock_speed.speed == approx(1.0) and not facts


def test_the_pause_of_a_slow_simulator_does_not_count_as_its_speed():
    running = np.arange(0.0, 40.0, 0.1)
    now = np.where(running < 7.0, running, running + 20.0)
    clock_speed, facts = measured_speed_and_facts(now, 30.0 + 0.5 * running)
    assert [fact.figures["clock_speed"] for fact in facts] == [approx(0.5)]
    assert clock_speed.speed == approx(0.5)


def test_rates_stay_those_of_the_vehicle_where_its_clock_becomes_slower():
    """100 messages in each second of the vehicle's clock, whose speed falls just before a new window."""
    clock_speed = ClockSpeed(lambda fact: None)
    arrival_rates = ArrivalRates()
    vehicle_time = 0.0
    measured_rates = []
    for now in np.arange(0.0, 40.0, 0.1).tolist():
        vehicle_time += 0.05 if now < 20.0 else 0.01
        clock_speed.update(now, 50.0 + vehicle_time)
        if now == approx(21.0):
            arrival_rates = ArrivalRates()
        counts = {30: round(100 * vehicle_time)}
        rates = arrival_rates.update(now, counts, clock_speed.elapsed_seconds(now))
        if rates is not None:
            measured_rates.append(rates[30])
    assert measured_rates == approx(np.full(len(measured_rates), 100.0), rel=0.03)
