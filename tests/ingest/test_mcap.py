"""MCAP recordings: the same stream as the telemetry log they were made from, other recorders' layouts, and damage."""

import json
import random
import re
import struct

import numpy as np
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_streams import HOVER, NOW, TIMES, flight, heartbeat, tlog
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType
from mcap_files import Recorder, converted, json_only, spoil
from numpy.testing import assert_array_equal
from pytest import approx, fixture, mark
from recorded_flights import SAMPLE_LOGS
from refusals import unreadable
from ros2_files import TIMES as SHORT
from ros2_files import UNIX, Ros2Recorder, mavros_flight, px4_flight

from mavdem.errors import Unreadable
from mavdem.export.conversion import convert
from mavdem.facts.sources import Repair, SourceFact
from mavdem.ingest import read_log
from mavdem.ingest.mcap import records as mcap_records
from mavdem.ingest.mcap.log import mcap_stream, read_mcap
from mavdem.ingest.mcap.records import MAGIC, McapRecording
from mavdem.ingest.tlog import write_tlog

COMPRESSIONS = list(CompressionType)


@fixture
def recorder(tmp_path):
    return Recorder(tmp_path / "flight.mcap")


def back_to_tlog(mcap):
    path = mcap.with_suffix(".back.tlog")
    with path.open("wb") as file:
        write_tlog(file, mcap_stream(mcap))
    return path.read_bytes()


@mark.slow
@mark.parametrize("log", SAMPLE_LOGS, ids=lambda log: log.stem)
def test_json_alone_tells_the_same(log, tmp_path):
    """A recording with MAVLink as JSON only is read like the telemetry log with the same messages as frames."""
    path = tmp_path / log.name
    path.write_bytes(log.read_bytes()[:100_000])
    log_of_json, log_of_frames = map(
        read_log, (json_only(converted(path, tmp_path), tmp_path), path)
    )
    assert [vars(message) for message in log_of_json.components] == [
        vars(message) for message in log_of_frames.components
    ]
    for vehicle, other in zip(log_of_json.vehicles, log_of_frames.vehicles, strict=True):
        # The bits of a NaN are an integer of PX4's, and JSON has but one NaN: these, with their types, are lost.
        shared_parameters = {name: other.parameters[name] for name in vehicle.parameters}
        assert vehicle.parameters == shared_parameters
        if other.autopilot != "PX4":
            assert shared_parameters == other.parameters
        else:
            assert shared_parameters != other.parameters
        for name, columns in vehicle.messages.items():
            for field in columns.keys() - {"param_type"}:
                assert_array_equal(columns[field], other.messages[name][field], strict=True)


@mark.slow
def test_a_stamp_that_mcap_cannot_hold_becomes_the_one_before(tmp_path):
    content = bytearray(tlog(HOVER))
    second = 8 + len(heartbeat())
    content[second : second + 8] = struct.pack(">Q", 2**63)
    log = tmp_path / "future.tlog"
    log.write_bytes(content)
    content[second : second + 8] = struct.pack(">Q", NOW)
    held = tmp_path / "held.mcap"
    assert convert(log, held, "roll")["stamps_filled"] == 1
    assert back_to_tlog(held) == content


# Other recorders' files


@mark.slow
def test_blueos(recorder):
    """BlueOS writes MAVLink messages as JSON into MCAP files.

    Names in pieces, infinite numbers, missing values and flags in words are read.
    """
    recorder.flight(TIMES)
    name = json.dumps([*"SERVO1_FUNCTION", "\0"])
    recorder.blueos(
        "PARAM_VALUE",
        f'"param_value":33.0,"param_count":1,"param_index":0,"param_id":{name},'
        '"param_type":{"type":"MAV_PARAM_TYPE_INT16"}',
    )
    recorder.blueos("PARAM_VALUE", '"param_value":2.5,"param_id":"GAIN\0","param_type":9')
    recorder.blueos(
        "VFR_HUD",
        '"airspeed":NaN,"groundspeed":Infinity,"alt":-inf,"climb":null,"heading":-3,"throttle":7',
    )
    recorder.blueos(
        "SYS_STATUS",
        '"onboard_control_sensors_present":"MAV_SYS_STATUS_SENSOR_3D_GYRO | MAV_SYS_STATUS_SENSOR_3D_MAG | 0x8",'
        '"onboard_control_sensors_enabled":"","load":12',
    )
    log = recorder.log()
    (vehicle,) = log.vehicles
    assert (vehicle.vehicle, vehicle.autopilot, vehicle.repairs) == (
        "QUADROTOR",
        "ARDUPILOTMEGA",
        (),
    )
    assert log.frames == 605
    assert vehicle.messages["HEARTBEAT"]["base_mode"].tolist() == [209]
    assert np.allclose(vehicle.messages["ATTITUDE"]["time"], TIMES)
    assert vehicle.messages["ATTITUDE"]["yaw"].tolist() == list(range(300))
    assert np.isnan(vehicle.messages["ATTITUDE"]["pitch"]).all()
    assert (vehicle.messages["SERVO_OUTPUT_RAW"]["servo16_raw"] == 0).all()
    assert vehicle.parameters == {"SERVO1_FUNCTION": 33.0, "GAIN": 2.5}
    hud = vehicle.messages["VFR_HUD"]
    assert np.isnan([hud["airspeed"][0], hud["climb"][0]]).all()
    assert (hud["groundspeed"][0], hud["alt"][0], hud["heading"][0]) == (np.inf, -np.inf, -3)
    assert vehicle.messages["SYS_STATUS"]["onboard_control_sensors_present"].tolist() == [1 + 4 + 8]
    assert vehicle.messages["SYS_STATUS"]["onboard_control_sensors_enabled"].tolist() == [0]


@mark.slow
def test_gaps_in_the_headers_sequence_are_losses(recorder):
    for row in range(300):
        if not 100 <= row < 107:
            recorder.blueos("ATTITUDE", {"time_boot_ms": 20_000 + row, "roll": 0.0}, row)
    assert recorder.log().components[0].lost == 7


def test_the_other_bridge(recorder):
    recorder.write("/camera/image", b"\xff\xd8", "cdr")
    recorder.write("/mavlink/3/1/HEARTBEAT", b'{"type":2,"autopilot":12,"base_mode":81}')
    for time in TIMES:
        body = {"time_boot_ms": round(time * 1e3), "roll": time}
        recorder.write("/mavlink/3/1/ATTITUDE", json.dumps(body).encode())
    log = recorder.log()
    (vehicle,) = log.vehicles
    assert (vehicle.system, vehicle.vehicle, vehicle.autopilot) == (3, "QUADROTOR", "PX4")
    assert np.array_equal(vehicle.messages["ATTITUDE"]["roll"], np.array(TIMES, dtype=np.float32))
    assert log.components[0].lost == 0


def test_two_bridges_in_one_recording_count_once(recorder):
    for row in range(20):
        fields = {"time_boot_ms": row + 1, "roll": 0.5}
        recorder.write("/mavlink/1/1/ATTITUDE", json.dumps(fields).encode())
        recorder.blueos("ATTITUDE", fields, row)
    recorder.write("/mavlink/1/1/VFR_HUD", b'{"alt":1.0}')
    assert recorder.log().components[0].messages == {"ATTITUDE": 20, "VFR_HUD": 1}


@mark.parametrize("encoding", ["mavlink", ""])
def test_frames_may_come_in_pieces(encoding, recorder):
    frames = HOVER
    content = b"".join(frames)
    size = 100
    for begin in range(0, len(content), size):
        recorder.write("serial", content[begin : begin + size], encoding, schema=False)
        recorder.write("noise", b"\xfe\x01\x02 something else", "x", schema=False)
    log = recorder.log()
    assert log.components[0].messages == {"HEARTBEAT": 1, "ATTITUDE": 300, "SERVO_OUTPUT_RAW": 300}
    assert log.receive_time == approx(
        (NOW / 1e6 + 0.01, NOW / 1e6 + 0.02 * (len(content) // size) + 0.01)
    )


def test_a_channel_of_encoding_mavlink_may_begin_within_a_frame(recorder):
    content = b"".join(HOVER)[3:]
    for begin in range(0, len(content), 100):
        recorder.write("serial", content[begin : begin + 100], "mavlink", schema=False)
    messages = recorder.log().components[0].messages
    assert messages == {"ATTITUDE": 300, "SERVO_OUTPUT_RAW": 300}


def test_who_is_heard_in_frames_is_not_read_again_from_json(recorder):
    """System 1 is recorded as frames and as JSON with another roll angle, system 2 as JSON only."""
    for row, frame in enumerate(flight(TIMES[:20], system=1)):
        recorder.write("raw", frame, "mavlink", schema=False)
        recorder.blueos("ATTITUDE", {"time_boot_ms": row + 1, "roll": 9.0}, row, system=1)
    recorder.flight(TIMES[:20], system=2)
    log = recorder.log()
    assert [(message.system, message.messages.get("ATTITUDE")) for message in log.components] == [
        (1, 20),
        (2, 20),
    ]
    assert (log.vehicles[0].messages["ATTITUDE"]["roll"] == np.float32(0.1)).all()


@mark.parametrize("chunked", [True, False])
@mark.parametrize("compression", COMPRESSIONS)
def test_the_library_reads_the_same_messages(compression, chunked, tmp_path):
    """The reader of this project and the library mcap read the same messages from each kind of file."""
    path = tmp_path / "compared.mcap"
    with Recorder(path, compression=compression, use_chunking=chunked, chunk_size=3000) as recorder:
        recorder.flight(TIMES[:50])
    recording = McapRecording(path.read_bytes())
    log_of_json = list(recording.messages())
    with path.open("rb") as file:
        read = NonSeekingReader(file).iter_messages(log_time_order=False)
        assert log_of_json == [message for *_, message in read]
    assert not recording.repairs()


@mark.parametrize("topic", ["two\nlines", "\x1b[2Jcleared", "\u202etnorf ot kcab", "long" * 10_000])
def test_a_topic_may_be_called_anything(topic, recorder):
    recorder.write(topic, b"{}")
    said = unreadable(recorder.log).sentence_and_remedy
    assert said.isprintable() and len(said) < 300 + len(str(recorder.path))


# Damage and malice


def attitudes(path):
    """Returns the stamps of the attitude, ms.

    None if the file is unreadable, which the error must say in one sentence.
    """
    try:
        log = read_log(path)
    except Unreadable as error:
        message = str(error)
        assert "\n" not in message
        assert re.search("MCAP|ROS 2|empty", message)
        return None
    tables = [
        table
        for vehicle in log.vehicles
        for name, table in vehicle.messages.items()
        if "ATTITUDE" in name
    ]
    return [
        stamp for table in tables for stamp in np.rint(1e3 * table["time"]).astype(int).tolist()
    ]


def small(folder, compression, frames):
    """A recording of several chunks."""
    path = folder / "small.mcap"
    with Recorder(path, compression=compression, chunk_size=2500) as recorder:
        if frames:
            for frame in [heartbeat(), *flight(TIMES[:60])]:
                recorder.write("mavlink/raw", frame, "mavlink", schema=False)
        else:
            recorder.flight(TIMES[:30])
    return path.read_bytes()


@mark.slow
@mark.parametrize("frames", [True, False])
def test_a_cut_recording_is_read_up_to_the_cut(frames, tmp_path):
    """The longer the rest of a recording, the more messages are read, and all of them are right."""
    content = small(tmp_path, CompressionType.ZSTD if frames else CompressionType.LZ4, frames)
    path = tmp_path / "cut.mcap"
    all_stamps = [round(time * 1e3) for time in TIMES[: 60 if frames else 30]]
    fewest = 0
    for cut in [*range(0, 40, 5), *range(40, len(content), 397), len(content)]:
        path.write_bytes(content[:cut])
        read = attitudes(path) or []
        assert read == all_stamps[: len(read)]
        assert len(read) >= fewest
        fewest = len(read)
    assert fewest == len(all_stamps)
    path.write_bytes(content[: len(content) // 2])
    assert Repair.RECORDING_CUT in [fact.code for fact in read_mcap(path).vehicles[0].repairs]


@mark.slow
@given(
    st.integers(0, 2**32),
    st.sampled_from(COMPRESSIONS),
    st.sampled_from(["frames", "json", "px4", "mavros"]),
)
@settings(max_examples=12)
def test_damage_never_makes_an_error_or_a_false_message(tmp_path_factory, seed, compression, kind):
    """Random bytes of recordings of all kinds are changed: only true messages may be read."""
    path = tmp_path_factory.mktemp("damaged") / "damaged.mcap"
    if kind in ("frames", "json"):
        path.write_bytes(small(path.parent, compression, kind == "frames"))
    else:
        with Ros2Recorder(path, compression=compression, chunk_size=2500) as recorder:
            px4_flight(recorder, SHORT[:60]) if kind == "px4" else mavros_flight(
                recorder, UNIX + SHORT[:60]
            )
    spoil(path, random.Random(seed))
    read = set(attitudes(path) or [])
    # MAVROS's seconds count from another first message where the first are lost.
    assert (
        all(0 < message <= 61_000 for message in read)
        if kind == "mavros"
        else read <= {round(1e3 * time) for time in TIMES}
    )


@mark.parametrize("compression", COMPRESSIONS)
def test_a_damaged_stretch_costs_its_own_messages(compression, tmp_path):
    """The length of a chunk is damaged, so that the reader must search for the next one."""
    content = bytearray(small(tmp_path, compression, frames=True))
    position = len(MAGIC)
    while content[position] != mcap_records.Opcode.CHUNK:
        position += 9 + int.from_bytes(content[position + 1 : position + 9], "little")
    # The length of the first chunk: the file can no longer be walked from record to record.
    content[position + 1 : position + 9] = struct.pack("<Q", 2**62)
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    read = attitudes(path)
    assert len(read) > 30
    repairs = {fact.code: fact for fact in read_mcap(path).vehicles[0].repairs}
    assert repairs[Repair.BYTES_SKIPPED].figures["part"] == "recording"


def test_json_of_a_damaged_chunk_is_not_used(tmp_path):
    content = small(tmp_path, CompressionType.NONE, frames=False)
    wrong = content.replace(b'"roll": 0.1, "yaw": 3}', b'"roll": 0.9, "yaw": 3}')
    assert wrong != content
    path = tmp_path / "wrong.mcap"
    path.write_bytes(wrong)
    (vehicle,) = read_mcap(path).vehicles
    assert (vehicle.messages["ATTITUDE"]["roll"] == np.float32(0.1)).all()
    repairs = {fact.code: fact for fact in vehicle.repairs}
    figures = repairs[Repair.CHUNKS_DAMAGED].figures
    assert figures["size"] > figures["count"] * 1000
    assert 0.0 < figures["duration"] < TIMES[30] - TIMES[0]


def test_of_damaged_mavlink_alone_it_says_that_it_is_damaged(tmp_path):
    content = bytearray(small(tmp_path, CompressionType.ZSTD, frames=False))
    # All positions up to the summary.
    for position in range(60, int.from_bytes(content[-28:-20], "little"), 40):
        content[position] ^= 0xFF
    (tmp_path / "small.mcap").write_bytes(content)
    assert unreadable(read_mcap, tmp_path / "small.mcap").code is SourceFact.MCAP_DAMAGED


BODIES = [
    b"",
    b"null",
    b"\xff\xfe\x00",
    b"[" * 100_000,
    b'{"a":' * 100_000,
    b'{"message":[],"header":{}}',
    b'{"message":{"type":"HEARTBEAT","time_boot_ms":1,"roll":0}}',
    b'{"message":{"type":5,"roll":"x"}}',
    b'{"message":{"type":"ATTITUDE","roll":{"type":{"type":1}}}}',
    b'{"message":{"type":"ATTITUDE","roll":1e400,"time_boot_ms":-1}}',
    b'{"message":{"type":"ATTITUDE","time_boot_ms":4294967296}}',
    b'{"message":{"type":"ATTITUDE","roll":' + b"9" * 10_000 + b"}}",
    b'{"message":{"type":"ATTITUDE","roll":1e39}}',
    b'{"message":{"type":"ATTITUDE","roll":true,"time_boot_ms":"MAV_NO_SUCH"}}',
]


@mark.parametrize("body", BODIES, ids=range(len(BODIES)))
def test_a_hostile_body_costs_itself_only(body, recorder):
    recorder.flight(TIMES[:20])
    for topic in (
        "mavlink/1/1/ATTITUDE",
        "mavlink/out",
        "mavlink/1/1/NOTHING",
        "mavlink/1/1/STATUSTEXT",
    ):
        recorder.write(topic, body)
    recorder.blueos("ATTITUDE", {"time_boot_ms": 20_200, "roll": 0.1}, 42)
    vehicle = recorder.vehicle()
    assert vehicle.messages["ATTITUDE"]["time_boot_ms"].tolist() == [
        *(round(time * 1e3) for time in TIMES[:20]),
        20_200,
    ]
    assert "STATUSTEXT" not in vehicle.messages


@mark.parametrize("header", ["5", "{}", '{"sequence":-1,"system_id":1e9}', '{"sequence":1e400}'])
def test_without_a_header_the_topic_tells_who_sent_it(header, recorder):
    for row in range(20):
        body = f'{{"header":{header},"message":{{"type":"ATTITUDE","time_boot_ms":{row + 1},"roll":1}}}}'
        recorder.write("mavlink/7/1/ATTITUDE", body.encode())
    (speaker,) = recorder.log().components
    assert (speaker.system, speaker.messages, speaker.lost) == (7, {"ATTITUDE": 20}, 0)


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(packed):
    head = struct.pack("<QQQII", 0, 0, 0, 0, 4) + b"zstd"
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


@mark.slow
def test_what_chunks_unpack_to_is_bounded(tmp_path, monkeypatch):
    """100 chunks of a few bytes would each unpack to 8 MB: the sum of what is unpacked has a limit."""
    bomb = chunk(zstandard.ZstdCompressor().compress(record(0x80, bytes(1 << 23))))
    unpacked_sizes = []
    unpack = mcap_records._unpacked_records

    def watched(compression, packed, most):
        records = unpack(compression, packed, most)
        assert len(records) <= most
        unpacked_sizes.append(len(records))
        return records

    monkeypatch.setattr(mcap_records, "_unpacked_records", watched)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + 100 * bomb)
    assert attitudes(path) is None
    assert len(unpacked_sizes) == 100
    assert sum(unpacked_sizes) <= (1 << 26) + 100 * path.stat().st_size
    assert sum(unpacked_sizes) < 50 << 23


def test_texts_of_json_are_as_on_the_wire(recorder):
    recorder.flight(TIMES[:5])
    for text in ('"hello"', '["h","e","l","l","o","\\u0000"]', "[104,101,108,108,111,0,0]"):
        recorder.blueos("STATUSTEXT", f'"severity":{{"type":"MAV_SEVERITY_INFO"}},"text":{text}')
    recorder.blueos("STATUSTEXT", f'"text":"{51 * "x"}"')
    vehicle = recorder.vehicle()
    assert vehicle.messages["STATUSTEXT"]["text"].tolist() == [b"hello"] * 3
    assert vehicle.messages["STATUSTEXT"]["severity"].tolist() == [6] * 3
