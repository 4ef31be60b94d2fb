"""The live view: the pictures of a flight while it is flown."""

from mavdem.view.live.live_view import LiveView
from mavdem.view.live.rows import Channels
from mavdem.view.live.sinks import RecordingFile, Sink, Viewer, WebServer, native_viewer, sinks_for

__all__ = ["Channels", "LiveView", "RecordingFile", "Sink", "Viewer", "WebServer", "native_viewer", "sinks_for"]
