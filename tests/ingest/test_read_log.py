"""Whole logs: who flew, what was mended, and one clear sentence for what cannot be read."""

import os
import random
import struct

import dataflash_logs
import numpy as np
import ulog_files
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_streams import HOVER, TIMES, flight, frame, heartbeat, message, read, tlog
from mcap_files import spoil
from pymavlink.dialects.v20 import all as dialect
from pytest import mark, raises
from refusals import refused

from mavdem.dataset.attitude import attitude_of_axis
from mavdem.errors import Unreadable
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.ingest.mavlink.sender_links import missing_messages


def log_of(content, folder, name="flight.tlog"):
    path = folder / name
    path.write_bytes(content)
    return read_log(path)


def vehicle_of(frames, folder):
    (vehicle,) = log_of(tlog(frames), folder).vehicles
    return vehicle


@mark.parametrize(
    "beats, who",
    [
        ([], ("UNKNOWN", "UNKNOWN")),
        ([heartbeat()] * 3 + [heartbeat(kind=0, autopilot=8)] * 2, ("QUADROTOR", "ARDUPILOTMEGA")),
        ([heartbeat()] * 3 + [heartbeat(kind=6, autopilot=8)] * 2, ("QUADROTOR", "ARDUPILOTMEGA")),
    ],
)
def test_stray_heartbeats_and_none_do_not_change_who_flies(tmp_path, beats, who):
    vehicle = vehicle_of(flight(TIMES) + beats, tmp_path)
    assert (vehicle.vehicle, vehicle.autopilot) == who


def parameter(name, value, kind=9, component=1):
    return message(
        "PARAM_VALUE", component=component, param_id=name, param_value=value, param_type=kind
    )


COPIED = float(np.int32(-7).view(np.float32))
"""-7 copied, which is no finite float32."""
SENT = [
    parameter(b"COUNT", 99.0),
    parameter(b"COUNT", COPIED, kind=6),
    parameter(b"GAIN_OF_16_CHARS", 0.5),
]
NOTED = [
    parameter(b"A", 2.0),
    parameter(b"A", 1.0, component=190),
    parameter(b"B", 1.0, component=190),
]


@mark.parametrize(
    "autopilot, sent, expected",
    [
        (12, SENT, {"COUNT": -7.0, "GAIN_OF_16_CHARS": 0.5}),
        (3, SENT, {"COUNT": 99.0, "GAIN_OF_16_CHARS": 0.5}),
        (3, NOTED, {"A": 2.0, "B": 1.0}),
        *(
            (
                autopilot,
                [
                    parameter(b"SERVO1_FUNCTION", wrong),
                    parameter(b"GAIN", 0.5),
                    parameter(b"GAIN", wrong),
                ],
                {"GAIN": 0.5},
            )
            for autopilot in (3, 12)
            for wrong in (float("nan"), float("-inf"))
        ),
    ],
)
def test_parameters_are_what_the_autopilot_sent_or_a_ground_station_noted(
    tmp_path, autopilot, sent, expected
):
    """Each autopilot sends integers in its own way; what is not finite was not sent; notes fill in."""
    frames = [heartbeat(autopilot=autopilot), *flight(TIMES), *sent]
    assert vehicle_of(frames, tmp_path).parameters == expected


def test_failures_are_distinguished(tmp_path):
    """A frame with a wrong checksum may be damaged, or of a dialect with another definition of the message."""
    frames = [*HOVER]
    damaged = bytearray(frames[11])
    damaged[15] ^= 0xFF
    frames[11] = bytes(damaged)
    frames += [
        frame(70_000, b"abc", seed=3),
        *[frame(33, bytes(range(28)), seed=1)] * 4,
        heartbeat(),
    ]
    log = log_of(tlog(frames), tmp_path)
    causes = {(kind.message_id, kind.frames, kind.total): kind.cause for kind in log.unread}
    assert causes == {
        (30, 1, 300): Flaw.DAMAGE,
        (33, 4, 4): Flaw.ANOTHER_DIALECT,
        (70_000, 1, 1): Flaw.ANOTHER_DIALECT,
    }
    assert log.frames == len(frames)


@mark.slow
def test_what_is_overtaken_or_comes_twice_is_not_lost(tmp_path):
    """Sequence numbers show that ten messages are missing, although others are swapped or there twice."""
    steps = np.array([0, 1, 2, 128, 129, -32, -33])
    assert missing_messages(7, 7 + steps).tolist() == [0, 0, 1, 127, 0, -33, 0]
    frames = [heartbeat(), *flight(TIMES, sequence=1)]
    frames[520:530] = frames[525:530] + frames[520:525]
    del frames[541:546], frames[300:305]
    twice = [frame for each in frames for frame in (each, each)]
    assert [log_of(tlog(one), tmp_path).components[0].lost for one in (frames, twice)] == [10, 10]


def test_a_file_transferred_as_text_is_restored(tmp_path):
    content = tlog(HOVER)
    (intact,) = log_of(content, tmp_path).vehicles
    (restored,) = log_of(content.replace(b"\n", b"\r\n"), tmp_path).vehicles
    for name in intact.messages:
        for field, values in intact.messages[name].items():
            assert np.array_equal(values, restored.messages[name][field]), (name, field)
    assert restored.repairs[0].code is Repair.CARRIAGE_RETURNS_UNDONE


WHOLE = {
    "tlog": tlog([heartbeat(), *flight(TIMES[:100])] * 2),
    "ulg": ulog_files.log(
        *ulog_files.flight(ulog_files.TIMES[:60]), parameters=ulog_files.parameter("MAV_SYS_ID", 3)
    ),
    "bin": dataflash_logs.log(*dataflash_logs.flight(TIMES[:20])),
}


@mark.slow
@given(st.integers(0, 2**32), st.sampled_from([*WHOLE]))
@settings(max_examples=40)
def test_damage_never_makes_an_error_or_a_false_message(tmp_path_factory, seed, kind):
    """Logs of each format are damaged at random.

    Each is read or refused with a sentence. Columns have equal lengths, and a tlog has no time that was not written.
    """
    path = tmp_path_factory.mktemp("damaged") / f"flight.{kind}"
    path.write_bytes(WHOLE[kind])
    spoil(path, random.Random(seed))
    try:
        log = read_log(path)
    except Unreadable as error:
        assert str(error).endswith(".")
        return
    allowed = set(np.round(TIMES[:100], 3).tolist())
    for vehicle in log.vehicles:
        for columns in vehicle.messages.values():
            assert len(set(map(len, columns.values()))) == 1
            if kind != "tlog":
                assert np.isfinite(columns["time"]).all()
        if kind == "tlog" and (vehicle.system, vehicle.component) == (1, 1):
            stamps = (
                vehicle.messages.get("ATTITUDE", {"time_boot_ms": np.zeros(0)})["time_boot_ms"]
                / 1e3
            )
            assert set(np.round(stamps, 3).tolist()) <= allowed


def unreadable(path, read=read_log):
    fact = refused(read, path, kind=Unreadable)
    assert fact.figures["path"] == str(path)
    assert "\n" not in fact.sentence_and_remedy
    return fact


LOADS = ulog_files.log(ulog_files.data("cpuload", 3.0, 1.0))
LATER = (
    ulog_files.HEADER
    + ulog_files.message("B", bytes(8) + b"\x02" + bytes(31))
    + ulog_files.log()[16:]
)
FLAGGED = ulog_files.HEADER + ulog_files.message("B", bytes(40))
BEYOND = ulog_files.definitions() + struct.pack("<HB", 20_000, 1) + bytes(99)
"""Hostile definitions, one that holds itself and one of a million numbers; and a length beyond the end."""
BEGUN = dataflash_logs.formats() + dataflash_logs.told()
WITHOUT_CLOCK = b"FMT, 129, 0, ATT, ccc, Roll,Pitch,Yaw\nATT, 1, 2, 3\n"


@mark.parametrize(
    "name, content, code, figures",
    [
        ("a.tlog", b"", SourceFact.FILE_EMPTY, {"zeros": False}),
        ("a.tlog", bytes(99), SourceFact.FILE_EMPTY, {"zeros": True}),
        (
            "a.tlog",
            b"Time,Roll,Pitch\n0,1,2\n" * 50,
            SourceFact.FORMAT_UNKNOWN,
            {"name": "text"},
        ),
        ("a.tlog", bytes(range(256)) * 40, SourceFact.FORMAT_UNKNOWN, {"name": "mavlink"}),
        ("a.mcap", bytes(range(256)) * 40, SourceFact.FORMAT_UNKNOWN, {"name": "mavlink"}),
        ("a.tlog.gz", b"\x1f\x8b\x08" + bytes(100), SourceFact.FORMAT_UNKNOWN, {"name": "gzip"}),
        ("roll.csv", b"time_s,motor_1_us\n", SourceFact.FORMAT_UNKNOWN, {"name": "csv"}),
        ("a.tlog", b"\x89MCAP0\r\n" + bytes(100), SourceFact.MCAP_WITHOUT_FLIGHT, {"names": ()}),
        (
            "a.tlog",
            tlog([frame(64_000, b"abc", seed=3)] * 20),
            SourceFact.DIALECT_UNKNOWN,
            {"count": 20, "recording": False},
        ),
        ("a.ulg", ulog_files.HEADER[:9], SourceFact.ULOG_WITHOUT_FLIGHT, {"damaged": True}),
        ("a.ulg", FLAGGED[:19], SourceFact.ULOG_WITHOUT_FLIGHT, {"names": (), "damaged": True}),
        ("a.ulg", FLAGGED[:25], SourceFact.ULOG_WITHOUT_FLIGHT, {"names": (), "damaged": True}),
        ("a.ulg", FLAGGED[:58], SourceFact.ULOG_WITHOUT_FLIGHT, {"names": (), "damaged": True}),
        ("a.ulg", FLAGGED, SourceFact.ULOG_WITHOUT_FLIGHT, {"names": (), "damaged": False}),
        (
            "a.ulg",
            LOADS,
            SourceFact.ULOG_WITHOUT_FLIGHT,
            {"names": ("cpuload",), "damaged": False},
        ),
        ("a.ulg", ulog_files.HEADER + BEYOND, SourceFact.ULOG_WITHOUT_FLIGHT, {}),
        ("a.ulg", bytes(range(256)) * 20, SourceFact.FORMAT_UNKNOWN, {"name": "ulog"}),
        ("a.ulg", LATER, SourceFact.ULOG_OF_LATER_FORMAT, {}),
        ("a.tlog", b"\xa3\x95\x80" + bytes(500), SourceFact.DATAFLASH_WITHOUT_FLIGHT, {}),
        ("a.bin", b"\1" * 100, SourceFact.DATAFLASH_WITHOUT_MESSAGES, {}),
        (
            "a.bin",
            BEGUN,
            SourceFact.DATAFLASH_WITHOUT_FLIGHT,
            {"names": ("FMT", "MSG", "PARM")},
        ),
        ("a.log", b"FMT, 1\nATT, 2\n", SourceFact.DATAFLASH_WITHOUT_MESSAGES, {}),
        ("a.log", WITHOUT_CLOCK, SourceFact.DATAFLASH_WITHOUT_FLIGHT, {}),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, name, content, code, figures):
    path = tmp_path / name
    path.write_bytes(content)
    fact = unreadable(path)
    assert fact.code is code and figures.items() <= fact.figures.items()


@mark.parametrize("name", ["a.tlog", "a.mcap", "a.BIN", "a.ulg", "a"])
def test_a_pointer_of_git_lfs_says_how_to_fetch_the_log(tmp_path, name):
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:f878642b\nsize 61497068\n"
    for reader in (read_log, read_stream):
        (tmp_path / name).write_bytes(pointer)
        assert unreadable(tmp_path / name, reader).code is SourceFact.GIT_LFS_POINTER


def test_a_format_without_frames_has_none_to_give(tmp_path):
    (tmp_path / "flight.ulg").write_bytes(LOADS)
    assert unreadable(tmp_path / "flight.ulg", read_stream).code is SourceFact.FORMAT_WITHOUT_FRAMES


def test_a_frame_that_chance_makes_in_another_file_is_no_log(tmp_path):
    other = random.Random(0).randbytes(1 << 20)
    (tmp_path / "other").write_bytes(other + heartbeat() + other)
    assert unreadable(tmp_path / "other").code is SourceFact.FORMAT_UNKNOWN
    assert log_of(heartbeat(), tmp_path).frames == 1


def test_what_is_no_file_is_said(tmp_path):
    folder = unreadable(tmp_path)
    assert (folder.code, folder.figures["count"]) == (SourceFact.FOLDER_GIVEN, 0)
    assert unreadable(tmp_path / "missing.tlog").code is SourceFact.FILE_MISSING
    address = unreadable("https://logs.example.org/download?log=a")
    assert address.code is SourceFact.WEB_ADDRESS
    assert address.figures["path"] == "https://logs.example.org/download?log=a"
    pipe = tmp_path / "pipe.tlog"
    os.mkfifo(pipe)
    assert unreadable(pipe).code is SourceFact.SPECIAL_FILE
    (tmp_path / "a.log").write_bytes(b"")
    assert unreadable(tmp_path).figures["example"] == str(tmp_path / "a.log")
    assert unreadable(tmp_path / f"{'n' * 300}.tlog").code is SourceFact.FILE_NOT_OPENED


@mark.parametrize("path", [None, 5, [], 1.5])
def test_what_is_no_path_is_named(path):
    with raises(ValueError, match="path must"):
        read_log(path)


@mark.slow
@mark.filterwarnings("error")
def test_a_signalling_nan_is_no_number_and_no_warning(tmp_path):
    """Which a conversion to another width of number complains of."""
    signalling = bytes.fromhex("010080 7f")
    nan_parameter = frame(22, signalling + bytes(4) + b"SYSID_THISMAV\0\0\0" + b"\x09")
    rolls = [
        frame(30, struct.pack("<I", 20_000 + row) + signalling + bytes(20)) for row in range(3)
    ]
    vehicle = vehicle_of([heartbeat(), nan_parameter, *rolls, *flight(TIMES)], tmp_path)
    assert "SYSID_THISMAV" not in vehicle.parameters
    attitude = attitude_of_axis(vehicle, "roll")
    assert attitude.sent_count == len(TIMES) + 3 and len(attitude.time) == len(TIMES)


def test_a_path_may_be_bytes_and_have_any_name(tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(tlog(HOVER))
    log = read_log(os.fsencode(path))
    assert log.source == str(path) and len(log.vehicles) == 1


def test_ground_stations_radios_and_who_only_beats_are_no_vehicles():
    senders = [
        message("HEARTBEAT", 255, type=dialect.MAV_TYPE_GCS),
        message("SYSTEM_TIME", 255),
        message("RADIO_STATUS", 51, 68),
        message("HEARTBEAT", 7, type=dialect.MAV_TYPE_QUADROTOR),
    ]
    log = read(tlog([*senders, *flight([20.0, 20.1])]))
    assert [vehicle.system for vehicle in log.vehicles] == [1]
    kinds = {sender.system: sender.kind for sender in log.components}
    assert kinds == {1: "UNKNOWN", 7: "QUADROTOR", 51: "TELEMETRY_RADIO", 255: "GCS"}
