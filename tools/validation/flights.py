"""Simulated flights for validation: drawing scenarios, evaluating many in processes, and printing tables of results.

The tables of ``flights.toml`` state what scenarios are drawn from, one table for each script of this folder.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import click
import numpy as np
from numpy.random import Generator

from mavdem.files import load_adjacent_toml
from mavdem.ingest.mavlink.vehicles import assemble
from mavdem.ingest.telemetry import Telemetry
from mavdem.report.blocks import Blocks, Sentence, Table, markdown
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.mavlink.transmitter import recorded_stream
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario

Values = dict[str, Any]
"""Values by name: a table of a TOML file, or a row of a table of results."""

Main = Callable[..., None]
"""The main function of a script."""

TABLES: Values = load_adjacent_toml(__file__, "flights.toml")
"""What the scripts draw their scenarios from, by name of the table."""

SCALED_FIELDS = ("speed", "sd", "wind_at_20_feet")
"""Fields of winds and moments that are scaled with the size of the vehicle, by ``TABLES["scales"]``."""


def command(usage: str, **defaults: float) -> Callable[[Main], click.Command]:
    """Returns a decorator that makes the main function of a script a command.

    Args:
        usage: help text of the command.
        defaults: names of numeric options and their default values. The number of processes, ``jobs``, is always one.
    """

    def decorate(main: Main) -> click.Command:
        for name, default in {"jobs": 2, **defaults}.items():
            main = click.option(f"--{name}", default=default, show_default=True)(main)
        return click.command(help=usage)(main)

    return decorate


ARMING_TIME = 2.0
"""Time from the beginning of a recording to the arming, s. The times of a scenario count from the arming."""


def half_name(number: int) -> str:
    """Returns the half of the flights that one belongs to: thresholds are chosen on the "even" half, not on the "odd".

    Args:
        number: number of the flight within its kind.
    """
    return "even" if number % 2 == 0 else "odd"


def draw_values(table: Any, rng: Generator) -> Any:
    """Draws values from a table of ``flights.toml``.

    Args:
        table: any TOML value. ``{from, to}`` is a range that a number is drawn from uniformly, ``{by_ratio}`` a range
            that it is drawn from uniformly in its logarithm, and ``{one_of}`` a list that one item is drawn from.
        rng: generator of random numbers.

    Returns:
        The same value, with a number or an item in place of each range or list.
    """
    match table:
        case {"from": low, "to": high}:
            return float(rng.uniform(low, high))
        case {"by_ratio": limits}:
            return float(np.exp(rng.uniform(*np.log(limits))))
        case {"one_of": choices}:
            return draw_values(choices[rng.integers(len(choices))], rng)
        case dict():
            return {name: draw_values(value, rng) for name, value in table.items()}
        case list():
            return [draw_values(value, rng) for value in table]
    return table


def scenario_from_values(values: Values, *full_rate_messages: str) -> Scenario:
    """Returns the scenario of drawn values, with winds and moments scaled to the size of the vehicle.

    A small vehicle would tumble in the wind that a large one is tested with, so that speeds and moments are multiplied
    by a factor of the vehicle's model. The values are as in a scenario's TOML file, but may also have a key ``lag`` for
    the lag, s, of rotors that speed up and slow down alike, and an excitation of kind "none".

    Args:
        values: the drawn values, which are not changed.
        full_rate_messages: names of messages that are sent at the rate of the stream.

    Returns:
        The validated scenario.
    """
    table = dict(values)
    model = table["vehicle"].get("model", "iris")
    # The sections are wind and moments, each a list of several that act together.
    for section, scale_by_model in TABLES["scales"].items():
        scale = scale_by_model[model]
        scaled_entries = []
        for entry in table.get(section, []):
            scaled_fields = {name: scale * entry[name] for name in SCALED_FIELDS if name in entry}
            scaled_entries.append(entry | scaled_fields)
        table[section] = scaled_entries
    if table.get("excitation") == {"kind": "none"}:
        del table["excitation"]
    if "lag" in table:
        lag = table.pop("lag")
        table["vehicle"] = table["vehicle"] | {"lag_up": lag, "lag_down": lag}
    if full_rate_messages:
        stream = table["stream"]
        rates = dict.fromkeys(full_rate_messages, stream["rate"])
        table["stream"] = stream | {"rates": rates}
    return scenario_from_table(table)


def simulated_telemetry(scenario: Scenario, motion: Motion) -> Telemetry:
    """Returns the telemetry that the vehicle of a simulated flight sends."""
    return assemble(recorded_stream(scenario, motion)).vehicles[0]


def evaluate_flights(
    evaluate: Callable[[Any], list[Values]], flights: Iterable[Any], jobs: int
) -> Any:
    """Evaluates flights in processes; the number of finished flights goes to standard error.

    Args:
        evaluate: function that returns rows of results for one flight; it must pickle.
        flights: its arguments, one for each flight.
        jobs: number of processes.

    Returns:
        A data frame of the rows of all flights, in the order of the flights.
    """
    # pandas takes half a second to import, and tests of other functions need none.
    import pandas as pd

    rows = []
    with ProcessPoolExecutor(jobs) as pool:
        for number, flight_rows in enumerate(pool.map(evaluate, flights), start=1):
            click.echo(f"{number} flights", err=True)
            rows += flight_rows
    return pd.DataFrame(rows)


def percent_true(conditions: Any) -> str:
    """Returns the share of conditions that are true as text in percent; a dash if there are no conditions."""
    if len(conditions):
        return f"{np.mean(conditions):.0%}"
    return "–"


def print_table(title: str, rows: Any, *notes: str) -> None:
    """Prints a table in Markdown, between a title and notes.

    Args:
        title: sentence above the table.
        rows: rows of the table: a data frame, or a list of dictionaries with a value by the header of each column.
        notes: sentences below the table.
    """
    import pandas as pd

    table = pd.DataFrame(rows)
    cells = [[_cell_text(cell) for cell in row] for row in table.itertuples(index=False)]
    # Some columns have words, so all are aligned on the left.
    blocks: Blocks = [Sentence(title), Table(list(table), cells, words=True)]
    for note in notes:
        blocks.append(Sentence(note))
    click.echo(markdown(blocks) + "\n")


def _cell_text(cell: Any) -> str:
    """Returns the text of a cell: numbers with three digits, and nothing for NaN."""
    if not isinstance(cell, float):
        return str(cell)
    if np.isnan(cell):
        return ""
    return f"{cell:.3g}"
