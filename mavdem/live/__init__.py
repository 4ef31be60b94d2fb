"""Live flights: from the bytes of a link to aligned rows, a model learned from them, and alarms, as they come."""

from mavdem.facts.event import Event
from mavdem.live.rows import AlignedRow, RowFormat
from mavdem.live.session_status import SessionStatus
from mavdem.live.stream import LiveStream

__all__ = ["AlignedRow", "Event", "LiveStream", "RowFormat", "SessionStatus"]
