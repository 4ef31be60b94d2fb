"""Simulated flights to validate on, drawn by tables and judged in processes; and tables of what came of them."""

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import click
import numpy as np
import pandas as pd
from numpy.random import Generator

from mavdem.files import load_adjacent_toml
from mavdem.ingest.mavlink.vehicles import assemble
from mavdem.ingest.telemetry import Telemetry
from mavdem.report.blocks import Sentence, Table, markdown
from sitl_scenarios.files import scenario_of
from sitl_scenarios.mavlink.transmitter import recorded
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario

Values = dict[str, Any]
TABLES: Values = load_adjacent_toml(__file__, "flights.toml")
SCALED = ("speed", "sd", "wind_at_20_feet")
"""Of winds and moments, with the size of the vehicle."""
Main = Callable[..., None]


def command(usage: str, **defaults: float) -> Callable[[Main], click.Command]:
    """A command with an option for each of the defaults, and for the number of processes."""

    def made(main: Main) -> click.Command:
        for name, default in {"jobs": 2, **defaults}.items():
            main = click.option(f"--{name}", default=default, show_default=True)(main)
        return click.command(help=usage)(main)

    return made


def drawn(table: Any, rng: Generator) -> Any:
    """The values of a table, where it has ranges and choices one of each."""
    match table:
        case {"from": low, "to": high}:
            return float(rng.uniform(low, high))
        case {"by_ratio": limits}:
            return float(np.exp(rng.uniform(*np.log(limits))))
        case {"one_of": choices}:
            return drawn(choices[rng.integers(len(choices))], rng)
        case dict():
            return {name: drawn(value, rng) for name, value in table.items()}
        case list():
            return [drawn(value, rng) for value in table]
    return table


def flight_of(values: Values, *as_fast: str) -> Scenario:
    """The scenario of values; messages ``as_fast`` come at the stream's rate."""
    table = dict(values)
    model = table["vehicle"].get("model", "iris")
    for section, scales in TABLES["scales"].items():
        table[section] = [
            row | {name: scales[model] * row[name] for name in SCALED if name in row}
            for row in table.get(section, [])
        ]
    if table.get("excitation") == {"kind": "none"}:
        del table["excitation"]
    if "lag" in table:
        lag = table.pop("lag")
        table["vehicle"] = table["vehicle"] | {"lag_up": lag, "lag_down": lag}
    if as_fast:
        stream = table["stream"]
        table["stream"] = stream | {"rates": dict.fromkeys(as_fast, stream["rate"])}
    return scenario_of(table)


def telemetry_of(scenario: Scenario, motion: Motion) -> Telemetry:
    """What the vehicle of a simulated flight sent."""
    return assemble(recorded(scenario, motion)).vehicles[0]


def rows_of(judge: Callable[[Any], list[Values]], flights: Iterable[Any], jobs: int) -> Any:
    """What is found of each of the flights, rows of one frame; how many are done goes to standard error."""
    rows = []
    with ProcessPoolExecutor(jobs) as pool:
        for number, judged in enumerate(pool.map(judge, flights), start=1):
            click.echo(f"{number} flights", err=True)
            rows += judged
    return pd.DataFrame(rows)


def share(held: Any) -> str:
    """Of what is true, in percent."""
    if len(held):
        return f"{np.mean(held):.0%}"
    return "–"


def show(title: str, rows: Any, *more: str) -> None:
    """Prints rows, a frame or made into one, as a table in Markdown, and sentences under it."""
    table = pd.DataFrame(rows)
    cells = [[_text(cell) for cell in row] for row in table.itertuples(index=False)]
    under = [Sentence(text) for text in more]
    click.echo(markdown([Sentence(title), Table(list(table), cells, words=True), *under]) + "\n")


def _text(cell: Any) -> str:
    if not isinstance(cell, float):
        return str(cell)
    if np.isnan(cell):
        return ""
    return f"{cell:.3g}"
