"""Text DataFlash logs (.log), as ground stations write them: one message a line, name first, values in their units.

FMT lines define the columns as in the binary log; a line that does not fit its definition is left out.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.dataflash_definition import (
    EMPTY,
    FORMAT,
    MOST_DEFINITIONS,
    TEXTS,
    Definition,
    Recording,
    Table,
    defined,
    joined,
)
from mavdem.ingest.framing import Progress

FORMAT_VALUES = 5
PREAMBLE = 4096
"""Bytes within which the first FMT stands: ground stations put the firmware and the date before it."""
_BYTE = re.compile(rb"\s*\d{1,3}\s*")
"""What a number of one byte is written as."""
_Lines = list[tuple[int, bytes]]
"""The lines of one definition: their numbers, and their values."""


def is_text(content: bytes) -> bool:
    """Whether the first bytes of a log, or the whole of it, are those of a text log."""
    return (b"\n" + content[:PREAMBLE]).find(b"\nFMT,") >= 0


def read_text(content: bytes, progress: Progress | None = None) -> Recording:
    """The messages in the bytes of a text log; ``progress`` is called with the fraction done."""
    groups: dict[str, dict[Definition, _Lines]] = {}
    holding: dict[str, Definition] = {}
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
            if definition in group or len(group) < MOST_DEFINITIONS:
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
    return Recording(
        counts={name: count for name, count in counts.items() if count},
        table=lambda name: joined([_decoded(*group) for group in groups.get(name, {}).items()]),
        bytes_skipped=skipped,
        repairs=(f"{lost} lines that fit no definition were left out.",) if lost else (),
    )


def _definition(values: bytes) -> Definition | None:
    parts = values.split(b",", FORMAT_VALUES - 1)
    if len(parts) < FORMAT_VALUES or not (_BYTE.fullmatch(parts[0]) and _BYTE.fullmatch(parts[1])):
        return None
    found = defined((int(parts[0]), int(parts[1]), parts[2].strip(), parts[3].strip(), parts[4].strip()))
    return found[1] if found else None


def _decoded(definition: Definition, lines: _Lines) -> Table:
    count = len(definition.fields)
    if definition.wire is None or not count:
        return EMPTY
    # A text that is the last field may hold commas.
    rows = [(number, [value.strip() for value in values.split(b",", count - 1)]) for number, values in lines]
    numeric = [i for i, character in enumerate(definition.characters) if character not in TEXTS + "aM"]
    rows = [(number, row) for number, row in rows if all(_is_number(row[i]) for i in numeric)]
    place = np.array([number for number, _ in rows], dtype=np.int64)
    columns = {name: _column([row[i] for _, row in rows], i in numeric) for i, name in enumerate(definition.fields)}
    return Table(place, columns)


def _is_number(value: bytes) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _column(values: list[bytes], numeric: bool) -> NDArray[Any]:
    # As objects: an array of bytes would give all texts the room of the longest.
    return np.array([float(value) for value in values]) if numeric else np.array(values, dtype=np.object_)
