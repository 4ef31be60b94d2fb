"""Windows of a flight, training samples and the test samples after them; or the fact (coded finding) why none fits."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Indices
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.dem.plant_forecasts import FORECAST_HORIZON_SECONDS
from mavdem.errors import NotLearnable
from mavdem.facts.forecasts import ForecastFact
from mavdem.flight import Flight

TRAIN_SECONDS = 7.0
"""Default length of a training part, s: the paper's 700 samples at 100 Hz."""

MAX_WINDOWS = 24
"""Windows of a flight that methods are compared on unless --hop is given, at most; a choice.

Four times the pairs from which a test can find a difference, and half a minute for the usual methods on two cores.
"""

SHORT_TEST_FRACTION = 6
"""Ratio of a flight to the test part that is offered where the flight is too short for the window.

It is about the defaults' ratio, 8.5 s to 1.5 s.
"""


class Length(NamedTuple):
    """A length of flight: a number of samples, or of seconds."""

    number: float
    """The number of seconds or samples."""

    in_seconds: bool = True
    """Whether the number is one of seconds."""

    def samples(self, dt: float) -> int:
        """Returns the length as a number of samples, at least 1.

        Args:
            dt: sampling step, s.
        """
        return max(1, round(self.number / dt)) if self.in_seconds else int(self.number)


def part_samples(
    dt: float, train: Length | None = None, test: Length | None = None
) -> tuple[int, int]:
    """Returns the lengths of a training part and of a test part in samples.

    Args:
        dt: sampling step, s.
        train: length of the training part; None for 7 s.
        test: length of the test part; None for 1.5 s.

    Returns:
        Numbers of samples of the training part and of the test part.
    """
    train = train or Length(TRAIN_SECONDS)
    test = test or Length(FORECAST_HORIZON_SECONDS)
    return train.samples(dt), test.samples(dt)


class TooFewSamples(NotLearnable):
    """The settled flight is too short; its fact has the ``options`` with which a window fits, if there are any."""


def too_short(flight: Flight, start: float, train: int, test: int, min_train: int) -> TooFewSamples:
    """Returns the error that a window does not fit into a flight, with command-line options for one that does.

    The options are shown to the user as text to type. Their window has a shorter test part if necessary, in proportion
    to the remaining flight, and the longest training part that then fits.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.
        start: intended start of the training part after the beginning of the flight, s.
        train: number of samples of the training part.
        test: number of samples of the test part.
        min_train: number of samples that a training part needs; with fewer no options are offered.

    Returns:
        The error, which the caller raises. Its fact has the lengths, and the ``options``, empty if no window is long
        enough.
    """
    # A start beyond the end of the flight leaves no samples.
    first_sample = round(min(start / flight.dt, len(flight)))
    remaining_samples = len(flight) - first_sample
    shorter_test = min(test, max(remaining_samples // SHORT_TEST_FRACTION, 1))
    longest_train = min(train, remaining_samples - shorter_test)
    options: tuple[str, ...] = ()
    if longest_train >= min_train:
        options = ("--train", str(longest_train), "--test", str(shorter_test))
    return TooFewSamples(
        ForecastFact.FLIGHT_TOO_SHORT,
        samples=len(flight),
        duration=flight.duration,
        start=start,
        left=remaining_samples,
        train_samples=train,
        test_samples=test,
        options=options,
    )


def no_test_window(samples: int, dt: float, test: int, folds: int) -> TooFewSamples:
    """Returns the error that no test window fits into a fold of a flight, with an option for one that does.

    Args:
        samples: length of the flight, in samples.
        dt: sampling step, s.
        test: number of samples of a test window.
        folds: number of parts that the flight is cut into for cross-validation.

    Returns:
        The error, to be raised. Its fact has the lengths, and the ``options``, empty for a flight that is too short.
    """
    # The first window of a flight is kept for the filter to find its state.
    shorter_test = max(1, samples // (folds + 1))
    _, default_test = part_samples(dt)
    options: tuple[str, ...] = ()
    if shorter_test < test and samples >= 2 * default_test:
        options = ("--test", str(shorter_test))
    return TooFewSamples(
        ForecastFact.NO_TEST_WINDOW,
        samples=samples,
        duration=samples * dt,
        test_samples=test,
        options=options,
    )


@dataclass(frozen=True, eq=False)
class Window:
    """A training part of a flight, and the test part right after it."""

    flight: str
    """Name of the flight."""

    start: int
    """Index of the window's first sample in the flight."""

    train: Flight
    """The training part, which a model is learned from."""

    test: Flight
    """The test part, which is forecast."""

    @property
    def stop(self) -> int:
        """Index in the flight of the sample after the window."""
        return self.start + len(self.train) + len(self.test)


def windows(
    name: str,
    flight: Flight,
    train: int | None = None,
    test: int | None = None,
    hop: int | None = None,
) -> tuple[Window, ...]:
    """Cuts a flight into overlapping windows, each a training part followed by a test part.

    Windows begin every ``hop`` samples as long as they fit into the flight.

    Args:
        name: name of the flight.
        flight: uniformly sampled inputs and outputs of one segment of flight.
        train: number of samples of each training part; 7 s unless given.
        test: number of samples of each test part; 1.5 s unless given.
        hop: number of samples from the start of a window to the start of the next; half a window unless given.

    Returns:
        The windows in order of time; none if the flight is too short.

    Raises:
        ValueError: a number of samples is not positive.
    """
    default_train, default_test = part_samples(flight.dt)
    if train is None:
        train = default_train
    if test is None:
        test = default_test
    window_length = train + test
    if hop is None:
        hop = _half_window(window_length)
    if min(train, test, hop) < 1:
        raise ValueError(f"train, test and hop must be at least 1, not {train}, {test} and {hop}")
    last_start = len(flight) - window_length
    windows_of_flight = []
    for start in range(0, last_start + 1, hop):
        test_start = start + train
        test_end = test_start + test
        window = Window(
            flight=name,
            start=start,
            train=flight[start:test_start],
            test=flight[test_start:test_end],
        )
        windows_of_flight.append(window)
    return tuple(windows_of_flight)


def _half_window(window_length: int) -> int:
    """Returns half the length of a window, in samples, rounded up: every second window then overlaps none before it."""
    return ceil(window_length / 2)


def required_windows(
    name: str, flight: Flight, train: Length | None, test: Length | None, hop: int | None
) -> tuple[Window, ...]:
    """Cuts a flight into windows (:func:`windows`), evenly over all of it, and requires at least one.

    Args:
        name: name of the flight.
        flight: uniformly sampled inputs and outputs of one segment of flight.
        train: length of each training part; None for 7 s.
        test: length of each test part; None for 1.5 s.
        hop: samples from the start of a window to the start of the next; None for half a window, or more where that
            would be more windows than ``MAX_WINDOWS``.

    Returns:
        The windows, at least one.

    Raises:
        TooFewSamples: no window fits into the flight, or no model can be learned from so short a training part.
    """
    train_samples, test_samples = part_samples(flight.dt, train, test)
    if train_samples < MIN_SAMPLES:
        raise TooFewSamples(
            ForecastFact.TRAINING_TOO_SHORT, samples=train_samples, least_samples=MIN_SAMPLES
        )
    window_length = train_samples + test_samples
    if hop is None:
        spread_hop = ceil((len(flight) - window_length) / (MAX_WINDOWS - 1))
        hop = max(_half_window(window_length), spread_hop)
    fitting_windows = windows(name, flight, train_samples, test_samples, hop)
    if not fitting_windows:
        raise too_short(flight, 0.0, train_samples, test_samples, MIN_SAMPLES)
    return fitting_windows


def disjoint_windows(windows: Sequence[Window]) -> Indices:
    """Returns the indices of windows that share no sample, as many as possible.

    A statistical test needs windows that are independent. The greedy rule of interval scheduling finds the largest
    number: of each flight, take the window that ends first, then of those that begin after it the one that ends first,
    and so on.

    Args:
        windows: windows of one or several flights, which may overlap.

    Returns:
        Ascending indices of the chosen windows.
    """
    chosen_indices = []
    end_of_chosen: dict[str, int] = {}
    for index in sorted(range(len(windows)), key=lambda index: windows[index].stop):
        window = windows[index]
        # The first window of a flight overlaps none.
        if window.start >= end_of_chosen.get(window.flight, window.start):
            chosen_indices.append(index)
            end_of_chosen[window.flight] = window.stop
    return np.array(sorted(chosen_indices), int)
