"""Flights as tables: columns with units in their names, as CSV, Parquet, pandas and xarray."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues, Names
from mavdem.dataset.axes import EAST, NORTH
from mavdem.dataset.signals import Signals
from mavdem.flight import Flight
from mavdem.report.numbers import without_remark
from mavdem.wind_velocity.from_log import wind_evidence

if TYPE_CHECKING:
    import pandas
    import xarray

Table = Mapping[str, Array]
"""Columns (T,) by name; a name ends in its unit, such as "roll_rate_rad_s". The first column is ``TIME_COLUMN``."""

TIME_COLUMN = "time_s"
"""Name of the column of the time on the autopilot's boot clock, s."""

TIME_FORMAT = ".6f"
"""Format of times in text: autopilots count microseconds at best."""

NUMBER_FORMAT = ".7g"
"""Format of all other numbers in text: autopilots send and log them as float32, which has seven digits."""


class Channels(NamedTuple):
    """The inputs, the outputs or the setpoints of a flight."""

    kind: str
    """"input", "output" or "setpoint"."""
    names: Names
    """Name of each of the k channels."""
    units: Names
    """Unit of each of the k channels."""
    values: Array
    """(T, k) samples, in these units."""


def column_name(name: str, unit: str) -> str:
    """Makes the name of a column of letters, digits and underscores, which needs no quotes in any language.

    >>> column_name("motor 1 (front left)", "µs")
    'motor_1_us'

    Args:
        name: name of the signal; an addition in brackets is left out.
        unit: its unit; empty for none.

    Returns:
        Name and unit in lower case, joined by underscores.
    """
    text = f"{without_remark(name)} {unit}".replace("µ", "u")
    return "_".join(re.findall(r"[^\W_]+", text.lower()))


def channels_of(flight: Flight) -> Iterator[Channels]:
    """Yields the inputs and outputs of a flight, and its setpoints where it has some."""
    yield Channels("input", flight.input_names, flight.input_units, flight.inputs)
    yield Channels("output", flight.output_names, flight.output_units, flight.outputs)
    if flight.setpoints is not None:
        yield Channels("setpoint", flight.setpoint_names, flight.setpoint_units, flight.setpoints)


def columns(flight: Flight) -> dict[str, Array]:
    """Returns the time, inputs, outputs and setpoints of a flight as columns.

    Args:
        flight: a flight with T samples.

    Returns:
        Columns (T,) by :func:`column_name`, the time first.

    Raises:
        ValueError: two columns have the same name.
    """
    table = {TIME_COLUMN: flight.time}
    for channels in channels_of(flight):
        for index, (name, unit) in enumerate(zip(channels.names, channels.units, strict=True)):
            column = column_name(name, unit)
            if column in table:
                raise ValueError(f"two columns of the flight are called {column}: name them apart")
            table[column] = channels.values[:, index]
    return table


def wind_columns(signals: Signals, boot: int, time: Array) -> dict[str, Array]:
    """Returns the wind velocity of a log as columns, interpolated to the samples of a flight.

    Args:
        signals: the signals of the vehicle.
        boot: number of the boot that the flight belongs to.
        time: (T,) samples of the flight on the clock of this boot, s.

    Returns:
        Columns (T,): the north and east velocity of the air, m/s, and the half widths of their bands. They are NaN
        outside the flight whose wind was estimated. Empty if the wind of this boot is not identifiable.
    """
    wind = wind_evidence(signals).estimate
    if wind is None or not wind.speed_identifiable or wind.boot != boot:
        return {}
    series = {
        "wind north": wind.velocity[:, NORTH],
        "wind east": wind.velocity[:, EAST],
        "wind north band": wind.band[:, NORTH],
        "wind east band": wind.band[:, EAST],
    }
    columns = {}
    for name, values in series.items():
        columns[column_name(name, "m/s")] = np.interp(
            time, wind.time, values, left=np.nan, right=np.nan
        )
    return columns


def write_csv(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes a table as CSV: a line with the names of the columns, then a line for each sample.

    Args:
        file: open file to write to; it stays open.
        table: the columns, all of the same length.
        provenance: source of the flight. It is not written, since CSV has no place for metadata; all writers of tables
            have the same arguments.
    """
    formatted_columns = []
    for name, column in table.items():
        number_format = TIME_FORMAT if name == TIME_COLUMN else NUMBER_FORMAT
        formatted_columns.append([format(value, number_format) for value in column.tolist()])
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(list(table))
    writer.writerows(zip(*formatted_columns, strict=True))
    # Otherwise the wrapper would close the file, which belongs to the caller, when it is garbage-collected.
    text.detach()


def write_parquet(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes a table as Parquet with float64 columns, and the provenance as JSON in the file's metadata.

    Args:
        file: open file to write to; it stays open.
        table: the columns, all of the same length.
        provenance: source of the flight, and how it was resampled.

    Raises:
        ImportError: ``pyarrow`` is not installed.
    """
    import pyarrow
    from pyarrow import parquet

    metadata = {"provenance": json.dumps(dict(provenance))}
    parquet.write_table(pyarrow.table(dict(table)).replace_schema_metadata(metadata), file)


def to_pandas(flight: Flight) -> pandas.DataFrame:
    """Returns a flight as a data frame.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.

    Returns:
        One row for each sample, by its time on the boot clock, s. The columns are as :func:`columns` returns them; the
        sampling step and the provenance are in ``attrs``.

    Raises:
        ImportError: ``pandas`` is not installed.
    """
    import pandas

    frame = pandas.DataFrame(columns(flight)).set_index(TIME_COLUMN)
    frame.attrs = {"dt": flight.dt, "provenance": dict(flight.provenance)}
    return frame


def to_xarray(flight: Flight) -> xarray.Dataset:
    """Returns a flight as a data set.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.

    Returns:
        Variables ``inputs (time, input)``, ``outputs (time, output)``, and where the flight has them ``setpoints
        (time, setpoint)`` and ``effect_directions (input)``. ``time`` is in s on the autopilot's boot clock. Units are
        coordinates besides the names: ``input_unit (input)`` and so on. The sampling step and the source are in
        ``attrs``.

    Raises:
        ImportError: ``xarray`` is not installed.
    """
    import xarray

    variables: JsonValues = {}
    coordinates: JsonValues = {
        "time": ("time", flight.time, {"units": "s", "long_name": "time since boot"})
    }
    for channels in channels_of(flight):
        kind = channels.kind
        variables[f"{kind}s"] = (("time", kind), channels.values)
        coordinates[kind] = (kind, list(channels.names))
        coordinates[f"{kind}_unit"] = (kind, list(channels.units))
    if flight.effect_directions is not None:
        variables["effect_directions"] = ("input", flight.effect_directions)
    attributes = {"dt": flight.dt, "source": str(flight.provenance.get("source", ""))}
    return xarray.Dataset(variables, coordinates, attributes)
