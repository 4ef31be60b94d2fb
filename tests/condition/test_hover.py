"""Hover figures: trim, imbalance, headroom, limits and lean against what the flight was made of."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from hover import Hover, changed

from mavdem import Flight, hover, hover_figures
from mavdem.alignment.read import usable_segments
from mavdem.alignment.signals import Signals
from mavdem.condition.condition import hover_of_log
from mavdem.errors import NotLearnable
from mavdem.ingest import Log
from mavdem.ingest.motors import OutputScale
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover()
PULSES = OutputScale("PWM", "µs", 1000.0, 2000.0, 1.0)
DATA = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[3] / "shared/data"))


def log_of(telemetry: Telemetry) -> Log:
    return Log(telemetry.source, (telemetry,), (), (), 0, 0, (0.0, 0.0))


def leaning(motor_rate: float = 100.0) -> Telemetry:
    """A hover about 10° of roll and -4° of pitch, motor 1 at 1800 µs and, every fourth message, at 1995 µs."""
    telemetry = HOVER.telemetry(motor_time=motor_rate)
    attitude, motors = telemetry.messages["ATTITUDE"], telemetry.messages["SERVO_OUTPUT_RAW"]
    tilt = {"roll": attitude["roll"] + np.radians(10), "pitch": attitude["roll"] - np.radians(4)}
    telemetry = changed(telemetry, "ATTITUDE", **tilt, pitchspeed=attitude["rollspeed"])
    flying = motors["servo1_raw"] != 1000
    full = np.arange(len(flying)) % 4 == 0
    swing = 20 * np.sin(5 * motors["time"])
    outputs = (np.where(full, 1995.0, 1800.0), 1600 + swing, 1600 - swing, 1600 + swing)
    pulses = {f"servo{n}_raw": np.where(flying, output, 1000.0) for n, output in enumerate(outputs, 1)}
    return changed(telemetry, "SERVO_OUTPUT_RAW", **pulses)


@pytest.mark.parametrize("motor_rate", [100.0, 10.0])
def test_figures_are_those_of_the_flight_however_slowly_the_motors_come(motor_rate):
    found = hover_of_log(log_of(leaning(motor_rate)))
    assert found.unit == "µs" and found.motors[0] == "motor 1 (front right)"
    mean = 0.75 * 1800 + 0.25 * 1995
    of_range = np.array([mean - 1000, 600, 600, 600]) / 1000
    assert found.trim == pytest.approx([mean, 1600, 1600, 1600], abs=2)
    assert found.trim_of_range == pytest.approx(of_range, abs=2e-3)
    assert found.trim_share == pytest.approx(of_range / of_range.mean(), rel=5e-3)
    assert np.mean(found.trim_share) == pytest.approx(1) and np.sum(found.imbalance) == pytest.approx(0, abs=1e-9)
    assert found.imbalance == pytest.approx([100 * (share - 1) for share in found.trim_share])
    assert found.headroom == pytest.approx([0.005, 0.38, 0.38, 0.38], abs=1e-3)
    assert found.at_upper_limit == pytest.approx([0.25, 0, 0, 0], abs=0.01)
    assert found.at_lower_limit == (0, 0, 0, 0)
    assert (found.roll, found.pitch) == pytest.approx((10, -4), abs=0.2)
    assert found.seconds == pytest.approx(HOVER.hovering, abs=1.5)
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["imbalance"] == pytest.approx(found.imbalance)


def test_flights_give_the_same_figures_and_count_their_motors_once():
    log = log_of(leaning())
    expected = hover_of_log(log)
    flights = [one for axis in ("roll", "pitch") for one in usable_segments(Signals(log.vehicles[0], axis))[0]]
    found = hover_figures(flights)
    assert found.seconds == pytest.approx(expected.seconds, abs=0.1)
    for name in ("trim", "trim_of_range", "trim_share", "headroom", "at_upper_limit"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=1e-3, rel=1e-3)
    assert (found.roll, found.pitch) == pytest.approx((expected.roll, expected.pitch), abs=0.02)
    assert hover_figures(flights[:1]).pitch is None


def test_arrays_need_the_range_of_their_outputs():
    flight = Flight(np.arange(4) / 100, [[1500.0, 1100.0]] * 4, [0.1] * 4, output_names=("roll",))
    with pytest.raises(ValueError, match="give the scale"):
        hover_figures([flight])
    found = hover_figures([flight], PULSES)
    assert found.trim_of_range == pytest.approx((0.5, 0.1)) and found.at_lower_limit == (0.0, 1.0)
    assert found.roll == pytest.approx(np.degrees(0.1)) and found.pitch is None


@pytest.mark.parametrize(
    ("flights", "scale", "message"),
    [
        ([], None, "at least one"),
        ([Flight([0, 1], [1.0, 2.0], [1.0, 2.0], input_names=(name,)) for name in "ab"], PULSES, "the same inputs"),
        ([Flight([0, 1], [1.0, 2.0], [1.0, 2.0])], OutputScale("demand", "", -1, 1, 0.1), "demand"),
    ],
)
def test_what_has_no_figures_is_refused(flights, scale, message):
    with pytest.raises(ValueError, match=message):
        hover_figures(flights, scale)


def test_motors_that_are_off_have_no_trim():
    with pytest.raises(NotLearnable, match="are off"):
        hover_figures([Flight([0, 1], [1000.0, 1000.0], [1.0, 2.0])], PULSES)


def test_a_log_without_settled_flight_says_why():
    disarmed = changed(HOVER.telemetry(), "HEARTBEAT", base_mode=np.ones(len(HOVER.stamps(1.0))))
    with pytest.raises(NotLearnable, match="never armed"):
        hover_of_log(log_of(disarmed))
    with pytest.raises(NotLearnable, match="multirotors only"):
        hover_of_log(log_of(HOVER.telemetry(vehicle="GROUND_ROVER")))


def shared(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"{name} is not on this machine")
    return DATA / name


def test_a_weakened_motor_works_hardest():
    """Motor 1 has 65 % of its thrust for most of the flight."""
    found = hover(shared("sitl_events/ap_motor.tlog"))
    assert np.argmax(found.imbalance) == 0 and found.imbalance[0] > 15 > max(found.imbalance[1:])


def test_a_shortened_propeller_makes_its_motor_work_harder():
    """Logged at 10 Hz, too slowly for a model."""
    good, cut = (hover(shared(f"real/propeller/hover_{name}_1.BIN")) for name in ("good", "cut25mm"))
    assert np.argmax(cut.imbalance) == 0 and cut.imbalance[0] - good.imbalance[0] > 10
    assert cut.headroom[0] < good.headroom[0]
