"""Heading: what every JSON document of mavdem begins with; names, numbers, and values by name."""

from collections.abc import Mapping
from importlib import metadata
from typing import Any

Names = tuple[str, ...]
Numbers = tuple[float, ...]
Values = dict[str, Any]
"""JSON values by key: a document, or a part of one."""


def heading(document: str, version: int, units: Mapping[str, str]) -> Values:
    """Returns the name of a ``document``, the ``version`` of its schema, that of mavdem, and ``units`` by key."""
    return {
        "document": document,
        "schema_version": version,
        "mavdem_version": metadata.version("mavdem"),
        "units": dict(units),
    }
