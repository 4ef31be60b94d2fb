"""Physical parameters of one axis, estimated from each part of a flight alone: they show changes during the flight."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mavdem.flight import Flight, Flights
from mavdem.plant.estimation import physical
from mavdem.plant.parameters import Physical

PART_SECONDS = 20.0
"""Least length of a part, s: the memory of the online learner, so that a log shows what a live session does."""

MAX_PARTS = 12
"""Most parts of a flight: a choice. Estimating the parameters of one takes some tenths of a second."""


class ParametersOfPart(NamedTuple):
    """Physical parameters that were estimated from one part of a flight alone."""

    samples: Flight
    """The part."""

    physical: Physical
    """The parameters."""


def parameter_history(flights: Flights) -> list[ParametersOfPart]:
    """Estimates the physical parameters of each part of a flight, from this part alone.

    Parts are at least ``PART_SECONDS`` long, unless a segment is shorter. There are at most ``MAX_PARTS``, unless the
    flight has more segments. Parts without an estimate, such as those in which no motor moves, are left out.

    Args:
        flights: segments of one flight, in order of time.

    Returns:
        The parameters of the parts, in order of time.
    """
    history = []
    for part in _flight_parts(flights):
        parameters = physical(part)
        if isinstance(parameters, Physical):
            history.append(ParametersOfPart(part, parameters))
    return history


def _flight_parts(flights: Flights) -> Iterator[Flight]:
    """Yields the parts of a flight over which its physical parameters are estimated.

    All parts of a segment are equally long, about ``PART_SECONDS`` or longer, and there are about ``MAX_PARTS`` in all.

    Args:
        flights: segments of one flight, in order of time.

    Yields:
        Parts of the flight in the order of time.
    """
    total_seconds = sum(len(flight.time) * flight.dt for flight in flights)
    part_seconds = max(PART_SECONDS, total_seconds / MAX_PARTS)
    for flight in flights:
        count = max(1, int(len(flight.time) * flight.dt / part_seconds))
        bounds = np.linspace(0, len(flight.time), count + 1).astype(int).tolist()
        for start, end in zip(bounds[:-1], bounds[1:], strict=True):
            yield flight[start:end]
