"""Damaged logs of PX4: what is whole is read, what is not is told, and nothing fails or takes long."""

from __future__ import annotations

import lzma
import random
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_flights import shared
from ulog_files import (
    FORMATS,
    HEADER,
    REAL,
    SYNC,
    TIMES,
    data,
    definitions,
    flight,
    log,
    message,
    parameter,
    subscription,
    subscriptions,
    vehicle_of,
)

from mavdem.errors import Unreadable
from mavdem.ingest import contents as files
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Telemetry

WANTED = "HIL_ACTUATOR_CONTROLS"


def stamps_of(vehicle: Telemetry) -> list[int]:
    return np.rint(vehicle.messages[WANTED]["time"] * 1e6).astype(int).tolist()


INTACT = [round(time * 1e6) for time in TIMES.tolist()]


@pytest.mark.parametrize("header", ["00 00 44", "01 00 44", "42 FF 44", "42 01 44", "42 00 00", "42 00 FF", "42 00 4C"])
def test_a_wrong_header_costs_its_own_message(tmp_path: Path, header: str) -> None:
    pieces = flight(TIMES)
    row = next(row for row, piece in enumerate(pieces) if row > 700 and piece[:5] == b"\x42\0D\x02\0")
    pieces[row] = bytes.fromhex(header) + pieces[row][3:]
    vehicle = vehicle_of(log(*pieces), tmp_path)
    assert set(INTACT) - set(stamps_of(vehicle)) == {struct.unpack_from("<Q", pieces[row], 5)[0]}
    assert len(vehicle.messages["ATTITUDE_QUATERNION"]["time"]) == len(TIMES)
    assert "damaged in 1 place:" in vehicle.repairs[0]


NOISE = random.Random(1).randbytes(5000)
ALONE = b"\xff" * 100 + message("O", struct.pack("<H", 60_000)) + b"\xff" * 100  # a dropout, were it one
INSERTED = {
    "noise": ([NOISE] * 3, "damaged in 3 places: 15000 bytes"),
    "an unknown kind": ([message("Z", bytes(40))], ""),
    "an unknown topic": ([message("D", struct.pack("<H", 999) + bytes(30))], ""),
    "what looks like a message": ([ALONE], f"{len(ALONE)} bytes that belong to no message were skipped."),
    "subscriptions again": ([subscriptions()], ""),
    **{f"a run of {letter}": ([bytes([letter]) * 50_000], "50000 bytes") for letter in b"BQ\0\xff"},
}


@pytest.mark.parametrize("name", INSERTED)
def test_what_lies_between_messages_costs_nothing(tmp_path: Path, name: str) -> None:
    pieces, (inserted, repair) = flight(TIMES), INSERTED[name]
    for row, piece in zip((900, 600, 300), inserted, strict=False):
        pieces.insert(row, piece)
    vehicle = vehicle_of(log(*pieces), tmp_path)
    assert stamps_of(vehicle) == INTACT
    assert [repair in said for said in vehicle.repairs] == [True] * bool(repair)


FIRST_FORMATS = {
    "HEARTBEAT": b"vehicle_status:uint64_t[1] timestamp;uint8_t arming_state;uint8_t system_type;uint8_t vehicle_type;",
    "ATTITUDE_QUATERNION": b"vehicle_attitude:vehicle_attitude[9999] x;",
}


@pytest.mark.parametrize("lost", FIRST_FORMATS)
def test_a_format_that_has_no_stamp_or_contains_itself_costs_its_topic(tmp_path: Path, lost: str) -> None:
    first = message("F", FIRST_FORMATS[lost])
    vehicle = vehicle_of(HEADER + first + definitions() + subscriptions() + b"".join(flight(TIMES)), tmp_path)
    assert stamps_of(vehicle) == INTACT and lost not in vehicle.messages


def test_padding_may_be_there_or_not(tmp_path: Path) -> None:
    pieces = [data("vehicle_angular_velocity", time, 0.5, 0.0, 0.1) for time in (19.9, 20.0, 20.1, 20.35)]
    pieces += [data("vehicle_attitude", 19.8 + 0.08 * row, 1, 0, 0, 0, 0) for row in range(8)]
    pieces[-1] = message("D", pieces[-1][3:] + bytes(7))
    vehicle = vehicle_of(log(*pieces), tmp_path)
    assert len(vehicle.messages["ATTITUDE_QUATERNION"]["time"]) == 4 and vehicle.repairs == ()


@pytest.mark.slow
def test_a_log_cut_off_anywhere_gives_what_came_before(tmp_path: Path) -> None:
    content = log(*flight(TIMES[:30]))
    begin = len(log())
    for end in [*range(0, begin, 37), *range(begin, len(content), 23)]:
        try:
            vehicle = vehicle_of(content[:end], tmp_path)
        except Unreadable as error:
            assert end < begin + 200 and str(error).endswith(".")
            continue
        if WANTED in vehicle.messages:
            found = stamps_of(vehicle)
            assert found == INTACT[: len(found)] and content[:end].count(b"D\x02\x00") == pytest.approx(
                len(found), abs=1
            )


def test_what_was_appended_after_a_crash_is_read(tmp_path: Path) -> None:
    """The data section ends within a message; what was saved on the way down follows, in three parts."""
    pieces = flight(TIMES)
    parts = [b"".join(pieces[:900]) + pieces[900][:-4], b"".join(pieces[901:1200]), b"".join(pieces[1200:]), SYNC]
    head = definitions() + subscriptions()
    first = 16 + 43 + len(head)
    offsets = [first + sum(map(len, parts[: n + 1])) for n in range(3)]
    flags = message("B", bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", *offsets))
    vehicle = vehicle_of(HEADER + flags + head + b"".join(parts), tmp_path)
    lost = {struct.unpack_from("<Q", pieces[900], 5)[0]} if pieces[900][3] == 2 else set()
    assert set(INTACT) - set(stamps_of(vehicle)) == lost
    assert vehicle.repairs == ("Left out: 1 message cut off by the end of the file or of a part of it.",)


@pytest.mark.parametrize("offsets", [(5, 0, 0), (2**60, 0, 0), (400, 300, 0)])
def test_offsets_that_cannot_be_are_ignored(tmp_path: Path, offsets: tuple[int, ...]) -> None:
    flags = message("B", bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", *offsets))
    content = HEADER + flags + definitions() + subscriptions() + b"".join(flight(TIMES))
    assert stamps_of(vehicle_of(content, tmp_path)) == INTACT


def test_stamps_that_cannot_be_are_left_out(tmp_path: Path) -> None:
    pieces = flight(TIMES)
    for row, wrong in ((500, 1e12), (900, 3.0), (len(pieces) - 1, 5000.0)):
        row = max(row for row in range(row + 1) if pieces[row][2:4] == b"D\x02")
        pieces[row] = pieces[row][:5] + struct.pack("<Q", round(wrong * 1e6)) + pieces[row][13:]
    # A topic's last message from long before the log began is none of them.
    pieces.insert(0, data("vehicle_land_detected", 2.2, True))
    vehicle = vehicle_of(log(*pieces), tmp_path)
    assert set(stamps_of(vehicle)) < set(INTACT) and len(stamps_of(vehicle)) == len(INTACT) - 3
    assert any("3 messages with a time stamp" in repair for repair in vehicle.repairs)
    assert vehicle.messages["EXTENDED_SYS_STATE"]["time"][0] == 2.2


def nested(deep: int, wide: int) -> bytes:
    """Formats that hold the next one many times over: ``wide`` to the power of ``deep`` values in the first."""
    parts = [f"t{n}:" + "".join(f"t{n + 1} x{m};" for m in range(wide)) for n in range(deep)]
    return b"".join(message("F", text.encode()) for text in [*parts, f"t{deep}:int8_t x;"])


@pytest.mark.parametrize(
    ("formats", "topic"),
    [
        (nested(7, 4), "t0"),
        (nested(7, 4) + message("F", b"t:t0 a;missing b;"), "t"),
        (message("F", b"t:t a;t b;t c;"), "t"),
        (message("F", b"t:u a;u b;") + message("F", b"u:t a;t b;"), "t"),
    ],
    ids=["nested", "nested and missing", "holds itself", "hold each other"],
)
def test_a_format_is_laid_out_once_however_often_it_is_subscribed_to(
    tmp_path: Path, formats: bytes, topic: str
) -> None:
    content = HEADER + formats + subscription(topic, number=5000) * 20_000
    began = time.perf_counter()
    vehicle = vehicle_of(content + definitions() + subscriptions() + b"".join(flight(TIMES)), tmp_path)
    assert "ATTITUDE_QUATERNION" in vehicle.messages
    assert time.perf_counter() - began < 10


@pytest.mark.parametrize("fields", ["uint8_t[9999] x0;uint8_t[9999] x1;uint8_t[9999] x2;", ""])
def test_topics_of_more_values_than_there_can_be_are_left_out(tmp_path: Path, fields: str) -> None:
    """A few kilobytes could ask for gigabytes: each value of each subscription is a column."""
    formats = message("F", f"actuator_outputs:{FORMATS['cpuload']}{fields}".encode())
    many = b"".join(subscription("actuator_outputs", number=1000 + n) for n in range(9000))
    content = HEADER + formats + definitions() + subscriptions() + many + b"".join(flight(TIMES))
    began = time.perf_counter()
    vehicle = vehicle_of(content, tmp_path)
    assert "ATTITUDE_QUATERNION" in vehicle.messages
    (said,) = vehicle.repairs
    assert said.startswith("Left out:") and said.endswith("to more topics, or larger ones, than PX4 has.")
    assert time.perf_counter() - began < 10


def test_a_dropout_before_the_first_topic_is_reported(tmp_path: Path) -> None:
    dropout = message("O", struct.pack("<H", 1500))
    vehicle = vehicle_of(HEADER + definitions() + dropout + subscriptions() + b"".join(flight(TIMES)), tmp_path)
    assert "dropped out 1 time, for 1.5 s in all and 1.5 s at most" in vehicle.repairs[0]


@given(st.integers(0, 2**32), st.floats(0.0, 0.01))
@settings(max_examples=40)
def test_damage_never_makes_an_error(tmp_path_factory: pytest.TempPathFactory, seed: int, rate: float) -> None:
    chance = random.Random(seed)
    content = bytearray(log(*flight(TIMES[:60]), parameters=parameter("MAV_SYS_ID", 3)))
    for place in range(len(content) - 1, 7, -1):
        if chance.random() < rate:
            content[place : place + chance.randrange(2)] = chance.randbytes(chance.randrange(4))
    try:
        vehicle = vehicle_of(bytes(content), tmp_path_factory.mktemp("damaged"))
    except Unreadable as error:
        assert str(error).endswith(".")
        return
    for columns in vehicle.messages.values():
        assert np.isfinite(columns["time"]).all() and len({len(values) for values in columns.values()}) == 1


@pytest.mark.parametrize("name", REAL)
def test_damage_to_a_real_log_costs_what_it_hits(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = bytearray(shared(name).read_bytes())
    (whole,) = read_log(shared(name)).vehicles
    chance, hits = random.Random(2), 20
    for _ in range(hits):
        place = chance.randrange(len(content) // 3, len(content))
        content[place : place + 8] = b"\xff" * 8
    vehicle = vehicle_of(bytes(content), tmp_path)
    for message_name, columns in whole.messages.items():
        assert len(vehicle.messages[message_name]["time"]) >= len(columns["time"]) - 2 * hits
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda packed: packed[:-300], "cut off"),
        (lambda packed: packed[:200] + b"\0\xff" * 50 + packed[300:], "damaged xz"),
        (lambda packed: lzma.compress(bytes(2_000_000)), "more than 1 MiB"),
    ],
)
def test_an_archive_that_cannot_be_unpacked_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil: object, said: str
) -> None:
    monkeypatch.setattr(files, "MAX_UNPACKED_BYTES", 1 << 20)
    assert callable(spoil)
    path = tmp_path / "flight.ulg.xz"
    path.write_bytes(spoil(lzma.compress(log(*flight(TIMES)))))
    with pytest.raises(Unreadable, match=said) as failure:
        read_log(path)
    assert str(path) in str(failure.value) and str(failure.value).endswith(".")


LOADS = data("cpuload", 3.0, 1.0)
LATER = HEADER + message("B", bytes(8) + b"\x02" + bytes(7) + bytes(24)) + definitions() + subscriptions()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (HEADER, "without the topics"),
        (HEADER[:9], "without the topics"),
        (log(LOADS), r"is intact, but holds neither .* \(its topics: cpuload\).* SDLOG_PROFILE"),
        (log(LOADS) + b"\x09", "the file is cut off at its end, holds neither"),
        (HEADER + bytes(5000), "damaged"),
        (bytes(range(256)) * 20, "no PX4 ULog"),
        (LATER, "later format"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_sentence(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "a.ulg"
    path.write_bytes(content)
    with pytest.raises(Unreadable, match=said) as failure:
        read_log(path)
    assert str(path) in str(failure.value) and str(failure.value).endswith(".")
