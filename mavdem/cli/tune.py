"""``mavdem tune``: stability margins of the rate and attitude loops with intervals, and gains to set."""

from pathlib import Path

import click

from mavdem.assessment import Assessment
from mavdem.assessment.axis.figures import ALL_AXES
from mavdem.assessment.axis.parameter_sets import present_parameter_files
from mavdem.assessment.axis.tuning import Tuning, tune_loops
from mavdem.assessment.evidence import Evidence
from mavdem.cli.exit_codes import EXIT_UNSUPPORTED
from mavdem.cli.options import (
    file_option,
    params_option,
    source_options,
    start_option,
    verbose_option,
)
from mavdem.cli.output import print_json, print_screen, progress
from mavdem.cli.output_files import check_output_folder, write_texts
from mavdem.cli.sources import assess_without_model
from mavdem.cli.streams import print_to_stderr
from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.documents.loops import tune_document
from mavdem.facts.margins import MarginsLight
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.gain_changes import GainChanges, gains_in_tables
from mavdem.report.pages.tune_page import changes_to_load, gains_of_tuning, tune_page
from mavdem.report.screen import flight_sentences, judgement_sentences
from mavdem.report.templates import Medium, sentences_for
from mavdem.report.tuning.decisions import measured_margins
from mavdem.report.tuning.goal import goal_reached_sentences, goal_sentences
from mavdem.report.tuning.outcomes import axes_with_kept_gains, field_sentences
from mavdem.report.tuning.overview import tune_overview
from mavdem.report.tuning.reasons import tune_blocks
from mavdem.report.tuning.result import tuning_result
from mavdem.report.tuning.summary import later_flight_sentences, tune_summary

PAGE_FILE = "tune.html"
"""Name of the page with the loops and the advised gains."""

GAIN_FILES = tuple(
    f"gains.{part}.{ending}"
    for part in ("stage1", "stage2", "lower", "notch", "before")
    for ending in ("params", "param")
)
"""Names of the files with the advised gains, by the stage of tuning, and with the present ones; for QGroundControl and
for Mission Planner."""

MARGIN_TARGETS_TEXT = "; ".join(
    f"{name}: phase {target.phase_margin:g}°, gain {target.gain_margin:g} dB, Ms {target.ms:g}"
    for name, target in MARGIN_TARGETS.items()
)
"""The choices of --margins with their phase margin, gain margin and peak of the sensitivity, for the help."""


@click.command("tune")
@source_options((*AXES, ALL_AXES), "Axis of the loops; all: roll, pitch and yaw.")
@click.option(
    "--margins",
    type=click.Choice(list(MARGIN_TARGETS)),
    default="default",
    show_default=True,
    help=f"{MARGIN_TARGETS_TEXT}.",
)
@click.option(
    "--more",
    is_flag=True,
    help="Go on where the estimate has the margins: raise gains that have room, lower those that are not sure.",
)
@params_option
@click.option("--filters", is_flag=True, help="Advise a notch filter too, and gains with it.")
@start_option
@file_option("--out", "Folder for tune.html and the parameter files.")
@verbose_option
def tune_command(
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    margins: str,
    more: bool,
    params: Path | None,
    filters: bool,
    start: float,
    out: Path | None,
    verbose: bool,
) -> None:
    """Reports margins of the rate and attitude loops, and gains.

    SOURCE is a log with the autopilot's parameters. Gains go in steps of at most a factor of 1.5 (half more, or a third
    less), with a flight after each: first P and D of the rate, with I in ratio (stage 1), then the angle's gain (stage
    2). They lead to the fastest loops that have the --margins in 90 % of the vehicle models that agree with the flight,
    with 20 % more or less thrust. Loops with enough margin keep their gains, unless --more is asked. With --filters a
    notch filter is advised on the motors' line in the gyro's spectrum, and gains have the margins with it. With
    --verbose it prints all margins, and what they rest on. Nothing is ever sent to a vehicle: --out writes the gains of
    each stage for QGroundControl (.params) and Mission Planner (.param), and the present ones beside them (.before).

    Exit code: 0 if gains of any axis are to be set, lowered or kept; otherwise, or if another flight is to confirm them
    first, 1: the report and the page then say why, and what to do.

    \b
    Examples:
      mavdem tune flight.tlog --out tune
      mavdem tune flight.tlog --axis all --margins soft
      mavdem tune flight.bin --params vehicle.param --filters
    """
    if out:
        check_output_folder(out, (PAGE_FILE, *GAIN_FILES), params)
    assessment, evidence = assess_without_model(
        source, vehicle, params, inputs, start, judges_worst_flight=True
    )
    axes = AXES if axis == ALL_AXES else (axis,)
    with progress("Choosing gains", measured=False):
        tuning = tune_loops(
            assessment,
            axes,
            margins,
            is_written=bool(out),
            raises_sound_gains=more,
            filters=filters,
        )
    file_names: Names = ()
    if out:
        # Flights of the twin, which a page with new gains has, may take longer than all before.
        title = "Simulating the new gains" if tuning.has_computed_gains else "Drawing the page"
        with progress(title, measured=False):
            file_names = _write_tuning(out, source, tuning, assessment, evidence)
    if as_json:
        flights = tuple(verdict.fact for verdict in assessment.flight_verdicts)
        print_json(tune_document(source, margins, tuning, flights))
    else:
        _print_tuning(tuning, assessment, evidence, Path(source).name, out, verbose=verbose)
    if file_names:
        # What was found comes before the files in which it is kept.
        print_to_stderr(f"Written: {', '.join(file_names)}. Nothing was sent to the vehicle.")
    if tuning.failure:
        raise click.exceptions.Exit(EXIT_UNSUPPORTED)


def _write_tuning(
    folder: Path, source: str, tuning: Tuning, assessment: Assessment, evidence: Evidence
) -> Names:
    """Writes the page and, if gains are advised, the parameter files for ground stations.

    Args:
        folder: Folder for the files.
        source: Path of the log.
        tuning: The gains to set.
        assessment: Assessment of the log, which the page is made from.
        evidence: Evidence of the log, with the parameters that the vehicle has now.

    Returns:
        Names of the files.
    """
    text_by_name = {PAGE_FILE: tune_page(Path(source).name, tuning, assessment)}
    vehicle = evidence.signals.telemetry
    # The keys are endings of names, such as ".stage1.params".
    parameter_texts = tuning.files(vehicle)
    if parameter_texts:
        names = [name for parameter_set in tuning.sets for name in parameter_set.parameters]
        oscillates = tuning.judgement.headline.code is MarginsLight.OSCILLATES
        parameter_texts |= present_parameter_files(names, vehicle, oscillates=oscillates)
    for ending, text in parameter_texts.items():
        text_by_name[f"gains{ending}"] = text
    write_texts(folder, text_by_name, GAIN_FILES)
    return tuple(text_by_name)


def _print_tuning(
    tuning: Tuning,
    assessment: Assessment,
    evidence: Evidence,
    name: str,
    folder: Path | None,
    *,
    verbose: bool,
) -> None:
    """Prints the tuning: its result and the next step in the words of its page, margins and gains, and then reasons.

    Args:
        tuning: The gains to set, and the judgement of the flight.
        assessment: Assessment of the log, with the verdicts on its flights if they are judged each by itself.
        evidence: Evidence of the log, with the parameters that the vehicle has now.
        name: Name of the log.
        folder: Folder that the page was written to, if it was.
        verbose: Whether to print all margins, and the status lights (a level for each part of the vehicle) that warn.
    """
    changes = changes_to_load(name, tuning, evidence)
    # The table of these gains stands below the sentences.
    with sentences_for(Medium(table_gains=gains_in_tables(changes))):
        light_sentences: list[Sentence] = []
        if verbose:
            light_sentences = judgement_sentences(tuning.judgement).lights
        footer = _tuning_blocks(tuning, assessment, evidence, changes, verbose=verbose)
    if folder:
        footer.append(Sentence(str(folder / PAGE_FILE), "Page:"))
    # A screen shortens its summary, but never its footer, so that all blocks are given as the footer.
    print_screen(title=[], summary=[], details=light_sentences, footer=footer, verbose=verbose)


def _tuning_blocks(
    tuning: Tuning,
    assessment: Assessment,
    evidence: Evidence,
    changes: GainChanges | None,
    *,
    verbose: bool,
) -> Blocks:
    """Returns the sentences and tables of a tuning: result and next step, margins and gains, and then reasons.

    Args:
        tuning: The gains to set, and the judgement of the flight.
        assessment: Assessment of the log, with the verdicts on its flights if they are judged each by itself.
        evidence: Evidence of the log, with the parameters that the vehicle has now.
        changes: The gains to load, as a table; None if none change.
        verbose: Whether to state all margins.
    """
    result = tuning_result(tuning)
    blocks: Blocks = [*tune_summary(tuning, result)]
    blocks += flight_sentences(assessment, has_headline_above=False)
    blocks += tune_overview(tuning, result)
    if changes is not None:
        blocks += changes.blocks
        blocks += changes.tried_sentences
        if not tuning.has_computed_gains:
            # The cautions on computed gains stand with the reasons below.
            blocks += changes.cautions
    gains = gains_of_tuning(tuning, evidence, changes)
    if gains is not None:
        for axis in axes_with_kept_gains(tuning):
            blocks += gains.sentences_on_axis(axis)
    blocks += tune_blocks(tuning, is_full=verbose, headline_above=result)
    blocks += measured_margins(tuning, assessment.margins)
    blocks += goal_sentences(tuning)
    blocks += goal_reached_sentences(tuning)
    blocks += field_sentences(tuning)
    blocks += later_flight_sentences(tuning)
    if tuning.notch:
        # The parameters of a notch filter that is set stand in the table of gains.
        is_in_table = bool(tuning.notch_parameters)
        text = tuning.notch.sentence if is_in_table else tuning.notch.sentence_and_remedy
        blocks.append(Sentence(text, "Notch filter:"))
    return blocks
