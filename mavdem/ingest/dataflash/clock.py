"""The clock of a DataFlash log: the stamps of all messages as one boot clock, and times of messages without stamps.

All messages carry one clock: TimeUS, µs since boot, or TimeMS before ArduPilot 3.3. Before 3.4 some have no stamp. A
log may contain several boots, appended.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Integers
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair
from mavdem.ingest.dataflash.recording import MessageTable
from mavdem.ingest.dataflash.states import ARMING_EVENTS
from mavdem.ingest.mavlink.clock_readings import MessageStamps, Rows
from mavdem.ingest.mavlink.clocks import boot_clock
from mavdem.ingest.telemetry import Columns, Tables, repair_facts, selected_rows

CLOCK_FIELDS = {"TimeUS": 1e6, "TimeMS": 1e3}
"""Fields with the time since boot, and their units per second; where a message has both, the last counts."""

MESSAGES_WITH_OLD_STAMPS = ("MSG", "PARM")
"""Messages whose stamps are not used as a clock: those of the start are older than the messages around them."""

UNSTAMPED_MESSAGES = ("EV", "ARM", "ERR", "MODE", *MESSAGES_WITH_OLD_STAMPS)
"""Messages that are used also where they have no stamp, as before ArduCopter 3.4.

Without a stamp they have the time of the message before them; with an old one (MSG, PARM), their own, as far as it lies
between those of their neighbours.
"""

MAX_STAMP_SECONDS = 2.0**63 / 1e6
"""Bound of stamps, s: TimeUS in a signed integer of 64 bits. Damaged stamps lie beyond it."""


class LogClock(NamedTuple):
    """The n messages of all names that have a stamp, in the order of the log."""

    names: tuple[str, ...]
    """Names of these messages."""

    positions: Integers
    """Position (n,) of each."""

    seconds: Array
    """Its stamp (n,), s."""

    rows: Mapping[str, Integers]
    """Row of each message of a name among these, by the name."""


def log_clock(logged_tables: Mapping[str, MessageTable]) -> LogClock:
    """Merges the stamps of all messages into one clock, in the order of the log.

    ``MESSAGES_WITH_OLD_STAMPS`` are left out: their stamps may be older than the messages before them.

    Args:
        logged_tables: Decoded columns and file positions of all messages, by name.

    Returns:
        Names of the messages with stamps, positions in the file and times, s, of all N stamps in the order of the log,
        and for each name the rows of its messages among these.
    """
    stamps: dict[str, Array] = {}
    for name, table in logged_tables.items():
        table_stamps = stamps_of_table(table)
        if table_stamps is not None and name not in MESSAGES_WITH_OLD_STAMPS:
            stamps[name] = table_stamps
    names = tuple(stamps)
    if not names:
        return LogClock((), np.zeros(0, dtype=np.int64), np.zeros(0), {})
    # The stamps of all messages, first in the order of the names, then sorted into the order of the log.
    positions = np.concatenate([logged_tables[name].position for name in names])
    seconds = np.concatenate([stamps[name] for name in names])
    order = np.argsort(positions, kind="stable")
    # The inverse permutation gives, for each stamp in the order of the names, its row in the order of the log.
    sorted_row = np.empty(len(order), dtype=np.int64)
    sorted_row[order] = np.arange(len(order))
    message_counts = [len(logged_tables[name].position) for name in names]
    rows_of_messages = np.split(sorted_row, np.cumsum(message_counts)[:-1])
    rows_by_name = dict(zip(names, rows_of_messages, strict=True))
    return LogClock(names, positions[order], seconds[order], rows_by_name)


def stamps_of_table(table: MessageTable) -> Array | None:
    """Returns the stamps (n,), s, of the messages of one name; None if they have none."""
    stamps = None
    for field, units_per_second in CLOCK_FIELDS.items():
        if field in table.columns:
            stamps = table.columns[field] / units_per_second
    return stamps


def on_boot_clock(
    logged_tables: Mapping[str, MessageTable], clock: LogClock
) -> tuple[Tables, Facts]:
    """Puts the messages that have stamps, and the ``UNSTAMPED_MESSAGES``, on the boot clock.

    The stamps of all messages, in the order of the log, give one clock with boots counted and outliers found. Each
    message then looks up its own stamp there. Messages without a stamp are placed between their neighbours.

    Args:
        logged_tables: The messages by name.
        clock: The stamps of all of them. Impossible ones are set to 0 in place.

    Returns:
        Their columns, with ``time`` (s) and ``boot``, and facts that report what was repaired. Messages with impossible
        or outlying stamps are left out.
    """
    if not clock.names:
        return {}, ()
    # All messages have one clock: their stamps, in the order of the log, are read like the stamps of one message.
    positions = clock.positions
    seconds = clock.seconds
    # A damaged stamp may be anything, if it is a float or a text.
    is_impossible = ~((seconds >= 0) & (seconds <= MAX_STAMP_SECONDS))
    # The boot clock takes a stamp of 0 for none.
    seconds[is_impossible] = 0.0
    all_messages = ""
    boot_times, clock_repairs, _ = boot_clock(
        [MessageStamps(all_messages, np.arange(len(positions)), seconds)]
    )
    time, boot = boot_times[all_messages]
    tables: dict[str, Columns] = {}
    for name, table in logged_tables.items():
        if name in clock.names:
            rows = clock.rows[name]
            table_time = time[rows]
            tables[name] = {**table.columns, "time": table_time, "boot": _boots_of_rows(boot, rows)}
            # A message whose stamp was ignored has the time of the one before it: it is not to be trusted either.
            is_trusted = table_time == seconds[rows]
            if not is_trusted.all():
                tables[name] = selected_rows(tables[name], is_trusted)
        elif name in UNSTAMPED_MESSAGES and len(table.position):
            # The row of the stamped message after each.
            rows = np.searchsorted(positions, table.position)
            tables[name] = _with_times_of_neighbours(name, table, rows, time, boot)
    count = np.count_nonzero(is_impossible)
    impossible_stamps = repair_facts(
        Repair.LOGGED_MESSAGES_LEFT_OUT, count=count, flaw=Flaw.IMPOSSIBLE_STAMP
    )
    return tables, impossible_stamps + clock_repairs


def _boots_of_rows(boot: Rows, rows: NDArray[np.signedinteger]) -> Rows:
    """Returns the boot of the autopilot in which each of some messages was written.

    Args:
        boot: Number of the boot (n,), from 0, of each message of the log.
        rows: Indices (N,) of the messages among all messages of the log.

    Returns:
        Numbers of their boots (N,). If the log has only one boot, they are a view of a single 0, which saves memory.
    """
    has_single_boot = not boot.any()
    if has_single_boot:
        return np.broadcast_to(np.int64(0), len(rows))
    return boot[rows]


def _with_times_of_neighbours(
    name: str,
    table: MessageTable,
    next_rows: NDArray[np.signedinteger],
    time: Array,
    boot: Rows,
) -> Columns:
    """Gives times to messages that have no stamps, or old ones, by the stamped messages before and after them.

    A message was logged between its stamped neighbours in the file. If it has a stamp, this is clipped to the interval
    between them; but a text (MSG) before all stamped messages keeps its earlier stamp. Without a stamp, a message gets
    the time of the neighbour before it. Only the event of arming gets the time of the neighbour after it: by default
    nothing is logged while the vehicle is disarmed, and arming ends this gap.

    Args:
        name: Name of the messages, such as PARM.
        table: The messages (N,).
        next_rows: Row (N,) of the first stamped message after each, in the order of the log.
        time: Times (S,) of all stamped messages on the boot clock, s.
        boot: Numbers (S,) of their boots.

    Returns:
        The columns with ``time`` and ``boot``.
    """
    row_before = np.maximum(next_rows - 1, 0)
    row_after = np.minimum(next_rows, len(time) - 1)
    stamps = stamps_of_table(table)
    if stamps is None:
        is_arming = np.isin(table.columns.get("Id", 0), ARMING_EVENTS)
        ends_gap = (name == "EV") & is_arming & (boot[row_after] == boot[row_before])
        # These are clipped below, to the time of the neighbour after the message (∞) or before it (−∞).
        stamps = np.where(ends_gap, np.inf, -np.inf)
    earliest = time[row_before]
    if name == "MSG":
        # A text from before the beginning of the log, such as "Arming motors", keeps the time at which it was sent.
        earliest = np.where((next_rows == 0) & (stamps > 0), 0.0, earliest)
    latest = np.maximum(time[row_after], earliest)
    return {
        **table.columns,
        "time": np.clip(stamps, earliest, latest),
        "boot": boot[row_before],
    }
