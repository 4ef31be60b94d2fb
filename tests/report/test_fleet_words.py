"""The summary of a fleet in words: who needs a look first, what was flown, and why logs could not be used."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

from fleet_rows import fleet_rows, flight_row

from mavdem.fleet.row import FlightRow, summary
from mavdem.report.blocks import text_of
from mavdem.report.flights import fleet_blocks, vehicle_health, vehicle_words


def test_vehicles_in_trouble_come_first_and_the_worst_before_others():
    rows = [
        flight_row("alpha", 0),
        flight_row("alpha", 1, health="drift"),
        flight_row("alpha", 2, health="unknown"),
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
    assert vehicle_health(flights) == "ok"
    words = vehicle_words(flights)
    # That a motor is weak, whichever it is: the row has no probability of this motor.
    assert "motor 1 (probability of a fault 0.99)" in words and "The latest flight that was judged shows none." in words
    text = text_of(fleet_blocks([row for flight in flights for row in flight]))
    assert text.startswith("No drift and no fault in the latest flights of 1 vehicle")
    assert "in earlier flights, and not in the latest: quad." in text


def test_reasons_are_counted_without_the_numbers_that_make_each_different():
    refused = [
        FlightRow(file=f"/logs/{i}.bin", key=str(i), status=f"/logs/{i}.bin is cut off at {i}.") for i in range(5)
    ]
    text = text_of(fleet_blocks([*refused, FlightRow(file="x.bin", status="It is empty.")]))
    assert "the log is cut off at …  5" in " ".join(text.split("\n")).replace("   ", "  ") or "cut off at …" in text
    assert text.count("cut off") == 1 and "6 logs" in text


def test_flights_and_tiers_are_counted_once_for_both_axes():
    text = text_of(fleet_blocks(fleet_rows(10)))
    assert "10 flights of 5 vehicles" in text and "10 full model" in text


def test_a_flight_that_two_logs_have_counts_once_and_by_the_better():
    slow = [flight_row("quad", 0, axis, key="slow", file="/logs/quad/0.tlog", tier="c") for axis in ("roll", "pitch")]
    late = [replace(row, date=row.date + timedelta(seconds=5)) for row in slow]
    rows = [flight_row("quad", 0), *late, flight_row("quad", 1)]
    assert "2 flights of 1 vehicle (1 more log has a flight of these)" in text_of(fleet_blocks(rows))
    counts = summary(rows)
    assert (counts["flights"], counts["tiers"], counts["health"]) == (2, {"a": 2}, {"ok": 2})


def test_flights_by_a_system_id_are_no_vehicle_until_they_are_judged_as_one():
    rows = [flight_row("px4-1", number, vehicle_basis="system id", health="unknown") for number in range(2)]
    text = text_of(fleet_blocks(rows))
    assert "2 flights whose logs do not say of which vehicle" in text and "of 1 vehicle" not in text
    assert summary(rows)["vehicles"] == 0
    judged = [replace(row, health="fault") for row in rows]
    assert "px4-1 (fault)" in text_of(fleet_blocks(judged))
    assert "these may be several" in vehicle_words([[row] for row in judged])
