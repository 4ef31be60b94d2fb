"""The formats (F) of a ULog file: how many bytes a topic's messages have, and where their time stamp is.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

from __future__ import annotations

import re
from typing import NamedTuple

# Bounded, so that a long stretch of letters is not read again from each of them.
FORMAT = re.compile(rb"([\w/-]{1,255}):((?:\w{1,255}(?:\[\d{1,4}\])? \w{1,255};)+)")
"""What a format says: its name, and its fields."""
SIZES = {"int8_t": 1, "uint8_t": 1, "bool": 1, "char": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4}
SIZES |= {"float": 4, "int64_t": 8, "uint64_t": 8, "double": 8}
"""Bytes of the types that are no formats."""

_FIELD = re.compile(rb"(\w+)(?:\[(\d+)\])? (\w+);")
_LARGEST, _NESTED = 0xFFFF, 16


class Layout(NamedTuple):
    """How the fields of a format lie in a message.

    Attributes:
        size: bytes of all.
        unpadded: bytes without the padding at the end.
        values: single values in it, those of the formats it is made of included.
        stamp: where the time stamp is; -1 where there is none.
        nested: formats inside one another, itself included.
    """

    size: int
    unpadded: int
    values: int
    stamp: int = -1
    nested: int = 0


class _Field(NamedTuple):
    """One value of ``kind``, which may be another format, or an array of as many as ``length`` says if it is not 0."""

    kind: bytes
    length: int
    name: bytes


_BASIC = {kind.encode(): Layout(size, size, 1) for kind, size in SIZES.items()}


class Formats:
    """The formats of a file; ``layouts`` has those, by name, whose parts are all there.

    A format may come before those it is made of. Each is laid out once, when the last of them is: a few formats that
    hold each other many times over would else take forever. One that holds itself never is, nor is one too large.
    """

    def __init__(self) -> None:
        self.layouts: dict[bytes, Layout] = {}
        self._fields: dict[bytes, list[_Field]] = {}
        self._missing: dict[bytes, int] = {}
        self._awaited: dict[bytes, list[bytes]] = {}

    def add(self, name: bytes, fields: bytes) -> bool:
        """Takes what ``FORMAT`` found, if it is the first of its name and makes sense; says whether."""
        found = [_Field(kind, int(length or 0), field) for kind, length, field in _FIELD.findall(fields)]
        if name in self._fields or len({field.name for field in found}) != len(found):
            return False
        self._fields[name] = found
        parts = {field.kind for field in found if field.kind not in _BASIC and field.kind not in self.layouts}
        self._missing[name] = len(parts)
        for part in parts:
            self._awaited.setdefault(part, []).append(name)
        whole = [] if parts else [name]
        while whole:
            whole += self._lay_out(whole.pop())
        return True

    def _lay_out(self, name: bytes) -> list[bytes]:
        """Lays out one whose parts are; answers with those that waited for nothing but it."""
        layout = _layout([(field, _BASIC.get(field.kind) or self.layouts[field.kind]) for field in self._fields[name]])
        if layout is None:
            return []
        self.layouts[name] = layout
        waiting = self._awaited.pop(name, [])
        for other in waiting:
            self._missing[other] -= 1
        return [other for other in waiting if not self._missing[other]]


def _layout(fields: list[tuple[_Field, Layout]]) -> Layout | None:
    size = values = unpadded = 0
    stamp = -1
    for field, part in fields:
        if (field.kind, field.length, field.name) == (b"uint64_t", 0, b"timestamp"):
            stamp = size
        size += part.size * max(field.length, 1)
        values += part.values * max(field.length, 1)
        if not field.name.startswith(b"_padding"):
            unpadded = size
    nested = 1 + max(part.nested for _, part in fields)
    return Layout(size, unpadded, values, stamp, nested) if size <= _LARGEST and nested <= _NESTED else None
