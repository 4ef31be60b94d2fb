"""Header of a flight's page: facts on vehicle and flight, lights, and the timeline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mavdem.analysis import LogAnalysis
from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.report.timeline import Timeline

POINTS = 16_000
FEW_POINTS = 2_000
"""Of a line of the timeline: ten minutes with all that autopilots log stay within a megabyte; of a small page."""


class Head(NamedTuple):
    """The top of a flight's page: how bad it is, the lights, and the timeline; a small one has no still picture."""

    level: Level
    analysis: LogAnalysis | None
    lights: Mapping[str, Fact]
    timeline: Timeline | None = None
    is_small: bool = False
    vehicle: str = ""
    events: Sequence[Event] = ()
