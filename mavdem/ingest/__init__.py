"""Ingest: recorded flights as ``Log`` and ``Telemetry``."""

from mavdem.ingest.formats import read_log
from mavdem.ingest.log import Component, Log, Unread
from mavdem.ingest.telemetry import Telemetry

__all__ = ["Log", "Component", "Telemetry", "Unread", "read_log"]
