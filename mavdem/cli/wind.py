"""``mavdem wind``: wind speed and direction, gusts, the vehicle's drag, and the parameters to set."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from mavdem.assessment import Assessment
from mavdem.assessment.assess import with_wind
from mavdem.assessment.identity import Identity, identify_vehicle
from mavdem.cli.exit_codes import EXIT_UNSUPPORTED
from mavdem.cli.options import (
    file_option,
    json_option,
    source_argument,
    vehicle_option,
    verbose_option,
)
from mavdem.cli.output import json_text, print_json, print_screen, report_error
from mavdem.cli.output_files import check_output_folder, write_texts
from mavdem.cli.sources import assess_without_model
from mavdem.cli.streams import print_to_stderr
from mavdem.confidence import IntervalEstimate
from mavdem.dataset.signals import Signals
from mavdem.documents.wind import Wind
from mavdem.fleet.priors import WIND_DOCUMENT, doubt_on_prior, earlier_drag
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Telemetry
from mavdem.report.blocks import Block, Blocks, Sentence, caution
from mavdem.report.condition import (
    drag_blocks,
    flight_warning,
    wind_blocks,
    wind_tables,
)
from mavdem.report.fleet import unnamed_vehicle
from mavdem.report.pages.wind_page import next_step_without_wind, page_without_wind, wind_page
from mavdem.report.screen import remarks_on_wind
from mavdem.report.templates import render_section
from mavdem.wind_velocity.from_log import WindEvidence, drag_settings, wind_of_signals
from mavdem.wind_velocity.vehicle_drag import DRAG_MODEL_SETTINGS
from mavdem.wind_velocity.velocity import WindVelocity

DRAG_FILES = ("drag.params", "drag.param")
"""Names of the files with the drag parameters to set; for QGroundControl and for Mission Planner."""

DRAG_HEADING = "Drag of the vehicle, for the wind estimate of the autopilot's own state estimator"
"""First line of these files, before the setting with which the autopilot uses them."""

PAGE_FILE = "wind.html"
"""Name of the page with the wind over time, on the map, by height, and the drag."""


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
    log_name = Path(source).name
    # A vehicle that did not fly shows no wind, whatever else its log lacks.
    reason_without_wind = evidence.wind.reason
    if reason_without_wind is not None and evidence.not_flown is not None:
        reason_without_wind = evidence.not_flown
    if reason_without_wind is not None:
        if out:
            page = page_without_wind(log_name, reason_without_wind, assessment)
            write_texts(out, {PAGE_FILE: page}, (WIND_DOCUMENT, *DRAG_FILES))
            print_to_stderr(f"Written: {PAGE_FILE}.")
        report_error(reason_without_wind, as_json=as_json)
        for sentence in next_step_without_wind(reason_without_wind, assessment.judgement):
            print_to_stderr(f"{sentence.lead} {sentence.text}")
        raise click.exceptions.Exit(EXIT_UNSUPPORTED)
    signals = evidence.signals
    identity = identify_vehicle(signals)
    result = _WindResult(assessment, evidence.wind)
    if prior is not None:
        result = _result_with_prior(result, signals, identity, prior)
    # Parameters that rest on the drag of what may be another vehicle are none to set.
    parameters_to_set = {}
    if not result.is_prior_in_doubt:
        parameters_to_set = drag_settings(result.wind.drag, signals.telemetry)
    document = Wind.from_results(
        result.assessment.judgement,
        result.wind.without_unidentified_speeds,
        parameters=parameters_to_set,
        identity=identity,
    )
    written = ""
    if out:
        drag_files = _drag_files(parameters_to_set, signals.telemetry)
        page = wind_page(
            log_name,
            result.evidence,
            result.assessment,
            parameters_to_set,
            result.remarks_on_prior,
            drag_files,
        )
        texts = {PAGE_FILE: page, WIND_DOCUMENT: json_text(document)}
        for ending, text in drag_files.items():
            texts[f"drag{ending}"] = text
        write_texts(out, texts, DRAG_FILES)
        written = f"Written: {', '.join(texts)}. Nothing was sent to the vehicle."
    if as_json:
        print_json(document)
    else:
        page_path = None if out is None else out / PAGE_FILE
        _print_result(result, signals.telemetry, parameters_to_set, page_path, verbose=verbose)
    if written:
        # What was found comes before the files in which it is kept.
        print_to_stderr(written)


class _WindResult(NamedTuple):
    """The wind of a flight, and what is known of the drag that its estimate uses."""

    assessment: Assessment
    """Assessment of the log with this wind."""

    evidence: WindEvidence
    """The estimate, and the autopilot's own one."""

    remarks_on_prior: Sequence[Block] = ()
    """Sentences on the earlier flight whose drag was used; empty without one."""

    is_prior_in_doubt: bool = False
    """Whether that drag may be another vehicle's, or contradicts this flight."""

    @property
    def wind(self) -> WindVelocity:
        """The estimated wind."""
        # There is an estimate unless something prevented it, and then the command has ended already.
        assert self.evidence.estimate is not None
        return self.evidence.estimate


def _result_with_prior(
    result: _WindResult, signals: Signals, identity: Identity, prior: Path
) -> _WindResult:
    """Estimates the wind of a flight anew, with the drag of an earlier flight as its prior.

    A hover in one place does not show the drag, which relates tilt to wind speed; an earlier flight may.

    Args:
        result: the wind by this flight alone.
        signals: logged time series of the vehicle.
        identity: the vehicle of this flight.
        prior: path of the earlier flight: its log, or a file or folder of ``mavdem learn`` or ``mavdem wind``.

    Raises:
        Unreadable: the drag of the earlier flight cannot be read, or is of this flight.
    """
    prior_drag = earlier_drag(prior, result.wind.speed)
    (source_of_prior,) = render_section(
        "wind_prior",
        file=prior.name,
        source=prior_drag.drag.source,
        # Why this flight does not show the drag itself; None if it does.
        drag_doubt=result.wind.reasons.get("drag"),
    )
    if prior_drag.is_typical:
        # The wind of this flight is estimated with the drag of typical multirotors already.
        return result._replace(remarks_on_prior=[caution(source_of_prior.text)])
    doubt = doubt_on_prior(prior_drag, result.wind, identity)
    remarks: Blocks = [source_of_prior]
    for sentence in render_section(
        "wind_prior_doubt",
        doubt,
        earlier_vehicle=_vehicle_description(
            prior_drag.vehicle, prior_drag.autopilot, prior_drag.frame
        ),
        vehicle=_vehicle_description(
            identity.name_of_one_vehicle, identity.autopilot, identity.frame
        ),
    ):
        remarks.append(caution(sentence.text))
    estimate = wind_of_signals(signals, prior_drag.drag)
    evidence = result.evidence._replace(estimate=estimate)
    return _WindResult(
        with_wind(result.assessment, evidence),
        evidence,
        remarks_on_prior=remarks,
        is_prior_in_doubt=doubt.is_of_another_vehicle or doubt.is_contradicted,
    )


def _vehicle_description(name: str, autopilot: str, frame: str) -> str:
    """Returns the name of a vehicle, or its autopilot and frame, such as "an unnamed PX4 quadrotor", without one."""
    return name or f"an {unnamed_vehicle(autopilot, frame)}"


def _print_result(
    result: _WindResult,
    vehicle: Telemetry,
    parameters_to_set: Mapping[str, IntervalEstimate],
    page_path: Path | None,
    *,
    verbose: bool,
) -> None:
    """Prints the wind and the drag on the terminal.

    Args:
        result: the wind of the flight.
        vehicle: the vehicle; its autopilot decides on the names of the drag parameters.
        parameters_to_set: value with its interval by name of the drag parameter.
        page_path: path of the page that was written, which the last line names; None without one.
        verbose: whether the drag is shown even if no parameter is to be set.
    """
    wind = result.wind
    judgement = result.assessment.judgement
    tables: Blocks = [*wind_tables(wind)]
    if verbose or parameters_to_set:
        tables += drag_blocks(wind.drag, vehicle.autopilot, parameters_to_set)
    remarks = [*result.remarks_on_prior, *remarks_on_wind(judgement)]
    blocks: Blocks = [
        *flight_warning(judgement),
        *wind_blocks(result.evidence, tables, remarks=remarks),
    ]
    if page_path is not None:
        blocks.append(Sentence(str(page_path), "Page:"))
    print_screen(title=[], summary=[], details=[], footer=blocks, verbose=verbose)


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
