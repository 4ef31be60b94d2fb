"""Windows: a flight cut into training parts, each with the test part that follows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from mavdem.flight import Flight

TRAIN_SECONDS, TEST_SECONDS = 7.0, 1.5
"""Default lengths of a training and a test part: a few periods of a vehicle's motion, as in the paper at 100 Hz."""


def samples_in(seconds: float, dt: float) -> int:
    """The number of samples ``dt`` s apart that last so many ``seconds``, at least 1."""
    return max(1, round(seconds / dt))


class Length(NamedTuple):
    """A length of flight as it was asked for: a number of samples, or of seconds."""

    number: float
    in_seconds: bool

    def samples(self, dt: float) -> int:
        """The number of samples ``dt`` s apart, at least 1."""
        return samples_in(self.number, dt) if self.in_seconds else int(self.number)


def fewer_samples(available: int, train: int, test: int) -> tuple[int, int]:
    """Numbers of training and test samples that fit into a flight: at most these, and at most a sixth for the test."""
    test = min(test, max(available // 6, 1))
    return min(train, available - test), test


@dataclass(frozen=True, eq=False)
class Window:
    """One window of the flight named ``flight``: from sample ``start`` on, ``train`` and, right after it, ``test``."""

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
        train, test: numbers of training and test samples; those of 7 s and 1.5 s unless given.
        hop: samples from the start of one window to the next; half a window unless given, so that neighbours share a
            half.

    Raises:
        ValueError: a number of samples that is not positive.
    """
    train = samples_in(TRAIN_SECONDS, flight.dt) if train is None else train
    test = samples_in(TEST_SECONDS, flight.dt) if test is None else test
    hop = max(1, (train + test) // 2) if hop is None else hop
    if min(train, test, hop) < 1:
        raise ValueError(f"train, test and hop must be at least 1, not {train}, {test} and {hop}")
    return tuple(
        Window(name, start, flight[start : start + train], flight[start + train : start + train + test])
        for start in range(0, len(flight) - train - test + 1, hop)
    )
