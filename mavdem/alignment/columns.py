"""Columns of messages as series that can be used: numbers, in time order, each stamp once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.telemetry import Columns, Telemetry

FREQUENT_ENOUGH = 0.9
"""A preferred message gives way to another only when it comes less often than this share of the other's count."""

MAX_ANGLE = 2 * np.pi  # rad: no Euler angle lies beyond, whatever the convention
MAX_BODY_RATE = np.radians(4000.0)
"""rad/s: beyond the range of the gyroscopes that autopilots carry, 2000 °/s and at most 4000."""


@dataclass(frozen=True, eq=False)
class Signal:
    """One quantity: ``values`` (N,) at ``time`` (N,) s of ``boot`` (N,)."""

    time: NDArray[np.float64]
    boot: NDArray[np.int64]
    values: NDArray[np.float64]


def floats(columns: Columns, field: str) -> NDArray[np.float64]:
    """A field of a message as floats; what is no number becomes NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray(columns[field], dtype=np.float64)


def in_order(
    time: NDArray[np.float64], boot: NDArray[np.int64], table: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], int]:
    """Time (N,), boot (N,) and table (N, k), sorted, without repeated stamps and values that are not finite.

    And the number of rows left out; one whose stamp and values are both those of another does not count.
    """
    finite = np.isfinite(table).all(axis=1) & np.isfinite(time)
    lost = int(np.count_nonzero(~finite))
    time, boot, table = time[finite], boot[finite], table[finite]
    order = np.lexsort((time, boot))
    time, boot, table = time[order], boot[order], table[order]
    new = np.ones(len(time), dtype=bool)
    new[1:] = (np.diff(time) > 0) | (np.diff(boot) > 0)
    other = np.zeros(len(time), dtype=bool)
    other[1:] = (np.diff(table, axis=0) != 0).any(axis=1)
    return time[new], boot[new], table[new], lost + int(np.count_nonzero(other & ~new))


def message_counts(telemetry: Telemetry, names: tuple[str, ...]) -> dict[str, int]:
    """How many of each message there are, of those that there are."""
    return {name: len(telemetry.messages[name]["time"]) for name in names if name in telemetry.messages}


def preferred_message(counts: Mapping[str, int]) -> str | None:
    """The first of the messages in ``counts``, the preferred first, that came about as often as the most frequent."""
    most = max(counts.values(), default=0)
    return next((name for name, count in counts.items() if count and count >= FREQUENT_ENOUGH * most), None)


def by_preference(counts: Mapping[str, int]) -> Iterator[str]:
    """The :func:`preferred_message` of ``counts``, then that of the others, and so on."""
    left = dict(counts)
    while (name := preferred_message(left)) is not None:
        yield name
        del left[name]
