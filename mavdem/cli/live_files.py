"""Files of a live session: their paths, how they are written, and the lines on them at its end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from mavdem.cli.output_files import check_output_file
from mavdem.cli.streams import print_to_stderr
from mavdem.containers import JsonValues
from mavdem.errors import Unreadable
from mavdem.export.stream_writers import STREAM_WRITERS
from mavdem.facts import Facts
from mavdem.facts.loops import GainFact
from mavdem.facts.session import TimeUse
from mavdem.files import numbered_path, reporting_write_errors, write_text_atomically
from mavdem.live.raw_recording import RawRecording
from mavdem.report.numbers import listed


@dataclass(frozen=True)
class OutputPaths:
    """Files that a live session writes, by the options that name them; None for each that is not written."""

    rrd: Path | None
    """Recording for Rerun."""

    record: Path | None
    """Recording of the raw stream."""

    model: Path | None
    """Model at the end of the session."""

    page: Path | None
    """Page on what happened."""

    @property
    def any_exists(self) -> bool:
        """Whether one of the files exists already."""
        paths = (self.rrd, self.record, self.model, self.page)
        return any(path is not None and path.exists() for path in paths)


def output_paths(
    rrd: Path | None, record: Path | None, model: Path | None, page: Path | None
) -> OutputPaths:
    """Chooses the files that a session writes, and checks before the flight that they can be written.

    A model or page without a name is written to the folder of another named file, under that file's name.

    Args:
        rrd: Path of the option --rrd.
        record: Path of the option --record.
        model: Path of the option --model.
        page: Path of the option --html.

    Returns:
        Paths of the recording for Rerun, the raw recording, the model and the page; None for a file that is not
        written.

    Raises:
        click.BadParameter: The name of a file has the wrong ending.
        Unreadable: A file cannot be written.
    """
    check_output_file(rrd, "--rrd", (".rrd",))
    if record is not None and record.suffix.lower() in STREAM_WRITERS:
        # A recording may go into a folder of its own, such as that of the day, which does not exist yet.
        with reporting_write_errors(record):
            record.parent.mkdir(parents=True, exist_ok=True)
    check_output_file(record, "--record", tuple(STREAM_WRITERS))
    named_file = rrd or record or model
    if named_file is not None:
        page = page or named_file.with_suffix(".html")
        model = model or named_file.with_suffix(".model.json")
    check_output_file(model, "--model", (".json",))
    check_output_file(page, "--html", (".html",))
    return OutputPaths(rrd, record, model, page)


def unused_number(paths: Sequence[Path | None], first_number: int) -> int:
    """Returns a number for the file names of a further vehicle, with which no existing file is overwritten.

    With number 2, "flight.tlog" of the first vehicle becomes "flight-2.tlog". If any such file exists, the next number
    is tried.

    Args:
        paths: Paths that the user named for the files of the first vehicle; None for a file that is not named.
        first_number: First number that is tried.
    """
    number = first_number
    while numbered_paths(paths, number).any_exists:
        number += 1
    return number


def numbered_paths(paths: Sequence[Path | None], number: int) -> OutputPaths:
    """Returns the paths of the files of a further vehicle, whose names end in its number, such as "flight-2.tlog".

    Args:
        paths: Paths that the user named for the first vehicle: the recording for Rerun, the raw recording, the model
            and the page; None for a file that is not named.
        number: Number of the vehicle, from 2 on.

    Returns:
        The paths, also of a model and a page that are not named: they go into the folder of a named file.
    """
    rrd, record, model, page = _with_number(paths, number)
    return output_paths(rrd, record, model, page)


def _with_number(paths: Sequence[Path | None], number: int) -> list[Path | None]:
    """Returns the paths of files for the flight of a further vehicle, such as "flight-2.tlog" for "flight.tlog".

    Args:
        paths: Paths that the user named for the files of the first vehicle; None for a file that is not named.
        number: Number of the vehicle, from 2 on.
    """
    paths_with_number: list[Path | None] = []
    for path in paths:
        if path is None:
            paths_with_number.append(None)
        else:
            paths_with_number.append(numbered_path(path, number))
    return paths_with_number


def written_file_lines(
    paths: OutputPaths,
    frame_count: int,
    *,
    is_for_browser: bool = False,
    is_flight_forbidden: bool = False,
) -> list[str]:
    """Returns a line for each file that a session has written, such as "Dashboard: a.rrd. Open it: `rerun a.rrd`".

    Args:
        paths: Paths of the written files; None for a file that was not written.
        frame_count: Messages in the recording of the raw stream.
        is_for_browser: Whether the lines are for the session's page in a browser. Terminals make a link of the URI of
            a file; browsers open no file from a page of a server, which may be on another computer.
        is_flight_forbidden: whether the verdict on some flight of the session forbids to fly before a repair. The model
            of a faulty vehicle is then not offered for the next flight.
    """
    lines = []
    if paths.record is not None:
        count = f"{frame_count:,} messages"
        lines.append(
            f"Recording: {paths.record}, {count}. Judge it: `mavdem {_shell_word(paths.record)}`"
        )
    if paths.rrd is not None:
        lines.append(f"Dashboard: {paths.rrd}. Open it: `rerun {_shell_word(paths.rrd)}`")
    if paths.page is not None and is_for_browser:
        lines.append(f"Page: {paths.page}. It has what this page shows, and the model.")
    elif paths.page is not None:
        lines.append(f"Page: {paths.page}. Open it: {paths.page.absolute().as_uri()}")
    if paths.model is not None and is_flight_forbidden:
        lines.append(f"Model: {paths.model}")
    elif paths.model is not None:
        lines.append(
            f"Model: {paths.model}. For the next flight: `--prior {_shell_word(paths.model)}`"
        )
    return lines


def gain_file_line(advice: Facts, *, is_flight_forbidden: bool = False) -> str:
    """Returns the line on the files with the controller gains that a session advises; empty without files.

    Args:
        advice: the facts (coded findings) of the latest advice.
        is_flight_forbidden: whether the verdict on some flight of the session forbids to fly before a repair.
    """
    axes = _axes_with_new_gains(advice)
    for fact in advice:
        if fact.code is GainFact.GAINS_WRITTEN:
            which = f" for {axes}" if axes else ""
            when = "once the vehicle may fly again, on trial" if is_flight_forbidden else "on trial"
            return (
                f"Gains{which}: {fact.figures['path']}. Load one file in a ground station {when}."
            )
    return ""


def line_without_gains(
    advice: Facts | None,
    seconds_by_use: Mapping[TimeUse, float],
    *,
    is_recording_cut: bool = False,
) -> str:
    """Returns the line at the end of a session that says why there are no files with new gains, or none to load yet.

    It is empty if the advice says so itself: advice is reported when it comes, with the reason for each axis that gets
    no gains, and the end of the session does not repeat that.

    Args:
        advice: the facts (coded findings) of the latest advice, empty if no flight has given any; None where no
            recording has a whole flight.
        seconds_by_use: seconds of the session by what they were spent on, such as learning.
        is_recording_cut: whether the recording failed, as on a full disk.
    """
    if advice is None and is_recording_cut:
        return "No gains: the recording lacks the end of the flight."
    if advice is None:
        return "No gains: they are computed from a recording, --record FILE.tlog."
    if not advice:
        has_flown = seconds_by_use[TimeUse.LEARNED] > 0 or seconds_by_use[TimeUse.UNSETTLED] > 0
        reason = "too little settled flight to compute them from" if has_flown else "nothing flew"
        return f"No gains: {reason}."
    unconfirmed_axes = _axes_with_new_gains(advice)
    has_files = any(fact.code is GainFact.GAINS_WRITTEN for fact in advice)
    if unconfirmed_axes and not has_files:
        return f"No gains for {unconfirmed_axes} yet: another flight is to confirm those that were tried."
    return ""


def _axes_with_new_gains(advice: Facts) -> str:
    """Returns the axes for which an advice has new gains, in words; empty if there are none."""
    return listed(fact.subject for fact in advice if fact.code is GainFact.GAINS_ADVISED)


def written_files(paths: OutputPaths, recording: RawRecording | None) -> JsonValues:
    """Returns the files that a session has written, as its JSON document lists them.

    Args:
        paths: Paths of the written files; None for a file that was not written.
        recording: Raw recording of the stream, if there is one.

    Returns:
        Path by kind of the file, None for a file that was not written; for the raw recording path and frame count.
    """
    files = JsonValues(rrd=None, record=None, model=None, html=None)
    if paths.rrd is not None:
        files["rrd"] = str(paths.rrd)
    if recording is not None and paths.record is not None:
        files["record"] = {"file": str(paths.record), "frames": recording.frame_count}
    if paths.model is not None:
        files["model"] = str(paths.model)
    if paths.page is not None:
        files["html"] = str(paths.page)
    return files


def write_text(path: Path | None, text: str, subject: str) -> bool:
    """Writes the model or the page, and reports on standard error if that fails.

    Args:
        path: Path of the file; None if it is not to be written.
        text: Content of the file.
        subject: Kind of the file, "model" or "page".

    Returns:
        Whether it succeeded: False if the file should have been written and could not be.
    """
    if path is None:
        return True
    try:
        write_text_atomically(path, text)
    except Unreadable as error:
        print_to_stderr(f"The {subject} is lost: {error}")
        return False
    return True


def _shell_word(path: Path) -> str:
    """Returns a path as one word of a command line, in quotation marks if a shell would split it."""
    return quote(str(path))
