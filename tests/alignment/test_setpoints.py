"""Setpoints: which message has them, when they hold, and how a flight carries them."""

import numpy as np
import pytest
from hover import Hover, changed, columns
from recorded_flights import shared

from mavdem import Flight
from mavdem.alignment.align import align, settled_segments
from mavdem.alignment.read import read_segments
from mavdem.alignment.signals import HOLD_SECONDS, Signals, setpoints
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import quaternion

HOVER = Hover()


def with_targets(rate: float = 10.0, type_mask: int = 0, start: float = 0.0, end: float = np.inf) -> Telemetry:
    """A hover with ATTITUDE_TARGET whose roll rate is the time, its roll a tenth of the sine of it."""
    time = HOVER.stamps(rate)
    time = time[(time >= start) & (time < end)]
    roll, pitch, yaw = 0.1 * np.sin(time), 0.05 * np.cos(time), 0.02 * time
    fields = {
        "type_mask": np.full(len(time), type_mask, dtype=np.uint8),
        "q": quaternion(roll, pitch, yaw),
        "body_roll_rate": time,
        "body_pitch_rate": 2 * time,
        "body_yaw_rate": 3 * time,
    }
    return changed(HOVER.telemetry(), "ATTITUDE_TARGET", **columns(time, **fields))


def flight_of(telemetry: Telemetry, axis: str = "roll") -> Flight:
    signals = Signals(telemetry, axis)
    return align(signals, settled_segments(signals)[0])


def test_a_flight_has_the_last_setpoint_until_its_sample_and_none_of_the_future():
    flight = flight_of(with_targets(rate=10.0))
    assert flight.setpoint_names == ("roll rate setpoint", "roll setpoint")
    assert flight.setpoint_units == ("rad/s", "rad")
    last = np.floor(10 * flight.time + 1e-6) / 10
    np.testing.assert_allclose(flight.setpoints[:, 0], last, atol=1e-9)
    np.testing.assert_allclose(flight.setpoints[:, 1], 0.1 * np.sin(last), atol=1e-9)
    assert (flight.setpoints[:, 0] <= flight.time + 1e-9).all()
    assert flight.provenance["setpoints"]["roll setpoint"] == "ATTITUDE_TARGET"


@pytest.mark.parametrize(
    ("mask", "units"), [(1, ["rad"]), (2, ["rad/s", "rad"]), (64, ["rad/s", "rad"]), (128, ["rad/s"]), (129, [])]
)
def test_masked_fields_are_no_setpoints(mask, units):
    assert [one.unit for one in setpoints(with_targets(type_mask=mask), "roll")] == units


def test_before_the_first_and_long_after_the_last_nothing_is_known():
    flight = flight_of(with_targets(start=20.0, end=30.0))
    known = np.isfinite(flight.setpoints[:, 0])
    np.testing.assert_array_equal(known, (flight.time >= 20 - 1e-9) & (flight.time <= 29.9 + HOLD_SECONDS + 1e-9))


def with_sticks(autopilot: str = "ARDUPILOTMEGA", parameters: dict[str, float] | None = None) -> Telemetry:
    time = HOVER.stamps(4.0)
    pulses = {f"chan{n}_raw": 1000.0 * n / 5 + 1000 + 10 * np.sin(time) for n in range(1, 5)}
    pulses["chan2_raw"][::2], pulses["chan5_raw"] = 65535, np.zeros(len(time))
    telemetry = HOVER.telemetry(autopilot=autopilot, parameters=parameters)
    return changed(telemetry, "RC_CHANNELS", **columns(time, **pulses))


@pytest.mark.parametrize(
    ("autopilot", "parameters", "axis", "channel"),
    [
        ("ARDUPILOTMEGA", {}, "roll", 1),
        ("ARDUPILOTMEGA", {"RCMAP_ROLL": 3.0}, "roll", 3),
        ("ARDUPILOTMEGA", {}, "yaw", 4),
        ("PX4", {"RC_MAP_ROLL": 4.0}, "roll", 4),
        ("PX4", {}, "roll", None),
        ("PX4", {"RC_MAP_ROLL": 0.0}, "roll", None),
        ("ARDUPILOTMEGA", {"RCMAP_ROLL": 5.0}, "roll", None),
        ("ARDUPILOTMEGA", {"RCMAP_ROLL": 40.0}, "roll", None),
    ],
)
def test_the_stick_is_on_the_channel_of_the_parameters(autopilot, parameters, axis, channel):
    found = setpoints(with_sticks(autopilot, parameters), axis)
    assert [one.name for one in found] == ([f"{axis} stick"] if channel else [])
    if channel:
        assert found[0].unit == "µs"
        assert found[0].signal.values.mean() == pytest.approx(1000 + 200 * channel, abs=5)
    # A channel that was not received is none.
    (stick,) = setpoints(with_sticks(), "pitch")
    assert len(stick.signal.time) == len(HOVER.stamps(4.0)) // 2 and stick.signal.values.max() < 1500


def test_the_sticks_as_the_autopilot_takes_them_are_preferred():
    time = HOVER.stamps(5.0)
    sticks = {"x": 100 * np.sin(time), "y": -500 * np.sin(time), "r": np.full(len(time), 32767.0)}
    telemetry = changed(with_sticks(), "MANUAL_CONTROL", **columns(time, **sticks))
    (roll,), (pitch,) = setpoints(telemetry, "roll"), setpoints(telemetry, "pitch")
    assert (roll.name, roll.unit, roll.message) == ("roll stick", "", "MANUAL_CONTROL")
    np.testing.assert_allclose(roll.signal.values, -0.5 * np.sin(time))
    np.testing.assert_allclose(pitch.signal.values, 0.1 * np.sin(time))
    assert setpoints(telemetry, "yaw") == ()


@pytest.mark.parametrize("name", ["sitl_ardupilot/ardupilot_wind4_doublets.tlog", "sitl_px4/px4_wind5_gust.tlog"])
def test_a_recorded_vehicle_does_what_it_is_asked(name):
    for flight in read_segments(shared(name)):
        assert flight.setpoint_names[:2] == ("roll rate setpoint", "roll setpoint")
        assert np.isfinite(flight.setpoints).all()
        assert np.corrcoef(flight.setpoints[:, 1], flight.outputs[:, 0])[0, 1] > 0.8
