"""``mavdem wind``: wind speed and direction, gusts, the vehicle's drag, and the parameters to set."""

from collections.abc import Mapping
from pathlib import Path

import click

from mavdem.assessment.assess import with_wind
from mavdem.assessment.identity import identify_vehicle
from mavdem.cli.options import (
    file_option,
    json_option,
    source_argument,
    vehicle_option,
    verbose_option,
)
from mavdem.cli.output import json_text, print_json, print_screen
from mavdem.cli.output_files import check_output_folder, write_texts
from mavdem.cli.sources import assess_without_model
from mavdem.cli.streams import print_to_stderr
from mavdem.confidence import IntervalEstimate
from mavdem.documents.wind import Wind
from mavdem.errors import NotLearnable
from mavdem.fleet.priors import WIND_DOCUMENT, doubt_on_prior, earlier_drag
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Telemetry
from mavdem.report.blocks import Blocks, Sentence, caution
from mavdem.report.condition import (
    drag_blocks,
    flight_warning,
    wind_blocks,
    wind_tables,
)
from mavdem.report.pages.wind_page import page_without_wind, wind_page
from mavdem.report.screen import remarks_on_wind
from mavdem.report.templates import render_section
from mavdem.wind_velocity.from_log import drag_settings, wind_of_signals
from mavdem.wind_velocity.vehicle_drag import DRAG_MODEL_SETTINGS

DRAG_FILES = ("drag.params", "drag.param")
"""Names of the files with the drag parameters to set; for QGroundControl and for Mission Planner."""

DRAG_HEADING = "Drag of the vehicle, for the wind estimate of the autopilot's own state estimator"
"""First line of these files, before the setting with which the autopilot uses them."""

PAGE_FILE = "wind.html"
"""Name of the page with the wind over time, on the map, by height, and the drag."""

MAX_COURSE_ROWS = 6
"""Rows of the tables of the wind over time and height, without --verbose."""


@click.command("wind")
@source_argument
@vehicle_option
@file_option(
    "--prior",
    "Another flight of the vehicle, for its drag: a log, or a folder or file of learn or wind.",
)
@file_option("--out", "Folder for wind.html and wind.json.")
@json_option
@verbose_option
def wind_command(
    source: str,
    vehicle: str | None,
    prior: Path | None,
    out: Path | None,
    as_json: bool,
    verbose: bool,
) -> None:
    """Reports wind speed and direction, and the vehicle's drag.

    SOURCE is a log with attitude and velocity over ground. Legs in several directions show the drag; a hover needs
    --prior, or the autopilot's drag parameters. --out writes a page of the wind over time, on the map and by height,
    and the drag as parameters for QGroundControl (.params) and Mission Planner (.param), if the flight shows it.
    Exit code: 1 if no wind can be estimated from the log.
    """
    if out:
        check_output_folder(out, (PAGE_FILE, WIND_DOCUMENT, *DRAG_FILES), prior)
    assessment, evidence = assess_without_model(source, vehicle)
    wind = evidence.wind.estimate
    if evidence.wind.reason is not None:
        if out:
            page = page_without_wind(Path(source).name, evidence.wind.reason, assessment)
            write_texts(out, {PAGE_FILE: page}, (WIND_DOCUMENT, *DRAG_FILES))
            print_to_stderr(f"Written: {PAGE_FILE}.")
        raise NotLearnable(evidence.wind.reason)
    # There is an estimate unless something prevented it.
    assert wind is not None
    signals = evidence.signals
    wind_evidence = evidence.wind
    identity = identify_vehicle(signals)
    remarks_on_prior: Blocks = []
    is_prior_in_doubt = False
    if prior is not None:
        # The estimate is made anew with the earlier drag as its prior. A hover in one place does not show the drag that
        # relates tilt to wind speed; an earlier flight may.
        prior_drag = earlier_drag(prior, wind.speed)
        doubt = doubt_on_prior(prior_drag, wind, identity)
        is_prior_in_doubt = doubt.is_of_another_vehicle or doubt.is_contradicted
        remarks_on_prior = [*render_section("wind_prior", file=prior.name)]
        for sentence in render_section("wind_prior_doubt", doubt):
            remarks_on_prior.append(caution(sentence.text))
        wind = wind_of_signals(signals, prior_drag.drag)
        wind_evidence = wind_evidence._replace(estimate=wind)
        assessment = with_wind(assessment, wind_evidence)
    # Parameters that rest on the drag of what may be another vehicle are none to set.
    parameters_to_set = {} if is_prior_in_doubt else drag_settings(wind.drag, signals.telemetry)
    document = Wind.from_results(
        assessment.judgement,
        wind.without_unidentified_speeds,
        parameters=parameters_to_set,
        identity=identity,
    )
    written = ""
    if out:
        drag_files = _drag_files(parameters_to_set, signals.telemetry)
        texts = {
            PAGE_FILE: wind_page(
                Path(source).name,
                wind_evidence,
                assessment,
                parameters_to_set,
                remarks_on_prior,
                drag_files,
            ),
            WIND_DOCUMENT: json_text(document),
        }
        for ending, text in drag_files.items():
            texts[f"drag{ending}"] = text
        write_texts(out, texts, DRAG_FILES)
        written = f"Written: {', '.join(texts)}. Nothing was sent to the vehicle."
    if as_json:
        print_json(document)
        if written:
            print_to_stderr(written)
        return
    tables: Blocks = [*wind_tables(wind, None if verbose else MAX_COURSE_ROWS)]
    if verbose or parameters_to_set:
        tables += drag_blocks(wind.drag, signals.telemetry.autopilot, parameters_to_set)
    print_screen(
        title=[],
        summary=[],
        details=[],
        footer=[
            *flight_warning(assessment.judgement),
            *wind_blocks(
                wind_evidence,
                tables,
                remarks=[*remarks_on_prior, *remarks_on_wind(assessment.judgement)],
            ),
            *([Sentence(str(out / PAGE_FILE), "Page:")] if out else []),
        ],
        verbose=verbose,
    )
    if written:
        # What was found comes before the files in which it is kept.
        print_to_stderr(written)


def _drag_files(
    parameters_to_set: Mapping[str, IntervalEstimate], vehicle: Telemetry
) -> dict[str, str]:
    """Returns the texts of the files with the drag parameters, in the formats of ground stations.

    Args:
        parameters_to_set: Value with its interval by name of the parameter.
        vehicle: The vehicle whose drag they are; its autopilot decides which setting makes use of them.

    Returns:
        The text of each file by the ending of its name, ".params" and ".param"; empty without parameters.
    """
    if not parameters_to_set:
        return {}
    values = {name: parameter.value for name, parameter in parameters_to_set.items()}
    setting_name, setting_value = DRAG_MODEL_SETTINGS[vehicle.autopilot]
    heading = f"{DRAG_HEADING}, which {setting_name} {setting_value} switches on"
    return parameter_files(values, vehicle, heading)
