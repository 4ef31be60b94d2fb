"""RecentMessages: the latest messages of one boot of a vehicle, as the columns that a log has them in."""

from collections.abc import Iterable, Sequence
from math import inf

import numpy as np

from mavdem.containers import Numbers
from mavdem.ingest.telemetry import Columns
from mavdem.live.messages import FIELDS

MAX_ROWS = 2048  # Of each message; then every second of the older half is dropped. Of parameters there are up to 1500
MAX_EVENTS = 256  # Of events, alarms and replies that wait, or are shown


class RecentMessages:
    """Messages that come slowly, by name, of the ``boot`` of this number."""

    def __init__(self, boot: int = 0) -> None:
        self.boot = boot
        self.rows: dict[str, list[tuple[float, Numbers]]] = {}

    def take(self, name: str, time: float, values: Numbers) -> None:
        """Takes a message at ``time``, s."""
        rows = self.rows.setdefault(name, [])
        rows.append((time, values))
        if len(rows) > MAX_ROWS:
            del rows[: MAX_ROWS // 2 : 2]

    def columns(self, names: Iterable[str], since: float = -inf) -> dict[str, Columns]:
        """Returns the messages of these ``names`` that came ``since`` a time, s."""
        return {
            name: columns_of(FIELDS[name], rows, self.boot)
            for name in names
            if (rows := [row for row in self.rows.get(name, ()) if row[0] >= since])
        }


def columns_of(
    fields: Sequence[str], rows: Sequence[tuple[float, Numbers]], boot: int
) -> dict[str, np.ndarray]:
    """Returns times, s, and values of ``fields`` as columns."""
    time, values = zip(*rows, strict=True)
    columns = map(np.array, zip(*values, strict=True))
    stamps = {"time": np.array(time), "boot": np.full(len(time), boot)}
    return stamps | dict(zip(fields, columns, strict=False))
