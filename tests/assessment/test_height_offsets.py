"""Estimated heights that barometer and satellites both refute."""

from dataclasses import replace

import numpy as np
from hover import changed, columns
from instrumented import instrumented, stamps
from pytest import approx, mark

from mavdem.assessment.motion import motion_events
from mavdem.dataset.signals import Signals
from mavdem.facts.ending import MotionEvent


def flight(error, satellite_error=0.0, **parameters):
    """A hover whose estimated height is wrong by so many metres from 35 s on, and the altitude by satellites too."""
    telemetry = instrumented()
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    down = telemetry.messages["LOCAL_POSITION_NED"]["z"]
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", z=down - error * growth(time))
    time = stamps(telemetry, "SCALED_PRESSURE")
    altitude = telemetry.messages["SCALED_PRESSURE"]["altitude"]
    satellites = columns(
        time,
        fix_type=3,
        satellites_visible=14,
        lat=473_977_420,
        lon=85_455_940,
        alt=1000.0 * (altitude + satellite_error * growth(time)),
    )
    return replace(changed(telemetry, "GPS_RAW_INT", **satellites), parameters=parameters)


def growth(time):
    return np.clip((time - 30.0) / 5.0, 0.0, 1.0)


def offsets(telemetry):
    events = motion_events(Signals(telemetry, inputs="motors"))
    return [event for event in events if event.code is MotionEvent.HEIGHT_OFFSET]


@mark.parametrize(("error", "side"), [(3.0, "above"), (-3.0, "below")])
def test_a_height_that_both_sensors_refute_is_to_be_watched(error, side):
    (event,) = offsets(flight(error))
    assert event.is_watch_or_bad and event.time == approx(34.0, abs=2.0)
    assert event.figures["height"] == approx(error, abs=0.3)
    assert f"up to 3.0 m {side} what both barometer and satellites show" in event.sentence


@mark.slow
@mark.parametrize(
    ("error", "satellite_error"),
    [(1.5, 0.0), (3.0, 3.0), (3.0, 2.0)],
    ids=["small", "of the barometer", "mostly of the barometer"],
)
def test_an_estimate_close_to_one_of_them_is_not_refuted(error, satellite_error):
    assert not offsets(flight(error, satellite_error))


@mark.slow
def test_a_height_above_what_a_rangefinder_measures_is_not_compared():
    assert not offsets(flight(3.0, EKF2_HGT_REF=2.0))
    assert offsets(flight(3.0, EKF2_HGT_REF=1.0))
