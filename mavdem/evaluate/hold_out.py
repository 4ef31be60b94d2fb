"""The length of the training data: as much of the past as does not make forecasts worse.

More samples determine the parameters better, unless wind, trim or load have changed meanwhile. So models of several
lengths forecast the end of the flight, which none of them has seen.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mavdem.dem import Settings, learn
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.flight_windows import TEST_SECONDS, TRAIN_SECONDS, samples_in
from mavdem.flight import Flight

LENGTHS = (TRAIN_SECONDS, 14.0, 35.0, 70.0)
"""Seconds; each about twice the one before. Longer ones cost more time than they gain."""

MIN_GROWTH = 1.2  # of a length over the one before: the last is all there is, if that is so much more
FORECASTS, HOLD_OUTS = 5, 2
"""Forecasts of ``TEST_SECONDS`` in each held-out part at the end, and number of these parts, one before the other."""

STANDARD_ERRORS = 2.0
"""By how many the mean log error of a shorter length must be lower. Of so few forecasts it often is by chance, and more
samples are better on most flights."""


def training_length(
    flight: Flight, settings: Settings | None = None, progress: Callable[[float], None] | None = None
) -> int:
    """The number of samples at the end of a flight to learn from, for forecasts of what follows it.

    It is 70 s, or the whole flight, unless models of 35, 14 or 7 s forecast the last 15 s significantly better: each
    model is learnt from the samples before a held-out part, and the logs of the squared errors of its forecasts, of
    1.5 s each, are compared pair by pair. With less than 22 s there is too little to compare: it is 7 s.

    Args:
        flight: what may be learnt from.
        settings: of the fits; ``Settings()`` unless given.
        progress: called with the share of the work that is done, which is up to eight fits.

    Returns:
        the number of samples, at most those of the flight: ``learn(flight[-training_length(flight):])``.
    """
    settled, steps = len(flight), samples_in(TEST_SECONDS, flight.dt)
    held_out = FORECASTS * steps
    usual = samples_in(TRAIN_SECONDS, flight.dt)
    if settled < usual + HOLD_OUTS * held_out:
        return min(usual, settled)
    lengths = [usual]
    for seconds in LENGTHS[1:]:
        length = min(samples_in(seconds, flight.dt), settled)
        if length >= MIN_GROWTH * lengths[-1]:
            lengths.append(length)
    jobs = [(length, settled - part * held_out) for length in lengths for part in range(1, HOLD_OUTS + 1)]
    errors: dict[int, list[Array]] = {}
    for done, (length, end) in enumerate(jobs, 1):
        errors.setdefault(length, []).append(_log_errors(flight, settings, max(0, end - length), end, steps))
        if progress is not None:
            progress(done / len(jobs))
    return _longest_good({length: np.concatenate(parts) for length, parts in errors.items()})


def _log_errors(flight: Flight, settings: Settings | None, start: int, end: int, steps: int) -> Array:
    """(FORECASTS,) of a model of the samples from ``start`` on, forecasts from ``end`` on; NaN where there is none."""
    following = flight[end : end + FORECASTS * steps]
    try:
        learned = learn(flight[start:end], settings)
    except ValueError:
        return np.full(FORECASTS, np.nan)
    predicted = learned.forecast_every(steps, following.inputs, following.outputs)
    with np.errstate(all="ignore"):
        squares = (predicted - following.outputs) ** 2 / flight.outputs.var(axis=0)
        return np.asarray(np.log(squares.reshape(FORECASTS, -1).mean(axis=1)))


def _longest_good(errors: dict[int, Array]) -> int:
    """The longest of the lengths, or the next one that is significantly better; the shortest where none can be used."""
    best, *others = sorted(errors, reverse=True)
    for length in others:
        difference = errors[best] - errors[length]
        error = difference.std(ddof=1) / np.sqrt(len(difference))
        if not np.isfinite(errors[best]).all() or difference.mean() > STANDARD_ERRORS * error:
            best = length
    return best
