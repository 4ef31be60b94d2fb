"""Live: the same pictures while the flight goes on."""

from mavdem.view.live.live_view import LiveView
from mavdem.view.live.row import Channels, Status
from mavdem.view.live.sinks import RecordingFile, Sink, Viewer
from mavdem.view.live.viewers import WebServer, native_viewer, sinks_for

__all__ = [
    "Channels",
    "LiveView",
    "RecordingFile",
    "Sink",
    "Status",
    "Viewer",
    "WebServer",
    "native_viewer",
    "sinks_for",
]
