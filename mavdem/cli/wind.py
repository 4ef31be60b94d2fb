"""``mavdem wind``: wind speed and direction, gusts, the vehicle's drag, and the parameters to set."""

from pathlib import Path

import click

from mavdem.cli.options import (
    assessed,
    file_option,
    json_option,
    vehicle_option,
    verbose_option,
)
from mavdem.cli.output import print_json, print_screen
from mavdem.condition.wind_of_log import wind_of
from mavdem.errors import NotLearnable
from mavdem.facts.online import DragSource
from mavdem.fleet.priors import earlier_drag
from mavdem.report.blocks import Blocks, Table
from mavdem.report.condition import wind_blocks
from mavdem.report.screen import conclusion

SOURCES = {
    DragSource.POPULATION: "other vehicles",
    DragSource.PARAMETERS: "the autopilot's parameters",
    DragSource.FLIGHT: "flight",
    DragSource.CALIBRATION: "calibration",
}


@click.command("wind")
@click.argument("source", type=click.Path())
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
    assessment, evidence = assessed(source, vehicle)
    signals = evidence.signals
    wind, _, reason = evidence.air
    if reason is not None:
        raise NotLearnable(reason)
    assert wind is not None
    if prior is not None:
        wind = wind_of(signals, earlier_drag(prior, wind.speed))
    drag = wind.drag
    above, *lights, following = conclusion(assessment.judgement)
    blocks = wind_blocks((wind, signals.autopilot_wind, None))
    tables = Blocks()
    for header, name, rows in (
        ("Time (s)", "start", wind.minutes),
        ("Height (m)", "height", wind.profile),
    ):
        cells = [
            [f"{row[name]:.0f}", f"{row['speed']:.1f}", f"{row['direction']:.0f}"] for row in rows
        ]
        if wind.sized and len(rows) > 1:
            tables.append(Table([header, "Wind (m/s)", "From (°)"], cells))
    telemetry = signals.telemetry
    settings = drag.parameters(telemetry.autopilot)
    if telemetry.translated_from == "DataFlash":  # which has all that the firmware has
        settings = {name: ends for name, ends in settings.items() if name in telemetry.parameters}
    numbers = settings | {
        "linear drag (1/s)": (drag.linear.mean(), *drag.interval("linear").mean(axis=1))
    }
    table = [[name, *(f"{value:.3g}" for value in values)] for name, values in numbers.items()]
    blocks += [Table([f"Drag, from {SOURCES[drag.source]}", "value", "from", "to"], table)]
    document = assessment.judgement._asdict() | wind.as_dict() | {"parameters": settings}
    if as_json:
        print_json(document)
    else:
        print_screen(None, blocks, [*tables, *lights], [above, following], verbose)
