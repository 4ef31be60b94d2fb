"""read_flight: from a log to the Flight of one vehicle, or the reason why not."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import pytest
from hover import Hover, changed

from mavdem.alignment.read import choose_vehicle, learnable_flight, read_flight
from mavdem.alignment.segments import Segment
from mavdem.errors import NotLearnable
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover()
DATA = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[3] / "shared/data"))


def log_of(telemetry: Telemetry) -> Log:
    return Log(telemetry.source, (telemetry,), (), (), 0, 0, (0.0, 0.0))


def test_the_flight_is_the_segment_that_was_judged():
    """A longer stretch at 15 Hz comes before it."""
    hover = Hover(hovering=150.0)
    stamps = np.concatenate([np.arange(0, 100, 1 / 15), np.arange(100.5, hover.end, 0.01)])
    flight, verdict = learnable_flight(log_of(hover.telemetry(stamps, stamps)))
    assert Segment(**flight.provenance["segment"]) == verdict.segment
    assert flight.time[0] == pytest.approx(100.5) and flight.dt == 0.01


def test_a_flight_carries_the_cautions_of_its_verdict():
    telemetry = HOVER.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    full = {"servo1_raw": np.where(np.sin(table["time"]) > 0, 2000.0, table["servo1_raw"])}
    flight, verdict = learnable_flight(log_of(changed(telemetry, "SERVO_OUTPUT_RAW", **full)))
    assert len(verdict.cautions) >= 2
    assert flight.provenance["cautions"] == list(verdict.cautions)
    assert json.loads(json.dumps(flight.provenance, allow_nan=False)) == flight.provenance


def test_one_vehicle_is_chosen_and_several_are_listed():
    first, second = HOVER.telemetry(), dataclasses.replace(HOVER.telemetry(), system=7)
    silent = dataclasses.replace(first, system=9, messages={})
    assert choose_vehicle((first, silent)) is first
    assert choose_vehicle((first, second), "7") is second
    assert choose_vehicle((first, second), "1:1") is first
    with pytest.raises(NotLearnable, match="1:1 .*7:1 .*--vehicle"):
        choose_vehicle((first, second))
    with pytest.raises(NotLearnable, match="no vehicle 3"):
        choose_vehicle((first, second), "3")
    with pytest.raises(NotLearnable, match="no vehicle"):
        choose_vehicle(())


def shared(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"{name} is not on this machine")
    return DATA / name


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("samples/ardupilot_default_rates.tlog", "4.0 Hz"),
        ("sitl_ardupilot/ardupilot_wind5_defaultrate_mavproxy.tlog", "4.0 Hz"),
        ("logs/wlichon_baseline.tlog", "4.0 Hz"),
        ("logs/dronekit_flight.tlog", "Hz"),
        ("logs/lucagemma_crlf.tlog", "Hz"),
        ("logs/bluerobotics_00025.tlog", "SUBMARINE"),
        ("sitl_px4/px4_two_vehicles_gcslink.tlog", "several vehicles"),
    ],
)
def test_recorded_logs_that_must_be_refused(name, said):
    with pytest.raises(NotLearnable, match=said) as refusal:
        read_flight(shared(name))
    assert refusal.value.remedy


@pytest.mark.parametrize("system", ["2", "3"])
def test_either_of_two_vehicles_can_be_asked_for(system):
    flight = read_flight(shared("sitl_px4/px4_two_vehicles_gcslink.tlog"), vehicle=system)
    assert flight.provenance["system"] == int(system)
    assert flight.dt == 0.02


@pytest.mark.parametrize("axis", ["roll", "pitch"])
@pytest.mark.parametrize("name", ["ardupilot_wind5_steps", "px4_wind5_steps"])
def test_the_samples_are_learnable(name, axis):
    flight = read_flight(shared(f"samples/{name}.tlog"), axis=axis)
    assert flight.dt == 0.01 and flight.duration > 55
