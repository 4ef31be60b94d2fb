"""Loop: rate and attitude loop of one axis, from the identified plant and the autopilot's own gains."""

from mavdem.condition.loop.loop import Loop, loop, loop_of
from mavdem.condition.loop.margins import OpenLoop
from mavdem.condition.loop.response import MeasuredResponse

__all__ = ["Loop", "MeasuredResponse", "OpenLoop", "loop", "loop_of"]
