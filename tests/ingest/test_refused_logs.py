"""Files that hold a log and cannot be read as they are: the refusal says what they are and what to do."""

import io
import lzma
import struct
import tracemalloc
import zipfile

import dataflash_logs as made
import numpy as np
from pytest import mark
from refusals import unreadable
from ulog_files import TIMES, flight, log

from mavdem.facts.sources import SourceFact
from mavdem.ingest import contents, read_log
from mavdem.ingest.contents import file_beginning
from mavdem.ingest.formats import looks_like_log


def refusal(content, folder, name):
    path = folder / name
    path.write_bytes(content)
    return unreadable(read_log, path)


@mark.parametrize("name", ["flight.ulge", "flight.ulg"])
def test_an_encrypted_ulog_is_to_be_decrypted_first(name, tmp_path):
    fact = refusal(b"ULogEnc\1" + bytes(range(200)), tmp_path, name)
    assert fact.code is SourceFact.ULOG_ENCRYPTED
    assert "encrypted PX4 log: decrypt it first" in str(fact)
    assert "decrypt_ulog.py" in fact.remedy
    assert looks_like_log(tmp_path / name)


def sdlog2_log():
    """A log of PX4 before ULog: the framing of DataFlash, and the time in messages of its own."""
    fields = struct.pack("<BB4s16s64s", 129, 11, b"TIME", b"Q", b"StartTime")
    times = [b"\xa3\x95\x81" + struct.pack("<Q", stamp) for stamp in range(0, 10**6, 10**4)]
    return made.HEADER + b"\x80" + fields + b"".join(times)


@mark.parametrize("name", ["flight.px4log", "log001.bin"])
def test_a_px4log_names_its_converter(name, tmp_path):
    fact = refusal(sdlog2_log(), tmp_path, name)
    assert fact.code is SourceFact.PX4_LOG_BEFORE_ULOG
    assert "sdlog2_dump.py" in fact.remedy


def test_a_dataflash_log_without_its_head_lacks_definitions(tmp_path):
    whole = made.formats() + b"".join(made.flight(20 + 0.1 * np.arange(100)))
    fact = refusal(whole[len(made.formats()) + 7 :], tmp_path, "flight.bin")
    assert fact.code is SourceFact.DATAFLASH_WITHOUT_DEFINITIONS
    assert "its definitions (FMT) are missing" in str(fact)


def test_a_text_log_without_its_head_lacks_definitions(tmp_path):
    lines = "".join(f"ATT, {row}000, 0.1, 0.2, 0.3\nIMU, {row}000, 1\n" for row in range(50))
    fact = refusal(lines.encode(), tmp_path, "flight.log")
    assert fact.code is SourceFact.DATAFLASH_WITHOUT_DEFINITIONS


@mark.parametrize("seed", range(3))
def test_random_bytes_are_no_log_whose_definitions_are_missing(seed, tmp_path):
    content = np.random.default_rng(seed).bytes(200_000)
    fact = refusal(b"\0" + content, tmp_path, "flight.bin")
    assert fact.code is SourceFact.DATAFLASH_WITHOUT_MESSAGES


LOG = log(*flight(TIMES))


def zipped(members, compression=zipfile.ZIP_DEFLATED):
    """A zip archive of files by name."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


@mark.parametrize(
    "members",
    [
        {"flight.ulg": LOG},
        {"flight.ulg.xz": lzma.compress(LOG)},
        {"a/readme.txt": b"hello", "a/b/": b"", "a/b/FLIGHT.ULG": LOG},
        {"flight.ulg": LOG, "__MACOSX/._flight.ulg": b"\0\5\x16\7"},
        {"flight.dat": LOG},
    ],
)
def test_the_log_in_a_zip_archive_is_read(members, tmp_path):
    path = tmp_path / "flight.zip"
    path.write_bytes(zipped(members))
    assert looks_like_log(path)
    (vehicle,) = read_log(path).vehicles
    assert len(vehicle.messages["ATTITUDE_QUATERNION"]["time"]) == len(TIMES)
    assert vehicle.source == str(path)


@mark.parametrize(
    "members, count", [({"a.ulg": LOG, "b.bin": LOG}, 2), ({}, 0), ({"a": b"", "b": b""}, 0)]
)
def test_a_zip_archive_without_exactly_one_log_is_refused(members, count, tmp_path):
    content = zipped(members) if members else zipped({"folder/": b""})
    fact = refusal(content, tmp_path, "flights.zip")
    assert fact.code is SourceFact.ARCHIVE_WITHOUT_ONE_LOG
    assert fact.figures["count"] == count
    assert looks_like_log(tmp_path / "flights.zip") == (count > 0)


def with_password(content):
    """The archive with the flag of encryption set for all its members."""
    spoiled = bytearray(content)
    for marker, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        spoiled[spoiled.index(marker) + offset] |= 1
    return bytes(spoiled)


@mark.parametrize(
    "spoil",
    [
        lambda content: content[: len(content) // 2],
        lambda content: content[:100] + b"\xff" * 50 + content[150:],
        with_password,
    ],
)
def test_a_zip_archive_that_cannot_be_unpacked_is_refused(spoil, tmp_path):
    fact = refusal(spoil(zipped({"flight.ulg": LOG})), tmp_path, "flight.zip")
    assert fact.code is SourceFact.ARCHIVE_DAMAGED and "zip" in str(fact)
    assert looks_like_log(tmp_path / "flight.zip")


def test_a_zip_archive_that_unpacks_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(contents, "MAX_LOG_BYTES", 1 << 20)
    fact = refusal(zipped({"flight.ulg": b"\1" * 2_000_000}), tmp_path, "flight.zip")
    assert fact.code is SourceFact.FILE_TOO_LARGE


@mark.slow
@mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_zip_archive_whose_pieces_unpack_without_bound_is_refused(packing, tmp_path):
    """A kilobyte of bzip2 unpacked to a gigabyte in the server, which looks at the beginning of each upload."""
    content = zipped({"flight.ulg": LOG + bytes(1 << 24)}, packing)
    path = tmp_path / "flight.zip"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        fact = unreadable(file_beginning, path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1 << 23
    assert "flight.zip is a zip archive that is not packed by Deflate." in str(fact)
    assert fact.remedy == "Unpack it."


@mark.slow
def test_a_zip_archive_of_very_many_files_is_refused_before_they_are_listed(tmp_path):
    names = {f"{number:0200d}.txt": b"" for number in range(5000)}
    fact = refusal(zipped(names | {"flight.ulg": LOG}), tmp_path, "flight.zip")
    assert fact.code is SourceFact.ARCHIVE_DAMAGED
    assert "a zip archive of too many files" in str(fact)


@mark.slow
def test_a_packed_size_that_lies_gives_no_room(tmp_path, monkeypatch):
    """A zip archive states 1 GB as its packed size, so that its contents of 8 MB would seem harmless."""
    monkeypatch.setattr(contents, "MIN_UNPACKED_LIMIT", 1 << 10)
    content = bytearray(zipped({"flight.ulg": LOG + bytes(1 << 23)}))
    # The packed size is 20 bytes behind the marker of the directory's entry, and 18 behind that of the member.
    for marker, offset in ((b"PK\1\2", 20), (b"PK\3\4", 18)):
        start = content.index(marker) + offset
        content[start : start + 4] = struct.pack("<I", 1 << 30)
    fact = refusal(bytes(content), tmp_path, "flight.zip")
    assert fact.code is SourceFact.FILE_TOO_LARGE


@mark.parametrize(
    "files, sentence",
    [
        ({}, "flight.zip is a zip archive without a log."),
        ({"in ner.zip": zipped({"a.ulg": log(*flight(TIMES))})}, "holds another one (in ner.zip)."),
    ],
)
def test_a_zip_without_a_log_of_its_own_is_refused(files, sentence, tmp_path):
    fact = refusal(zipped(files), tmp_path, "flight.zip")
    assert fact.code is SourceFact.ARCHIVE_WITHOUT_ONE_LOG
    assert sentence in str(fact)
