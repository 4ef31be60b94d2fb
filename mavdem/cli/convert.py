"""``mavdem convert``: a log as another kind of log, or its flight as a table."""

from pathlib import Path

import click

from mavdem.cli.links import refuse_link
from mavdem.cli.options import source_options
from mavdem.cli.output import print_json, progress
from mavdem.cli.streams import escape_unprintable, print_to_stdout
from mavdem.export.conversion import convert as convert_file
from mavdem.ingest.formats import detect_format
from mavdem.log_formats import Format
from mavdem.report.templates import render_section
from mavdem.results import convert_to_recording


@click.command("convert")
@source_options()
@click.argument("out", type=click.Path())
def convert_command(
    source: str, out: str, axis: str, vehicle: str | None, inputs: str | None, as_json: bool
) -> None:
    """Converts a log to another file format.

    The ending of OUT says the format. .tlog and .mcap receive every frame of the recorded stream with its receive
    time; an .mcap also every message as JSON. .rrd receives the plots of the flight and, if one can be learned, of
    its model for `rerun`, and an .mcap of a log without frames (.bin, .log, .ulg) their series for Foxglove and
    PlotJuggler. .csv and .parquet receive the longest settled flight of one vehicle as a table (--axis, --vehicle,
    --inputs), with the wind in m/s where it is known (north and east that the air moves to, and half widths of 90
    %); tables are not read again. If no model can be learned from the log, the table has what there is of attitude
    and inputs, with a caution. Times in .csv are rounded to microseconds, other numbers to float32; .parquet keeps
    float64. .kml and .geojson receive the flown path of one vehicle, for maps.

    \b
    Examples:
      mavdem convert flight.tlog flight.mcap
      mavdem convert flight.mcap roll.csv --axis roll
      mavdem convert flight.bin flight.rrd
      mavdem convert flight.ulg flight.kml
    """
    refuse_link(source)
    try:
        with progress(f"Converting {source}", measured=False):
            if _is_recording(source, out):
                document = convert_to_recording(Path(source), Path(out), axis, vehicle, inputs)
            else:
                document = convert_file(source, out, axis, vehicle, inputs)
    except ValueError as error:
        # Unreadable and NotLearnable are ValueErrors too, and report themselves.
        if type(error) is not ValueError:
            raise
        raise click.BadParameter(f"{error}.", param_hint="OUT") from error
    if as_json:
        print_json(document)
        return
    for sentence in render_section("converted", **document):
        print_to_stdout(escape_unprintable(sentence.text))
    for repair in document.get("repairs", ()):
        print_to_stdout(f"Noted: {repair}")
    for caution in document.get("cautions", ()):
        print_to_stdout(f"Caution: {caution}")


def _is_recording(source: str, out: str) -> bool:
    """Returns whether a conversion makes a recording of the flight and its model, instead of another kind of log.

    Args:
        source: Path of the log.
        out: Path of the file to write, whose ending decides.
    """
    ending = Path(out).suffix.lower()
    if ending == ".rrd":
        return True
    if ending != ".mcap":
        return False
    # An .mcap may contain both. It receives the MAVLink frames of the log, if there are any.
    _, source_format = detect_format(source)
    has_mavlink_frames = source_format in (Format.TLOG, Format.MCAP)
    return not has_mavlink_frames
