"""A difference in words: the change with its interval, what is the same, conditions apart, and what it rests on."""

from __future__ import annotations

from dataclasses import replace

import pytest
from fleet_rows import flight_row

from mavdem.fleet.difference import since_baseline, vehicle_difference
from mavdem.report.blocks import text_of
from mavdem.report.flights import baseline_blocks, difference_blocks


def flown(number, vehicle="quad", **changed):
    known = {"voltage_mean": 16.0, "collective": 0.4, "lean_roll": 0.0, "lean_pitch": 0.0}
    return [flight_row(vehicle, number, axis, **(known | changed)) for axis in ("roll", "pitch")]


WEAK = {"effect": (-40.0, 40.0, 0.7 * 41.0, -39.0), "trim_share": (0.97, 0.95, 1.12, 0.96)}


def words(before, after):
    return text_of(difference_blocks(vehicle_difference(before, after)))


def test_a_changed_motor_is_named_with_its_interval_and_what_is_the_same_has_one_too():
    before = [row for number in range(5) for row in flown(number)]
    after = [row for number in range(5, 10) for row in flown(number, **WEAK)]
    text = words(before, after)
    changed = next(line for line in text.splitlines() if line.startswith("Changed:"))
    assert "motor 3's share +12" in changed and "motor 3's control effectiveness −29.1 % ±" in changed
    same = next(line for line in text.splitlines() if line.startswith("The same:"))
    assert "rate damping on roll (±" in same and "motor time constant on pitch (±" in same
    assert "5 flights of A and 5 flights of B" in text


def test_between_two_flights_it_says_that_the_variation_is_assumed():
    assert "one flight each" in words(flown(0), flown(1)) and "assumed" in words(flown(0), flown(1))


def test_wind_battery_and_lean_are_conditions():
    other = {"wind_torque_sd": 4.0, "voltage_mean": 14.0, "lean_roll": 0.2}
    text = words(flown(0), flown(1, **other))
    condition = next(line for line in text.splitlines() if line.startswith("Conditions"))
    assert "battery 16.0 → 14.0 V" in condition and "+11° of roll" in condition
    assert "wind torque on roll 46 → 229 °/s²" in condition
    assert "Nothing changed beyond chance." in text
    allowed = "shares for the lean and mean control effectiveness for battery and mean output"
    assert f"Intervals that allow for conditions: {allowed}." in condition
    assert "wind torque on roll 46 → 46 °/s²" in words(flown(0), flown(1))


def test_what_is_not_known_has_its_figures():
    text = words(flown(0), flown(1, trim_share=(1.0, 0.98, 1.08, 0.99)))
    unknown = next(line for line in text.splitlines() if line.startswith("Not known:"))
    assert "motor 3's share +5 % ±" in unknown


def test_a_name_that_many_vehicles_have_is_taken_on_trust():
    flights = [flown(number, "ardupilotmega-1", vehicle_basis="system id") for number in (0, 1)]
    assert "ardupilotmega-1 is a name by the MAVLink system id, which many vehicles share" in words(*flights)


@pytest.mark.parametrize(("vehicle", "said"), [("other", "A is quad and B is other"), ("unknown", "taken on trust")])
def test_another_or_an_unknown_vehicle_is_said(vehicle, said):
    assert said in words(flown(0), flown(1, vehicle))


def test_nothing_to_compare_has_its_reason():
    text = words(flown(0), [replace(row, status="It is empty.") for row in flown(1)])
    assert text.startswith("Nothing can be compared.") and "B has no flight with figures." in text


def test_the_latest_flight_of_each_vehicle_is_compared_with_the_baseline():
    baseline = [row for number in range(4) for row in flown(number)]
    later = [row for number in range(4, 8) for row in flown(number, **WEAK)]
    rows = [*baseline, *later, *flown(0, "new"), *flown(0, "unknown")]
    found = {name: baseline_blocks(*one) for name, one in since_baseline(rows, baseline).items()}
    assert set(found) == {"quad", "new"}
    assert "motor 3's share +12" in text_of(found["quad"])
    assert "the latest flight, 0007.ulg (2026-01-12), beside 4 flights." in text_of(found["quad"])
    assert "no flight of this vehicle" in text_of(found["new"])
