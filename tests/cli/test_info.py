"""``mavdem info``: what it says of the sample flights, and when it says no."""

import json

from command_line import run
from pytest import approx, mark
from recorded_flights import LOGS


@mark.slow
def test_a_sample_flight_can_be_learnt_from(capsys):
    assert run("info", LOGS / "px4_wind5_steps.tlog", "--json") == 0
    said = capsys.readouterr()
    held = json.loads(said.out)
    assert held["learnable"] and said.err == ""
    (vehicle,) = held["vehicles"]
    known = vehicle["system"], vehicle["autopilot"], vehicle["vehicle"]
    assert known == (5, "PX4", "QUADROTOR")
    rates = [vehicle["messages"][name]["rate"] for name in ("ATTITUDE", "SERVO_OUTPUT_RAW")]
    assert rates == approx([100, 100], rel=0.01)
    assert vehicle["segments"][0]["duration"] == approx(60, abs=1)
    assert vehicle["watched"] and vehicle["alarms"] == vehicle["autopilot_alarms"] == []


def test_the_rates_a_ground_station_asks_for_are_too_slow(capsys):
    path = LOGS / "ardupilot_default_rates.tlog"
    assert run("info", path, "--json") == 1
    said = capsys.readouterr()
    assert said.err.startswith(
        f"mavdem: No roll model can be learned from {path}; 1:1: ATTITUDE comes at 4 Hz"
    )
    held = json.loads(said.out)
    (vehicle,) = held["vehicles"]
    assert not held["learnable"] and vehicle["messages"]["ATTITUDE"]["rate"] == approx(4, rel=0.1)
    assert run("info", path) == 1
    said = capsys.readouterr()
    assert said.err == "" and said.out.count("ATTITUDE comes at 4 Hz") == 1
