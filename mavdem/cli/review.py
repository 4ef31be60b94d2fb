"""``mavdem review``, and ``mavdem LOG``: everything that a log shows, on one screen and in one folder."""

import os
import sys
from collections.abc import Collection
from pathlib import Path
from time import perf_counter

import click

from mavdem.assessment import Assessment
from mavdem.assessment.assess import FirstFindings, assess
from mavdem.cli.options import (
    file_option,
    json_option,
    mcap_option,
    params_option,
    rrd_option,
    sources_argument,
    vehicle_option,
)
from mavdem.cli.output import print_blocks, print_json, progress
from mavdem.cli.output_files import check_output_folder
from mavdem.cli.result_folders import (
    chosen_recordings,
    default_result_folder,
    write_results,
)
from mavdem.cli.sources import read_sources
from mavdem.cli.streams import (
    escape_unprintable,
    print_page_path,
    print_to_stdout,
    text_columns,
)
from mavdem.processes import keep_freed_memory
from mavdem.report.review import (
    LABEL_COLUMNS,
    LEVEL_COLUMNS,
    first_lines,
    further_lines,
    gain_lines,
    headline_lines,
    page_lines,
    review_screen,
)
from mavdem.report.screen import analysis_blocks, instance_blocks
from mavdem.results import PAGE_FILE, RESULT_FILES

LEVEL_COLOURS = {"good": "green", "watch": "yellow", "BAD": "bright_red"}
"""Colour of the word for each level on a terminal; a level that is unknown has none."""


class ReviewScreen:
    """The screen of a review. A terminal gets it in two parts, since the second waits for the control loops."""

    def __init__(self, *, is_in_parts: bool) -> None:
        """Takes whether the screen may be printed in two parts; for a program that reads it, it is printed at once."""
        self._is_in_parts = is_in_parts
        self._first_findings: FirstFindings | None = None

    def show_first_lines(self, findings: FirstFindings) -> None:
        """Prints the first part, if the log holds what models and loops need, so that the second will take a while."""
        if self._is_in_parts and findings.analysis.learnability.learnable:
            self._first_findings = findings
            print_review_lines(first_lines(findings, text_columns()))

    def show(self, assessment: Assessment) -> None:
        """Prints the screen: all of it, or the second part if ``show_first_lines`` has printed the first.

        Args:
            assessment: The complete assessment of the log.
        """
        columns = text_columns()
        if self._first_findings is None:
            text = review_screen(assessment, columns)
        else:
            text = further_lines(assessment, self._first_findings, columns)
        print_review_lines(text, headline_lines(assessment, columns))


def print_review_lines(text: str, emphasised_lines: Collection[str] = ()) -> None:
    """Prints lines of a review: on a terminal with the levels of lights and events in colour, and the headline bold.

    Names of files in the text are made harmless first. Files and pipes get the same text without colours, which
    ``click.echo`` leaves out there.

    Args:
        text: lines of the review.
        emphasised_lines: lines that are the headline.
    """
    # A user who sets this variable wants no colours (https://no-color.org).
    is_styled = not os.environ.get("NO_COLOR")
    for line in text.splitlines():
        printable_line = escape_unprintable(line)
        if is_styled and line in emphasised_lines:
            printable_line = click.style(printable_line, bold=True)
        elif is_styled:
            printable_line = with_coloured_level(printable_line)
        print_to_stdout(printable_line)


def with_coloured_level(line: str) -> str:
    """Returns a line of a review with its level in the level's colour; any line without a level unchanged.

    Args:
        line: columns of constant width with a label and a level, then a sentence, such as
            "Power      good   The battery held 15.2 V.".
    """
    level_end = LABEL_COLUMNS + LEVEL_COLUMNS
    label = line[:LABEL_COLUMNS]
    level = line[LABEL_COLUMNS:level_end]
    sentence = line[level_end:]
    colour = LEVEL_COLOURS.get(level.strip())
    # A line of a wrapped text may have the word "good" in these columns too, but hardly a space just before them.
    if colour is None or not label.endswith(" "):
        return line
    return label + click.style(level, fg=colour) + sentence


@click.command("review")
@sources_argument
@vehicle_option
@params_option
@file_option("--out", "Folder for the results. [default: named after the log]")
@rrd_option
@mcap_option
@json_option
@click.option("--verbose", is_flag=True, help="Also print what `mavdem learn` does.")
def review_command(
    sources: tuple[str, ...],
    vehicle: str | None,
    params: Path | None,
    out: Path | None,
    rrd: bool,
    mcap: bool,
    as_json: bool,
    verbose: bool,
) -> None:
    """Reports all that a log says: what happened, lights, next step.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz, at any rate. `mavdem LOG` is the
    same. Two logs are joined if the autopilot restarted in flight and began the second. The first sentence is how a
    flight was lost, or else the worst that was found. Each light is good, watch, BAD or unknown: motors, vibration,
    tracking, margins of the control loops, power, estimator, wind, log.

    The folder --out receives report.html, all of it with pictures in one file to mail, and report.json; where a model
    can be learned also model.json. --rrd and --mcap add flight.rrd for `rerun` and flight.mcap for Foxglove and
    PlotJuggler.

    Exit code: 0 for every log that could be read.

    \b
    Examples:
      mavdem review flight.tlog
      mavdem flight.bin --params vehicle.param --out results
      mavdem flight.ulg --rrd --mcap
      mavdem 00000042.BIN 00000043.BIN
    """
    recordings = chosen_recordings(rrd=rrd, mcap=mcap)
    folder = out or default_result_folder(sources[0])
    check_output_folder(folder, RESULT_FILES, *sources, params)
    start_time = perf_counter()
    keep_freed_memory()
    log = read_sources(sources, params)
    screen = ReviewScreen(is_in_parts=sys.stdout.isatty() and not (as_json or verbose))
    assessment = assess(log, vehicle, progress=progress, show_findings=screen.show_first_lines)
    # The screen comes first: drawing the page takes as long again.
    if not as_json:
        if verbose:
            print_blocks([*analysis_blocks(assessment), *instance_blocks(assessment)])
        screen.show(assessment)
    assessment.compute_for_page()
    if not as_json:
        columns = text_columns()
        further_texts = [*gain_lines(assessment, columns), *page_lines(assessment, columns)]
        print_review_lines("\n".join(further_texts))
    # Imported here, so that the screen does not wait for the models of the documents.
    from mavdem.documents.review import review_document

    document = review_document(assessment)
    write_results(folder, document, assessment, recordings)
    if as_json:
        print_json(document)
        return
    print_page_path(folder / PAGE_FILE, perf_counter() - start_time)
