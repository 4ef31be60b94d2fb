"""Text DataFlash logs (.log), as ground stations write them: one message a line, name first, values in their units.

FMT lines define the columns as in the binary log; a line that does not match its definition is left out.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.dataflash.binary import (
    EMPTY,
    FORMAT,
    MAX_DEFINITIONS,
    TEXTS,
    DataflashRecording,
    FormatDefinition,
    MessageTable,
    defined,
    joined_tables,
)
from mavdem.ingest.mavlink.framing import Progress

_BYTE = re.compile(rb"\s*\d{1,3}\s*")  # A number of one byte as text
_Lines = list[tuple[int, bytes]]  # The lines of one definition: their numbers, and their values


def is_text(content: bytes) -> bool:
    """Whether ``content``, the beginning of a log or all of it, is a text log."""
    # Ground stations write the firmware and the date before the first FMT.
    return b"\nFMT," in b"\n" + content[:4096]


def read_text(content: bytes, progress: Progress | None = None) -> DataflashRecording:
    """The messages in the bytes of a text log; ``progress`` is called with the fraction done."""
    groups: dict[str, dict[FormatDefinition, _Lines]] = {}
    holding: dict[str, FormatDefinition] = {}
    skipped = lost = 0
    every = max(content.count(b"\n") // 100, 1)
    for number, line in enumerate(content.split(b"\n")):
        if progress is not None and number % every == 0:
            progress(min(number / (100 * every), 1.0))
        name, _, values = line.partition(b",")
        text = name.decode("latin-1").strip()
        if text == FORMAT.name and (definition := _definition(values)) is not None:
            groups.setdefault(text, {}).setdefault(FORMAT, []).append((number, values))
            group = groups.setdefault(definition.name, {})
            if definition in group or len(group) < MAX_DEFINITIONS:
                group.setdefault(definition, [])
                holding[definition.name] = definition
            else:
                holding.pop(definition.name, None)
        elif text in holding and text != FORMAT.name and values.count(b",") >= len(holding[text].fields) - 1:
            groups[text][holding[text]].append((number, values))
        elif line.strip():
            skipped += len(line) + 1
            lost += 1
    if progress is not None:
        progress(1.0)
    counts = {name: sum(map(len, group.values())) for name, group in groups.items()}
    return DataflashRecording(
        counts={name: count for name, count in counts.items() if count},
        table=lambda name: joined_tables([_decoded(*group) for group in groups.get(name, {}).items()]),
        bytes_skipped=skipped,
        repairs=(f"{lost} lines that match no definition were left out.",) if lost else (),
    )


def _definition(values: bytes) -> FormatDefinition | None:
    parts = values.split(b",", 4)
    if len(parts) < 5 or not all(_BYTE.fullmatch(part) for part in parts[:2]):
        return None
    found = defined((int(parts[0]), int(parts[1]), parts[2], parts[3], parts[4]))
    return found[1] if found else None


def _decoded(definition: FormatDefinition, lines: _Lines) -> MessageTable:
    count = len(definition.fields)
    if definition.wire is None or not count:
        return EMPTY
    # A text that is the last field may hold commas.
    rows = [(number, [value.strip() for value in values.split(b",", count - 1)]) for number, values in lines]
    numeric = [i for i, character in enumerate(definition.characters) if character not in TEXTS + "aM"]
    rows = [(number, row) for number, row in rows if all(_is_number(row[i]) for i in numeric)]
    place = np.array([number for number, _ in rows], dtype=np.int64)
    columns = {name: _column([row[i] for _, row in rows], i in numeric) for i, name in enumerate(definition.fields)}
    return MessageTable(place, columns)


def _is_number(value: bytes) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _column(values: list[bytes], numeric: bool) -> NDArray[Any]:
    # As objects: an array of bytes would give all texts the room of the longest.
    return np.array([float(value) for value in values]) if numeric else np.array(values, dtype=np.object_)
