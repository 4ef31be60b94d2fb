"""Conversion of a log to another stream format, or of its flight to a table or a path, by the file's ending."""

from pathlib import Path

import numpy as np

from mavdem.containers import JsonValues
from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.segments import longest_recorded_segment
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable
from mavdem.export.geographic_paths import geographic_paths, write_geojson, write_kml
from mavdem.export.stream_writers import STREAM_WRITERS
from mavdem.export.tables import TIME_COLUMN, columns, wind_columns, write_csv, write_parquet
from mavdem.extras import require_extra_of_file
from mavdem.files import PathName, atomic_write, reporting_write_errors, writable_target
from mavdem.flight import boot_number
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.ingest.mavlink.frame_stream import MAX_NANOSECOND_STAMP
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES

TABLE_WRITERS = {".csv": write_csv, ".parquet": write_parquet}
"""Writers of tables, by the ending of the file."""

PATH_WRITERS = {".kml": write_kml, ".geojson": write_geojson}
"""Writers of the flown path on a map, by the ending of the file."""


def convert(
    source: PathName,
    out: PathName,
    axis: str,
    vehicle: str | None = None,
    inputs: str | None = None,
) -> JsonValues:
    """Converts a log to the format of the ending of ``out``, and reports what was written.

    A .tlog or .mcap receives every frame with its receive stamp, also frames that cannot be decoded, but no bytes
    between frames. Messages that an MCAP recording has as JSON only become MAVLink 2 frames.

    A .csv or .parquet receives the longest usable segment of one vehicle. Where no model can be learned it is the
    longest segment that attitude and inputs have in common. If their rates are far apart, or only one of them is there,
    each has its own stamps, and NaN elsewhere.

    A .kml or .geojson receives where one vehicle was, on a map.

    Args:
        source: the log.
        out: the file to write. It appears whole or not at all.
        axis, vehicle, inputs: of a table, as for :func:`mavdem.read_flight`.

    Returns:
        Plain JSON values. For a stream: the frames written, messages left out, frames that could not be decoded, stamps
        that had to be taken from the frame before, bytes skipped, and repairs. For a table: its samples, columns and
        step (None at a stream's own stamps), how attitude and motors were resampled, whether a model can be learned
        from it, and cautions.

    Raises:
        Unreadable: ``source`` cannot be read, or ``out`` cannot be written.
        MissingExtra: The format of ``out`` or of the source needs a package that is not installed.
        NotLearnable: there is no vehicle, or several and none was chosen, or attitude or inputs are missing.
        ValueError: ``out`` is the source, or has no known ending, or the ending of the source.
    """
    source = Path(source)
    out = Path(out)
    ending = out.suffix.lower()
    endings = [*STREAM_WRITERS, *TABLE_WRITERS, *PATH_WRITERS]
    if ending not in endings:
        # A recording for Rerun is made above this room, by ``mavdem.results``.
        listed_endings = ", ".join([*endings, ".rrd"])
        raise ValueError(f"{out} must end in {listed_endings}: the ending chooses the format")
    require_extra_of_file(out)
    with reporting_write_errors(out):
        # A target that cannot be written is refused before the work, which may take long.
        writable_target(out)
        if out.exists() and source.exists() and out.samefile(source):
            raise ValueError(f"{out} is the input: name another file")
        if ending in TABLE_WRITERS:
            report = convert_to_table(source, out, axis, vehicle, inputs)
        elif ending in PATH_WRITERS:
            report = convert_to_path(source, out, vehicle)
        else:
            report = convert_stream(source, out)
    return {"source": str(source), "out": str(out), **report}


def convert_stream(source: Path, out: Path) -> JsonValues:
    """Writes all MAVLink frames of a log in the other stream format, and reports what was written.

    Args:
        source: the log, .tlog or .mcap.
        out: the file to write, of the other of these formats.

    Returns:
        Plain JSON values, as of :func:`convert`.

    Raises:
        ValueError: the source has the format of ``out`` already.
    """
    ending = out.suffix.lower()
    stream = read_stream(source)
    if stream.file_ending == ending:
        raise ValueError(f"{source} is a {ending} already: choose another format")
    with atomic_write(out) as file:
        frames_written = STREAM_WRITERS[ending](file, stream)
    stamps = stream.stamps
    # The writer fills missing stamps.
    is_filled = stamps == 0
    if ending == ".mcap":
        # It also replaces stamps that are too large for MCAP, which has nanoseconds in 64 bits.
        is_filled |= stamps > MAX_NANOSECOND_STAMP
    return {
        "frames": frames_written,
        "left_out": len(stream.frames) - frames_written,
        "unread": int(np.count_nonzero(stream.frames.checksum != CHECKSUM_MATCHES)),
        "stamps_filled": int(np.count_nonzero(is_filled)),
        "bytes_skipped": stream.bytes_skipped,
        "repairs": [str(repair) for repair in stream.repairs],
    }


def convert_to_path(source: Path, out: Path, vehicle: str | None) -> JsonValues:
    """Writes the flown path of one vehicle for maps, as KML or GeoJSON, and reports how many positions were written.

    Args:
        source: the log.
        out: the file to write.
        vehicle: as for :func:`convert`.

    Returns:
        Plain JSON values: the number of positions as ``samples``, and ``start`` and ``end``, s.

    Raises:
        Unreadable: the log has no geographic position of the vehicle.
    """
    paths = geographic_paths(choose_vehicle(read_log(source).vehicles, vehicle))
    with atomic_write(out) as file:
        PATH_WRITERS[out.suffix.lower()](file, source.name, paths)
    start = float(paths[0].time[0])
    end = float(paths[-1].time[-1])
    return {"samples": sum(len(path.time) for path in paths), "start": start, "end": end}


def convert_to_table(
    source: Path, out: Path, axis: str, vehicle: str | None, inputs: str | None
) -> JsonValues:
    """Writes the longest segment of one vehicle's flight as a table with its wind, and reports what was written.

    It is the segment from which a model would be learned. If no model can be learned, the longest common segment of
    attitude and motors is written, with the reason as a caution.

    Args:
        source: the log.
        out: the file to write.
        axis, vehicle, inputs: as in :func:`convert`.

    Returns:
        Samples, columns, sampling and interval (s) of the table, whether a model can be learned, and cautions, by their
        keys in the document.

    Raises:
        NotLearnable: the log has no segment with attitude and inputs.
    """
    log = read_log(source)
    signals = Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs)
    learnability = learnability_of(signals, log.components)
    flight = learnability.flight
    if not flight:
        segment = longest_recorded_segment(signals)
        if segment:
            flight = aligned_flight(signals, segment)
    if flight is None:
        raise NotLearnable(learnability.reason)
    cautions = [str(caution) for caution in learnability.cautions]
    if not learnability.learnable:
        cautions.append(str(learnability.reason))
    table = columns(flight)
    table.update(wind_columns(signals, boot_number(flight), flight.time))
    with atomic_write(out) as file:
        provenance = {**flight.provenance, "cautions": cautions}
        TABLE_WRITERS[out.suffix.lower()](file, table, provenance)
    return {
        "samples": len(flight.time),
        "columns": list(table),
        "dt": flight.dt,
        "resampling": flight.provenance["resampling"],
        "start": float(table[TIME_COLUMN][0]),
        "end": float(table[TIME_COLUMN][-1]),
        "learnable": learnability.learnable,
        "cautions": cautions,
    }
