"""``mavdem open`` and ``rerun-loader-mavdem``: the dashboard of a log, by a command or in the Rerun Viewer."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavdem.assessment.assess import assess_signals
from mavdem.cli.exit_codes import EXIT_DONE, EXIT_ERROR
from mavdem.cli.learn import learn_command
from mavdem.cli.options import source_options
from mavdem.cli.result_folders import default_result_folder
from mavdem.cli.streams import print_to_stderr
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable, Unreadable
from mavdem.extras import MissingExtra, missing_extra_fact, require_extra
from mavdem.ingest import Log, read_log
from mavdem.ingest.formats import looks_like_log
from mavdem.report.blocks import Sentence
from mavdem.results import RECORDING_FILE, write_dashboard

if TYPE_CHECKING:
    from mavdem.view import Target

EXIT_INCOMPATIBLE = 66
"""Exit code by which a data loader passes a file on to others (rerun.io/docs/reference/data-loaders)."""


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

    Of a log from which no model can be learned it shows the flight: its path in 3D, attitude,
    motors and wind. The folder is that of `mavdem learn`, named after the log. A log dropped into the Rerun Viewer,
    or given to `rerun`, opens in the same way.
    """
    require_extra("view", "`mavdem open`")
    # The command is `mavdem learn` with the same options, after which the dashboard that it has written is shown.
    args = ["--rrd"]
    for option, value in {"--axis": axis, "--vehicle": vehicle, "--inputs": inputs}.items():
        if value is not None:
            args += [option, value]
    if as_json:
        args.append("--json")
    # After "--" a log whose name begins with a hyphen is no option.
    args += ["--", source]
    exit_code = EXIT_DONE
    with learn_command.make_context("learn", args, context) as learn_context:
        try:
            learn_command.invoke(learn_context)
        except click.exceptions.Exit as no_model:
            exit_code = no_model.exit_code
    recording = default_result_folder(source) / RECORDING_FILE
    if exit_code != EXIT_DONE and not recording.is_file():
        raise click.exceptions.Exit(exit_code)
    # Rerun takes a second to import, and is not needed where there is nothing to show.
    from mavdem.view import show

    # The reason why no viewer was opened; empty if one was.
    problem = show(recording)
    if problem:
        print_to_stderr(problem)


def load(arguments: list[str]) -> int:
    """Writes the dashboard of a log to standard output: the data loader that the Rerun Viewer calls for any file.

    The viewer first shows that a model is being learned. If none can be learned, it then shows the flight alone.

    Args:
        arguments: Path of the file, and options of the viewer, of which --application-id is used
            (rerun.io/docs/reference/data-loaders).

    Returns:
        The exit code: ``EXIT_INCOMPATIBLE`` for a file that is no log of a vehicle, which the viewer then offers to
        other loaders.
    """
    if not arguments:
        return EXIT_INCOMPATIBLE
    path = Path(arguments[0])
    if not path.is_file() or not looks_like_log(path):
        return EXIT_INCOMPATIBLE
    missing_extra = missing_extra_fact("view", "The dashboard")
    if missing_extra is not None:
        print_to_stderr(missing_extra)
        return EXIT_ERROR
    log: Log | Unreadable
    try:
        log = read_log(path)
    except MissingExtra:
        # Rerun itself can read recordings whose libraries are missing here.
        return EXIT_INCOMPATIBLE
    except Unreadable as error:
        if path.suffix.lower() == ".mcap":
            # It may hold data of another program, which Rerun itself can read.
            return EXIT_INCOMPATIBLE
        log = error
    from mavdem.view import streamed, write_words

    application_id = _application_id(arguments)
    with streamed(path.name, application_id or "mavdem") as recording:
        if application_id:
            # Only a viewer gives its id; it is waiting for the recording.
            write_words(recording, path.name, [Sentence("Learning from the log …")])
        _write_log(recording, path.name, log)
    return EXIT_DONE


def _application_id(arguments: list[str]) -> str | None:
    """Returns the application id that the viewer gives a loader, or None if no viewer waits for the recording."""
    parser = ArgumentParser(add_help=False)
    parser.add_argument("--application-id")
    options, _ = parser.parse_known_args(arguments)
    application_id: str | None = options.application_id
    return application_id


def _write_log(recording: Target, name: str, log: Log | Unreadable) -> None:
    """Learns a model of roll and writes its dashboard into a recording.

    Without a model it has the flight. Of a log without a flight the recording gets sentences instead, as on the error
    of an unreadable log. The viewer shows only the recording, so every outcome must be written to it.

    Args:
        recording: Recording that is streamed to the viewer.
        name: Name of the log's file.
        log: The log, or the error why it cannot be read.
    """
    from mavdem.view import write_words

    try:
        if isinstance(log, Unreadable):
            raise log
        signals = Signals(choose_vehicle(log.vehicles))
        assessment = assess_signals(log, signals, "roll")
    except (NotLearnable, Unreadable) as error:
        write_words(recording, name, [Sentence(f"{error.reason} {error.remedy}")])
        return
    write_dashboard(recording, assessment)
