"""Flights and signals as tables: comma-separated text, or Parquet."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.drive import Motors
from mavdem.alignment.signals import Attitude, Signals, axis_outputs
from mavdem.flight import Flight
from mavdem.ingest.telemetry import rows_by

Table = Mapping[str, NDArray[np.float64]]
"""Columns (T,) by name, with units, such as "roll_rate_rad_s"; the first is "time_s"."""
TIME = "time_s"
DECIMALS = {"_rad_s": 5, "_rad": 6, "_us": 2, "_v": 3, "_s": 6}
"""Of numbers in text, by the unit at the end of a name, the first that fits: a tenth of what gyroscopes, attitude,
outputs and battery monitors resolve, or less; stamps of autopilots are microseconds at best."""
SIGNIFICANT = 7  # digits of other numbers: autopilots send and log them as float32


def column_name(name: str, unit: str) -> str:
    """A name that needs no quotes: "motor_1_us" of "motor 1 (front left)" and "µs"."""
    plain = f"{name.split(' (')[0]} {unit}".replace("µ", "u")
    return "_".join(re.findall(r"[^\W_]+", plain.lower()))


def columns(flight: Flight) -> dict[str, NDArray[np.float64]]:
    """Time, inputs, outputs, setpoints and the battery's voltage (T,) by :func:`column_name`.

    Raises ``ValueError`` if two names are equal.
    """
    named = {TIME: flight.time}
    none = np.empty((len(flight), 0))
    for names, units, values in (
        (flight.input_names, flight.input_units, flight.inputs),
        (flight.output_names, flight.output_units, flight.outputs),
        (flight.setpoint_names, flight.setpoint_units, none if flight.setpoints is None else flight.setpoints),
        (("battery",), ("V",), flight.voltage[:, None]) if flight.voltage is not None else ((), (), none),
    ):
        for name, unit, column in zip(names, units, values.T, strict=True):
            head = column_name(name, unit)
            if head in named:
                raise ValueError(f"two columns of the flight are called {head}: name them apart")
            named[head] = column
    return named


def own_columns(signals: Signals) -> dict[str, NDArray[np.float64]]:
    """Time, inputs and outputs (T,), each at its own stamps and NaN at the other's, of the boot with most of them.

    Empty where there are neither.
    """
    streams: list[tuple[Attitude | Motors, list[str], NDArray[np.float64]]] = []
    if (drive := signals.drive) is not None:
        streams.append((drive, [column_name(name, drive.scale.unit) for name in drive.layout.names], drive.outputs))
    if (seen := signals.attitude) is not None:
        names = [column_name(*output) for output in axis_outputs(signals.axis)]
        streams.append((seen, names, np.column_stack([seen.angle, seen.rate])[:, -len(names) :]))
    boots = rows_by(np.concatenate([np.zeros(0, dtype=np.int64), *(stream.boot for stream, _, _ in streams)]))
    if not boots:
        return {}
    boot = max(boots, key=lambda one: len(boots[one]))
    time = np.unique(np.concatenate([stream.time[stream.boot == boot] for stream, _, _ in streams]))
    table = {TIME: time}
    for stream, names, values in streams:
        here = stream.boot == boot
        placed = np.full((len(time), len(names)), np.nan)
        placed[np.searchsorted(time, stream.time[here])] = values[here]
        table |= dict(zip(names, placed.T, strict=True))
    return table


def write_csv(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes a head and one line a sample, rounded to ``DECIMALS``, without the provenance."""
    texts = [_rounded(name, column) for name, column in table.items()]
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(table)
    lines.writerows(zip(*texts, strict=True))
    text.detach()


def _rounded(name: str, column: NDArray[np.float64]) -> list[float] | list[str]:
    decimals = next((number for end, number in DECIMALS.items() if name.endswith(end)), None)
    if decimals is None:
        return [f"{value:.{SIGNIFICANT}g}" for value in column.tolist()]
    rounded: list[float] = (np.round(column, decimals) + 0.0).tolist()  # + 0.0: no minus before zero
    return rounded


def write_parquet(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes the columns as Parquet, as float64, the provenance as JSON in the metadata; needs pyarrow."""
    import pyarrow
    from pyarrow import parquet

    metadata = {"provenance": json.dumps(dict(provenance))}
    parquet.write_table(pyarrow.table(dict(table)).replace_schema_metadata(metadata), file)
