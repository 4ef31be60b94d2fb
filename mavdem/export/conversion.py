"""Conversion of recorded streams between telemetry log and MCAP, and of flights to tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from mavdem.alignment.align import LOW_PASS_RATIO, align, longest_recorded
from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import verdict_of
from mavdem.errors import NotLearnable, Unreadable, require
from mavdem.export.tables import TIME, columns, own_columns, write_csv, write_parquet
from mavdem.files import atomic_write
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.ingest.mavlink.framing import GOOD, Progress, no_progress
from mavdem.ingest.mcap.writer import MAX_STAMP, write_mcap
from mavdem.ingest.tlog import write_tlog

STREAMS = {".tlog": write_tlog, ".mcap": write_mcap}
TABLES = {".csv": write_csv, ".parquet": write_parquet}  # what writes a file, by the end of its name


def convert(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Converts ``source`` to the format of ``out``'s ending, and reports what was written.

    A .tlog or .mcap receives every frame with its receive stamp, those that cannot be read included, but no bytes
    between frames; messages that an MCAP recording has as JSON only become MAVLink 2 frames. A .csv or .parquet
    receives the longest usable segment of one vehicle, or where no model can be learnt the longest that attitude and
    inputs have in common; if they come at rates far apart, or only one is there, each at its own stamps, NaN elsewhere.

    ``out`` appears whole or not at all; ``axis``, ``vehicle`` and ``inputs`` of a table are as for
    :func:`mavdem.read_flight`, ``progress`` is called with the fraction of the reading that is done. The report, plain
    JSON values, holds of a stream the frames written, messages left out, frames unread, stamps that had to be taken
    from the frame before, bytes skipped, and repairs; of a table its samples, columns, step (None at a stream's own
    stamps), how attitude and motors were resampled, whether a model can be learnt from it, and cautions.

    Raises:
        Unreadable: ``source`` cannot be read, or ``out`` not written.
        MissingExtra: ``out`` is a .parquet, and pyarrow is not installed.
        NotLearnable: there is no vehicle, or several and none was chosen, or neither attitude nor inputs.
        ValueError: ``out`` is the source, or has no known ending or that of the source.
    """
    source, out = Path(source), Path(out)
    if out.suffix.lower() not in {*STREAMS, *TABLES}:
        raise ValueError(f"{out} must end in {', '.join([*STREAMS, *TABLES])}: the ending chooses the format")
    if out.exists() and source.exists() and out.samefile(source):
        raise ValueError(f"{out} is the input: name another file")
    if out.suffix.lower() == ".parquet":
        require(f"{out}", "parquet")
    try:
        if out.suffix.lower() in TABLES:
            written = _convert_to_table(source, out, axis, vehicle, inputs, progress)
        else:
            written = _convert_stream(source, out, progress)
    except OSError as error:
        raise Unreadable(f"{out} cannot be written ({error.strerror or error}): name another file.") from None
    return {"source": str(source), "out": str(out), **written}


def _convert_stream(source: Path, out: Path, progress: Progress) -> dict[str, Any]:
    kind, stream = out.suffix.lower(), read_stream(source, progress)
    if stream.form == kind:
        raise ValueError(f"{source} is a {kind} already: choose another format")
    with atomic_write(out) as file:
        written = STREAMS[kind](file, stream)
    # Stamps that the form cannot hold, like those that are missing, are taken from the frame before.
    beyond = stream.stamps > MAX_STAMP if kind == ".mcap" else np.False_
    return {
        "frames": written,
        "left_out": len(stream.frames) - written,
        "unread": int(np.count_nonzero(stream.frames.verdict != GOOD)),
        "stamps_filled": int(np.count_nonzero((stream.stamps == 0) | beyond)),
        "bytes_skipped": stream.bytes_skipped,
        "repairs": list(stream.repairs),
    }


def _convert_to_table(
    source: Path, out: Path, axis: str, vehicle: str | None, inputs: str | None, progress: Progress
) -> dict[str, Any]:
    log = read_log(source, progress)
    signals = Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs)
    verdict = verdict_of(signals, log.components)
    segment = None if verdict.flight else longest_recorded(signals)
    flight = align(signals, segment) if segment else verdict.flight
    cautions = list(verdict.cautions)
    if not verdict.learnable:
        cautions.append(f"A {axis} model cannot be learnt from this table: {verdict.reason}")
    # A common step would cost most of the faster stream, which a model needs but a table does not.
    rates = [] if flight is None else flight.provenance["rates"].values()
    if flight is not None and (verdict.learnable or max(rates) < LOW_PASS_RATIO * min(rates)):
        table, provenance = columns(flight), {**flight.provenance, "cautions": cautions}
    else:
        table, provenance = own_columns(signals), {"source": str(source), "cautions": cautions}
    if not table:
        raise NotLearnable(verdict.reason, verdict.remedy)
    with atomic_write(out) as file:
        TABLES[out.suffix.lower()](file, table, provenance)
    return {
        "samples": len(table[TIME]),
        "columns": list(table),
        "dt": provenance.get("dt"),
        "resampling": provenance.get("resampling", {}),
        "start": float(table[TIME][0]),
        "end": float(table[TIME][-1]),
        "learnable": verdict.learnable,
        "cautions": cautions,
    }
