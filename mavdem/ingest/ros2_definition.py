"""ROS 2 message definitions out of a file, before anything is decoded by them.

``mcap_ros2`` decodes by whatever definition it is given: one that nests without end, or a thousand million times, keeps
it busy for as long, its parser takes quadratic time over some comments and prints what it does not understand. So a
definition is read here first, line by line, and what the library is given is written anew: types and names of fields
and nothing else, of messages of bounded size.

Sources: https://mcap.dev/spec/registry#ros2msg (the text with the definitions it refers to behind lines of "=") and
https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html (the lines).
"""

from __future__ import annotations

import re
from typing import NamedTuple

LONGEST = 1 << 16
"""Characters of a definition; PX4's longest, vehicle_status, has 7000."""
MOST_VALUES = 1000
"""Values in one message, those of a fixed array counted one by one; PX4's and MAVROS's messages hold up to 100."""
PRIMITIVES = frozenset(
    {"bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32"}
    | {"int64", "uint64", "string"}
)
DEEPEST = 8
"""Messages within one another; PX4's and MAVROS's are 3 deep."""
_LOWER = "[a-z](?:_?[a-z0-9])*"
"""Names of packages and fields."""
_BETWEEN = re.compile(r"={3,}")
_OF = re.compile(rf"MSG:\s+({_LOWER})/(?:msg/)?([A-Z][A-Za-z0-9]*)", re.ASCII)
_FIELD = re.compile(
    rf"(?P<of>(?:{_LOWER}/)?[A-Za-z][A-Za-z0-9]*)(?P<longest><=\d+)?"
    rf"(?P<array>\[(?:(?P<size>[1-9]\d{{0,8}})|<=[1-9]\d{{0,8}})?\])?\s+(?P<name>{_LOWER})(?:\s.*)?",
    re.ASCII,
)
_CONSTANT = re.compile(r"[a-z0-9]+(?:<=\d+)?\s+[A-Z][A-Z0-9_]*\s*=.*", re.ASCII)


class _Field(NamedTuple):
    """A field: ``of`` is a primitive or a message's "package/Name", ``array`` as the text writes one: "[4]" or "[<=4]".

    ``size`` is that of a fixed array; 0 for others and for single values.
    """

    of: str
    array: str
    size: int
    name: str


class _Size(NamedTuple):
    """Of a message: how many ``values`` it holds, and in how many ``levels`` there are messages within it."""

    values: int
    levels: int


BUILT_IN = {"builtin_interfaces/Time": _Size(2, 0), "builtin_interfaces/Duration": _Size(2, 0)}
"""Messages that texts refer to without defining them."""


def rewritten(name: str, text: str) -> str | None:
    """The definition as the decoder may be given it.

    Args:
        name: of the message, "package/msg/Name".
        text: its definition in the encoding ``ros2msg``.

    Returns:
        Fields only, without comments, defaults and constants; None where a line is none of the language's, a type is
        not defined, there is an array of messages without a fixed size, or the text is longer than ``LONGEST``, a
        message nested deeper than ``DEEPEST`` or larger than ``MOST_VALUES``.
    """
    package, _, short = name.partition("/msg/")
    own = f"{package}/{short}"
    messages = _messages(own, text) if len(text) <= LONGEST else None
    if messages is None or (size := _size(own, messages, {}, 0)) is None or size.values > MOST_VALUES:
        return None
    written = {of: "\n".join(f"{field.of}{field.array} {field.name}" for field in messages[of]) for of in messages}
    first = written.pop(own)
    return "\n===\n".join([first, *(f"MSG: {of}\n{fields}" for of, fields in written.items())])


def _messages(own: str, text: str) -> dict[str, list[_Field]] | None:
    """The fields of each message that the text defines, the first of which is ``own``; None where a line is wrong."""
    messages: dict[str, list[_Field]] = {own: []}
    current = own
    for line in text.splitlines():
        line = line.partition("#")[0].strip()
        if not line or _BETWEEN.fullmatch(line) or _CONSTANT.fullmatch(line):
            continue
        if of := _OF.fullmatch(line):
            current = f"{of[1]}/{of[2]}"
            if current in messages:
                return None
            messages[current] = []
            continue
        field = _field(line, current.partition("/")[0])
        if field is None:
            return None
        messages[current].append(field)
    return messages


def _field(line: str, package: str) -> _Field | None:
    """The field of a line; ``package`` is that of the message it is in."""
    found = _FIELD.fullmatch(line)
    if found is None or (found["longest"] and found["of"] != "string"):
        return None
    of = found["of"] if found["of"] in PRIMITIVES or "/" in found["of"] else f"{package}/{found['of']}"
    return _Field(of, found["array"] or "", int(found["size"] or 0), found["name"])


def _size(name: str, messages: dict[str, list[_Field]], known: dict[str, _Size], depth: int) -> _Size | None:
    """What a message holds, a text or an array of any length as one value; None where that has no bound.

    Args:
        name: the message.
        messages: the fields of each that is defined.
        known: what was counted before; added to.
        depth: how many messages contain this one.
    """
    if name in known or name not in messages:
        return known.get(name) or BUILT_IN.get(name)
    values, levels = 0, 0
    for field in messages[name]:
        if field.of in PRIMITIVES:
            values += max(field.size, 1)
            continue
        # In a circle depth grows until here; where a message was counted before, at another depth, its levels tell.
        endless = depth >= DEEPEST or (field.array and not field.size)
        each = None if endless else _size(field.of, messages, known, depth + 1)
        if each is None or depth + 1 + each.levels > DEEPEST:
            return None
        values += each.values * max(field.size, 1)
        levels = max(levels, 1 + each.levels)
    known[name] = _Size(values or 1, levels)  # ROS 2 puts a byte where there is no field
    return known[name]
