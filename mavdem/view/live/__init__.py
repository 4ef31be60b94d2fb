"""The live view: what a flight looks like while it is flown."""

from mavdem.view.live.content import Channels
from mavdem.view.live.live_view import LiveView
from mavdem.view.viewer import RecordingFile, Sink, Viewer, WebServer, sinks_for

__all__ = ["Channels", "LiveView", "RecordingFile", "Sink", "Viewer", "WebServer", "sinks_for"]
