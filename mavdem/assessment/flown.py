"""What was measured in flight: off the ground, and until the vehicle was lost, whose end is no fault of all else."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from itertools import pairwise
from math import inf

import numpy as np

from mavdem.alignment import phases
from mavdem.alignment.align import Segment
from mavdem.alignment.drive import Signal
from mavdem.assessment.evidence import Evidence
from mavdem.condition.condition import settled_parts
from mavdem.facts import Code, Fact, Level
from mavdem.ingest.telemetry import Array

INJECTED = frozenset({"Autotune", "Systemid"})
"""ArduPilot's modes that move the vehicle themselves, to and over what its gains allow."""
SEVERITY = (Level.UNKNOWN, Level.GOOD, Level.WATCH, Level.BAD)


def before_loss(evidence: Evidence, boot: int) -> phases.Intervals:
    """Returns the time of ``boot`` until the vehicle was lost."""
    ending = evidence.ending
    if ending is None or ending.figures.get("boot", boot) != boot:
        return [(-inf, inf)]
    return [(-inf, ending.time or inf)]


def flights(evidence: Evidence, boot: int) -> phases.Intervals:
    """Returns where the vehicle flew in a ``boot``."""
    signals = evidence.signals
    flown = phases.off_ground(phases.flying(signals, boot), signals, boot)
    return phases.both(flown, before_loss(evidence, boot))


def flown(evidence: Evidence, signal: Signal | None) -> Iterator[Signal]:
    """Yields what of a ``signal`` was measured in each flight."""
    if signal is None:
        return
    for boot in np.unique(signal.boot):
        here = signal.boot == boot
        for flight in flights(evidence, int(boot)):
            rows = here & phases.during(signal.time, [flight])
            if rows.any():
                yield Signal(signal.time[rows], signal.boot[rows], signal.values[rows])


def settled(evidence: Evidence, without: frozenset[str]) -> tuple[Segment, ...]:
    """Returns settled flight, until the vehicle was lost, in other modes than those."""
    signals = evidence.signals
    found = list[Segment]()
    for part in settled_parts(signals):
        changes = [*signals.modes(part.boot), (inf, "")]
        left_out = [
            (start, end) for (start, name), (end, _) in pairwise(changes) if name in without
        ]
        spans = phases.both([(part.start, part.end)], phases.outside(left_out))
        spans = phases.both(spans, before_loss(evidence, part.boot))
        found += [Segment(part.boot, *span) for span in spans]
    return tuple(found)


def reported(evidence: Evidence, codes: Container[Code]) -> Iterator[Fact]:
    """Yields what the autopilot warned of in flight, of these kinds."""
    for event in evidence.events:
        if event.code in codes and event.level in (Level.WATCH, Level.BAD):
            time = np.array([event.time])
            if phases.during(time, flights(evidence, event.figures["boot"])).any():
                yield event


def averaged(evidence: Evidence, signal: Signal | None) -> Array:
    """Returns the means over 2 s of a ``signal`` in flight."""
    means = [phases.average(part) for part in flown(evidence, signal)]
    return np.concatenate([np.zeros(0), *means])


def worst(facts: Iterable[Fact]) -> Fact:
    """Returns the worst of the facts, the first of such."""
    return max(facts, key=lambda fact: SEVERITY.index(fact.level))
