"""Live: the offline path in small steps, from the bytes of a link to aligned rows, and a model learned from them."""

from mavdem.facts.event import Event
from mavdem.live.decisions import RowFormat
from mavdem.live.rows import AlignedRow
from mavdem.live.session_status import SessionStatus
from mavdem.live.stream import LiveStream

__all__ = ["AlignedRow", "Event", "LiveStream", "SessionStatus", "RowFormat"]
