"""Windows: parts of a flight that a model is trained on, each with the part after it that is forecast."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Indices
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.dem.plant_forecasts import FORECAST_HORIZON_SECONDS
from mavdem.errors import NotLearnable
from mavdem.facts.forecasts import Forecasts
from mavdem.flight import Flight

TRAIN_SECONDS = 7.0  # of a training part by default, as in the paper at 100 Hz


class Length(NamedTuple):
    """A length of flight: a number of samples, or of seconds."""

    number: float
    in_seconds: bool = True

    def samples(self, dt: float) -> int:
        """Returns the number of samples ``dt`` s apart, at least 1."""
        return max(1, round(self.number / dt)) if self.in_seconds else int(self.number)


def part_samples(
    dt: float, train: Length | None = None, test: Length | None = None
) -> tuple[int, int]:
    """Returns the samples of a training and a test part ``dt`` s apart: as asked for, else 7 s and 1.5 s."""
    return (train or Length(TRAIN_SECONDS)).samples(dt), (
        test or Length(FORECAST_HORIZON_SECONDS)
    ).samples(dt)


class TooFewSamples(NotLearnable):
    """The settled flight is too short; the fact's ``options`` are those with windows that fit, or empty."""


def too_short(flight: Flight, start: float, train: int, test: int, least: int) -> TooFewSamples:
    """Returns why ``train`` and ``test`` samples do not fit after ``start`` s of a ``flight``, and how many would.

    With fewer than ``least`` training samples none do.
    """
    left = len(flight) - round(min(start / flight.dt, len(flight)))
    shorter = min(test, max(left // 6, 1))
    longest = min(train, left - shorter)
    options = ("--train", str(longest), "--test", str(shorter)) if longest >= least else ()
    return TooFewSamples(
        Forecasts.FLIGHT_TOO_SHORT,
        samples=len(flight),
        duration=flight.duration,
        start=start,
        left=left,
        train_samples=train,
        test_samples=test,
        options=options,
    )


def no_test_window(samples: int, dt: float, test: int, folds: int) -> TooFewSamples:
    """Returns why no window of ``test`` samples fits into a part of so many ``folds``, and which would.

    The flight has so many ``samples``, ``dt`` s apart.
    """
    shorter = max(1, samples // (folds + 1))
    usual = part_samples(dt)[1]
    options = ("--test", str(shorter)) if shorter < test and samples >= 2 * usual else ()
    return TooFewSamples(
        Forecasts.NO_TEST_WINDOW,
        samples=samples,
        duration=samples * dt,
        test_samples=test,
        options=options,
    )


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
    name: str,
    flight: Flight,
    train: int | None = None,
    test: int | None = None,
    hop: int | None = None,
) -> tuple[Window, ...]:
    """Returns every window that fits into the ``flight`` of this ``name``; none if it is too short.

    ``train`` and ``test`` samples last 7 s and 1.5 s unless given. Windows begin ``hop`` samples apart: half a window
    unless given, so that neighbours share a half.

    Raises:
        ValueError: a number of samples that is not positive.
    """
    usual = part_samples(flight.dt)
    train = usual[0] if train is None else train
    test = usual[1] if test is None else test
    hop = max(1, (train + test) // 2) if hop is None else hop
    if min(train, test, hop) < 1:
        raise ValueError(f"train, test and hop must be at least 1, not {train}, {test} and {hop}")
    return tuple(
        Window(
            name, start, flight[start : start + train], flight[start + train : start + train + test]
        )
        for start in range(0, len(flight) - train - test + 1, hop)
    )


def windows_as_asked(
    name: str, flight: Flight, train: Length | None, test: Length | None, hop: int | None
) -> tuple[Window, ...]:
    """Returns the :func:`windows` of these lengths; raises ``TooFewSamples`` where none fits."""
    lengths = part_samples(flight.dt, train, test)
    if cut := windows(name, flight, *lengths, hop):
        return cut
    raise too_short(flight, 0.0, *lengths, MIN_SAMPLES)


def disjoint(windows: Sequence[Window]) -> Indices:
    """Returns the indices of ``windows`` that share no sample: as many as possible, those that end first."""
    chosen = []
    free: dict[str, int] = {}
    for i, window in sorted(enumerate(windows), key=lambda numbered: numbered[1].stop):
        if window.start >= free.get(window.flight, window.start):
            chosen.append(i)
            free[window.flight] = window.stop
    return np.array(sorted(chosen), int)
