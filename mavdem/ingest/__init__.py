"""Ingest: recorded flights as ``Log`` and ``Telemetry``."""

from mavdem.ingest.formats import read_log
from mavdem.ingest.telemetry import Component, Log, Telemetry, UnreadFrames

__all__ = ["Log", "Component", "Telemetry", "UnreadFrames", "read_log"]
