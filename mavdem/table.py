"""A Flight as a table: comma-separated text, or Parquet."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavdem.flight import Flight


def columns(flight: Flight) -> dict[str, NDArray[np.float64]]:
    """Time, inputs and outputs (T,) by name, each with its unit in brackets: "time [s]", "roll rate [rad/s]"."""
    named = {"time [s]": flight.time}
    for names, units, values in (
        (flight.input_names, flight.input_units, flight.inputs),
        (flight.output_names, flight.output_units, flight.outputs),
    ):
        for name, unit, column in zip(names, units, values.T, strict=True):
            head = f"{name} [{unit}]" if unit else name
            if head in named:
                raise ValueError(f"two columns of the flight are called {head}: name them apart")
            named[head] = column
    return named


def write_csv(file: BinaryIO, flight: Flight) -> None:
    """Writes a head and one line a sample; every number reads back as it was.

    Args:
        file: open for writing.
        flight: what to write.

    Raises:
        ValueError: two columns of the same name.
    """
    table = columns(flight)
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(table)
    lines.writerows(zip(*(column.tolist() for column in table.values()), strict=True))
    text.detach()


def write_parquet(file: BinaryIO, flight: Flight) -> None:
    """Writes the same columns as Parquet, the flight's provenance as JSON in the metadata under ``provenance``.

    Args:
        file: open for writing.
        flight: what to write.

    Raises:
        ImportError: there is no pyarrow.
        ValueError: two columns of the same name.
    """
    import pyarrow
    from pyarrow import parquet

    table = pyarrow.table(columns(flight))
    metadata: Mapping[str, str] = {"provenance": json.dumps(dict(flight.provenance))}
    parquet.write_table(table.replace_schema_metadata(metadata), file)
