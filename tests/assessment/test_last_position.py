"""Where a lost flight was seen last: place and height by satellites, and way from the take-off."""

import numpy as np
from hover import Hover, changed, columns
from pytest import approx

from mavdem.assessment.flights import flights_in_boot
from mavdem.assessment.last_position import last_position_of_loss
from mavdem.dataset.signals import EARTH_RADIUS, Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending
from mavdem.report.templates import render_section

HOVER = Hover()
"""A flight that lands, after which its receiver goes on."""


def flight_to_the_east(metres_per_second):
    """Signals of a hover near Delft that moves east from the beginning of its record on, and climbs at 1 m/s."""
    telemetry = HOVER.telemetry()
    time = np.arange(0.0, HOVER.end + 10.0, 0.2)
    degrees_east = np.degrees(metres_per_second * time / EARTH_RADIUS / np.cos(np.radians(52.0)))
    fixes = columns(
        time,
        fix_type=3,
        lat=np.full(len(time), 52e7),
        lon=1e7 * (4.35 + degrees_east),
        alt=1e3 * time,
    )
    return Signals(changed(telemetry, "GPS_RAW_INT", **fixes))


def test_the_last_position_is_the_last_one_of_the_flight_that_was_lost():
    signals = flight_to_the_east(1.0)
    [(take_off, landing)] = flights_in_boot(signals, 0)
    loss = Fact(Ending.CONTROL_LOST, Level.BAD, time=landing - 3.0, boot=0)
    position = last_position_of_loss(signals, loss)
    assert position.time == approx(landing, abs=0.21)
    assert position.altitude == approx(position.time)
    assert position.distance == approx(position.time - take_off, abs=0.3)
    assert position.direction == approx(90.0, abs=0.1)
    [sentence] = render_section("last_position", position)
    assert sentence.text.startswith("52.000000° N, 4.35")
    assert f"{position.distance:.0f} m E of the take-off" in sentence.text


def test_a_flight_that_was_not_lost_has_no_last_position():
    assert last_position_of_loss(flight_to_the_east(1.0), None) is None
