"""Evidence: what lights and headline of one vehicle are judged by, read from the log once.

What was measured counts in flight only: off the ground, and until the vehicle was lost, whose end is no fault of all
else.
"""

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.margins import AxisMargins, margins_of
from mavdem.assessment.axis.overrides import overrides_of
from mavdem.assessment.condition import Condition
from mavdem.assessment.flights import settled_flight
from mavdem.dataset import intervals, phases
from mavdem.dataset.learnability import Learnability
from mavdem.dataset.segments import Segment, Segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Code, Fact, Facts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.lights import Unjudged
from mavdem.ingest import Log
from mavdem.loops.advice import gain_reduction_advice
from mavdem.loops.axis_loops import Loop
from mavdem.wind_velocity.from_log import WindEvidence

INJECTED = frozenset({"Autotune", "Systemid"})
"""ArduPilot's modes that move the vehicle themselves, to and over what its gains allow."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a log says of one vehicle before it is judged.

    Attributes:
        log, signals: the log, and the signals of the vehicle, about roll.
        learnability: whether a full model of roll can be learned.
        condition: balance, limits, lean, vibration and battery.
        air: the wind in m/s, or why it is not known.
        events: what happened, in order of boot and time; the thrust that motors lost is among it.
        ending: how a flight that was lost was lost, and what failed first; None where none was.
        loops: the control loops of each axis, or why they are not known.
    """

    log: Log
    signals: Signals
    learnability: Learnability
    condition: Condition
    air: WindEvidence = WindEvidence(None, None, Fact(Unjudged.NOT_JUDGED, because=None))
    events: Facts = ()
    ending: Fact | None = None
    loops: Mapping[str, Loop | Fact] = field(default_factory=dict)

    @cached_property
    def margins(self) -> tuple[AxisMargins, ...]:
        """What is known of the margins of roll, pitch and yaw."""
        return margins_of(self.signals, self.settled(INJECTED), self.loops)

    @cached_property
    def grounds(self) -> Facts:
        """Why the vehicle must not fly again as it is: it was lost, it oscillates, or a motor is at its limit.

        A moment at the limit counts only where there was no hover, which shows for what share of the time.
        Facts about such a vehicle are shown :attr:`~mavdem.facts.Fact.grounded`.
        """
        grounds = [self.ending, *overrides_of(self.condition, ())]
        if self.condition.hover is None:
            grounds += self.reported([MotionEvent.MOTOR_AT_ITS_STOP])
        return tuple(filter(None, grounds))

    @cached_property
    def lowered(self) -> Fact | None:
        """Which gains to lower; None where nothing oscillates."""
        oscillation = self.condition.oscillation
        if oscillation is None:
            return None
        return gain_reduction_advice(oscillation, self.signals.telemetry.parameters)

    def flights(self, boot: int) -> intervals.Intervals:
        """Returns where the vehicle flew in a ``boot``."""
        return intervals.intersection(
            phases.free_flight_intervals(self.signals, boot), self._before_loss(boot)
        )

    def flown(self, signal: TimeSeries | None) -> Iterator[TimeSeries]:
        """Yields what of a ``signal`` was measured in each flight."""
        if signal is None:
            return
        for boot in np.unique(signal.boot):
            here = signal.boot == boot
            for flight in self.flights(int(boot)):
                rows = here & intervals.in_intervals(signal.time, [flight])
                if rows.any():
                    yield signal.select(rows)

    def averaged(self, signal: TimeSeries | None) -> Array:
        """Returns the means over 2 s of a ``signal`` in flight."""
        means = [phases.moving_average(part) for part in self.flown(signal)]
        return np.concatenate([np.zeros(0), *means])

    def settled(self, without: frozenset[str]) -> Segments:
        """Returns settled flight in other modes than those."""
        segments = []
        for part in settled_flight(self.signals):
            left_out = phases.mode_intervals(self.signals, part.boot, without)
            spans = intervals.intersection([(part.start, part.end)], intervals.complement(left_out))
            spans = intervals.intersection(spans, self._before_loss(part.boot))
            segments += [Segment(part.boot, *span) for span in spans]
        return tuple(segments)

    def reported(self, codes: Container[Code]) -> Iterator[Fact]:
        """Yields what the autopilot warned of in flight, of these kinds."""
        for event in self.events:
            if not (event.code in codes and event.warns):
                continue
            if intervals.in_intervals(event.time or 0.0, self.flights(event.figures["boot"])):
                yield event

    def _before_loss(self, boot: int) -> intervals.Intervals:
        ending = self.ending
        if ending is None or ending.figures.get("boot", boot) != boot:
            return [(-inf, inf)]
        return [(-inf, ending.time or inf)]
