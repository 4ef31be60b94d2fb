"""Damaged ULog files: what is lost is what was damaged, and it is stated."""

import random
import struct
import time

import numpy as np
from pytest import approx, mark, param
from ulog_files import (
    SYNC,
    TIMES,
    definitions,
    flight,
    log,
    message,
    subscription,
    vehicle_of,
)

from mavdem.facts.sources import Repair
from mavdem.ingest.ulog_definitions import HEADER, RecordDefinitions
from mavdem.ingest.ulog_records import FILE_HEADER_BYTES, RecordLoss, sound_records

PIECES = flight(TIMES)
"""The records of a short flight, in several of which are marks of synchronisation."""

UNMARKED = [piece for piece in PIECES if piece != SYNC]
"""The same without these marks, as before PX4 1.11."""

ATTITUDES = [row for row, piece in enumerate(UNMARKED) if piece[2:5] == b"D\0\0"]
"""Which records hold the attitude."""


STAMPS = np.rint(TIMES * 1e6).astype(int).tolist()
"""The time stamps of the attitude, µs."""


def attitude_stamps(vehicle):
    return np.rint(vehicle.messages["ATTITUDE_QUATERNION"]["time"] * 1e6).astype(int).tolist()


def kept_bytes(records):
    """The records that are kept, one after the other."""
    kept = []
    for start in records.offsets.tolist():
        length, _ = HEADER.unpack_from(records.content, start)
        kept.append(bytes(records.content[start : start + HEADER.size + length]))
    return b"".join(kept)


def records_of(*pieces):
    """The records of a sound file."""
    return log(*pieces)[FILE_HEADER_BYTES:]


def test_all_records_of_a_sound_file_are_kept():
    records = sound_records(log(*PIECES))
    assert kept_bytes(records) == records_of(*PIECES) and records.loss == RecordLoss()


@mark.parametrize("missing_bytes, is_cut", [(0, False), (1, True), (len(UNMARKED[-1]) - 1, True)])
def test_a_file_that_ends_within_a_record_is_reported_as_cut(missing_bytes, is_cut, tmp_path):
    content = log(*UNMARKED)
    vehicle = vehicle_of(content[: len(content) - missing_bytes], tmp_path)
    assert (Repair.RECORDING_CUT in [fact.code for fact in vehicle.repairs]) is is_cut


@mark.parametrize("bit", range(16))
def test_a_flipped_bit_in_a_length_loses_that_record_alone(bit):
    """One bit of the size or type of a record is wrong."""
    row = ATTITUDES[100]
    damaged = bytearray(UNMARKED[row])
    damaged[bit // 8] ^= 1 << bit % 8
    records = sound_records(log(*UNMARKED[:row], bytes(damaged), *UNMARKED[row + 1 :]))
    assert kept_bytes(records) == records_of(*UNMARKED[:row], *UNMARKED[row + 1 :])
    assert records.loss.damaged_places == 1 and records.loss.lost_bytes == len(damaged)
    assert records.loss.lost_seconds == approx(0.01, abs=0.011)


@mark.parametrize(
    "short",
    [
        message("D", b"\0"),
        message("D", struct.pack("<HI", 0, 7)),
        message("L", b"6abc"),
        message("C", b"6" + bytes(7)),
        message("O", b"\1"),
        message("A", b"\0"),
        message("I", b"\x0dfloat GAIN_P"),
        message("P", b"\x0cfloat GAIN_P\0\0"),
        message("M", b""),
        message("Q", b"\1\xff"),
        message("F", b"nothing"),
        message("S", b"\0" * 8),
    ],
)
def test_a_record_that_is_too_short_loses_nothing_else(short):
    """A record of each type is too short for its fields."""
    records = sound_records(log(*UNMARKED[:700], short, *UNMARKED[700:]))
    assert kept_bytes(records) == records_of(*UNMARKED)
    assert records.loss.lost_bytes == len(short)


@mark.slow
def test_a_topic_without_time_stamp_does_not_end_the_log(tmp_path):
    """Two topics have no time stamp, or one of 32 bits, which ULog does not allow."""
    bare = definitions("bare:uint8_t state;", "odd:uint32_t timestamp;")
    topics = [subscription("bare", number=300), subscription("odd", number=301)]
    records = [message("D", struct.pack("<HB", 300, 5)), message("D", struct.pack("<HI", 301, 5))]
    vehicle = vehicle_of(
        log(*topics, *UNMARKED[:500], *records, *UNMARKED[500:], first=bare), tmp_path
    )
    assert attitude_stamps(vehicle) == STAMPS
    assert vehicle.repairs == ()


def test_values_that_look_like_the_header_of_a_record_are_values(tmp_path):
    """The values of a message contain the bytes with which another message begins."""
    header = UNMARKED[ATTITUDES[0]][:5]
    row = ATTITUDES[50]
    record = UNMARKED[row]
    disguised = record[:21] + header + record[26:]
    records = sound_records(log(*UNMARKED[:row], disguised, *UNMARKED[row + 1 :]))
    assert len(records.offsets) == len(sound_records(log(*UNMARKED)).offsets)
    assert records.loss == RecordLoss()


def test_data_with_padding_is_searched_for_no_more_often_than_other_data(monkeypatch):
    """PX4 pads some messages beyond their definition: the reader must not search all records again for each."""
    search = RecordDefinitions.possible_data_records
    searches = []

    def counted_search(definitions, first, stop):
        searches.append(first)
        return search(definitions, first, stop)

    monkeypatch.setattr(RecordDefinitions, "possible_data_records", counted_search)
    padded = [message("D", UNMARKED[row][3:] + bytes(7)) for row in ATTITUDES]
    records = sound_records(log(*padded))
    assert records.loss == RecordLoss()
    assert np.sum(np.array(records.offsets) >= len(log())) == len(padded)
    assert len(searches) == 1


def is_within_record(start):
    """Whether 64 bytes from an offset on are values of one record."""
    ends = len(log()) + np.cumsum([len(piece) for piece in UNMARKED])
    end = ends[np.searchsorted(ends, start, side="right")]
    return start + 64 <= end


@mark.slow
@mark.parametrize(
    "kind", ["removed", param("zeros", marks=mark.in_full), param("random", marks=mark.in_full)]
)
def test_a_hole_without_marks_of_synchronisation_costs_few_records(kind):
    """64 bytes are removed or overwritten, in a log without the marks by which a reader finds the next record."""
    content = log(*UNMARKED)
    generator = random.Random(68)
    first_data = len(log())
    for _ in range(60):
        start = generator.randrange(first_data, len(content) - 500)
        filling = {"removed": b"", "zeros": bytes(64), "random": generator.randbytes(64)}[kind]
        records = sound_records(content[:start] + filling + content[start + 64 :])
        lost_bytes = len(content) - FILE_HEADER_BYTES - len(kept_bytes(records))
        assert lost_bytes < 64 + 200
        assert kept_bytes(records).endswith(content[start + 300 :])
        # Nothing shows it where whole records are missing, or no more than values of one record were overwritten.
        if not records.loss.damaged_places:
            assert kind == "removed" or is_within_record(start)


@mark.parametrize("damage", [random.Random(1).randbytes(5000), bytes(999), b"\x42\xffD"])
def test_bytes_between_records_lose_one_record_at_most(damage, tmp_path, capfd):
    """Foreign bytes are inserted between two records."""
    vehicle = vehicle_of(log(*UNMARKED[:700], damage, *UNMARKED[700:]), tmp_path)
    assert len(set(STAMPS) - set(attitude_stamps(vehicle))) <= 1
    (damaged,) = [fact for fact in vehicle.repairs if fact.code is Repair.ULOG_DAMAGED]
    assert len(damage) <= damaged.figures["count"] < len(damage) + 100
    assert capfd.readouterr() == ("", "")


def test_the_time_that_is_lost_is_that_between_the_neighbours():
    content = log(*UNMARKED[:500], b"\xee" * 3000, *UNMARKED[1000:])
    loss = sound_records(content).loss
    assert loss.lost_seconds == approx(1.0, abs=0.02)


def test_a_stamp_that_is_damaged_too_does_not_lengthen_the_loss():
    wild = UNMARKED[1001][:5] + struct.pack("<Q", 1 << 60) + UNMARKED[1001][13:]
    content = log(*UNMARKED[:1000], b"\xee" * 50, wild, *UNMARKED[1002:])
    assert sound_records(content).loss.lost_seconds < 0.1


@mark.parametrize("tail", [b"\0" * 100_000, b"\xff" * 100_000, PIECES[-1][:9], b"\x20", b""])
def test_an_end_where_nothing_more_was_written_is_no_damage(tail):
    assert sound_records(log(*UNMARKED) + tail).loss == RecordLoss()


def test_a_definition_that_is_lost_costs_its_topic_only(tmp_path):
    """The definition of the motors is overwritten, so that their messages cannot be read."""
    content = log(*UNMARKED)
    start = content.index(b"actuator_motors:")
    vehicle = vehicle_of(content[:start] + b"\x01" * 20 + content[start + 20 :], tmp_path)
    assert attitude_stamps(vehicle) == STAMPS
    assert "HIL_ACTUATOR_CONTROLS" not in vehicle.messages
    (damaged,) = vehicle.repairs
    motor_records = [piece for piece in UNMARKED if piece[2:5] == b"D\2\0"]
    assert damaged.figures["count"] > sum(len(piece) for piece in motor_records)


def test_a_repeated_subscription_keeps_what_came_before(tmp_path):
    again = subscription("vehicle_attitude")
    vehicle = vehicle_of(log(*UNMARKED[:700], again, *UNMARKED[700:]), tmp_path)
    assert attitude_stamps(vehicle) == STAMPS


def test_a_second_definition_of_a_topic_does_not_replace_the_first(tmp_path):
    again = definitions("vehicle_attitude:vehicle_attitude[9] x;")
    vehicle = vehicle_of(log(again, *UNMARKED), tmp_path)
    assert attitude_stamps(vehicle) == STAMPS
    assert vehicle.repairs == ()


def test_types_of_records_of_later_versions_are_passed_over():
    later = message("Z", b"of 2030")
    records = sound_records(log(*UNMARKED[:700], later, *UNMARKED[700:], later))
    assert kept_bytes(records) == records_of(*UNMARKED)
    assert records.loss == RecordLoss()


@mark.parametrize(
    "definition",
    [
        "big:uint64_t timestamp;float[60000] x;",
        "big:uint64_t timestamp;big inner;",
        "big:lost inner;",
        "big:b[999] x;|b:c[999] x;|c:bool[9] x;",
        "big:uint64_t timestamp;float timestamp;",
    ],
)
def test_a_topic_that_would_take_all_memory_is_left_out(definition, tmp_path):
    """A message definition is too large, contains itself, or names another that is missing."""
    pieces = [*UNMARKED[:700], subscription("big", number=300), *UNMARKED[700:]]
    vehicle = vehicle_of(log(*pieces, first=definitions(*definition.split("|"))), tmp_path)
    assert attitude_stamps(vehicle) == STAMPS


def test_data_appended_after_a_crash_follows_a_record_that_is_cut():
    first, second = records_of(*UNMARKED[:700]), b"".join(UNMARKED[701:])
    cut = UNMARKED[700][:11]
    file_header = log()[:FILE_HEADER_BYTES]
    first_offset = FILE_HEADER_BYTES + 43 + len(first) + len(cut)
    flags = message("B", bytes(8) + b"\1" + bytes(7) + struct.pack("<3Q", first_offset, 0, 0))
    records = sound_records(file_header + flags + first + cut + second)
    assert kept_bytes(records) == first + second
    assert records.loss == RecordLoss()


@mark.slow
@mark.parametrize(
    "filling", [b"A", b"D", b"F:", b"L", b"P", b"M\1A", param(b"\4\0D\0\0", marks=mark.in_full)]
)
def test_bytes_that_look_like_records_are_skipped_at_once(filling):
    """None takes a second; the limit leaves room for a busy machine."""
    start = time.process_time()
    records = sound_records(log(*UNMARKED[:700], 100_000 * filling, *UNMARKED[700:]))
    assert time.process_time() - start < 10
    assert kept_bytes(records).endswith(b"".join(UNMARKED[702:]))


@mark.parametrize("seed", range(8))
def test_random_damage_is_left_out_without_an_error(seed, tmp_path):
    generator = random.Random(seed)
    content = bytearray(log(*UNMARKED))
    for _ in range(30):
        content[generator.randrange(len(log()), len(content))] ^= 1 << generator.randrange(8)
    vehicle = vehicle_of(bytes(content), tmp_path)
    assert np.isin(attitude_stamps(vehicle), STAMPS).mean() > 0.95
    assert len(attitude_stamps(vehicle)) > 0.95 * len(STAMPS)
