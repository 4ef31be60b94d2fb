"""``mavdem open`` and ``rerun-loader-mavdem``: a log as a dashboard, by a command or dropped into the Rerun Viewer."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from mavdem.alignment.drive import TILT_AXES
from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.analysis import analyse
from mavdem.cli.learn import RECORDING, learn_command, named_after, write_dashboard
from mavdem.cli.options import source_options
from mavdem.cli.output import say_aside
from mavdem.condition.wind_of_log import air_of
from mavdem.errors import NotLearnable, Unreadable
from mavdem.ingest import read_log
from mavdem.ingest.formats import looks_like_log
from mavdem.report.blocks import Sentence
from mavdem.report.screen import analysis_blocks

INCOMPATIBLE = 66
"""Exit code of a loader for a file that is for others (rerun.io/docs/reference/data-loaders)."""


@click.command("open")
@source_options(TILT_AXES)
@click.pass_context
def open_command(
    context: click.Context, source: str, axis: str, vehicle: str | None, inputs: str | None, as_json: bool
) -> None:
    """Learns from a log, and shows the dashboard at once.

    The folder is that of `mavdem learn`, named after the log. A log dropped into the Rerun Viewer,
    or given to `rerun`, opens in the same way.
    """
    chosen = {"--axis": axis, "--vehicle": vehicle, "--inputs": inputs}
    words = [word for name, value in chosen.items() if value is not None for word in (name, value)]
    with learn_command.make_context("learn", [*words, *["--json"] * as_json, "--", source], context) as learning:
        learn_command.invoke(learning)
    from mavdem.view import show

    if why := show(named_after(source) / RECORDING):
        say_aside(why)


def load(arguments: list[str]) -> int:
    """Writes the dashboard of the log that is named first to standard output, as the Rerun Viewer asks its loaders to.

    Returns the exit code: ``INCOMPATIBLE`` for a file that is no log of a vehicle.
    """
    path = Path(arguments[0]) if arguments else Path()
    if not path.is_file() or not looks_like_log(path):
        return INCOMPATIBLE
    from mavdem.view import write_words

    with TemporaryDirectory() as folder:
        recording = Path(folder, RECORDING)
        try:
            read = read_log(path)
            signals = Signals(choose_vehicle(read.vehicles, None))
            air = air_of(signals)
            analysis = analyse(read, signals=signals)
        except (NotLearnable, Unreadable) as error:
            if isinstance(error, Unreadable) and path.suffix.lower() == ".mcap":
                return INCOMPATIBLE  # of something else, which Rerun itself reads
            write_words(recording, path.name, [Sentence(f"{error.reason} {error.remedy}")])
        else:
            if analysis.learned is None or analysis.held_out is None:
                write_words(recording, path.name, analysis_blocks(analysis))
            else:
                write_dashboard(recording, analysis, air, signals.position)
        with recording.open("rb") as written:
            shutil.copyfileobj(written, sys.stdout.buffer)
    return 0
