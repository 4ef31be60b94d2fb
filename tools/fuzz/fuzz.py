#!/usr/bin/env python
"""Searches for a log that crashes its reader.

Usage: tools/fuzz/fuzz.py dataflash|mcap|tlog|ulog [CORPUS] [OPTIONS]

Coverage-guided, by atheris (``pip install atheris``, Linux and macOS). OPTIONS are libFuzzer's: ``-max_total_time=480``
stops after eight minutes, ``-artifact_prefix=FOLDER/`` names the folder for failing inputs. Useful inputs gather in
the folder CORPUS. An input that fails is run again by naming its file, and becomes a test of ``tests/ingest``.
``--seeds`` checks the first inputs once, without atheris.

The first byte of an input is its mode: the rest is a file as it is (0), or pieces that become one, without (1) or with
the usual definitions before them; a piece may stand for a whole flight, which single bytes would never make. Any bytes
are read, or refused with ``Unreadable`` in one sentence, within the time and the memory that libFuzzer allows
(``-timeout``, ``-rss_limit_mb``). Nothing is printed. Every column has as many rows as its ``time``, no time is
infinite, and ``mavdem info`` can report on it. Blocks of a few bytes of a telemetry log give the same result as one.

atheris 3.0 keeps the result of every traced comparison of arrays, so memory grows by up to 0.3 MB a run. Several runs
with ``-max_total_time=100`` and one corpus do more than one long run.
"""

from __future__ import annotations

import contextlib
import io
import struct
import sys
import tempfile
import warnings
import zlib
from collections.abc import Callable
from math import cos, sin
from pathlib import Path
from typing import Any

import click
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "tests"), str(ROOT / "tests/ingest")]
SEEDS = "--seeds" in sys.argv
if SEEDS:
    tracing: contextlib.AbstractContextManager[object] = contextlib.nullcontext()
else:
    import atheris

    tracing = atheris.instrument_imports(include=["mavdem", "pyulog"])
with tracing:
    import dataflash_logs
    import lz4.frame
    import mavlink_streams
    import ulog_files
    import whole_logs
    import zstandard
    from mcap import records
    from mcap.data_stream import RecordBuilder
    from pymavlink.dialects.v20 import all as dialect
    from pymavlink.generator.mavcrc import x25crc

    from mavdem.condition.inventory import inventory
    from mavdem.errors import NotLearnable, Unreadable
    from mavdem.ingest import Log, read_log

BETWEEN = b"\xff\n"  # separates the pieces of an input: it hardly occurs in JSON, names and numbers
FLIGHT = b"~"  # first byte of a piece that is replaced by a whole flight
HOVER = FLIGHT + struct.pack("<IIB", 200_000, 22_000, 250)  # its first stamp, 0.1 ms, the step, µs, and their number
MEMORY = Path("/dev/shm")


def check_columns(log: Log) -> None:
    for vehicle in log.vehicles:
        for name, columns in vehicle.messages.items():
            assert not np.isinf(columns["time"]).any(), name
            assert {len(values) for values in columns.values()} == {columns["time"].size}, name


class Format:
    """A format's inputs: pieces become a file, whose name ends in ``suffix`` and which has ``header`` in any case."""

    suffix, header, modes = "", b"", 3
    file: Callable[[int, list[bytes]], bytes]  # of a mode and pieces, but for the header
    pieces: Callable[[], list[bytes]]  # that a file of this format may have

    def seeds(self) -> dict[str, bytes]:
        """Returns the first inputs, by name: all pieces in each mode, and each by itself."""
        pieces, modes = self.pieces(), range(1, self.modes)
        made = [bytes([mode]) + BETWEEN.join(pieces) for mode in modes] + [b"\2" + piece for piece in pieces]
        made += [b"\0" + self.file(mode, pieces) for mode in modes]
        return {f"seed_{number}": content for number, content in enumerate(made)}

    def check(self, data: bytes) -> None:
        mode, printed = data[0] % self.modes if data else 0, io.StringIO()
        content = self.header + (data[1:] if mode == 0 else self.file(mode, data[1:].split(BETWEEN)))
        with tempfile.NamedTemporaryFile(suffix=self.suffix, dir=MEMORY if MEMORY.exists() else None) as file:
            file.write(content)
            file.flush()
            with contextlib.redirect_stdout(printed):
                try:
                    log = read_log(file.name)
                except Unreadable as error:
                    assert "\n" not in str(error), error
                    log = None
        assert not printed.getvalue(), printed.getvalue()
        if log is not None:
            check_columns(log)
            with contextlib.suppress(NotLearnable, Unreadable):
                inventory(log)


def times(piece: bytes) -> list[float]:
    first, step, count = struct.unpack_from("<IIB", piece[1:].ljust(9, b"\0"))
    return [0.001 + first / 1e4 + row * step / 1e6 for row in range(count)]


class DataFlash(Format):
    suffix = ".bin"

    def file(self, mode: int, pieces: list[bytes]) -> bytes:
        made = [b"".join(dataflash_logs.flight(times(one))) if one.startswith(FLIGHT) else one for one in pieces]
        return b"".join([dataflash_logs.formats()] * (mode == 2) + made)

    def pieces(self) -> list[bytes]:
        made = dataflash_logs
        wrong = [made.fmt("ATT", length=10), made.fmt("RATE", characters="QfffaZnNgLeE"), made.fmt("EV", kind=129)]
        rows = [made.att(20, 2), made.rate(20.01, 1), made.rcou(20, 1500), made.message("EV", 20_500_000, 10)]
        rows += [made.message("PARM", 1_000_000, "FRAME_CLASS", 1.0, 0.0), made.message("MSG", 1, "Frame: QUAD/X")]
        rows += [made.message("ARM", 21_000_000, 0, 0, 0, 1), made.message("CTUN", 20_500_000, 0.5, 1, 2)]
        return [*(made.fmt(name) for name in ("ATT", "RATE", "RCOU", "EV")), *rows, HOVER, *wrong, HOVER]


class ULog(Format):
    suffix, header, modes = ".ulg", ulog_files.HEADER, 4
    sizes = {number: struct.calcsize("<" + ulog_files.layout(name)) for name, number in ulog_files.NUMBERS.items()}

    def file(self, mode: int, pieces: list[bytes]) -> bytes:
        start = ulog_files.definitions() + ulog_files.subscriptions() if mode > 1 else b""
        return start + b"".join(self._message(piece, mode == 3) for piece in pieces)

    def _message(self, piece: bytes, fitted: bool) -> bytes:
        """The message of a piece, with a correct length; ``fitted``: a data message gets the size of its topic."""
        if piece.startswith(FLIGHT):
            return b"".join(ulog_files.flight(np.array(times(piece))))
        kind, content = piece[:1], piece[1:]
        if fitted and kind == b"D" and len(content) >= 2:
            size = 2 + self.sizes.get(content[0], len(content) - 2)
            content = content[:1] + b"\0" + content[2:size].ljust(size - 2, b"\0")
        return struct.pack("<H", len(content) & 0xFFFF) + kind + content if kind else b""

    def pieces(self) -> list[bytes]:
        made = ulog_files
        whole = [made.parameter("MAV_SYS_ID", 7), made.parameter("CA_ROTOR0_PX", 0.1, "float"), made.SYNC]
        whole += [made.subscription(name) for name in ("vehicle_attitude", "vehicle_angular_velocity")]
        whole += [made.data("vehicle_land_detected", 20, False), made.data("vehicle_control_mode", 20, True)]
        whole += [made.data("actuator_outputs", 20, 4, *[1500] * 16)]
        heads = [struct.pack("<HQQ", number, 20_000_000, 19_999_000) for number in made.NUMBERS.values()]
        stamped = [b"D" + head + b"\1\0\0\x3f" * 9 for head in heads]
        others = [b"Factuator_motors:uint64_t timestamp;int8_t[12] control;", b"O\x10\0", b"I\x0echar[3] ver_swPX4"]
        others += [b"M\0\x0achar[3] abxyz", b"Q\1\x0dint32_t GAIN1\1\0\0\0", b"L6" + bytes(8) + b"hello", b"R\1\0"]
        others += [b"C6\1\0" + bytes(8) + b"tagged", b"B" + bytes(8) + b"\1" + bytes(7) + struct.pack("<3Q", 9, 6, 0)]
        return [*(message[2:] for message in whole), HOVER, *others, *stamped]


CHANNELS = [  # topic, encoding and schema; the first byte of a piece chooses one
    *((f"mavlink/1/1/{name}", "json", 1) for name in ("ATTITUDE", "SERVO_OUTPUT_RAW", "HEARTBEAT", "PARAM_VALUE")),
    *((f"mavlink/1/1/{name}", "json", 1) for name in ("STATUSTEXT", "EXTENDED_SYS_STATE", "OTHER")),
    *((f"/mavlink/2/1/{name}", "json5", 1) for name in ("ATTITUDE_QUATERNION", "HIL_ACTUATOR_CONTROLS")),
    *(("mavlink/out", "json", 1), ("mavlink/raw", "mavlink", 0), ("serial", "", 0), ("camera", "cdr", 1)),
]
NOW = 1_700_000_000_000_000_000


def written(record: records.McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


class Mcap(Format):
    suffix, header = ".mcap", b"\x89MCAP0\r\n"
    modes = 6  # plain; chunks without, with lz4, with zstd, wrong sums
    any_record = b"\xfe"  # first byte of a piece that is any record, whose opcode follows

    def file(self, mode: int, pieces: list[bytes]) -> bytes:
        named = (records.Channel(number, topic, kind, {}, of) for number, (topic, kind, of) in enumerate(CHANNELS))
        parts = [b"".join(map(written, named))]
        parts += [self._records(piece, NOW + 10_000_000 * row) for row, piece in enumerate(pieces)]
        if mode > 1:
            packers = {3: ("lz4", lz4.frame.compress), 4: ("zstd", zstandard.compress)}
            (name, pack), half = packers.get(mode, ("", bytes)), len(parts) // 2 + 1
            parts = [b"".join(parts[:half]), b"".join(parts[half:])]
            sums = [(part, zlib.crc32(part) ^ (mode == 5)) for part in parts]
            parts = [written(records.Chunk(name, pack(part), 0, 0, of, len(part))) for part, of in sums]
        return b"".join(parts) + written(records.Footer(0, 0, 0)) + self.header

    def _records(self, piece: bytes, stamp: int) -> bytes:
        if piece.startswith(self.any_record):
            return struct.pack("<BQ", piece[1] if len(piece) > 1 else 0, len(piece[2:])) + piece[2:]
        bodies = [piece]
        if piece.startswith(FLIGHT):
            bodies = [b'\x09{"message":{"type":"HEARTBEAT","mavtype":2,"autopilot":3}}']
            for time in times(piece):
                head = b'\x00{"time_boot_ms":%d,"roll":%.4f,"rollspeed":%.3f,"pitch":0,"yaw":0}'
                bodies.append(head % (round(1e3 * time), sin(3 * time) / 10, cos(3 * time) * 3 / 10))
                pulses = b'"servo2_raw":1600,"servo3_raw":1500,"servo4_raw":1500'
                head = b'\x01{"time_usec":%d,"servo1_raw":%d,%s}'
                bodies.append(head % (round(1e6 * time), 1500 + 50 * sin(5 * time), pulses))
        when = {"sequence": 0, "log_time": stamp, "publish_time": stamp}
        messages = (records.Message(channel_id=one[0] % len(CHANNELS), data=one[1:], **when) for one in bodies if one)
        return b"".join(map(written, messages))

    def pieces(self) -> list[bytes]:
        raw = mavlink_streams.heartbeat() + mavlink_streams.message("ATTITUDE", time_boot_ms=20_000, roll=0.1)
        state = b'"landed_state":{"type":"MAV_LANDED_STATE_IN_AIR"}'
        return [
            b'\0{"message":{"type":"ATTITUDE","time_boot_ms":20000,"roll":0.1,"pitch":NaN,"yaw":-inf}}',
            b'\1{"message":{"type":"SERVO_OUTPUT_RAW","time_usec":20000000,"servo1_raw":1500}}',
            b'\2{"message":{"mavtype":{"type":"MAV_TYPE_QUADROTOR"},"autopilot":3,"base_mode":{"bits":209}}}',
            b'\3{"message":{"param_value":33.0,"param_id":["A","\\u0000"],"param_type":9}}',
            b'\5{"message":{%s}}' % state,
            b'\7{"time_boot_ms":5,"q1":1,"q2":0,"q3":0,"q4":0,"rollspeed":"1.5","repr_offset_q":[1,2,3,4]}',
            b'\x08{"time_usec":5,"controls":[0.5,0.5,0.5,0.5],"mode":"MAV_MODE_FLAG_SAFETY_ARMED | 1"}',
            b"\x0a" + raw,
            b"\x0b" + mavlink_streams.message("SERVO_OUTPUT_RAW", time_usec=20_000_000, servo1_raw=1500, version=1),
            b"\x0c\xff\xd8",
            self.any_record + b"\x01" + written(records.Header("profile", ""))[9:],
            HOVER,
        ]


class Tlog(Format):
    """A stream; in odd modes every frame gets a correct checksum first: else hardly any change would pass it."""

    def file(self, mode: int, pieces: list[bytes]) -> bytes:
        stream, at = bytearray(b"".join(pieces)), 8
        while at + 8 <= len(stream):
            second = stream[at] == 0xFD
            if stream[at] not in (0xFD, 0xFE) or (second and stream[at + 2] > 1):
                at += 1
                continue
            end = at + (10 if second else 6) + stream[at + 1]
            if end + 2 > len(stream):
                break
            number = int.from_bytes(stream[at + 7 : at + 10], "little") if second else stream[at + 5]
            if number in dialect.mavlink_map:
                seed = dialect.mavlink_map[number].crc_extra
                stream[end : end + 2] = x25crc([*stream[at + 1 : end], seed]).crc.to_bytes(2, "little")
            at = end + 2 + (13 if second and stream[at + 2] == 1 else 0) + 8
        return bytes(stream)

    def pieces(self) -> list[bytes]:
        samples = [path.read_bytes() for path in sorted((ROOT / "logs").glob("*.tlog"))]
        return [content[at : at + 600] for content in samples for at in range(0, len(content), len(content) // 6)]

    def seeds(self) -> dict[str, bytes]:
        return {f"seed_{number}": b"\1" + piece for number, piece in enumerate(self.pieces())}

    def check(self, data: bytes) -> None:
        content = self.file(1, [data[1:]]) if data[:1] and data[0] % 2 else data[1:]
        log = whole_logs.read(content)
        assert whole_logs.everything(log) == whole_logs.everything(whole_logs.in_small_blocks(content)), "blocks matter"
        if log is not None:
            check_columns(log)


FORMATS = {"dataflash": DataFlash(), "mcap": Mcap(), "tlog": Tlog(), "ulog": ULog()}


@click.command(help=__doc__, context_settings={"ignore_unknown_options": True})
@click.argument("kind", metavar="FORMAT", type=click.Choice(list(FORMATS)))
@click.argument("arguments", metavar="[CORPUS] [OPTIONS]", nargs=-1, type=click.UNPROCESSED)
def main(kind: str, arguments: tuple[str, ...]) -> None:
    warnings.simplefilter("ignore")
    inputs = FORMATS[kind]
    if SEEDS:
        for content in inputs.seeds().values():
            inputs.check(content)
        return
    folders = [Path(argument) for argument in arguments if not argument.startswith("-")]
    if folders and not folders[0].is_file():
        folders[0].mkdir(parents=True, exist_ok=True)
        for name, content in inputs.seeds().items():
            (folders[0] / name).write_bytes(content)
    atheris.Setup([__file__, *arguments], inputs.check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
