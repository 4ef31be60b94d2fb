"""The bank of flights that physical parameters are tried on: all of it can be flown, and a seed decides it."""

from itertools import product

import pytest
from physical_flights import AUTOPILOTS, RATES, SPEEDS, STEERING, WINDS, cases, scenario


@pytest.mark.parametrize("seed", [0, 1])
def test_each_vehicle_flies_in_each_wind_with_each_steering(seed):
    bank = cases(seed, 1)
    assert bank == cases(seed, 1) != cases(seed + 2, 1)
    flown = [(case.vehicle, case.wind, case.steering) for case in bank]
    assert sorted(flown) == sorted(product(SPEEDS, WINDS, STEERING))
    for case in bank:
        assert scenario(case).stream.rate == case.rate
    assert {(case.rate, case.autopilot) for case in bank} == set(product(RATES, AUTOPILOTS))
    assert any(case.varied for case in bank) and not all(case.varied for case in bank)


def test_a_part_of_the_bank_has_as_many_of_each_steering_and_rate():
    part = cases(0, 1, every=2)
    for steering in STEERING:
        assert sum(case.steering == steering for case in part) == len(part) / len(STEERING)
    counts = [sum((case.rate, case.autopilot) == each for case in part) for each in product(RATES, AUTOPILOTS)]
    assert max(counts) - min(counts) <= 1
