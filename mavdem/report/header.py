"""Header of a flight's page: facts on vehicle and flight, lights, and how sure the figures of a model are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import degrees, isfinite
from typing import TYPE_CHECKING, NamedTuple

from mavdem.analysis import LogAnalysis
from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.health.in_flight import MotorAlarm, losses_of
from mavdem.report.timeline import Timeline

POINTS = 16_000
FEW_POINTS = 2_000
"""Of a line of the timeline: ten minutes with all that autopilots log stay within a megabyte; of a small page."""

if TYPE_CHECKING:
    from mavdem.live.history import SessionStatus


class KeyFigure(NamedTuple):
    """A figure with its ``label``, a ``remark`` below it, and a ``level``, if it rates something."""

    label: str
    value: str
    remark: str = ""
    level: Level | None = None


class Head(NamedTuple):
    """The top of a flight's page: how bad it is, key figures, and the timeline; a small one has no still picture."""

    level: Level
    analysis: LogAnalysis | None = None
    figures: Sequence[KeyFigure] = ()
    timeline: Timeline | None = None
    is_small: bool = False
    vehicle: str = ""
    events: Sequence[Event] = ()


def light_tiles(lights: Mapping[str, Fact]) -> Iterator[KeyFigure]:
    """Yields each of the ``lights``."""
    for name, fact in lights.items():
        yield KeyFigure(name.capitalize(), fact.level, str(fact), fact.level)


def live_figures(status: SessionStatus) -> Iterator[KeyFigure]:
    """Yields those of a live flight."""
    yield from _lost(status.alarms)
    if status.wind is not None:
        speed, *origin = map(str, status.wind.facts)
        yield KeyFigure("Wind", speed, f"{' '.join(origin)} at {status.wind.time:.0f} s")
    seconds, half = status.ahead
    if isfinite(half):
        yield KeyFigure(
            "Prediction", f"± {degrees(half):.1f}°", f"{seconds:.2g} s ahead, 90 % band at the end"
        )


def _lost(alarms: Sequence[MotorAlarm]) -> Iterator[KeyFigure]:
    """The worst that lasts, or else the worst that a motor lost."""
    for lost in losses_of(alarms)[:1]:
        low, high = lost.figures["loss"]
        until = "" if lost.until is None else f", until {lost.until:.0f} s"
        yield KeyFigure(
            f"{lost.subject.capitalize()} lost",
            f"{100 * low:.0f} to {100 * high:.0f} %",
            f"of its thrust at {lost.time:.0f} s{until}",
            lost.level,
        )
