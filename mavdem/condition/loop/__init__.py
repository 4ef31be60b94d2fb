"""Loop: rate and attitude loop of one axis, from the identified plant and the autopilot's own gains."""

from mavdem.condition.loop.advice import NOT_CHECKED, TARGETS, Advice, Tuned, advise, tuned, verdict
from mavdem.condition.loop.loop import Loop, loop, loop_of
from mavdem.condition.loop.margins import OpenLoop

__all__ = [
    "NOT_CHECKED",
    "TARGETS",
    "Advice",
    "Loop",
    "OpenLoop",
    "Tuned",
    "advise",
    "loop",
    "loop_of",
    "tuned",
    "verdict",
]
