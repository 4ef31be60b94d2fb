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
from mavdem.fleet.priors import earlier_drag
from mavdem.report.condition import drag_table, wind_blocks, wind_tables
from mavdem.report.screen import conclusion
from mavdem.wind_velocity.from_log import WindEvidence, drag_settings, wind_of_signals


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
    --prior, or the autopilot's drag parameters. Exit code: 1 if the log cannot have a wind.
    """
    assessment, evidence = assess_without_model(source, vehicle)
    signals = evidence.signals
    wind, _, reason = evidence.wind
    if reason is not None:
        raise NotLearnable(reason)
    assert wind is not None
    if prior is not None:
        wind = wind_of_signals(signals, earlier_drag(prior, wind.speed))
    above, *lights, following = conclusion(assessment.judgement)
    settings = drag_settings(wind.drag, signals.telemetry)
    air = WindEvidence(wind, signals.autopilot_wind, None)
    blocks = [*wind_blocks(air), drag_table(wind.drag, settings)]
    if as_json:
        print_json(Wind.gather(assessment.judgement, wind.identified_figures, parameters=settings))
    else:
        print_screen(None, blocks, [*wind_tables(wind), *lights], [above, following], verbose)
