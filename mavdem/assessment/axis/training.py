"""Training of the model of one axis, its test on held-out data, and facts (coded findings) that refuse it."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from mavdem.assessment.axis.options import Options, ShowStep
from mavdem.dataset.flights import flights_of_longest_boot
from mavdem.dem import Learned, learn
from mavdem.dem.learning import MIN_SAMPLES, prepared_training
from mavdem.errors import NotLearnable, fact_from_error
from mavdem.experiments.held_out import (
    BASELINES,
    FOLDS,
    HeldOut,
    held_out_test,
    held_out_windows,
)
from mavdem.experiments.paired_test import SIGNIFICANCE, paired
from mavdem.experiments.window import Length, TooFewSamples, no_test_window, part_samples, too_short
from mavdem.facts import Fact
from mavdem.facts.assessment import NoModel
from mavdem.facts.forecasts import ForecastFact, TestResult
from mavdem.flight import Flight, Flights

MAX_SLOW_ERROR_RATIO = 0.9
"""Squared error of a model of the slow motion, over that of each baseline, up to which the model is worth having."""


class TestedModel(NamedTuple):
    """A model with the data of its training and test."""

    flights: Flights
    """What the model was trained on."""
    learned: Learned
    """The model."""
    held_out: HeldOut
    """Forecasts of windows that no model was trained on."""


def train_and_test(
    segments: Flights, options: Options, progress: ShowStep, *, is_slow: bool
) -> TestedModel:
    """Trains a model and tests it on windows that it was not trained on.

    There are three ways. If a length of the training data is given, the model is trained on this length of the longest
    segment and tested once on what follows. Otherwise it is trained on all flights and judged by cross-validation, with
    models that are each trained without one fold of the flights. For a model of the slow motion the cross-validation
    comes first, and the model is learned only if it predicts well enough.

    Args:
        segments: segments of settled flight: armed, off the ground, without climbs.
        options: choices of the user, with the lengths of training data and test windows.
        progress: shows the steps of the work.
        is_slow: whether it is a model of the slow motion.

    Returns:
        The model, what it was trained on, and its forecasts of held-out windows.

    Raises:
        NotLearnable: no model can be learned, or a model of the slow motion predicts too badly.
    """
    settings = options.settings
    if options.train is not None:
        longest_segment = max(segments, key=len)
        training, test_flight = split_training_and_test(
            longest_segment, options.start, options.train, options.test
        )
        with _learning_step(progress):
            learned = learn(training, settings)
        return TestedModel((training,), learned, held_out_test(training, test_flight, learned))
    flights = flights_after_start(segments, options.start)
    first_learned = None
    with _learning_step(progress):
        if is_slow:
            # This raises an error if no model can be learned from the data.
            prepared_training(flights, settings)
        else:
            first_learned = learn(flights, settings)
    dt = flights[0].dt
    _, window_samples = part_samples(dt, None, options.test)
    try:
        with progress("Judging by held-out windows") as show_share:
            held_out = held_out_windows(flights, settings, window_samples, show_share)
    except ValueError as error:
        raise no_test_window(sum(map(len, flights)), dt, window_samples, FOLDS) from error
    if first_learned is not None:
        return TestedModel(flights, first_learned, held_out)
    refusal = slow_motion_refusal(held_out)
    if refusal is not None:
        raise NotLearnable(refusal)
    return TestedModel(flights, learn(flights, settings), held_out)


@contextmanager
def _learning_step(progress: ShowStep) -> Iterator[None]:
    """Shows the step "Learning" while the code in this context learns a model, and converts errors of learning.

    Args:
        progress: shows the name of a step while it runs.

    Raises:
        NotLearnable: the code raised a ``ValueError``, which becomes its reason.
    """
    try:
        # The step is shown without the fraction that is done, since learning does not report it.
        with progress("Learning", measured=False):
            yield
    except ValueError as error:
        raise NotLearnable(NoModel.NOT_LEARNED, reason=fact_from_error(error)) from error


def slow_motion_refusal(held_out: HeldOut) -> Fact | None:
    """Returns the reason to refuse a model that was learned from a slow stream, if it does not forecast well enough.

    A stream too slow to show rotation still shows slow motion, but a model of that may be no better than a trivial
    forecast. Two conditions must hold for each of two baselines, the mean of the training data and the last sample. The
    model's error on held-out windows is at most ``MAX_SLOW_ERROR_RATIO`` times the baseline's. And a paired test
    over the windows shows that the model's error is significantly lower.

    Args:
        held_out: forecasts of windows that the model was not trained on, and the baselines' forecasts.

    Returns:
        The fact with the first baseline that fails: with the p-value and its limit if only the test failed, otherwise
        with the ratio of errors and its limit. None if both conditions hold.
    """
    for baseline in BASELINES:
        error_ratio = held_out.error_ratio() / held_out.error_ratio(baseline)
        # The ratios of the windows are compared with 1: such a forecast is as good as the baseline.
        significance_test = paired(held_out.error_ratios(baseline), np.ones(len(held_out)))
        # The ratio may be NaN, which is no improvement.
        is_better = error_ratio <= MAX_SLOW_ERROR_RATIO
        if not is_better or significance_test.result != TestResult.LOWER:
            return Fact(
                NoModel.SLOW_MODEL_TOO_WEAK,
                name=baseline,
                windows=len(held_out),
                ratio=error_ratio,
                p_value=significance_test.p_value if is_better else None,
                limit=SIGNIFICANCE if is_better else MAX_SLOW_ERROR_RATIO,
            )
    return None


def flights_after_start(segments: Flights, start: float) -> Flights:
    """Returns the flights that remain if training begins some time after the start (option ``--start``).

    Only the boot of the longest segment is used, since the clocks of different boots cannot be compared.

    Args:
        segments: flights of all boots.
        start: time after the first sample of that boot's flights, s.

    Returns:
        The flights of that boot, cut at the start; flights that are too short to learn from are left out.

    Raises:
        TooFewSamples: no flight has enough samples left to learn from.
    """
    flights = flights_of_longest_boot(segments)
    start_time = flights[0].time[0] + start
    remaining_flights = []
    for flight in flights:
        # Half a step of tolerance, since stamps are rounded.
        first_sample = int(np.searchsorted(flight.time, start_time - flight.dt / 2))
        if len(flight) - first_sample >= MIN_SAMPLES:
            remaining_flights.append(flight[first_sample:] if first_sample else flight)
    if not remaining_flights:
        raise TooFewSamples(ForecastFact.NOTHING_LEFT, samples=MIN_SAMPLES, start=start)
    return tuple(remaining_flights)


class TrainingAndTest(NamedTuple):
    """A flight, split in two."""

    training: Flight
    """Data to learn from."""

    test: Flight
    """Data after these, which nothing was learned from."""


def split_training_and_test(
    flight: Flight, start: float, train: Length, test: Length | None
) -> TrainingAndTest:
    """Splits a flight into training data from ``start`` s on and the test data after it.

    Args:
        flight: uniformly sampled inputs and outputs of one segment of flight.
        start: time from its first sample at which the training data begin, s.
        train: length of the training data, in seconds or samples.
        test: length of the test data; None for the default.

    Returns:
        Training data, and test data that begin at their end.

    Raises:
        TooFewSamples: the flight is too short.
    """
    # A start beyond the end of the flight leaves no sample, which is an error below.
    training_start = round(min(start / flight.dt, len(flight)))
    training_samples, test_samples = part_samples(flight.dt, train, test)
    test_start = training_start + training_samples
    test_end = test_start + test_samples
    if len(flight) < test_end:
        raise too_short(flight, start, training_samples, test_samples, MIN_SAMPLES)
    return TrainingAndTest(flight[training_start:test_start], flight[test_start:test_end])
