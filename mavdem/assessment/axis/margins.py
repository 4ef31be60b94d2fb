"""Margins of an axis: of its loops where they are identified, or else resonances that the log shows."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import isfinite

from mavdem.confidence import CONFIDENCE_LEVEL
from mavdem.dataset.axes import AXES
from mavdem.dataset.segments import Segments, recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.loops import Loops
from mavdem.facts.margins import MarginsLight
from mavdem.loops.axis_loops import (
    MARGIN_TARGETS,
    Loop,
    identified_loops,
    margin_rating,
    margin_ratios,
)
from mavdem.loops.injected_signal import injected_loop
from mavdem.loops.margins import OpenLoop
from mavdem.loops.measured_response import MIN_RESPONSE_FIT
from mavdem.loops.resonance import (
    MAX_LOOP_FREQUENCY,
    Resonance,
    setpoint_resonance,
    spectral_resonance,
)

LEAST = MARGIN_TARGETS["sharp"]
USUAL = MARGIN_TARGETS["default"]
"""The least margins that are advised, surely below which a loop is bad; and the usual ones."""

WITH_SETPOINT = (Loops.CROSSOVER_UNSEEN, Loops.LOOP_NOT_FOUND, Loops.MARGIN_UNCERTAIN)
"""Why a loop is not identified though the rate's setpoint was logged, and steered."""


@dataclass(frozen=True, eq=False)
class AxisMargins:
    """What is known of the margins of one axis."""

    axis: str
    loop: Loop | Fact | None
    """Identified and not refuted by what was measured, or why not."""
    response: Resonance | None
    """The largest response of the rate to its setpoint."""
    peak: Resonance | None
    """A peak of the rate's own spectrum, which the motors share."""
    injected: OpenLoop | None = None
    """The rate loop by system identification, without a model of the vehicle."""

    @cached_property
    def facts(self) -> Facts:
        """What is known of it: of the loops or else of the spectrum, and of the response."""
        facts = []
        if self.injected is not None:
            facts.append(_of_injected(self.axis, self.injected))
        elif isinstance(self.loop, Loop):
            facts.append(_of_loop(self.loop))
        elif self.peak is not None:
            peak = _of_resonance(MarginsLight.RATE_STANDS_OUT, None, self.peak)
            if isinstance(self.loop, Fact) and self.loop.code in WITH_SETPOINT:
                peak = peak.but(because=self.loop)
            facts.append(peak)
        if self.response is not None:
            facts.append(of_response(self.response))
        return tuple(fact for fact in facts if fact.level is not Level.UNKNOWN)


def margins_of(
    signals: Signals, parts: Segments, loops: Mapping[str, Loop | Fact]
) -> tuple[AxisMargins, ...]:
    """Returns what is known of the margins of roll, pitch and yaw, by ``parts`` of settled flight and the ``loops``.

    A loop does not count whose predicted response is not the measured one. Where that is so by far, no loop does that
    its own response does not confirm: gains or a mixer that are not those of the parameters are so for all axes.
    """
    by_far = [
        loop.disagreement
        for loop in identified_loops(loops).values()
        if loop.disagreement and loop.measured and 2 * loop.measured.agreement < MIN_RESPONSE_FIT
    ]

    def confirmed(axis: str) -> Loop | Fact | None:
        loop = loops.get(axis)
        if isinstance(loop, Loop) and not loop.agrees:
            return next(filter(None, [loop.disagreement, *by_far]), loop)
        return loop

    return tuple(
        AxisMargins(
            about.axis,
            confirmed(about.axis),
            setpoint_resonance(about, parts),
            spectral_resonance(about, parts),
            injected_loop(about, recorded_spans(about)),
        )
        for about in map(signals.for_axis, AXES)
    )


def _of_loop(loop: Loop) -> Fact:
    """Good with the margins of the default, and surely the least; bad surely without these."""
    rating = margin_rating(loop)
    sure = loop.share_meeting(LEAST)
    level = Level.BAD if sure <= 1 - CONFIDENCE_LEVEL else Level.WATCH
    if sure >= CONFIDENCE_LEVEL and not rating.is_bad:
        level = Level.GOOD
    return Fact(
        MarginsLight.LOOP_MARGINS,
        level,
        subject=rating.subject,
        axis=loop.axis,
        rating=rating.level,
        is_biased=loop.plant.bias < 0,
        **rating.figures,
    )


def _of_injected(axis: str, loop: OpenLoop) -> Fact:
    """Good with the usual margins, bad without the least."""
    lacking, little = (min(margin_ratios(target, loop).values()) < 1 for target in (LEAST, USUAL))
    return Fact(
        MarginsLight.LOOP_MEASURED,
        Level.BAD if lacking else Level.WATCH if little else Level.GOOD,
        axis=axis,
        frequency=loop.crossover,
        phase_margin=loop.phase_margin,
        gain_margin=loop.gain_margin if isfinite(loop.gain_margin) else None,
        ms=loop.ms,
    )


def of_response(resonance: Resonance) -> Fact:
    """Returns whether it resonates; unknown where it was not seen far enough, or not surely enough."""
    assert resonance.ms_interval is not None
    low, high = resonance.ms_interval
    code = MarginsLight.RESONATES
    level = Level.UNKNOWN
    if low > USUAL.ms:
        level = Level.BAD if low > LEAST.ms else Level.WATCH
    elif high < USUAL.ms:
        code = MarginsLight.NO_RESONANCE
        # a response that falls may rise again where the loop of the rate crosses over
        if resonance.rolls_off and resonance.max_frequency >= MAX_LOOP_FREQUENCY / 2:
            level = Level.GOOD
    return _of_resonance(code, level, resonance)


def _of_resonance(code: MarginsLight, level: Level | None, resonance: Resonance) -> Fact:
    return Fact(
        code,
        level,
        axis=resonance.axis,
        ratio=resonance.peak,
        frequency=resonance.frequency,
        coherence=resonance.coherence,
        rate=resonance.max_frequency,
    )
