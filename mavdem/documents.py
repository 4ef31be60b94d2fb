"""Documents: the JSON that mavdem writes; ``documents.toml`` has their versions, keys, types, units and meanings."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import metadata
from importlib.resources import files
from typing import Any, NamedTuple


@cache
def tables() -> dict[str, dict[str, dict[str, Any]]]:
    """Returns the ``documents``, by name, and the ``records`` that they are made of."""
    return tomllib.loads((files("mavdem") / "documents.toml").read_text("utf-8"))


class Key(NamedTuple):
    """A key of a record: its ``type`` as Python has it, ``unit``, ``meaning``, and whether it may be missing."""

    type: str
    unit: str
    meaning: str
    optional: bool


def keys_of(record: str) -> dict[str, Key]:
    """Returns the keys of a ``record`` by name, with those of other records that it includes."""
    keys = dict[str, Key]()
    for name, text in tables()["records"][record].items():
        if name == "*":
            keys |= {key: one for other in text.split(", ") for key, one in keys_of(other).items()}
        else:
            kind, unit, meaning = text.split("; ", 2)
            keys[name.rstrip("?")] = Key(kind, unit, meaning, name.endswith("?"))
    return keys


def units_of(record: str, path: str = "", above: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    """Yields the place below a ``path`` of each key of a ``record`` with a unit, and it; none of those ``above``."""
    for name, key in keys_of(record).items():
        if key.unit:
            yield f"{path}{name}", key.unit
        inner = next(
            (word for word in re.findall(r"\w+", key.type) if word in tables()["records"]), record
        )
        if inner not in (*above, record):
            yield from units_of(
                inner, f"{path}{name}{'.*' * key.type.count('[')}.", (*above, record)
            )


@cache
def header(name: str) -> dict[str, Any]:
    """Returns what the document of this ``name`` begins with: its name, the versions, and units by key."""
    known = tables()["documents"][name]
    versions = {
        "document": name,
        "schema_version": known["version"],
        "mavdem_version": metadata.version("mavdem"),
    }
    return versions | {"units": known.get("units") or dict(units_of(known["record"]))}
