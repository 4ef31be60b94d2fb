"""Barometers that drift in flight: the height at rest before it and after it, against that by satellites."""

from dataclasses import replace

import numpy as np
from hover import changed, columns
from instrumented import instrumented, stamps
from pytest import approx, mark

from mavdem.assessment.barometer_drifts import barometer_drifts
from mavdem.assessment.doubted_heights import events_with_checked_heights
from mavdem.assessment.motion import motion_events
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.trust import TrustCheck
from mavdem.facts.witnesses import HeightSource
from mavdem.witnesses import trust_of_boots
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.ground_heights import ground_heights

TAKE_OFF, LANDING = 6.0, 71.0
PLACE = (473_977_420, 85_455_940)


def flight(drift, satellite_change=0.0, north=0.0, fix_type=3, noise=0.1):
    """The hover whose barometer drifts by so many metres in 10 s, with a receiver of satellites.

    Its altitude changes by ``satellite_change``, m, and it lands ``north`` metres north of the take-off.
    """
    telemetry = instrumented()
    time = stamps(telemetry, "SCALED_PRESSURE")
    share = np.clip((time - 30.0) / 10.0, 0.0, 1.0)
    random = np.random.default_rng(4)
    true_altitude = telemetry.messages["SCALED_PRESSURE"]["altitude"]
    altitude = true_altitude + drift * share + noise * random.standard_normal(len(time))
    telemetry = changed(telemetry, "SCALED_PRESSURE", altitude=altitude)
    satellites = (
        true_altitude + satellite_change * share + noise * random.standard_normal(len(time))
    )
    latitude, longitude = PLACE
    return changed(
        telemetry,
        "GPS_RAW_INT",
        **columns(
            time,
            fix_type=fix_type,
            satellites_visible=14,
            lat=latitude + share * north / 0.0111,
            lon=longitude,
            alt=1000.0 * satellites,
        ),
    )


def drifts(telemetry):
    events = motion_events(Signals(telemetry, inputs="motors"))
    return [event for event in events if event.code is MotionEvent.BAROMETER_DRIFTED]


@mark.slow
@mark.parametrize("drift", [6.0, -6.0])
def test_a_barometer_that_drifts_in_flight_is_to_be_watched(drift):
    (event,) = drifts(flight(drift))
    assert event.level is Level.WATCH
    assert event.figures["change"] == approx(drift, abs=0.2)
    assert len(event.figures["witnesses"]) == 2


@mark.slow
@mark.parametrize(("drift", "level"), [(6.0, Level.WATCH), (0.0, Level.GOOD)])
def test_a_barometer_that_drifted_is_not_trusted_although_the_estimate_follows_it(drift, level):
    signals = Signals(flight(drift), inputs="motors")
    (trust,) = trust_of_boots(signals)
    height_drift = next(iter(drifts(signals.telemetry)), None)
    (check,) = [
        check
        for check in replace(trust, height_drift=height_drift).checks
        if check.code is TrustCheck.BAROMETER
    ]
    assert trust.is_climb_estimate_sound
    assert check.level is level
    assert ("drifted" in str(check)) is (drift > 0)


@mark.slow
def test_a_drift_that_satellites_show_in_flight_is_dated_by_its_growth():
    (event,) = drifts(flight(12.0))
    assert event.time == approx(30.0, abs=2.0)
    (small,) = drifts(flight(5.0))
    assert small.time == approx(TAKE_OFF, abs=1.0)


@mark.slow
def test_a_drift_is_not_dated_by_satellites_that_wandered_the_other_way():
    telemetry = flight(-5.0)
    time = stamps(telemetry, "GPS_RAW_INT")
    wandered = np.interp(time, [15.0, 20.0, 28.0, 30.0], [0.0, 20.0, 20.0, 0.0])
    altitude = telemetry.messages["GPS_RAW_INT"]["alt"] - 1000.0 * wandered
    (event,) = drifts(changed(telemetry, "GPS_RAW_INT", alt=altitude))
    assert event.time == approx(TAKE_OFF, abs=1.0)


@mark.slow
def test_a_barometer_that_freezes_in_flight_is_not_said_to_drift():
    telemetry = flight(0.0)
    time = stamps(telemetry, "SCALED_PRESSURE")
    altitude = telemetry.messages["SCALED_PRESSURE"]["altitude"]
    altitude = np.where(time < 40.0, altitude, altitude[np.searchsorted(time, 40.0)])
    (event,) = drifts(changed(telemetry, "SCALED_PRESSURE", altitude=altitude))
    assert event.time == event.figures["frozen_since"] == approx(40.0, abs=1.0)
    assert "has read the same since 40.0 s" in event.sentence
    assert "connection" in event.remedy
    (event,) = drifts(flight(6.0))
    assert event.figures["frozen_since"] is None and "drifted" in event.sentence


def test_a_drift_of_a_flight_without_a_recorded_landing_has_no_end():
    sensors = BootSensors(Signals(flight(6.0), inputs="motors"), 0, TAKE_OFF)
    (event,) = barometer_drifts(sensors, (TAKE_OFF, np.inf))
    assert event.end_time is None


@mark.parametrize("drift", [0.0, 1.5, -2.0])
def test_what_weather_and_warmth_change_is_no_drift(drift):
    assert not drifts(flight(drift))


def test_a_higher_landing_place_is_no_drift():
    assert not drifts(flight(6.0, satellite_change=6.0))


@mark.slow
def test_a_landing_elsewhere_shows_no_drift():
    assert not drifts(flight(6.0, north=60.0))


def test_without_a_fix_no_drift_is_stated():
    assert not drifts(flight(6.0, fix_type=1))


@mark.slow
def test_satellites_that_wander_alone_are_no_fault():
    telemetry = flight(0.0, satellite_change=10.0)
    assert not drifts(telemetry)
    [event] = [
        event
        for event in motion_events(Signals(telemetry, inputs="motors"))
        if event.code is MotionEvent.HEIGHTS_DISAGREE
    ]
    assert event.is_good
    assert "the altitude by satellites wandered" in event.sentence
    assert not event.remedy


@mark.slow
def test_noise_is_no_drift():
    assert not drifts(flight(3.5, noise=1.5))


def test_heights_at_rest_are_compared_before_and_after_the_flight():
    signals = Signals(flight(5.0, satellite_change=-1.0, north=10.0), inputs="motors")
    heights = ground_heights(signals, 0, (TAKE_OFF, LANDING))
    assert heights.barometer_change == approx(5.0, abs=0.2)
    assert heights.satellite_change == approx(-1.0, abs=0.2)
    assert heights.distance == approx(10.0, abs=0.5)


def test_a_flight_that_began_before_the_record_is_not_compared():
    signals = Signals(flight(5.0), inputs="motors")
    assert ground_heights(signals, 0, (-np.inf, LANDING)) is None


def test_a_rest_long_before_the_flight_is_not_compared():
    signals = Signals(flight(5.0), inputs="motors")
    assert ground_heights(signals, 0, (TAKE_OFF + 40.0, LANDING)) is None


def end_of_log(time, doubt):
    """The event that the log ends in the air by the barometer, in a flight with such a doubt about that."""
    sensors = BootSensors(Signals(flight(12.0), inputs="motors"), 0, TAKE_OFF)
    height = sensors.height.barometer_change(TAKE_OFF, time)
    source = HeightSource.BAROMETER
    event = Fact(MotionEvent.LOG_ENDED_IN_AIR, time=time, height=height, height_source=source)
    return events_with_checked_heights(sensors, [event], [doubt])


@mark.slow
def test_a_height_that_satellites_contradict_is_stated_with_theirs():
    doubt = Fact(MotionEvent.HEIGHTS_DISAGREE, Level.WATCH, time=32.0, height=12.0, boot=0)
    (event,) = end_of_log(60.0, doubt)
    difference = event.figures["height"] - event.figures["satellite_height"]
    assert difference == approx(12.0, abs=0.5)
    heights = (event.figures["height"], event.figures["satellite_height"])
    assert "{:.0f} m up by the barometer, {:.0f} m by satellites".format(*heights) in event.sentence
    for time, level in ((25.0, Level.WATCH), (60.0, Level.GOOD)):
        (agreed,) = end_of_log(time, doubt.replace(level))
        assert "satellite_height" not in agreed.figures


@mark.slow
def test_a_height_by_a_barometer_that_drifted_is_that_by_satellites():
    (drift,) = drifts(flight(12.0))
    (event,) = end_of_log(60.0, drift)
    (by_barometer,) = end_of_log(60.0, drift.replace(Level.GOOD))
    assert event.figures["height_source"] is HeightSource.SATELLITES
    assert event.figures["height"] == approx(by_barometer.figures["height"] - 12.0, abs=0.5)
    assert " m up by satellites" in event.sentence
