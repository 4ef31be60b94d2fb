"""From one file to another: recorded streams between telemetry log and MCAP, flights to tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from mavdem.errors import Unreadable
from mavdem.ingest import read_log
from mavdem.ingest.framing import GOOD, Progress
from mavdem.ingest.mcap_writer import LATEST, write_mcap
from mavdem.ingest.stream import Stream
from mavdem.ingest.streams import read_stream
from mavdem.ingest.tlog_writer import write_tlog
from mavdem.read import learnable_flight
from mavdem.table import columns, write_csv, write_parquet
from mavdem.whole_file import whole_file

STREAMS = {".tlog": write_tlog, ".mcap": write_mcap}
TABLES = {".csv": write_csv, ".parquet": write_parquet}
"""What writes a file, by the end of its name."""


def convert(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Writes what ``source`` holds in the form that the name of ``out`` asks for, and tells what was written.

    A .tlog or .mcap receives every frame with its receive stamp, those that cannot be read included, but no bytes
    between frames; messages that an MCAP recording has as JSON only become MAVLink 2 frames. A .csv or .parquet
    receives the longest usable segment of one vehicle.

    Args:
        source: a log; for a .tlog or .mcap one that holds a MAVLink stream.
        out: the file to write, which is replaced; it appears whole or not at all.
        axis, vehicle, inputs: of a table, as for :func:`mavdem.read_flight`.
        progress: called with the fraction of the reading that is done.

    Returns:
        Plain JSON values: of a stream the frames written, messages left out, frames unread, stamps that had to be taken
        from the frame before, bytes skipped, and repairs; of a table its samples, columns, step and cautions.

    Raises:
        Unreadable: ``source`` cannot be read, or ``out`` not written.
        NotLearnable: there is no segment that would make a table.
        ValueError: ``out`` is the source, or its name says no form or that of the source.
    """
    source, out = Path(source), Path(out)
    kind = out.suffix.lower()
    if kind not in {*STREAMS, *TABLES}:
        raise ValueError(f"{out} must end in {', '.join([*STREAMS, *TABLES])}: the name says what is written")
    if out.exists() and source.exists() and out.samefile(source):
        raise ValueError(f"{out} is the input: name another file")
    if kind in TABLES:
        told = _convert_to_table(source, out, kind, axis, vehicle, inputs, progress)
    else:
        told = _convert_stream(source, out, kind, progress)
    return {"source": str(source), "out": str(out), **told}


def _convert_stream(source: Path, out: Path, kind: str, progress: Progress | None) -> dict[str, Any]:
    stream = read_stream(source, progress)
    if stream.form == kind:
        raise ValueError(f"{source} is a {kind} already: ask for another form")
    try:
        with whole_file(out) as file:
            written = STREAMS[kind](file, stream)
    except OSError as error:
        raise _unwritable(out, error) from None
    return {
        "frames": written,
        "left_out": len(stream.frames) - written,
        "unread": int(np.count_nonzero(stream.frames.verdict != GOOD)),
        "stamps_filled": _filled(stream, kind),
        "bytes_skipped": stream.bytes_skipped,
        "repairs": list(stream.repairs),
    }


def _filled(stream: Stream, kind: str) -> int:
    """Frames whose stamp is taken from the frame before: without one, or with one that the form cannot hold."""
    beyond = stream.stamps > LATEST if kind == ".mcap" else np.zeros(len(stream.stamps), dtype=np.bool_)
    return int(np.count_nonzero((stream.stamps == 0) | beyond))


def _convert_to_table(
    source: Path,
    out: Path,
    kind: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    progress: Progress | None,
) -> dict[str, Any]:
    flight, verdict = learnable_flight(read_log(source, progress), axis, vehicle, inputs)
    try:
        with whole_file(out) as file:
            TABLES[kind](file, flight)
    except ImportError:
        raise Unreadable(
            f"{out} cannot be written without pyarrow: pip install 'mavdem[parquet]', or use .csv."
        ) from None
    except OSError as error:
        raise _unwritable(out, error) from None
    return {
        "samples": len(flight),
        "columns": list(columns(flight)),
        "dt": flight.dt,
        "start": float(flight.time[0]),
        "end": float(flight.time[-1]),
        "cautions": list(verdict.cautions),
    }


def _unwritable(out: Path, error: OSError) -> Unreadable:
    return Unreadable(f"{out} cannot be written ({error.strerror or error}): name another file.")
