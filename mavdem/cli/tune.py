"""``mavdem tune``: margins of the rate and attitude loops with intervals, and gains to set; ``mavdem twin``."""

from pathlib import Path

import click

from mavdem.assessment.axis.figures import ALL_AXES
from mavdem.assessment.axis.tuning import tuned
from mavdem.cli.options import (
    file_option,
    params_option,
    source_options,
    start_option,
    verbose_option,
)
from mavdem.cli.output import print_json, print_screen
from mavdem.cli.output_files import check_output_folder, replaced_files
from mavdem.cli.sources import assess_without_model
from mavdem.cli.streams import print_to_stderr
from mavdem.dataset.axes import AXES
from mavdem.documents.loops import tune_document
from mavdem.ingest.parameter_file import parameter_files
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.report.blocks import Sentence
from mavdem.report.loops import tune_blocks
from mavdem.report.pages.page import tune_page
from mavdem.report.screen import conclusion

PAGE = "tune.html"
GAINS = ("gains.params", "gains.param")


@click.command("tune")
@source_options((*AXES, ALL_AXES), "Axis of the loops; all: roll, pitch and yaw.")
@click.option(
    "--margins",
    type=click.Choice(list(MARGIN_TARGETS)),
    default="default",
    show_default=True,
    help="; ".join(
        f"{name}: phase {a:g}°, gain {b:g} dB, Ms {c:g}"
        for name, (a, b, c) in MARGIN_TARGETS.items()
    )
    + ".",
)
@click.option("--more", is_flag=True, help="Use the room of loops that have enough margin.")
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

    SOURCE is a log with the autopilot's parameters. Advised gains have the --margins in 95 % of the models that fit the
    flight, at 0.8 to 1.2 times the control effectiveness; of such gains, wind moves the vehicle least with these. Loops
    with enough margin keep their gains, unless --more is asked. With --filters a notch filter is advised on the motors'
    line in the gyro's spectrum, and gains have the margins with it. With --verbose it prints all margins, and what they
    rest on. Nothing is ever sent to a vehicle: --out writes the gains for QGroundControl (.params) and Mission Planner
    (.param).

    Exit code: 1 if gains are neither advised nor kept, with the reason.

    \b
    Examples:
      mavdem tune flight.tlog --out tune
      mavdem tune flight.tlog --axis all --margins soft
      mavdem tune flight.bin --params vehicle.param --filters
    """
    if out:
        check_output_folder(out, (PAGE, *GAINS), params)
    assessment, evidence = assess_without_model(source, vehicle, params, inputs=inputs, start=start)
    axes = AXES if axis == ALL_AXES else (axis,)
    tuning = tuned(assessment, axes, margins, more=more, filters=filters, is_written=bool(out))
    gains = tuning.parameters
    if out:
        texts = {PAGE: tune_page(Path(source).name, tuning)}
        if gains:
            texts |= {
                f"gains{ending}": text
                for ending, text in parameter_files(gains, evidence.signals.telemetry).items()
            }
        with replaced_files(out, [*texts], GAINS) as paths:
            for path, text in zip(paths, texts.values(), strict=True):
                path.write_text(text, "utf-8", "replace")
        print_to_stderr(f"Written: {', '.join(texts)}. Nothing was sent to the vehicle.")
    if as_json:
        print_json(tune_document(source, margins, tuning))
    else:
        above, *lights, following = conclusion(tuning.judgement)
        blocks = tune_blocks(tuning, verbose)
        blocks += [Sentence(tuning.notch.advised, "Notch filter:")] if tuning.notch else []
        page = [Sentence(str(out / PAGE), "Page:")] if out else []
        # What must not fly is said before its gains.
        blocks.insert(0 if assessment.headline.is_bad else len(blocks), above)
        print_screen(None, [], lights, [*blocks, following, *page], verbose)
    if tuning.refusal:
        raise click.exceptions.Exit(1)
