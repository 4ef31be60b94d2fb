"""Names of flight modes: PX4's by main and sub mode, those of other programs as they are announced."""

import struct

import numpy as np
from mavlink_streams import flight, message, tlog
from pytest import mark
from ulog_files import HEADER, NUMBERS, TIMES, log, subscription
from ulog_files import flight as ulog_flight
from ulog_files import message as record

from mavdem.dataset.signals import Signals
from mavdem.ingest import read_log
from mavdem.ingest.flight_modes import announced_names, mode_name, px4_custom_mode

FLIGHT = ulog_flight(TIMES)
"""The records of a flight in a ULog."""


def px4_mode(main, sub=0):
    return main << 16 | sub << 24


@mark.parametrize(
    "main, sub, name",
    [
        (4, 11, "External 1"),
        (4, 18, "External 8"),
        (4, 19, "mode 4:19"),
        (4, 0, "mode 4:0"),
        (4, 10, "VTOL takeoff"),
        (3, 2, "Position slow"),
        (3, 9, "Position"),
        (10, 0, "Termination"),
        (99, 0, "mode 99:0"),
    ],
)
def test_a_mode_of_px4_is_named_by_main_and_sub_mode(main, sub, name):
    assert mode_name("PX4", "QUADROTOR", px4_mode(main, sub)) == name


def test_navigation_states_have_the_names_of_their_modes():
    states = np.array([0, 12, 18, 22, 23, 30, 31])
    names = [mode_name("PX4", "QUADROTOR", number) for number in px4_custom_mode(states).tolist()]
    assert names == [
        "Manual",
        "Descend",
        "Land",
        "VTOL takeoff",
        "External 1",
        "External 8",
        "mode 31",
    ]


def test_announced_names_are_those_of_external_and_unknown_modes():
    columns = {
        "custom_mode": np.array([px4_mode(4, 11), px4_mode(4, 3), px4_mode(4, 30), 44]),
        "mode_name": np.array([b"Wall follower\0\0", b"My hold", b"Mapping", b""]),
    }
    names = announced_names(columns)
    assert mode_name("PX4", "QUADROTOR", px4_mode(4, 11), names) == "Wall follower"
    assert mode_name("PX4", "QUADROTOR", px4_mode(4, 3), names) == "Hold"
    assert mode_name("PX4", "QUADROTOR", px4_mode(4, 30), names) == "Mapping"
    assert mode_name("ARDUPILOTMEGA", "QUADROTOR", 44, names) == "mode 44"
    assert mode_name("ARDUPILOTMEGA", "QUADROTOR", 45, {45: "Scripted"}) == "Scripted"
    assert announced_names({}) == {}


def px4_heartbeat(sub_mode):
    fields = {"type": 2, "autopilot": 12, "base_mode": 128, "custom_mode": px4_mode(4, sub_mode)}
    return message("HEARTBEAT", **fields)


@mark.slow
def test_external_modes_of_a_telemetry_log_have_their_announced_names(tmp_path):
    """Modes 11 and 12 are external. Only mode 12 was announced with a name, by the message AVAILABLE_MODES."""
    announced = message("AVAILABLE_MODES", custom_mode=px4_mode(4, 12), mode_name=b"Wall follower")
    times = [20 + 0.01 * row for row in range(400)]
    frames = [
        *flight(times[:100]),
        announced,
        px4_heartbeat(11),
        *flight(times[100:200]),
        px4_heartbeat(12),
        *flight(times[200:300]),
        px4_heartbeat(12),
        *flight(times[300:]),
    ]
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog(frames))
    (vehicle,) = read_log(path).vehicles
    names = [name for _, name in Signals(vehicle).mode_changes(0)]
    assert names == ["External 1", "Wall follower"]


def test_navigation_states_of_a_ulog_are_external_modes(tmp_path):
    """PX4's navigation states from 23 on are the external modes."""
    name = "vehicle_status:uint64_t timestamp;uint8_t nav_state;"
    pieces = []
    for row, state in enumerate([4, 23, 24, 31]):
        stamp = 20_000_000 + row * 500_000
        pieces.append(record("D", struct.pack("<HQB", 300, stamp, state)))
    is_status = [
        piece[2:5] == b"D" + struct.pack("<H", NUMBERS["vehicle_status"]) for piece in FLIGHT
    ]
    rows = [piece for piece, status in zip(FLIGHT, is_status, strict=True) if not status]
    header = HEADER + record("F", name.encode())
    content = log(*rows, subscription("vehicle_status", number=300), *pieces)
    path = tmp_path / "flight.ulg"
    path.write_bytes(header + content[len(HEADER) :])
    (vehicle,) = read_log(path).vehicles
    names = [name for _, name in Signals(vehicle).mode_changes(0)]
    assert names == ["Hold", "External 1", "External 2", "mode 31"]
