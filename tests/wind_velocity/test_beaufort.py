"""The Beaufort scale, by which the speed of a wind is called known."""

from pytest import mark

from mavdem.wind_velocity.beaufort import beaufort_number, is_speed_known

HIGHEST_SPEEDS = [0.2, 1.5, 3.3, 5.4, 7.9, 10.7, 13.8, 17.1, 20.7, 24.4, 28.4, 32.6]
"""Highest speed of each Beaufort number from 0 to 11, m/s, by WMO-No. 8, vol. I, table 5.1."""


def test_speeds_have_the_beaufort_numbers_of_the_table():
    below = [round(beaufort_number(speed - 0.05)) for speed in HIGHEST_SPEEDS]
    above = [round(beaufort_number(speed + 0.15)) for speed in HIGHEST_SPEEDS]
    assert below == [*range(12)] and above == [*range(1, 13)]


@mark.parametrize("number", [3, 6, 9])
def test_a_speed_is_known_within_one_beaufort_number(number):
    low, high = HIGHEST_SPEEDS[number - 1] + 0.1, HIGHEST_SPEEDS[number]
    assert is_speed_known((low, high))
    assert not is_speed_known((low, 1.1 * high))


def test_a_light_breeze_is_known_whatever_its_interval():
    assert is_speed_known((0.0, 3.3)) and not is_speed_known((0.0, 3.6))
