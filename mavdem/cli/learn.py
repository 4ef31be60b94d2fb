"""``mavdem learn``: from a log to a model, what it is good for, and plots."""

from pathlib import Path
from time import perf_counter

import click

from mavdem.assessment.assess import assess_signals
from mavdem.assessment.axis import Options
from mavdem.assessment.axis.figures import ALL_AXES
from mavdem.cli.options import (
    file_option,
    model_options,
    source_options,
    start_option,
    verbose_option,
    window_options,
)
from mavdem.cli.output import print_json, print_screen, progress, report_error
from mavdem.cli.output_files import check_output_folder
from mavdem.cli.result_folders import default_result_folder, write_results
from mavdem.cli.sources import read_source
from mavdem.cli.streams import print_to_stderr
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.dem import Settings
from mavdem.documents.flight import report_of
from mavdem.experiments.window import Length
from mavdem.extras import missing_extra_fact
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.review import review_title
from mavdem.report.screen import analysis_blocks, detail_blocks, flight_title
from mavdem.results import PAGE_FILE, RECORDING_FILE, RESULT_FILES


@click.command("learn")
@source_options(
    (*TILT_AXES, ALL_AXES),
    "Axis to model; all: a model of roll, and the physical parameters of roll, pitch and yaw.",
)
@file_option("--out", "Folder for the results. [default: named after the log]")
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
      flight.rrd   the plots for `rerun`; flight.mcap the series for Foxglove or PlotJuggler

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
    folder = out or default_result_folder(source)
    if not no_files:
        check_output_folder(folder, RESULT_FILES, source)
    began = perf_counter()
    log = read_source(source)
    signals = Signals(choose_vehicle(log.vehicles, vehicle))
    options = Options(inputs, settings, start, train, test, truth)
    assessment = assess_signals(log, signals, axis, options, progress=progress)
    analysis = assessment.analysis
    assert analysis is not None
    learned = analysis.learned
    if learned is None and analysis.tier.tier is None:
        raise assessment.refusal
    took = perf_counter() - began
    report = report_of(assessment) | {"source": source, "seconds": round(took, 3)}
    if learned is None:
        heading = review_title(assessment)
        details = Blocks()
        refusal = assessment.refusal
        report["error"] = {"reason": refusal.reason, "remedy": refusal.remedy}
    else:
        heading = flight_title(analysis.flights, assessment.simulated)
        details = detail_blocks(learned)
    if not no_files:
        write_results(folder, report, assessment)
        if learned is not None and (
            hint := missing_extra_fact("view", f"{RECORDING_FILE} was not written, since it")
        ):
            print_to_stderr(hint)
    if as_json:
        print_json(report)
        if learned is None:  # else the screen has said it
            report_error(assessment.refusal.fact, as_json=False)
    else:
        above, *blocks, following = analysis_blocks(assessment)
        page = Sentence(f"{folder / PAGE_FILE} (took {took:.1f} s)", "Page:")
        conclusion = [above, following, *[page] * (not no_files)]
        print_screen(heading, blocks, details, conclusion, verbose)
    if learned is None:
        raise click.exceptions.Exit(1)  # no model
