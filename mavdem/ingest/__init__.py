"""Ingest: recorded flights as ``Log`` and ``Telemetry``."""

from typing import TYPE_CHECKING

from mavdem.ingest.telemetry import Component, Log, Telemetry, UnreadFrames
from mavdem.lazy_names import lazy_names

if TYPE_CHECKING:
    from mavdem.ingest.formats import read_log

__all__ = ["Log", "Component", "Telemetry", "UnreadFrames", "read_log"]

# The function that reads logs comes with the readers of all formats.
__getattr__ = lazy_names(__name__, {"read_log": "formats"})
