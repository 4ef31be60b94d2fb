"""``mavdem wind``: wind speed and direction, gusts, the vehicle's drag, and the parameters to set."""

from pathlib import Path

import click

from mavdem.cli.options import (
    file_option,
    json_option,
    source_argument,
    vehicle_option,
    verbose_option,
)
from mavdem.cli.output import print_json, print_screen
from mavdem.cli.sources import assess_without_model
from mavdem.documents.wind import Wind
from mavdem.errors import NotLearnable
from mavdem.facts.lights import Light
from mavdem.fleet.priors import earlier_drag
from mavdem.report.condition import drag_table, wind_blocks, wind_tables
from mavdem.report.screen import warnings_of_lights
from mavdem.wind_velocity.from_log import WindEvidence, drag_settings, wind_of_signals

WIND_LIGHTS = (Light.WIND, Light.ESTIMATOR)
"""Lights that bear on the wind: the estimate rests on the attitude and velocity of the autopilot's estimator."""

MAX_COURSE_ROWS = 6
"""Rows of the tables of the wind over time and height, without --verbose."""


@click.command("wind")
@source_argument
@vehicle_option
@file_option(
    "--prior",
    "Drag from an earlier flight: learn's folder or files, or wind's own JSON.",
)
@json_option
@verbose_option
def wind_command(
    source: str, vehicle: str | None, prior: Path | None, as_json: bool, verbose: bool
) -> None:
    """Reports wind speed and direction, and the vehicle's drag.

    SOURCE is a log with attitude and velocity over ground. Legs in several directions show the drag; a hover needs
    --prior, or the autopilot's drag parameters. Exit code: 1 if no wind can be estimated from the log.
    """
    assessment, evidence = assess_without_model(source, vehicle)
    wind = evidence.wind.estimate
    if evidence.wind.obstacle is not None:
        raise NotLearnable(evidence.wind.obstacle)
    assert wind is not None
    signals = evidence.signals
    if prior is not None:
        # The estimate is made anew with the earlier drag as its prior. A hover in one place does not show the drag that
        # relates tilt to wind speed; an earlier flight may.
        wind = wind_of_signals(signals, earlier_drag(prior, wind.speed))
    parameters_to_set = drag_settings(wind.drag, signals.telemetry)
    if as_json:
        document = Wind.from_results(
            assessment.judgement, wind.identified_figures, parameters=parameters_to_set
        )
        print_json(document)
        return
    # The shown wind is the estimate, perhaps with the earlier drag, beside that of the autopilot.
    shown_wind = WindEvidence(
        estimate=wind, autopilot_estimate=signals.autopilot_wind, obstacle=None
    )
    tables = wind_tables(wind, None if verbose else MAX_COURSE_ROWS)
    if verbose or parameters_to_set:
        tables.append(drag_table(wind.drag, parameters_to_set))
    print_screen(
        title=None,
        summary=[],
        details=[],
        conclusion=[
            *wind_blocks(shown_wind, tables),
            *warnings_of_lights(assessment.judgement, WIND_LIGHTS),
        ],
        verbose=verbose,
    )
