"""Live: the offline path in small steps, from the bytes of a link to aligned rows, and a model learnt from them."""

from mavdem.live.aligner import AlignedRow, Setup
from mavdem.live.history import Event, SessionStatus
from mavdem.live.stream import LiveStream

__all__ = ["AlignedRow", "Event", "LiveStream", "SessionStatus", "Setup"]
