#!/usr/bin/env python
"""Memory and time of `mavdem info` by the size of a telemetry log; prints a Markdown table.

A long log is made of one flight: its copies follow each other on a boot clock that goes on.

Usage: tools/bench/long_logs.py FLIGHT.tlog [--size MB]... [--before CHECKOUT] [--plot FILE.svg]
"""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click
import numpy as np

from mavdem.ingest.byte_rows import Bytes, rows_of
from mavdem.ingest.mavlink.checksums import frame_checksum
from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.ingest.mavlink.frame_stream import FrameStream
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_BYTES,
    CHECKSUM_MATCHES,
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    LENGTH_BYTE,
    MARKER_V1,
)
from mavdem.ingest.mavlink.vehicles import BOOT_CLOCK_UNITS
from mavdem.ingest.telemetry import MICROSECONDS
from mavdem.ingest.tlog import STAMP_BYTES, tlog_stream
from mavdem.report.blocks import Table, markdown

# The largest memory of a process is measured by the means of Linux.
assert sys.platform == "linux"

# Modules are compiled once, as where mavdem is installed, whatever this shell says.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

SIZES = (10, 100, 300, 1000)
"""Sizes of the logs, MB."""

PAUSE_SECONDS = 1
"""Time between the end of a flight and the beginning of its next copy, s."""


PEAK_INTERVAL = 0.02
"""Time between two looks at the largest memory that a process has had so far, s."""


class ClockFields(NamedTuple):
    """A field with a time in the frames of one message."""

    first_bytes: np.ndarray
    """Offset (n,) of the field in the log, of each frame."""
    bytes_of_field: int
    """Number of bytes of the field."""
    units_per_second: float
    """Its unit."""


class Cost(NamedTuple):
    """What a command cost."""

    megabytes: float
    """Largest resident memory, MB."""
    seconds: float
    """Time of the processor, s."""


class Flight:
    """A recorded flight, of which copies at later times are made."""

    def __init__(self, stream: FrameStream) -> None:
        """Finds the clocks in the frames whose checksum matches; all other bytes are left out.

        Args:
            stream: The recording.
        """
        frames = stream.frames[stream.frames.checksum == CHECKSUM_MATCHES]
        pieces = [
            bytes(stream.data[start - STAMP_BYTES : end])
            for start, end in zip(frames.start.tolist(), frames.end.tolist(), strict=True)
            if start >= STAMP_BYTES
        ]
        frames = frames[frames.start >= STAMP_BYTES]
        self.content = np.frombuffer(b"".join(pieces), dtype=np.uint8)
        ends = np.cumsum([len(piece) for piece in pieces])
        self._starts = ends - frames.size
        stamps = self._integers(self._starts - STAMP_BYTES, STAMP_BYTES, ">")
        self.seconds = float(stamps.max() - stamps[0]) / MICROSECONDS + PAUSE_SECONDS
        self._message_ids = frames.message_id
        self._ends = ends
        self._clocks = [
            fields
            for message_id in np.unique(frames.message_id).tolist()
            for fields in self._clock_fields(message_id)
        ]

    def copy(self, number: int) -> bytes:
        """Returns the flight as it would be recorded later: with later times in stamps and messages, and new checksums.

        Args:
            number: number of flights that come before this one in the long log.

        Returns:
            Bytes of the copy, of the same length.
        """
        content = self.content.copy()
        shift = number * self.seconds
        stamp_starts = self._starts - STAMP_BYTES
        self._add(content, stamp_starts, STAMP_BYTES, round(shift * MICROSECONDS), ">")
        for first_bytes, bytes_of_field, units_per_second in self._clocks:
            self._add(content, first_bytes, bytes_of_field, round(shift * units_per_second), "<")
        recording = bytearray(content.tobytes())
        frames = zip(
            self._starts.tolist(), self._ends.tolist(), self._message_ids.tolist(), strict=True
        )
        for start, end, message_id in frames:
            payload_end = (
                start + self._header_bytes(recording[start]) + recording[start + LENGTH_BYTE]
            )
            checksum = frame_checksum(
                bytes(recording[start + 1 : payload_end]),
                definitions_by_id()[message_id].crc_extra,
            )
            assert payload_end + CHECKSUM_BYTES <= end
            recording[payload_end : payload_end + CHECKSUM_BYTES] = checksum.to_bytes(2, "little")
        return bytes(recording)

    @staticmethod
    def _header_bytes(marker: int) -> int:
        """Returns the number of bytes before the payload of a frame with this marker."""
        return HEADER_BYTES_V1 if marker == MARKER_V1 else HEADER_BYTES_V2

    def _clock_fields(self, message_id: int) -> list[ClockFields]:
        """Finds the fields of a message that are times of the boot clock, in all its frames.

        A frame is left out where the field was not sent whole, since MAVLink 2 cuts off zeros at the end of a payload.

        Args:
            message_id: number of the message in its dialect.

        Returns:
            For each field the index of its first byte in each frame, its width and its unit.
        """
        definition = definitions_by_id()[message_id]
        assert definition.payload_type.fields is not None
        starts = self._starts[self._message_ids == message_id]
        headers = np.where(self.content[starts] == MARKER_V1, HEADER_BYTES_V1, HEADER_BYTES_V2)
        clocks = []
        for name, units_per_second in BOOT_CLOCK_UNITS.items():
            if name in definition.fields:
                field_type, offset = definition.payload_type.fields[name][:2]
                is_whole = self.content[starts + LENGTH_BYTE] >= offset + field_type.itemsize
                first_bytes = (starts + headers + offset)[is_whole]
                clocks.append(ClockFields(first_bytes, field_type.itemsize, units_per_second))
        return clocks

    def _integers(self, first_bytes: np.ndarray, width: int, byte_order: str) -> np.ndarray:
        """Reads integers of some bytes at offsets (n,) of the flight."""
        return rows_of(self.content, first_bytes, width).view(f"{byte_order}u{width}")[:, 0]

    def _add(
        self, content: Bytes, first_bytes: np.ndarray, width: int, units: int, byte_order: str
    ) -> None:
        """Adds a number to integers in a copy of the flight's bytes; they wrap as unsigned integers of their width.

        Args:
            content: the copy, which is changed in place.
            first_bytes: (n,) index of the first byte of each integer.
            width: bytes of an integer.
            units: number to add, in the unit of the integers.
            byte_order: ">" for big-endian, "<" for little-endian.
        """
        integer_type = np.dtype(f"{byte_order}u{width}")
        limit = 1 << (8 * width)
        moved = self._integers(first_bytes, width, byte_order) + np.array(
            units % limit, integer_type
        )
        moved_bytes = moved.astype(integer_type)[:, None].view(np.uint8)
        content[first_bytes[:, None] + np.arange(width)] = moved_bytes


def write_long_log(flight: Flight, path: Path, size: int) -> None:
    """Writes copies of a flight one after the other, up to a size in MB."""
    with path.open("wb") as file:
        number = 0
        while file.tell() + len(flight.content) <= max(size * 1e6, len(flight.content)):
            file.write(flight.copy(number))
            number += 1


def info_cost(path: Path, checkout: Path) -> Cost:
    """Runs `mavdem info` on a log, and measures its memory and its processor time.

    Args:
        path: the log.
        checkout: the checkout of the repository whose command is run.

    Returns:
        The largest resident memory, MB, and the processor time, s.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "mavdem", "info", str(path)],
        cwd=checkout,
        env=os.environ | {"PYTHONPATH": str(checkout)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    # The peak (VmHWM) is read again and again until the process ends, since the kernel's ``ru_maxrss`` of a child also
    # contains the memory that this process had when it started the child.
    peak_kibibytes = 0
    while os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
        for line in status.splitlines():
            if line.startswith("VmHWM"):
                peak_kibibytes = int(line.split()[1])
        time.sleep(PEAK_INTERVAL)
    usage = os.wait4(process.pid, 0)[2]
    return Cost(peak_kibibytes * 1024 / 1e6, usage.ru_utime + usage.ru_stime)


def plot_costs(
    path: Path, sizes: Sequence[float], costs_of_checkouts: dict[str, list[Cost]]
) -> None:
    """Draws memory and time by size.

    Args:
        path: The picture, SVG.
        sizes: Sizes of the logs (n,), MB.
        costs_of_checkouts: What `info` cost of each log (n,), by the name of the checkout.
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    # The ids in the file follow from this text, so that the same figures make the same file.
    mpl.rcParams["svg.hashsalt"] = "long logs"
    figure, (memory_axes, time_axes) = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
    for name, costs in costs_of_checkouts.items():
        memory_axes.loglog(sizes, [cost.megabytes for cost in costs], "o-", label=name)
        time_axes.loglog(sizes, [cost.seconds for cost in costs], "o-", label=name)
    memory_axes.loglog(sizes, sizes, ":", label="the file")
    memory_axes.set(xlabel="size of the log, MB", ylabel="resident memory, MB")
    time_axes.set(xlabel="size of the log, MB", ylabel="processor, s")
    memory_axes.legend()
    for axes in (memory_axes, time_axes):
        axes.grid(alpha=0.3)
    figure.savefig(path, metadata={"Date": None})


@click.command(help=__doc__)
@click.argument("flight", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--size", "sizes", multiple=True, type=int, default=SIZES, help="Size in MB.")
@click.option(
    "--before",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="A checkout to compare with.",
)
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="A picture, SVG.")
def main(flight: Path, sizes: tuple[int, ...], before: Path | None, plot: Path | None) -> None:
    """Makes logs of these sizes of a flight, one at a time, and prints what `mavdem info` of each costs.

    Args:
        flight: A telemetry log.
        sizes: Sizes of the logs, MB.
        before: Another checkout of the repository that is compared with this one.
        plot: Where a picture of memory and time is written.
    """
    checkouts = {"now": Path.cwd()}
    if before is not None:
        checkouts["before"] = before.resolve()
    recorded_flight = Flight(tlog_stream(flight))
    costs_of_checkouts: dict[str, list[Cost]] = {name: [] for name in checkouts}
    megabytes = []
    rows = []
    for size in sizes:
        with TemporaryDirectory() as folder:
            path = Path(folder, "long.tlog")
            write_long_log(recorded_flight, path, size)
            megabytes.append(path.stat().st_size / 1e6)
            row = [f"{megabytes[-1]:.0f}"]
            for name, checkout in checkouts.items():
                cost = info_cost(path, checkout)
                costs_of_checkouts[name].append(cost)
                row += [f"{cost.megabytes:.0f}", f"{cost.seconds:.1f}"]
            rows.append(row)
    header = ["log, MB"]
    for name in checkouts:
        header += [f"memory {name}, MB", f"processor {name}, s"]
    print(markdown([Table(header, rows)]))
    if plot is not None:
        plot_costs(plot, megabytes, costs_of_checkouts)


if __name__ == "__main__":
    main()
