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
    """The places in a log of one field of a message that has a time since boot."""

    first_bytes: np.ndarray
    """Offset in the log of the field's first byte in each of n frames (n,)."""
    width: int
    """Number of bytes of the field."""
    units_per_second: float
    """Unit of the time, such as 1000 for ms."""


class Cost(NamedTuple):
    """What a command cost."""

    megabytes: float
    """Largest resident memory, MB."""
    seconds: float
    """Time of the processor, s."""


class Flight:
    """A recorded MAVLink flight, of which copies with later times are made, to build a long log."""

    def __init__(self, stream: FrameStream) -> None:
        """Finds the clocks in the frames whose checksum matches; all other bytes are left out.

        Args:
            stream: MAVLink frames of the recording, with their receive stamps.
        """
        is_sound = stream.frames.checksum == CHECKSUM_MATCHES
        # Each frame follows its receive stamp, which the first one lacks in a log that is cut at its beginning.
        has_stamp = stream.frames.start >= STAMP_BYTES
        frames = stream.frames[is_sound & has_stamp]
        stamped_frames = []
        for start, end in zip(frames.start.tolist(), frames.end.tolist(), strict=True):
            stamped_frames.append(bytes(stream.data[start - STAMP_BYTES : end]))
        self.content = np.frombuffer(b"".join(stamped_frames), dtype=np.uint8)
        ends = np.cumsum([len(stamped_frame) for stamped_frame in stamped_frames])
        self._starts = ends - frames.size
        stamps = self._integers(self._starts - STAMP_BYTES, STAMP_BYTES, ">")
        self.seconds = float(stamps.max() - stamps[0]) / MICROSECONDS + PAUSE_SECONDS
        self._message_ids = frames.message_id
        self._ends = ends
        self._clocks = []
        for message_id in np.unique(frames.message_id).tolist():
            self._clocks += self._clock_fields(message_id)

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
        # Stamps of a telemetry log are big-endian, fields of messages little-endian.
        self._add(content, stamp_starts, STAMP_BYTES, round(shift * MICROSECONDS), ">")
        for first_bytes, width, units_per_second in self._clocks:
            self._add(content, first_bytes, width, round(shift * units_per_second), "<")
        recording = bytearray(content.tobytes())
        frames = zip(
            self._starts.tolist(), self._ends.tolist(), self._message_ids.tolist(), strict=True
        )
        for start, end, message_id in frames:
            payload_bytes = recording[start + LENGTH_BYTE]
            payload_end = start + self._header_bytes(recording[start]) + payload_bytes
            checksum_end = payload_end + CHECKSUM_BYTES
            assert checksum_end <= end, "a checksum lies outside its frame"
            # The checksum covers all of the frame before it but the marker.
            checksum = frame_checksum(
                bytes(recording[start + 1 : payload_end]),
                definitions_by_id()[message_id].crc_extra,
            )
            recording[payload_end:checksum_end] = checksum.to_bytes(CHECKSUM_BYTES, "little")
        return bytes(recording)

    @staticmethod
    def _header_bytes(marker: int) -> int:
        """Returns the number of bytes before the payload of a frame with this marker."""
        return HEADER_BYTES_V1 if marker == MARKER_V1 else HEADER_BYTES_V2

    def _clock_fields(self, message_id: int) -> list[ClockFields]:
        """Finds the fields of a message that have a time since boot, in all frames of the message.

        A frame is left out where the field was not sent whole, since MAVLink 2 cuts off zeros at the end of a payload.

        Args:
            message_id: number of the message in its dialect.

        Returns:
            The places of each such field; none for a message without one.
        """
        definition = definitions_by_id()[message_id]
        payload_fields = definition.payload_type.fields
        assert payload_fields is not None
        frame_starts = self._starts[self._message_ids == message_id]
        markers = self.content[frame_starts]
        header_bytes = np.where(markers == MARKER_V1, HEADER_BYTES_V1, HEADER_BYTES_V2)
        payload_bytes = self.content[frame_starts + LENGTH_BYTE]
        clock_fields = []
        for name, units_per_second in BOOT_CLOCK_UNITS.items():
            if name not in definition.fields:
                continue
            field_type, offset = payload_fields[name][:2]
            is_whole = payload_bytes >= offset + field_type.itemsize
            first_bytes = (frame_starts + header_bytes + offset)[is_whole]
            clock_fields.append(ClockFields(first_bytes, field_type.itemsize, units_per_second))
        return clock_fields

    def _integers(self, first_bytes: np.ndarray, width: int, byte_order: str) -> np.ndarray:
        """Reads unsigned integers of ``width`` bytes at offsets (n,) of the flight."""
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
        integers = self._integers(first_bytes, width, byte_order)
        number_of_values = 1 << (8 * width)
        sums = integers + np.array(units % number_of_values, integer_type)
        # (n, width) bytes of the sums, and the places of these bytes in the log.
        sum_bytes = sums.astype(integer_type)[:, None].view(np.uint8)
        places = first_bytes[:, None] + np.arange(width)
        content[places] = sum_bytes


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
    """Draws memory and processor time of `mavdem info` over the size of the log.

    Args:
        path: file of the picture, SVG.
        sizes: sizes of the n logs, MB.
        costs_of_checkouts: costs of the n logs, by the name of the checkout.
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
    """Repeats a flight up to each size of log, and prints memory and processor time of `mavdem info` on each log.

    Args:
        flight: a telemetry log.
        sizes: sizes of the logs, MB.
        before: another checkout of the repository that is compared with this one.
        plot: file for a picture of memory and time; None for no picture.
    """
    checkouts = {"now": Path.cwd()}
    if before is not None:
        checkouts["before"] = before.resolve()
    recorded_flight = Flight(tlog_stream(flight))
    costs_of_checkouts: dict[str, list[Cost]] = {name: [] for name in checkouts}
    written_sizes = []
    rows = []
    for size in sizes:
        # One log at a time lies on the disk.
        with TemporaryDirectory() as folder:
            path = Path(folder, "long.tlog")
            write_long_log(recorded_flight, path, size)
            megabytes = path.stat().st_size / 1e6
            written_sizes.append(megabytes)
            row = [f"{megabytes:.0f}"]
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
        plot_costs(plot, written_sizes, costs_of_checkouts)


if __name__ == "__main__":
    main()
