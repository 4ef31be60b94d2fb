"""Condition figures of made-up flights at rates down to 1 Hz, against what the flights were made of."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hover import Hover, changed, columns
from scipy.signal import lfilter

from mavdem.alignment.signals import Signals
from mavdem.condition import condition_of
from mavdem.condition.condition import LEVEL, mean_interval
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover(hovering=60.0)
SECONDS, RATE, SERIES = 60.0, 10.0, 1000
"""Series whose means have an interval."""


def uneven(rate: float, noise: float = 3.0) -> Telemetry:
    """Motor 2 at 1700 µs, the others at 1600, with noise; leaning 3° to the right; a battery, and vibration."""
    rng = np.random.default_rng(7)
    telemetry = HOVER.telemetry(attitude_time=rate, motor_time=rate)
    attitude, motors = telemetry.messages["ATTITUDE"], telemetry.messages["SERVO_OUTPUT_RAW"]
    flying = motors["servo1_raw"] != 1000
    level = {1: 1600.0, 2: 1700.0, 3: 1600.0, 4: 1600.0}
    pulses = {
        f"servo{n}_raw": np.where(flying, mean + noise * rng.standard_normal(len(flying)), 1000.0)
        for n, mean in level.items()
    }
    telemetry = changed(telemetry, "SERVO_OUTPUT_RAW", **pulses)
    telemetry = changed(telemetry, "ATTITUDE", roll=attitude["roll"] + np.radians(3))
    beat = HOVER.stamps(1.0)
    current = 15 + 3 * np.sin(1.3 * beat)
    volts = 16.0 - 0.01 * beat - 0.05 * current
    power = {"voltage_battery": 1e3 * volts, "current_battery": 1e2 * current}
    telemetry = changed(telemetry, "SYS_STATUS", **columns(beat, **power))
    shaking = {"vibration_x": np.full_like(beat, 2.0), "vibration_y": np.full_like(beat, 3.0)}
    clips = {
        "clipping_0": np.where(beat > 30, 4, 1),
        "clipping_1": np.zeros_like(beat),
        "clipping_2": np.zeros_like(beat),
    }
    return changed(telemetry, "VIBRATION", **columns(beat, **shaking, vibration_z=np.full_like(beat, 5.0), **clips))


@pytest.mark.parametrize("rate", [1.0, 4.0, 10.0, 100.0])
def test_the_figures_are_those_of_the_flight_at_any_rate(rate):
    found = condition_of(Signals(uneven(rate)))
    assert found.settled == pytest.approx(HOVER.hovering, abs=3)
    assert found.hover is not None and found.collective == pytest.approx(0.625, abs=2e-3)
    assert found.hover.trim_share == pytest.approx(np.array([600, 700, 600, 600]) / 625, abs=5e-3)
    assert len(found.share_interval) == 4
    for half in found.share_interval:
        assert half is not None and 0 < half < 0.01
    # Motor 2 is rear left: more of it turns the vehicle to the right, nose down and, as it turns to the left, right.
    steady = {axis: one.mean for axis, one in found.command.items()}
    assert steady == pytest.approx({"roll": 0.025, "pitch": -0.025, "yaw": 0.025}, abs=2e-3)
    assert np.degrees(found.lean["roll"].mean) == pytest.approx(3, abs=0.5)
    assert found.tilt_max is not None and found.tilt_mean is not None
    assert np.radians(3) < found.tilt_max <= np.radians(3) + 1.5 * HOVER.sway + 1e-6
    assert (
        found.vibration is not None and found.vibration.level == pytest.approx((2, 3, 5)) and found.vibration.clips == 3
    )
    assert found.battery is not None
    assert found.battery.current_mean == pytest.approx(15, abs=0.3)
    assert found.battery.resistance == pytest.approx(0.05, abs=2e-3)
    assert found.battery.voltage_start > found.battery.voltage_end
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["hover"]["unit"] == "µs"


def test_a_vehicle_that_never_armed_has_its_battery_and_how_long_it_stood():
    telemetry = uneven(10.0)
    beats = telemetry.messages["HEARTBEAT"]
    grounded = changed(telemetry, "HEARTBEAT", base_mode=np.zeros(len(beats["time"]), dtype=np.uint8))
    found = condition_of(Signals(grounded))
    assert (found.armed, found.settled, found.hover, found.lean, found.vibration) == (0, 0, None, {}, None)
    assert found.duration == pytest.approx(HOVER.end, abs=1.5)
    assert found.battery is not None and found.battery.voltage_start > found.battery.voltage_end


def test_without_motor_outputs_the_lean_is_known_all_the_same():
    telemetry = uneven(4.0)
    states = {"landed_state": np.where((HOVER.stamps(1.0) > 6) & (HOVER.stamps(1.0) < HOVER.landed), 2, 1)}
    telemetry = changed(telemetry, "EXTENDED_SYS_STATE", **columns(HOVER.stamps(1.0), **states))
    messages = {name: one for name, one in telemetry.messages.items() if name != "SERVO_OUTPUT_RAW"}
    found = condition_of(Signals(Telemetry(**{**vars(telemetry), "messages": messages})))
    assert found.hover is None and found.settled > 50
    assert np.degrees(found.lean["roll"].mean) == pytest.approx(3, abs=0.5)


def test_a_current_sensor_that_reads_nothing_in_flight_has_no_figures():
    telemetry = uneven(10.0)
    beat = HOVER.stamps(1.0)
    power = {"voltage_battery": np.full_like(beat, 16e3), "current_battery": np.where(beat < 20, 100.0, 0.0)}
    found = condition_of(Signals(changed(telemetry, "SYS_STATUS", **columns(beat, **power)))).battery
    assert found is not None and found.voltage_mean == 16.0
    assert (found.current_mean, found.resistance) == (None, None)


@pytest.mark.parametrize("correlation_seconds", [0.0, 1.0])
def test_the_interval_contains_the_mean_as_often_as_it_claims(correlation_seconds):
    pole = np.exp(-1 / (RATE * correlation_seconds)) if correlation_seconds else 0.0
    noise = np.random.default_rng(3).standard_normal((int(1.5 * SECONDS * RATE), SERIES))
    series = lfilter([1.0], [1.0, -pole], noise, axis=0)[-int(SECONDS * RATE) :] + 5.0
    inside = float((np.abs(series.mean(axis=0) - 5.0) <= mean_interval(series, SECONDS)).mean())
    # Four standard errors of a share of so many series; correlation costs a few per cent.
    assert LEVEL - 0.04 - 4 * np.sqrt(0.09 / SERIES) <= inside <= LEVEL + 4 * np.sqrt(0.09 / SERIES)


def test_a_rate_ten_times_as_high_makes_the_interval_no_narrower_where_it_adds_nothing():
    slow = np.random.default_rng(4).standard_normal((600, 20))
    often = np.repeat(slow, 10, axis=0)
    np.testing.assert_allclose(mean_interval(often, 60.0), mean_interval(slow, 60.0), rtol=1e-3)


def test_a_series_too_short_has_no_interval():
    assert np.isinf(mean_interval(np.arange(8.0)[:, None], 8.0)).all()
