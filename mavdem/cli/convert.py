"""``mavdem convert``: from one file format to another."""

from __future__ import annotations

import os

import click

from mavdem.cli.output import print_json, printable, progress, say
from mavdem.cli.source import no_option, refuse_link, source_options
from mavdem.convert import convert as convert_file


@click.command()
@source_options
@click.argument("out", type=click.Path(), callback=no_option)
def convert(source: str, out: str, axis: str, vehicle: str | None, inputs: str | None, as_json: bool) -> None:
    """Converts a log to another file format.

    OUT says by its ending what is written: .tlog or .mcap receives every frame of the recorded stream with the time it
    was received, .csv or .parquet the longest settled stretch of one vehicle's flight (--axis, --vehicle, --inputs) as
    a table.
    An .mcap also holds every message as JSON, for viewers; converted back to .tlog it is what it was.

    \b
    Examples:
      mavdem convert flight.tlog flight.mcap
      mavdem convert flight.mcap roll.csv --axis roll
    """
    refuse_link(source)
    if not os.path.isdir(os.path.dirname(out) or "."):
        raise click.BadParameter(f"there is no folder {os.path.dirname(out)}.", param_hint="OUT")
    try:
        with progress(f"Converting {source}") as done:
            told = convert_file(source, out, axis, vehicle, inputs, done)
    except ValueError as error:
        # Unreadable and NotLearnable are ValueErrors too, with sentences of their own.
        if type(error) is not ValueError:
            raise
        raise click.BadParameter(f"{error}.", param_hint="OUT") from error
    if as_json:
        print_json(told)
        return
    what = f"{told['samples']} samples" if "samples" in told else f"{told['frames']} frames"
    say(f"Wrote {what} to {printable(out)}.")
    if told.get("left_out"):
        say(f"Left out: {told['left_out']} messages that could not be made frames of.")
    if told.get("stamps_filled"):
        say(f"Without a receive time of their own that could be kept: {told['stamps_filled']} frames.")
    if told.get("bytes_skipped"):
        say(f"Left out: {told['bytes_skipped']} bytes that belong to no frame.")
    for repair in told.get("repairs", ()):
        say(f"Repaired: {repair}")
    for caution in told.get("cautions", ()):
        say(f"Caution: {caution}")
