"""Ingest: recorded flights as ``Log`` and ``Telemetry``."""

from typing import TYPE_CHECKING, Any

from mavdem.ingest.telemetry import Component, Log, Telemetry, UnreadFrames

if TYPE_CHECKING:
    from mavdem.ingest.formats import read_log

__all__ = ["Log", "Component", "Telemetry", "UnreadFrames", "read_log"]


def __getattr__(name: str) -> Any:
    """Imports the function that reads logs when it is first used (PEP 562), with the readers of all formats."""
    if name == "read_log":
        from mavdem.ingest.formats import read_log

        return read_log
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
