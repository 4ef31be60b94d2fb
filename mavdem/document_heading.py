"""The heading of every JSON document that mavdem writes: its name, its schema's version, and units."""

from collections.abc import Mapping
from importlib import metadata

from mavdem.containers import JsonValues


def document_heading(document: str, version: int, units: Mapping[str, str]) -> JsonValues:
    """Returns the entries that a JSON document begins with.

    Args:
        document: Name of the document, such as ``"model"`` or ``"review"``.
        version: Version of the document's schema; it increases when a key changes its meaning or goes.
        units: Unit by dotted key of the document, such as ``{"record.dt": "s"}``.

    Returns:
        The entries ``document``, ``schema_version``, ``mavdem_version`` and ``units``, in this order.
    """
    return {
        "document": document,
        "schema_version": version,
        "mavdem_version": metadata.version("mavdem"),
        "units": dict(units),
    }
