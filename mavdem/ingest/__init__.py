"""Ingest: recorded flights as ``Log`` and ``Telemetry``."""

from mavdem.ingest.formats import read_log
from mavdem.ingest.log import Log, Speaker, Unread

__all__ = ["Log", "Speaker", "Unread", "read_log"]
