"""``mavdem convert``: from one file format to another."""

import click

from mavdem.cli.options import source_options
from mavdem.cli.output import print_json, progress
from mavdem.cli.sources import refuse_link
from mavdem.cli.streams import escape_unprintable, print_to_stdout
from mavdem.export.conversion import convert as convert_file
from mavdem.report.templates import render_section


@click.command("convert")
@source_options()
@click.argument("out", type=click.Path())
def convert_command(
    source: str, out: str, axis: str, vehicle: str | None, inputs: str | None, as_json: bool
) -> None:
    """Converts a log to another file format.

    The ending of OUT says the format. .tlog and .mcap receive every frame of the recorded stream with its receive time;
    an .mcap also every message as JSON. .csv and .parquet receive the longest settled flight of one vehicle as a table
    (--axis, --vehicle, --inputs), with the wind in m/s where it is known (north and east that the air moves to, and
    half widths of 90 %); tables are not read again. If no model can be learned from the log, the table has what there
    is of attitude and inputs, with a caution. Times in .csv are rounded to microseconds, other numbers to float32;
    .parquet keeps float64.

    \b
    Examples:
      mavdem convert flight.tlog flight.mcap
      mavdem convert flight.mcap roll.csv --axis roll
    """
    refuse_link(source)
    try:
        with progress(f"Converting {source}", measured=False):
            written = convert_file(source, out, axis, vehicle, inputs)
    except ValueError as error:
        # Unreadable and NotLearnable are ValueErrors too, with sentences of their own.
        if type(error) is not ValueError:
            raise
        raise click.BadParameter(f"{error}.", param_hint="OUT") from error
    if as_json:
        print_json(written)
        return
    for said in render_section("converted", **written):
        print_to_stdout(escape_unprintable(said.text))
    for key, word in {"repairs": "Noted", "cautions": "Caution"}.items():
        for sentence in written.get(key, ()):
            print_to_stdout(f"{word}: {sentence}")
