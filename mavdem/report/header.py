"""Header of a flight's page: facts on vehicle and flight, and figures on motors, wind, certainty and margins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import degrees, isfinite
from typing import TYPE_CHECKING, NamedTuple

from mavdem.analysis import LogAnalysis
from mavdem.analysis.findings import LITTLE_HEADROOM, Findings, known_wind
from mavdem.condition.loop.loop import Loop, margin_rating
from mavdem.condition.wind_of_log import Air
from mavdem.confidence import LEVEL
from mavdem.evaluate.held_out import FORECAST
from mavdem.facts import Level
from mavdem.facts.assessment import Purpose
from mavdem.facts.event import Event
from mavdem.health.in_flight import MotorAlarm
from mavdem.report.condition import wind_words
from mavdem.report.labels import Labels
from mavdem.report.numbers import TORQUE, readable, rounded, short, with_unit
from mavdem.report.timeline import Timeline
from mavdem.report.words import bare, headline

POINTS = 16_000
FEW_POINTS = 2_000
"""Of a line of the timeline: ten minutes with all that autopilots log stay within a megabyte; of a small page."""
MARGINS = {Level.GOOD: "enough", Level.WATCH: "perhaps too little", Level.BAD: "too little"}
"""What is said of the margins of a loop by the level of their rating."""

if TYPE_CHECKING:
    from mavdem.live.history import SessionStatus


class KeyFigure(NamedTuple):
    """A figure with its ``label``, a ``remark`` below it, and a ``level``, if it rates something."""

    label: str
    value: str
    remark: str = ""
    level: Level | None = None


class Head(NamedTuple):
    """The top of a flight's page: what it is of, key figures, and the timeline; a small one has no still picture."""

    findings: Findings
    analysis: LogAnalysis | None = None
    figures: Sequence[KeyFigure] = ()
    timeline: Timeline | None = None
    is_small: bool = False
    vehicle: str = ""
    events: Sequence[Event] = ()


def key_figures(
    analysis: LogAnalysis, air: Air | None, loop: Loop | None = None
) -> Iterator[KeyFigure]:
    """Yields the figures that answer which motor, how strong the wind was, and how sure all that is."""
    learned = analysis.learned
    held_out = analysis.held_out
    hover = analysis.condition.hover
    levels = {finding.purpose: finding.grade.level for finding in analysis.findings.purposes}
    yield from _lost(analysis.alarms)
    if hover is not None:
        if (trim := analysis.trim) is not None and "deviation" in trim.figures:
            most = 100 * trim.figures["deviation"]
            remark = bare(headline(trim))
            yield KeyFigure("Trim deviation", f"{most:+.1f} %", remark, trim.level)
        left, motor = min(zip(hover.headroom, hover.motors, strict=True))
        limit = max(map(sum, zip(hover.at_upper_limit, hover.at_lower_limit, strict=True)))
        remark = f"{short(motor)}; motors at a limit {100 * limit:.1f} % of the time"
        level = Level.BAD if left < LITTLE_HEADROOM else Level.GOOD
        yield KeyFigure("Least headroom", f"{100 * left:.0f} %", remark, level)
    wind, _, reason = air or (None, None, None)
    unknown = "not known", bare(reason) if reason else "", ""
    speed, origin, gusts = unknown if wind is None else wind_words(wind)
    yield KeyFigure("Wind", speed, f"{origin}{gusts}".strip("; "))
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
    if loop is not None:
        low, high = loop.rate.phase_margin_interval
        level = margin_rating(loop).level
        remark = f"{low:.0f} to {high:.0f}° of the rate loop; {MARGINS[level]} margin in all: `mavdem tune` has gains"
        yield KeyFigure("Phase margin", f"{loop.rate.phase_margin:.0f}°", remark, level)


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
    if weak := max(
        (alarm for alarm in alarms if alarm.weak), key=lambda alarm: alarm.size, default=None
    ):
        yield KeyFigure(
            f"{weak.name.capitalize()} lost",
            weak.lost,
            f"of its thrust at {weak.since:.0f} s",
            Level.BAD,
        )
