"""Training data: which part of the settled flight a model is learnt from, and which part it is tested on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mavdem.dem import Settings
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.errors import NotLearnable
from mavdem.evaluate.flight_windows import TEST_SECONDS, Length, fewer_samples, samples_in
from mavdem.evaluate.held_out import FOLDS, HeldOut, held_out_windows
from mavdem.flight import Flight


class TooFewSamples(NotLearnable):
    """The settled flight is too short for the windows that were asked for.

    Attributes:
        lengths: options of ``mavdem learn`` with windows that fit, ("--test", "40"); empty where none do.
    """

    def __init__(self, reason: str, remedy: str = "", lengths: tuple[str, ...] = ()) -> None:
        super().__init__(reason, remedy or f"Ask for shorter ones: `{' '.join(lengths)}`.")
        self.lengths = lengths


def of_one_boot(segments: Sequence[Flight]) -> tuple[Flight, ...]:
    """Those of the longest segment's boot: times of another cannot be compared."""
    boot = max(segments, key=len).provenance["segment"]["boot"]
    return tuple(flight for flight in segments if flight.provenance["segment"]["boot"] == boot)


def flown_after(flights: Sequence[Flight], start: float) -> tuple[Flight, ...]:
    """What is flown ``start`` seconds after the first sample and later; raises TooFewSamples where little is left."""
    late = [
        (flight, round(np.clip(flights[0].time[0] + start - flight.time[0], 0, len(flight) * flight.dt) / flight.dt))
        for flight in flights
    ]
    left = tuple(flight[first:] for flight, first in late if len(flight) - first >= FEWEST_SAMPLES)
    if not left:
        raise TooFewSamples(
            f"Less than {FEWEST_SAMPLES} samples of settled flight are left after {start:g} s.",
            "Start earlier, with a smaller --start.",
        )
    return left


def judged(
    flights: Sequence[Flight], settings: Settings, test: Length | None, done: Callable[[float], None]
) -> HeldOut:
    """Held-out windows of ``test``, of 1.5 s unless given; ``done`` is called with the share of the work that is done.

    Raises TooFewSamples: no window fits into a part of the flights.
    """
    dt = flights[0].dt
    steps = test.samples(dt) if test else samples_in(TEST_SECONDS, dt)
    try:
        return held_out_windows(flights, settings, steps, done)
    except ValueError as error:
        samples = sum(map(len, flights))
        fewer = max(1, samples // (FOLDS + 1))
        shorter = fewer < steps and samples >= 2 * samples_in(TEST_SECONDS, dt)
        raise TooFewSamples(
            f"The settled flight has {samples} samples ({samples * dt:.1f} s), too few for test windows of {steps}.",
            "" if shorter else "Fly longer, or give a smaller --start.",
            ("--test", str(fewer)) if shorter else (),
        ) from error


def cut(flight: Flight, start: float, train: Length, test: Length | None) -> tuple[Flight, Flight]:
    """The training data from ``start`` on, and the test after it; raises TooFewSamples where they do not fit."""
    first = round(min(start / flight.dt, len(flight)))
    left = len(flight) - first
    length = train.samples(flight.dt)
    ahead = test.samples(flight.dt) if test else samples_in(TEST_SECONDS, flight.dt)
    if left >= length + ahead:
        end = first + length
        return flight[first:end], flight[end : end + ahead]
    fewer_train, fewer_test = fewer_samples(left, length, ahead)
    fits = fewer_train >= FEWEST_SAMPLES
    raise TooFewSamples(
        f"The settled flight has {len(flight)} samples ({flight.duration:.1f} s), {left} of them from {start:g} s on, "
        f"but {length} training and {ahead} test samples were asked for.",
        "" if fits else "Start earlier, with a smaller --start.",
        ("--train", str(fewer_train), "--test", str(fewer_test)) if fits else (),
    )
