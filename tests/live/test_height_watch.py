"""Wrong heights of a live vehicle: an estimate that diverges, and a barometer that reads another height afterwards."""

from dataclasses import dataclass

import numpy as np
from hover import Hover
from live_hover import NOW, Flight, by_time, replay, ticks
from mavlink_streams import message
from pytest import approx, mark, param

from mavdem.facts.ending import MotionEvent
from mavdem.facts.lights import Light

pytestmark = mark.slow

HECTOPASCALS_PER_METRE = 0.12
"""Decrease of the pressure with the height near the ground."""


def pressure_messages(end, drift=0.0, rise=0.0, sinking=41.0):
    """SCALED_PRESSURE of the hover, which drifts by ``drift``, m, in flight, and by ``rise``, m/s, from 20 to 24 s."""
    for time in ticks(0.5, end, 5.0):
        height = np.interp(time, [6.0, 11.0, sinking, sinking + 6.0], [0.0, 10.0, 10.0, 0.0])
        height += drift * np.clip((time - 15.0) / 20.0, 0.0, 1.0)
        height += rise * np.clip(time - 20.0, 0.0, 4.0)
        pressure = 1000.0 - HECTOPASCALS_PER_METRE * height + 1e-3 * np.sin(9.0 * time)
        yield time, message("SCALED_PRESSURE", time_boot_ms=round(1e3 * time), press_abs=pressure)


def position_messages(end, sinking=41.0):
    """GPS_RAW_INT of the hover, with altitudes that are right to 0.1 m."""
    for time in ticks(0.5, end, 2.0):
        height = np.interp(time, [6.0, 11.0, sinking, sinking + 6.0], [0.0, 10.0, 10.0, 0.0])
        altitude = round(1e3 * (400.0 + height + 0.1 * np.sin(3.0 * time)))
        fix = {"fix_type": 3, "lat": 470000000, "lon": 80000000, "satellites_visible": 12}
        yield time, message("GPS_RAW_INT", time_usec=round(1e6 * time), alt=altitude, **fix)


@dataclass(frozen=True)
class Still(Hover):
    """A hover that lies still on the ground before and after."""

    hovering: float = 30.0

    @property
    def landed(self):
        return self.sinking + 6.0

    def climb(self, t):
        """Rises and sinks 10 m."""
        rises = (t > 6.0) & (t < self.level)
        sinks = (t > self.sinking) & (t < self.landed)
        return 2.0 * rises - 10.0 / 6.0 * sinks

    def roll(self, t):
        t = np.asarray(t)
        return np.where((t > 6.0) & (t < self.landed), super().roll(t), 1e-4 * np.sin(t))

    def roll_rate(self, t):
        t = np.asarray(t)
        return np.where((t > 6.0) & (t < self.landed), super().roll_rate(t), 1e-4 * np.cos(t))


@dataclass(frozen=True)
class FallingEstimate(Flight):
    """A hover in Loiter, whose estimated height falls by 2 m/s from 20 to 24 s."""

    def _heartbeats(self, start, end):
        for time, name, fields in super()._heartbeats(start, end):
            yield time, name, fields | {"custom_mode": 5}

    def _climb(self, start, end):
        for time, name, fields in super()._climb(start, end):
            yield time, name, fields | ({"vz": 2.0} if 20.0 <= time < 24.0 else {})


@mark.parametrize("drift, hovering", [(8.0, 30.0), param(0.0, 6.0, marks=mark.in_full)])
def test_a_barometer_that_drifted_is_reported_after_the_landing(drift, hovering):
    """The barometer's height is wrong by 8 m at the end of the flight, while satellites show the true height."""
    hover = Still(hovering=hovering)
    end = hover.landed + 5.0
    flight = Flight(hover, attitude=25.0, motors=25.0).frames(start=0.5, end=end)
    pressures = pressure_messages(end, drift, sinking=hover.sinking)
    replayed = replay(by_time(flight, pressures, position_messages(end, hover.sinking)))
    drifts = [fact for fact in replayed.facts if fact.code is MotionEvent.BAROMETER_DRIFTED]
    assert len(drifts) == (1 if drift else 0)
    estimator = replayed.stream.status().overall_judgement.lights[Light.ESTIMATOR]
    if drift:
        assert drifts[0].figures["change"] == approx(drift, abs=0.6)
        # As in a log, satellites show in flight when it began.
        assert drifts[0].time == approx(15.0, abs=2.0)
        assert estimator == drifts[0]


@mark.in_full
def test_a_barometer_that_drifts_is_reported_in_flight_by_satellites():
    flight = Flight(Still(), attitude=12.0, motors=12.0).frames(start=0.5, end=40.0)
    replayed = replay(by_time(flight, pressure_messages(40.0, -10.0), position_messages(40.0)))
    [event] = [
        event for event in replayed.events if event.fact.code is MotionEvent.HEIGHTS_DISAGREE
    ]
    # The drift is 7.5 m at 30 s, and must last for 5 s. It began at 15 s, more than the watch's memory before.
    assert 35.0 < event.seconds - NOW < 38.0
    assert event.fact.time == approx(15.0, abs=2.0)
    light = replayed.stream.status().overall_judgement.lights[Light.ESTIMATOR]
    assert light.code is MotionEvent.HEIGHTS_DISAGREE
    assert light.time == event.fact.time
    assert light.figures["height"] == approx(-10.0, abs=0.6)


def test_an_estimated_height_that_falls_while_the_barometer_rises_is_reported_within_four_seconds():
    flight = FallingEstimate(Still(), attitude=25.0, motors=25.0).frames(end=27.0)
    replayed = replay(by_time(flight, pressure_messages(27.0, rise=4.0)))
    # Nothing but the barometer shows it here, so that it is to be watched only.
    [event] = [event for event in replayed.events if event.fact.code is MotionEvent.HEIGHT_DIVERGED]
    assert event.fact.time == approx(20.0, abs=0.5)
    assert 20.0 < event.seconds - NOW <= 24.0
    assert event.fact.figures["speed"] == approx(4.0, abs=1.0)
    estimator = replayed.stream.status().overall_judgement.lights[Light.ESTIMATOR]
    assert estimator.code is MotionEvent.HEIGHT_DIVERGED
