"""Header of a flight's page: facts on vehicle and flight, lights, and how sure the figures of a model are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import degrees, isfinite
from typing import TYPE_CHECKING, NamedTuple

from mavdem.analysis import LogAnalysis
from mavdem.analysis.findings import known_wind
from mavdem.assessment import Assessment
from mavdem.confidence import LEVEL
from mavdem.evaluate.held_out import FORECAST
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Purpose
from mavdem.facts.event import Event
from mavdem.health.in_flight import MotorAlarm, losses_of
from mavdem.report.labels import Labels
from mavdem.report.numbers import TORQUE, readable, rounded, with_unit
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


def key_figures(assessment: Assessment) -> Iterator[KeyFigure]:
    """Yields the lights, and how sure the figures of a model are."""
    yield from light_tiles(assessment.lights)
    analysis = assessment.analysis
    if analysis is None:
        return
    learned = analysis.learned
    held_out = analysis.held_out
    levels = {finding.purpose: finding.grade.level for finding in analysis.findings.purposes}
    physical = None if learned is None else learned.physical
    if learned is not None and (torque := known_wind(learned.wind_torque, physical)) is not None:
        remark = f"on {Labels.of(learned).output_names[0]}, standard deviation"
        sd = with_unit(torque.sd, TORQUE)
        yield KeyFigure("Wind torque", sd, remark, levels.get(Purpose.WIND_TORQUE))
    if physical is not None and physical.identifiable:
        mean, half = physical.mean_effect(LEVEL)
        remark = f"90 % interval of the motors' mean; {physical.status['effect']}"
        share = f"± {100 * half / mean:.0f} %"
        effect = levels.get(Purpose.CONTROL_EFFECTIVENESS)
        yield KeyFigure("Control effectiveness", share, remark, effect)
    if learned is not None and held_out is not None:
        unit = readable(Labels.of(learned).output_units[0])
        baseline = held_out.best_baseline
        ours, theirs = (with_unit(held_out.rmse(name)[0], unit) for name in (FORECAST, baseline))
        remark = f"{held_out.seconds:.2g} s ahead, RMSE {ours} (“{baseline}” {theirs})"
        ratio = rounded(held_out.error_ratio())
        yield KeyFigure("Error ratio", ratio, remark, levels.get(Purpose.PREDICTION))


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
