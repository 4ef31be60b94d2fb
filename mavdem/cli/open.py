"""``mavdem open`` and ``rerun-loader-mavdem``: a log as a dashboard, by a command or dropped into the Rerun Viewer."""

from argparse import ArgumentParser
from pathlib import Path

import click

from mavdem.assessment.assess import assess_signals
from mavdem.cli.exit_codes import EXIT_ERROR
from mavdem.cli.learn import learn_command
from mavdem.cli.options import source_options
from mavdem.cli.result_folders import default_result_folder
from mavdem.cli.streams import print_to_stderr
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable, Unreadable
from mavdem.extras import missing_extra_fact, require_extra
from mavdem.ingest import Log, read_log
from mavdem.ingest.formats import looks_like_log
from mavdem.report.blocks import Sentence
from mavdem.report.screen import analysis_blocks
from mavdem.results import RECORDING_FILE, write_dashboard

INCOMPATIBLE = 66
"""Exit code of a loader for a file that is for others (rerun.io/docs/reference/data-loaders)."""


@click.command("open")
@source_options(TILT_AXES)
@click.pass_context
def open_command(
    context: click.Context,
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
) -> None:
    """Learns from a log, and shows the dashboard at once.

    The folder is that of `mavdem learn`, named after the log. A log dropped into the Rerun Viewer,
    or given to `rerun`, opens in the same way.
    """
    require_extra("view", "`mavdem open`")
    chosen = {"--axis": axis, "--vehicle": vehicle, "--inputs": inputs}
    words = [word for name, value in chosen.items() if value is not None for word in (name, value)]
    with learn_command.make_context(
        "learn", [*words, *["--json"] * as_json, "--", source], context
    ) as learning:
        learn_command.invoke(learning)
    from mavdem.view import show

    if why := show(default_result_folder(source) / RECORDING_FILE):
        print_to_stderr(why)


def load(arguments: list[str]) -> int:
    """Writes the dashboard of the log that is named first to standard output, as the Rerun Viewer asks its loaders to.

    Until it is there, the viewer shows in its place what is being done. Returns the exit code: ``INCOMPATIBLE`` for a
    file that is no log of a vehicle.
    """
    path = Path(arguments[0]) if arguments else Path()
    if not path.is_file() or not looks_like_log(path):
        return INCOMPATIBLE
    if hint := missing_extra_fact("view", "The dashboard"):
        print_to_stderr(hint)
        return EXIT_ERROR
    read: Log | Unreadable
    try:
        read = read_log(path)
    except Unreadable as error:
        if path.suffix.lower() == ".mcap":
            return INCOMPATIBLE  # of something else, which Rerun itself reads
        read = error
    from mavdem.view import streamed, write_words

    parser = ArgumentParser(add_help=False)
    parser.add_argument("--application-id")
    application = parser.parse_known_args(arguments)[0].application_id
    with streamed(path.name, application or "mavdem") as recording:
        if application:  # the viewer waits
            write_words(recording, path.name, [Sentence("Learning from the log …")])
        try:
            if isinstance(read, Unreadable):
                raise read
            signals = Signals(choose_vehicle(read.vehicles))
            assessment = assess_signals(read, signals, "roll")
        except (NotLearnable, Unreadable) as error:
            write_words(recording, path.name, [Sentence(f"{error.reason} {error.remedy}")])
        else:
            if assessment.model is None:
                write_words(recording, path.name, analysis_blocks(assessment))
            else:
                write_dashboard(recording, assessment)
    return 0
