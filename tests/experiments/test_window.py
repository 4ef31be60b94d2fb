"""What does not fit into a flight, and which shorter parts would."""

from dataclasses import replace

import numpy as np
from pytest import mark
from refusals import refused
from simulated import simulated

from mavdem import Flight
from mavdem.assessment.axis.training import flights_after_start
from mavdem.experiments.window import (
    MAX_WINDOWS,
    Length,
    disjoint_windows,
    no_test_window,
    required_windows,
    too_short,
    windows,
)
from mavdem.facts.forecasts import ForecastFact

FLIGHT = replace(simulated(samples=600), provenance={"segment": {"boot": 0}})


@mark.parametrize(
    "start, train, options",
    [
        (0.0, 700, ("--train", "500", "--test", "100")),
        (3.0, 700, ("--train", "250", "--test", "50")),
        (5.5, 700, ()),
    ],
)
def test_parts_that_are_too_long_are_refused_with_those_that_fit(start, train, options):
    """A flight of 6 s is too short for the window; the error suggests shorter parts if they suffice."""
    fact = too_short(FLIGHT, start, train, 150, 100).fact
    remaining_samples = 600 - round(100 * start)
    assert fact.code is ForecastFact.FLIGHT_TOO_SHORT
    assert (fact.figures["left"], fact.figures["options"]) == (remaining_samples, options)


def test_every_second_window_overlaps_none_also_where_their_length_is_odd():
    parts = windows("flight", FLIGHT, 100, 25)
    assert [part.start for part in parts[:3]] == [0, 63, 126]
    assert len(disjoint_windows(parts)) == 4


def test_windows_of_a_long_flight_are_few_and_reach_over_all_of_it():
    train, test = Length(50, in_seconds=False), Length(10, in_seconds=False)
    parts = required_windows("short", FLIGHT, train, test, None)
    assert [part.start for part in parts[:3]] == [0, 30, 60] and len(parts) == 19
    time = 0.01 * np.arange(3000)
    long = Flight(time, np.tile(FLIGHT.inputs, (5, 1)), np.tile(FLIGHT.outputs, (5, 1)))
    parts = required_windows("long", long, train, test, None)
    assert MAX_WINDOWS - 2 < len(parts) <= MAX_WINDOWS
    assert len(long) - parts[-1].stop < parts[1].start
    assert len(required_windows("long", long, train, test, 30)) == 99


def test_a_window_that_fits_into_no_part_is_refused_with_one_that_does():
    fact = no_test_window(600, 0.01, 150, 5).fact
    assert fact.code is ForecastFact.NO_TEST_WINDOW
    assert fact.figures["options"] == ("--test", "100")
    assert no_test_window(200, 0.01, 150, 5).fact.figures["options"] == ()


def test_a_start_after_the_end_leaves_nothing():
    assert refused(flights_after_start, [FLIGHT], 5.9).code is ForecastFact.NOTHING_LEFT
