"""The summary of a fleet in words: who needs a look first, what was flown, and why logs could not be used."""

from __future__ import annotations

from fleet_rows import fleet_rows, flight_row

from mavdem.fleet.row import FlightRow
from mavdem.report.blocks import text_of
from mavdem.report.fleets.summary import fleet_blocks, vehicle_health, vehicle_words


def test_vehicles_in_trouble_come_first_and_the_worst_before_others():
    drift = flight_row("alpha", 0, health="drift")
    rows = [
        drift,
        flight_row("alpha", 1),
        flight_row("beta", 0, health="fault", suspect_motor=2),
        flight_row("gamma", 0),
    ]
    text = text_of(fleet_blocks(rows))
    assert text.startswith("2 of 3 vehicles need a look: beta (fault, motor 2) and alpha (drift).")


def test_a_fleet_without_healthy_flights_is_not_called_healthy():
    text = text_of(fleet_blocks([flight_row("quad", number, health="unknown") for number in range(3)]))
    assert text.startswith("No vehicle could be judged yet.")


def test_a_repaired_vehicle_says_that_later_flights_show_nothing():
    flights = [
        [flight_row("quad", 0, health="fault", suspect_motor=1, fault_probability=0.99)],
        [flight_row("quad", 1)],
    ]
    assert vehicle_health(flights) == "fault"
    assert "motor 1 (probability 0.99)" in vehicle_words(
        flights
    ) and "The flights after it show none." in vehicle_words(flights)


def test_reasons_are_counted_without_the_numbers_that_make_each_different():
    refused = [
        FlightRow(file=f"/logs/{i}.bin", key=str(i), status=f"/logs/{i}.bin is cut off at {i}.") for i in range(5)
    ]
    text = text_of(fleet_blocks([*refused, FlightRow(file="x.bin", status="It is empty.")]))
    assert "the log is cut off at …  5" in " ".join(text.split("\n")).replace("   ", "  ") or "cut off at …" in text
    assert text.count("cut off") == 1 and "6 logs" in text


def test_flights_and_tiers_are_counted_once_for_both_axes():
    text = text_of(fleet_blocks(fleet_rows(10)))
    assert "10 flights of 5 vehicles" in text and "10 of tier a" in text
