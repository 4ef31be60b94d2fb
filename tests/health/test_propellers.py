"""Recorded flights with one propeller shortened: what must be found, and what must not."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from propellers import recorded_flights
from recorded_flights import shared

from mavdem.health.assessment import assess


@pytest.fixture(scope="module")
def flights():
    return recorded_flights(shared("real/propeller"))


@pytest.fixture(scope="module")
def verdicts(flights):
    good = [flight for flight in flights if "good" in flight.name]
    return {flight.name: found for flight, found in zip(flights, assess(flights, good), strict=True)}


def kind(verdicts, *names: str):
    found = [verdict for flight, verdict in verdicts.items() if flight.split("_")[1] in names]
    assert found
    return found


@pytest.mark.slow
def test_good_flights_do_not_alarm_when_left_out(verdicts):
    assert {found.health for found in kind(verdicts, "good")} == {"ok"}
    # At 5 and 10 mm motor 4 works 8 % harder than the mean, since the vehicle leans 3° against the wind.
    assert max(one.fault_probability for one in kind(verdicts, "cut5mm", "cut10mm")) < 0.1


def test_20_and_25_mm_are_faults_of_motor_1_apart_from_good_and_5_mm(verdicts):
    found = kind(verdicts, "cut20mm", "cut25mm")
    assert {one.health for one in found} == {"fault"}
    assert {one.suspect_motor for one in found} == {1}
    bad = [one.fault_probability for one in kind(verdicts, "cut20mm", "cut25mm")]
    rest = [one.fault_probability for one in kind(verdicts, "good", "cut5mm")]
    assert min(bad) > 5 * max(rest)


def test_10_mm_flown_one_after_the_other_are_a_drift(flights):
    good = [flight for flight in flights if "good" in flight.name]
    first = datetime(2022, 3, 14, tzinfo=UTC)
    cut = [flight for flight in flights if "cut10mm" in flight.name]
    dated = [replace(flight, date=first + timedelta(days=day)) for day, flight in enumerate(cut)]
    assert {found.health for found in assess(dated, good)} == {"drift"}
