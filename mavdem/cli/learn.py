"""``mavdem learn``: a linear model of the vehicle, learned from a log, and what the model is good for."""

from pathlib import Path
from time import perf_counter

import click

from mavdem.assessment.assess import assess_signals
from mavdem.assessment.axis import Options
from mavdem.assessment.axis.figures import ALL_AXES
from mavdem.assessment.record import Assessment
from mavdem.cli.exit_codes import EXIT_UNSUPPORTED
from mavdem.cli.options import (
    file_option,
    mcap_option,
    model_options,
    rrd_option,
    source_options,
    start_option,
    verbose_option,
    window_options,
)
from mavdem.cli.output import print_json, print_screen, progress, report_error
from mavdem.cli.output_files import check_output_folder
from mavdem.cli.result_folders import (
    chosen_recordings,
    default_result_folder,
    write_results,
)
from mavdem.cli.sources import note_flights_used_together, read_source
from mavdem.cli.streams import print_page_path
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.dem import Settings
from mavdem.documents.flight import report_document
from mavdem.experiments.truth import read_truth
from mavdem.experiments.window import Length
from mavdem.report.blocks import Blocks
from mavdem.report.review import review_title
from mavdem.report.screen import (
    analysis_body,
    detail_blocks,
    flight_title,
    judgement_sentences,
    next_step_of_learning,
)
from mavdem.results import PAGE_FILE, RESULT_FILES

PAGE_LINES = 1
"""Lines of the screen that are left for the path of the page, which is printed when the page is written."""


@click.command("learn")
@source_options(
    (*AXES, ALL_AXES),
    "Axis to model; all: a model of roll, and the physical parameters of roll, pitch and yaw.",
)
@file_option("--out", "Folder for the results. [default: named after the log]")
@rrd_option
@mcap_option
@model_options
@window_options(
    "the whole settled flight",
    "A held-out window; with --train the one after it: seconds (1.5s) or samples (150).",
)
@start_option
@file_option(
    "--truth", "Truth of a simulated flight, flight.truth.npz: it is put beside the estimates."
)
@click.option("--no-files", is_flag=True, help="Only print the screen; write no files.")
@verbose_option
def learn_command(
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    out: Path | None,
    rrd: bool,
    mcap: bool,
    settings: Settings,
    train: Length | None,
    test: Length | None,
    start: float,
    truth: Path | None,
    no_files: bool,
    verbose: bool,
) -> None:
    """Learns a linear model, and reports what it is good for.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. The model is trained on its whole
    settled flight. It is judged by windows of --test: five further models, each trained on four fifths of the flight,
    forecast every window of the fifth that they have not seen.

    The screen says what the model is good for and why, and last the headline, the next step and where the page is. With
    --verbose it has all figures, the model A, B and C, and how it was learned.

    Below 40 Hz there is a model of the slow motion, if it predicts better than none. Without a model the folder
    receives report.html and report.json only, or nothing where the log has no flight, and the exit code is 1.

    \b
    The folder --out receives:
      report.html  all of it with pictures, in one file to mail
      report.json  the figures; model.json the model
      flight.rrd   with --rrd: the plots for `rerun`, which `mavdem open` shows at once
      flight.mcap  with --mcap: the series for Foxglove or PlotJuggler

    The paper's protocol instead, one model tested once: --train trains on so much from --start on, and forecasts the
    --test after it.

    \b
    Examples:
      mavdem learn flight.tlog
      mavdem learn flight.tlog --axis pitch --start 20 --out pitch
      mavdem learn flight.tlog --axis all --verbose
      mavdem learn flight.tlog --train 7s --preset paper --order 2
      mavdem learn simulated.tlog --truth simulated.truth.npz
    """
    recordings = chosen_recordings(rrd=rrd, mcap=mcap)
    folder = out or default_result_folder(source)
    if not no_files:
        check_output_folder(folder, RESULT_FILES, source)
    if truth is not None:
        # A file that has no truth is refused here, before the work; that it is of this flight shows afterwards.
        read_truth(truth, AXES[0] if axis == ALL_AXES else axis)
    start_time = perf_counter()
    log = read_source(source)
    signals = Signals(choose_vehicle(log.vehicles, vehicle))
    note_flights_used_together(signals)
    options = Options(
        inputs=inputs, settings=settings, start=start, train=train, test=test, truth=truth
    )
    assessment = assess_signals(log, signals, axis, options, progress=progress)
    analysis = assessment.analysis
    assert analysis is not None
    has_model = analysis.learned is not None
    if not has_model and analysis.tier.tier is None:
        # There is no flight that files or a screen could show.
        raise assessment.refusal
    seconds = perf_counter() - start_time
    # The screen comes first: drawing the page takes time.
    if not as_json:
        _print_assessment(assessment, verbose=verbose)
    document = report_document(assessment) | {"source": source, "seconds": round(seconds, 3)}
    if not has_model:
        refusal = assessment.refusal
        document["error"] = {"reason": refusal.reason, "remedy": refusal.remedy}
    if not no_files:
        write_results(folder, document, assessment, recordings)
    if as_json:
        print_json(document)
        if not has_model:
            report_error(assessment.refusal.fact, as_json=False)
    elif not no_files:
        print_page_path(folder / PAGE_FILE, seconds)
    if not has_model:
        raise click.exceptions.Exit(EXIT_UNSUPPORTED)


def _print_assessment(assessment: Assessment, *, verbose: bool) -> None:
    """Prints the report of a flight on one screen: with a model its grades, otherwise why there is none.

    Args:
        assessment: Assessment of the log, with the analysis of at least one axis.
        verbose: Whether to print all figures, and how the model was learned.
    """
    analysis = assessment.analysis
    assert analysis is not None
    if analysis.learned is None:
        title = review_title(assessment)
        details = Blocks()
    else:
        title = flight_title(analysis.flights, assessment.simulated)
        details = detail_blocks(analysis.learned)
    sentences = judgement_sentences(assessment.judgement)
    print_screen(
        [title],
        analysis_body(analysis, assessment),
        details,
        [sentences.headline, next_step_of_learning(assessment)],
        verbose=verbose,
        reserved_lines=PAGE_LINES,
    )
