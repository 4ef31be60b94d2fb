"""The time that plots of a flight show: a part of one boot of the autopilot, or of several, on one clock.

Each boot has a clock that begins at 0. Parts of several boots are put on the clock of one of them, one after the other,
``SECONDS_BETWEEN_BOOTS`` apart, since no clock says how long a restart took.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.segments import Segment, in_segments
from mavdem.dataset.setpoints import Setpoint, held_setpoint
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact
from mavdem.facts.event import Event

SECONDS_BETWEEN_BOOTS = 5.0
"""Time between the parts of two boots on one clock, s: a choice, wide enough to be seen as a gap."""


@dataclass(frozen=True)
class ShownPart:
    """The part of one boot that a time history shows, and where it lies on the clock of the history."""

    segment: Segment
    """The part, s on the clock of its own boot."""
    shift: float = 0.0
    """What is added to its times, s, to put them on the clock of the history."""

    @property
    def end(self) -> float:
        """Its end on the clock of the history, s."""
        return self.segment.end + self.shift


@dataclass(frozen=True)
class ShownTime:
    """The time that a time history shows: one part for each boot, in order."""

    boot: int
    """The boot on whose clock the history is."""
    parts: tuple[ShownPart, ...]
    """The parts, which do not overlap."""

    @property
    def segment(self) -> Segment:
        """All parts from the first to the last time, on the clock of the history."""
        first_part = self.parts[0]
        start = first_part.segment.start + first_part.shift
        return Segment(self.boot, start, self.parts[-1].end)

    def within(self, signal: TimeSeries | None) -> TimeSeries | None:
        """Returns the samples of a signal in all shown parts, one after the other on the clock of the history.

        Each boot has a clock of its own, which is shifted so that its part follows the part before.

        Args:
            signal: samples of the whole log; None if the signal was not recorded.

        Returns:
            The samples; None if these are less than two, or it was not recorded.
        """
        if signal is None:
            return None
        times_of_parts = []
        values_of_parts = []
        for part in self.parts:
            samples = signal.select(in_segments(signal, part.segment, slack=0))
            times_of_parts.append(samples.time + part.shift)
            values_of_parts.append(samples.values)
        all_values = np.concatenate(values_of_parts)
        if len(all_values) < 2:
            return None
        # A history has the number of one boot, whatever the boots of its parts.
        boot = np.full(len(all_values), self.boot)
        return TimeSeries(np.concatenate(times_of_parts), boot, all_values)

    def event(self, fact: Fact) -> Event | None:
        """Returns a fact as an event on the clock of the shown time.

        The shown time consists of parts of the record, one after the other. An event outside of all parts of its boot
        would appear in a part of another boot, so that it is not shown. With a single part there is no such risk.

        Args:
            fact: the fact. Its figure ``boot`` is the boot whose clock its time is on; without this figure it is the
                boot on whose clock the parts are shown.

        Returns:
            The event; None if the fact has no time, or a time that is not shown.
        """
        boot = fact.figures.get("boot", self.boot)
        for part in self.parts:
            if part.segment.boot != boot or fact.time is None:
                continue
            is_shown = part.segment.start <= fact.time <= part.segment.end
            if is_shown or len(self.parts) == 1:
                return Event(fact.time + part.shift, fact)
        return None

    def setpoint_at_samples(self, setpoint: Setpoint, signal: TimeSeries) -> Array:
        """Returns the setpoint that held at each shown sample of a signal, for a chart of both.

        Setpoint and signal are recorded at different times. The latest setpoint holds until the next one comes
        (zero-order hold).

        Args:
            setpoint: recorded values of the setpoint, from the whole log.
            signal: samples of the signal, from the whole log.

        Returns:
            (N,) a setpoint for each of the N samples that :meth:`within` returns, in their order; NaN where none had
            come recently.
        """
        setpoints_of_parts = []
        for part in self.parts:
            shown_samples = signal.select(in_segments(signal, part.segment, slack=0))
            boot = part.segment.boot
            setpoints_of_parts.append(held_setpoint(setpoint, boot, shown_samples.time))
        return np.concatenate(setpoints_of_parts)


def one_part(segment: Segment) -> ShownTime:
    """Returns the shown time of a single part, on the clock of its boot."""
    return ShownTime(segment.boot, (ShownPart(segment),))


def successive_parts(segments: Sequence[Segment], boot: int) -> ShownTime:
    """Puts parts of several boots one after the other on the clock of one of these boots, for charts of all of them.

    Args:
        segments: a part of each boot, in the order of the boots.
        boot: number of the boot on whose clock all parts are put.
    """
    # First the parts are put one after the other on a clock that is 0 at the start of the first. The shift of a part is
    # what has to be added to its times for that.
    shifts: list[float] = []
    shift_of_chosen_boot = 0.0
    next_start = 0.0
    for segment in segments:
        shift = next_start - segment.start
        shifts.append(shift)
        next_start += segment.duration + SECONDS_BETWEEN_BOOTS
        if segment.boot == boot:
            shift_of_chosen_boot = shift
    # Then all are moved to the clock of the chosen boot, whose own part is not shifted.
    parts = []
    for segment, shift in zip(segments, shifts, strict=True):
        parts.append(ShownPart(segment, shift - shift_of_chosen_boot))
    return ShownTime(boot, tuple(parts))
