"""Margins: the light on the loops' margins where they are identified, or else on resonances that the log shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians

from mavdem.alignment.drive import AXES, TILT_AXES
from mavdem.alignment.signals import MINIMUM_RATE, usual_rate
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flown import settled, worst
from mavdem.condition.loop.loop import TARGETS, Loop, margin_rating
from mavdem.condition.resonance import Resonance, resonance_of
from mavdem.confidence import LEVEL
from mavdem.facts import Fact, Level
from mavdem.facts.margins import MarginsLight

LEAST = TARGETS["sharp"]
USUAL = TARGETS["default"]
"""The least margins that are advised, surely below which a loop is bad; and the usual ones."""


@dataclass(frozen=True, eq=False)
class AxisMargins:
    """What is known of the margins of one axis."""

    axis: str
    loop: Loop | Fact | None
    """Identified, or why not."""
    resonance: Resonance | None
    """The largest response of the rate to its setpoint, or a peak of the rate's spectrum."""

    @property
    def facts(self) -> Iterator[Fact]:
        """What is said of it: of the loops, of the response, and else of the spectrum."""
        is_known = isinstance(self.loop, Loop) and self.loop.agrees is not False
        if is_known and isinstance(self.loop, Loop):
            yield _of_loop(self.loop)
        found = self.resonance
        if found is not None and (found.by_setpoint or not is_known):
            yield _of_resonance(found)


def margins_of(evidence: Evidence) -> tuple[AxisMargins, ...]:
    """Returns what is known of the margins of roll, pitch and yaw."""
    signals = evidence.signals
    parts = settled(evidence)
    return tuple(
        AxisMargins(axis, evidence.loops.get(axis), resonance_of(signals.about(axis), parts))
        for axis in AXES
    )


def margins_light(evidence: Evidence) -> Fact:
    """Returns the light on margins: a limit cycle, or the worst of the axes; else what keeps them from being known."""
    oscillation = evidence.condition.oscillation
    if oscillation is not None:
        return Fact(
            MarginsLight.OSCILLATES,
            Level.BAD,
            subject=oscillation.axis,
            frequency=oscillation.frequency,
            turn_rate=radians(oscillation.rate),
        )
    found = [fact for axis in margins_of(evidence) for fact in axis.facts]
    if found and (light := worst(found)).level in (Level.BAD, Level.WATCH):
        return light
    enough = [fact for fact in found if fact.level is Level.GOOD]
    names = dict.fromkeys(fact.figures["axis"] for fact in enough)
    if names.keys() & set(TILT_AXES):
        return enough[0].but(names=tuple(names))
    refusals = [fact for fact in evidence.loops.values() if isinstance(fact, Fact)]
    because = refusals[0] if refusals else evidence.verdict.reason
    streams = evidence.signals.attitude, evidence.signals.drive
    return Fact(
        MarginsLight.MARGINS_UNKNOWN,
        because=because,
        rate=min((usual_rate(stream) for stream in streams if stream is not None), default=None),
        least_rate=MINIMUM_RATE,
    )


def _of_loop(loop: Loop) -> Fact:
    """Good with the margins of the default, and surely the least; bad surely without these."""
    sure = loop.sure_of(LEAST)
    rating = margin_rating(loop)
    level = Level.WATCH
    if sure >= LEVEL and rating.level is not Level.BAD:
        level = Level.GOOD
    elif sure <= 1 - LEVEL:
        level = Level.BAD
    return Fact(
        MarginsLight.LOOP_MARGINS, level, subject=rating.subject, axis=loop.axis, **rating.figures
    )


def _of_resonance(found: Resonance) -> Fact:
    """Unknown where the response was not seen far enough, or not surely enough."""
    code = MarginsLight.RATE_STANDS_OUT
    level = Level.WATCH
    if found.ms_interval is not None:
        low, high = found.ms_interval
        code = MarginsLight.RESONATES
        if low > LEAST.ms:
            level = Level.BAD
        elif high < USUAL.ms and found.whole:
            code = MarginsLight.NO_RESONANCE
            level = Level.GOOD
        elif low <= USUAL.ms:
            level = Level.UNKNOWN
    return Fact(
        code,
        level,
        axis=found.axis,
        ratio=found.peak,
        frequency=found.frequency,
        coherence=found.coherence,
        rate=found.highest,
    )
