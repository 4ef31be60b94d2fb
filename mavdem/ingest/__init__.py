"""Ingest: recorded flights as ``Log`` and ``Telemetry``."""

from mavdem.ingest.formats import read_log
from mavdem.ingest.telemetry import Component, Log, Telemetry, Unread

__all__ = ["Log", "Component", "Telemetry", "Unread", "read_log"]
