"""Windows: a flight cut into a part to learn from and the part after it to forecast, again and again."""

from __future__ import annotations

from dataclasses import dataclass

from mavdem.flight import Flight

TRAIN, TEST = 700, 150
"""Samples learnt from and forecast unless told otherwise, those of the paper, in which a vehicle swings a few times."""

USUAL_RATE, FAST = 100.0, 125.0
"""Hz: what they are made for; and beyond what so few samples last too short, so that as many seconds are taken."""


def usual_samples(usual: int, dt: float) -> int:
    """The default number of samples ``dt`` s apart, which is ``usual`` up to ``FAST`` Hz, and then lasts as long."""
    return usual if dt >= 1 / FAST else round(usual / USUAL_RATE / dt)


@dataclass(frozen=True, eq=False)
class Window:
    """One window of a flight.

    Attributes:
        flight: the name of the flight, which tells it from others.
        start: its first sample there.
        train: what is learnt from.
        test: the samples right after it.
    """

    flight: str
    start: int
    train: Flight
    test: Flight

    @property
    def stop(self) -> int:
        """The sample of the flight after the last of the window."""
        return self.start + len(self.train) + len(self.test)


def windows(
    name: str, flight: Flight, train: int | None = None, test: int | None = None, hop: int | None = None
) -> tuple[Window, ...]:
    """Every window that fits into a flight; none if it is too short.

    Args:
        name: of the flight.
        flight: what is cut.
        train, test: samples learnt from and forecast; 700 and 150 unless given, or as many as last as long as those at
            100 Hz where they come faster than 125 Hz.
        hop: samples from the start of one window to the next; half a window unless given, so that neighbours share a
            half.

    Raises:
        ValueError: a number of samples that is not positive.
    """
    train = usual_samples(TRAIN, flight.dt) if train is None else train
    test = usual_samples(TEST, flight.dt) if test is None else test
    hop = max(1, (train + test) // 2) if hop is None else hop
    if min(train, test, hop) < 1:
        raise ValueError(f"train, test and hop must be at least 1, not {train}, {test} and {hop}")
    return tuple(
        Window(name, start, flight[start : start + train], flight[start + train : start + train + test])
        for start in range(0, len(flight) - train - test + 1, hop)
    )
