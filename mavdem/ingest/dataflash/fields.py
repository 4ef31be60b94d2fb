"""Fields of DataFlash's messages as numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.telemetry import Columns, selected

Values = NDArray[np.float64]


def having(tables: Mapping[str, Columns], name: str, fields: tuple[str, ...]) -> Columns | None:
    """The messages of that name; None where there are none, or one of the fields is not there as numbers."""
    columns = tables.get(name, {})
    if not all(field in columns and columns[field].dtype.kind in "iuf" for field in fields):
        return None
    return columns if len(columns["time"]) else None


def instance(columns: Columns | None, field: str, number: float) -> Columns | None:
    """Those of one instance (sensor, core); all where the messages have no instances."""
    if columns is None or field not in columns:
        return columns
    rows = columns[field] == number
    return selected(columns, rows) if rows.any() else None


def count(columns: Columns | None) -> int:
    """How many messages there are."""
    return 0 if columns is None else len(columns["time"])


def values(columns: Columns, fields: tuple[str, ...]) -> Values:
    """The fields as columns (N, k); NaN where not finite."""
    values = np.column_stack([np.asarray(columns[field], dtype=np.float64) for field in fields])
    values[~np.isfinite(values)] = np.nan
    return values


def stamped(logged: Columns, stamp: str, fields: Mapping[str, NDArray[Any]]) -> Columns:
    """A message's columns at the logged stamps, with the field ``stamp`` as MAVLink sends it."""
    time = logged["time"]
    if stamp == "time_boot_ms":
        fields = {stamp: (np.rint(time * 1e3) % 2**32).astype(np.uint32), **fields}  # as the counter wraps
    elif stamp:
        fields = {stamp: np.rint(time * 1e6).astype(np.uint64), **fields}
    return {"time": time, "boot": logged["boot"], **fields}
