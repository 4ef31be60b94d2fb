"""Loop: rate and attitude loop of one axis, from the identified plant and the autopilot's own gains."""

from mavdem.condition.loop.advice import TARGETS, Advice, advise, margin_rating
from mavdem.condition.loop.loop import Loop, loop, loop_of
from mavdem.condition.loop.margins import OpenLoop as OpenLoop

__all__ = ["TARGETS", "Advice", "Loop", "advise", "loop", "loop_of", "margin_rating"]
