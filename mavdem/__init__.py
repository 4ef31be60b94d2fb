"""mavdem: what a multirotor really does in wind, learnt from its flights by Dynamic Expectation Maximization."""

from mavdem import evaluate
from mavdem.dem import Learned, Settings, learn
from mavdem.errors import NotLearnable, Unreadable
from mavdem.flight import Flight
from mavdem.read import read_flight
from mavdem.telemetry import Telemetry

__all__ = [
    "Flight",
    "Learned",
    "NotLearnable",
    "Settings",
    "Telemetry",
    "Unreadable",
    "evaluate",
    "learn",
    "read_flight",
]
