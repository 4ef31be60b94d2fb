"""A DataFlash log whose messages were found, and the table of the messages of one name that is decoded from it."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Integers
from mavdem.facts import Facts
from mavdem.ingest.telemetry import Columns


class MessageTable(NamedTuple):
    """The N messages of one name."""

    position: Integers
    """Position (N,) of each message in the log, increasing: its byte offset, or the number of its line."""
    columns: Columns
    """Columns by field name, (N,) or (N, 32), in the field's unit; texts are bytes, ``S`` or objects."""
    unreadable: int = 0
    """Number of further messages, left out since a number in them cannot be read; of a text log."""


EMPTY_TABLE = MessageTable(np.zeros(0, dtype=np.int64), {})
"""The table of a message that does not occur."""


class DataflashRecording(NamedTuple):
    """A DataFlash log, binary or text, whose messages were found and not decoded yet."""

    counts: Mapping[str, int]
    """Number of messages by name."""
    decode: Callable[[str], MessageTable]
    """Decodes the messages of one name; none for a name that does not occur or has inconsistent fields."""
    bytes_skipped: int
    """Number of bytes that belong to no message."""
    size: int
    """Number of bytes of the log."""
    repairs: Facts
    """What was odd or damaged."""
    undefined_messages: int = 0
    """Number of headers in a binary log that belong to no message found, since their definitions are missing.

    They are counted only where most of the log could not be read.
    """


NON_NUMERIC_FIELDS = ("Message", "Name", "x", "y", "z")
"""Fields with a text or an array per message that are used: those of MSG, PARM and ISBD."""

CODE_FIELDS = ("Subsys", "ECode", "Id", "Mode", "ModeNum", "Rsn", "ArmState")
"""Fields whose number is a code: those of ERR, EV, MODE and ARM."""


def usable_fields(table: MessageTable) -> MessageTable:
    """Leaves out the fields of a table that no reader can use.

    A usable field has one number per message, or is one of ``NON_NUMERIC_FIELDS``, the texts and arrays that are read.
    A damaged definition may turn any field into a text or an array, and a code, such as the number of an event, into a
    float.

    Args:
        table: The decoded messages of one name.

    Returns:
        The table with its usable fields.
    """
    columns = {}
    for name, values in table.columns.items():
        is_numeric = values.ndim == 1 and values.dtype.kind in "iuf"
        is_broken_code = name in CODE_FIELDS and values.dtype.kind == "f"
        if name in NON_NUMERIC_FIELDS or (is_numeric and not is_broken_code):
            columns[name] = values
    return table._replace(columns=columns)
