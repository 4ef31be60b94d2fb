"""Identity: a vehicle has the same name in every format, another has another, and the date is that of the flight."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hover import Hover, changed, columns
from recorded_flights import shared

from mavdem.alignment.signals import Signals
from mavdem.condition import identity_of
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Telemetry

TEXT = "CUAVv5Nano 001A002F 30395113 33333539"
CALIBRATED = {"INS_ACCOFFS_X": 0.11, "INS_ACCOFFS_Y": -0.02, "INS_ACCOFFS_Z": 0.3}
CALIBRATED |= {"INS_ACCSCAL_X": 1.001, "INS_ACCSCAL_Y": 0.99, "INS_ACCSCAL_Z": 1.0}


def flown(parameters: dict[str, float] | None = None, autopilot: str = "ARDUPILOTMEGA") -> Telemetry:
    return Hover().telemetry(10.0, 10.0, autopilot=autopilot, parameters=parameters)


def name(telemetry: Telemetry) -> tuple[str, str]:
    found = identity_of(Signals(telemetry))
    return found.name, found.basis


def test_the_boards_number_is_the_same_from_the_text_and_from_autopilot_version():
    said = changed(flown(), "STATUSTEXT", **columns(np.array([1.0]), text=np.array([TEXT.encode()])))
    words = bytes.fromhex("".join(TEXT.split()[1:]))
    raw = b"".join(words[at : at + 4][::-1] for at in (0, 4, 8)).ljust(18, b"\0")
    uid2 = np.frombuffer(raw, dtype=np.uint8)[None]
    sent = changed(flown(), "AUTOPILOT_VERSION", **columns(np.array([1.0]), uid2=uid2))
    assert name(said) == name(sent) == ("001a002f3039511333333539", "board")


def test_without_a_number_the_calibration_names_the_vehicle_and_defaults_do_not():
    ours, basis = name(flown(CALIBRATED))
    assert basis == "accelerometer"
    assert name(flown(CALIBRATED | {"INS_GYROFFS_X": 0.5, "ATC_RAT_RLL_P": 0.2})) == (ours, basis)
    assert name(flown(CALIBRATED | {"INS_ACCOFFS_X": 0.12}))[0] != ours
    simulated = dict.fromkeys(("INS_ACCOFFS_X", "INS_ACCOFFS_Y", "INS_ACCOFFS_Z"), 0.001)
    scales = dict.fromkeys(("INS_ACCSCAL_X", "INS_ACCSCAL_Y", "INS_ACCSCAL_Z"), 1.001)
    assert name(flown(simulated | scales)) == ("ardupilotmega-1", "system id")
    assert name(flown()) == ("ardupilotmega-1", "system id")


@pytest.mark.parametrize("uid2", [bytes(18), bytes([4, *bytes(17)])])
def test_a_simulators_small_number_is_none(uid2):
    rows = np.frombuffer(uid2, dtype=np.uint8)[None]
    telemetry = changed(flown(autopilot="PX4"), "AUTOPILOT_VERSION", **columns(np.array([1.0]), uid2=rows))
    assert name(telemetry) == ("px4-1", "system id")


def test_the_date_is_when_the_settled_flight_began():
    unix = datetime(2026, 5, 4, 12, 0, 0, tzinfo=UTC)
    beat = Hover().stamps(1.0)
    clock = np.where(beat < 3, 0, 1e6 * (unix.timestamp() + beat)).astype(np.uint64)
    found = identity_of(Signals(changed(flown(), "SYSTEM_TIME", **columns(beat, time_unix_usec=clock)))).date
    assert found is not None and 11 <= (found - unix).total_seconds() <= 13  # level from 11 s on
    assert identity_of(Signals(flown())).date is None
    assert identity_of(Signals(flown()), unix.timestamp()).date == unix


def test_firmware_is_what_the_autopilot_says_or_sends():
    said = changed(flown(), "STATUSTEXT", **columns(np.array([1.0]), text=np.array([b"ArduCopter V4.5.7 (2a3dc4b7)"])))
    assert identity_of(Signals(said)).firmware == "ArduCopter V4.5.7 (2a3dc4b7)"
    version = columns(np.array([1.0]), flight_sw_version=np.array([(1 << 24) + (16 << 16) + 255], dtype=np.uint32))
    sent = changed(flown(autopilot="PX4"), "AUTOPILOT_VERSION", **version)
    assert identity_of(Signals(sent)).firmware == "PX4 v1.16.0"
    assert identity_of(Signals(replace(sent, firmware="PX4 v1.2.3 (abc)"))).firmware == "PX4 v1.2.3 (abc)"


def test_one_flight_recorded_both_ways_is_of_one_vehicle_and_another_is_of_another():
    recorded = [f"sitl_ardupilot/ardupilot_inertia_wind5_steps.{kind}" for kind in ("tlog", "BIN")]
    others = [f"real/propeller/hover_{which}_1.BIN" for which in ("good", "cut25mm")]
    names = [name(read_log(shared(path)).vehicles[0]) for path in (*recorded, *others)]
    assert names[0] == names[1] and names[2] == names[3] == ("001a002f3039511333333539", "board")
    assert names[0] != names[2]
