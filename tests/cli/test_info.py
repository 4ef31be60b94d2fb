"""``mavdem info``: what it says of the sample flights, and when it says no."""

from command_line import run, strict_json
from pytest import approx
from recorded_flights import LOGS


def test_the_rates_a_ground_station_asks_for_are_too_slow(capsys):
    path = LOGS / "ardupilot_default_rates.tlog"
    assert run("info", path, "--json") == 1
    said = capsys.readouterr()
    assert said.err.startswith(
        f"mavdem: No roll model can be learned from {path}; 1:1: ATTITUDE comes at 4 Hz"
    )
    held = strict_json(said.out)
    (vehicle,) = held["vehicles"]
    assert not held["learnable"] and vehicle["messages"]["ATTITUDE"]["rate"] == approx(4, rel=0.1)
