"""Live: the offline path in small steps, from the bytes of a link to rows of the uniform grid."""

from mavdem.live.row import Event, Row
from mavdem.live.status import Setup, Status
from mavdem.live.stream import LiveStream

__all__ = ["Event", "LiveStream", "Row", "Setup", "Status"]
