"""Flights and signals as tables: comma-separated text, or Parquet."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.drive import Motors
from mavdem.alignment.signals import Attitude, Signals, axis_outputs
from mavdem.flight import Flight
from mavdem.ingest.telemetry import rows_by

Table = Mapping[str, NDArray[np.float64]]
"""Columns (T,) by name, with units, such as "time [s]", which is the first."""
TIME_DECIMALS = 6  # of seconds in text: the stamps of autopilots are microseconds at best


def columns(flight: Flight) -> dict[str, NDArray[np.float64]]:
    """Time, inputs, outputs, setpoints and the battery's voltage (T,) by name, with units, such as "time [s]".

    Raises ``ValueError`` if two names are equal.
    """
    named = {"time [s]": flight.time}
    none = np.empty((len(flight), 0))
    for names, units, values in (
        (flight.input_names, flight.input_units, flight.inputs),
        (flight.output_names, flight.output_units, flight.outputs),
        (flight.setpoint_names, flight.setpoint_units, none if flight.setpoints is None else flight.setpoints),
        (("battery",), ("V",), flight.voltage[:, None]) if flight.voltage is not None else ((), (), none),
    ):
        for name, unit, column in zip(names, units, values.T, strict=True):
            head = f"{name} [{unit}]" if unit else name
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
        unit = f" [{drive.scale.unit}]" if drive.scale.unit else ""
        streams.append((drive, [f"{name}{unit}" for name in drive.layout.names], drive.outputs))
    if (seen := signals.attitude) is not None:
        names = [f"{name} [{unit}]" for name, unit in axis_outputs(signals.axis)]
        streams.append((seen, names, np.column_stack([seen.angle, seen.rate])[:, -len(names) :]))
    boots = rows_by(np.concatenate([np.zeros(0, dtype=np.int64), *(stream.boot for stream, _, _ in streams)]))
    if not boots:
        return {}
    boot = max(boots, key=lambda one: len(boots[one]))
    time = np.unique(np.concatenate([stream.time[stream.boot == boot] for stream, _, _ in streams]))
    table = {"time [s]": time}
    for stream, names, values in streams:
        here = stream.boot == boot
        placed = np.full((len(time), len(names)), np.nan)
        placed[np.searchsorted(time, stream.time[here])] = values[here]
        table |= dict(zip(names, placed.T, strict=True))
    return table


def write_csv(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes a head and one line a sample, without the provenance.

    Time is rounded to microseconds; other numbers have the fewest digits that read back as the same float32, the
    precision in which autopilots send and log them.
    """
    time, *others = table.values()
    texts = [
        np.round(time, TIME_DECIMALS).tolist(),
        *(column.astype(np.float32).astype(str).tolist() for column in others),
    ]
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(table)
    lines.writerows(zip(*texts, strict=True))
    text.detach()


def write_parquet(file: BinaryIO, table: Table, provenance: Mapping[str, Any]) -> None:
    """Writes the columns as Parquet, as float64, the provenance as JSON in the metadata; needs pyarrow."""
    import pyarrow
    from pyarrow import parquet

    metadata = {"provenance": json.dumps(dict(provenance))}
    parquet.write_table(pyarrow.table(dict(table)).replace_schema_metadata(metadata), file)
