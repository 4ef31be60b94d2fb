"""Physical parameters of one axis over time: each piece of about 20 s of a flight gives an estimate of its own."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mavdem.flight import Flight, Flights
from mavdem.plant.estimation import physical
from mavdem.plant.parameters import Physical

PIECE_SECONDS = 20.0
"""Least length of a piece, s: the memory of the online learner, so that a log shows what a live session does."""

MAX_PIECES = 12
"""Most pieces of a flight: a choice. Estimating the parameters of one takes some tenths of a second."""


class ParametersOfPiece(NamedTuple):
    """Physical parameters that were estimated from one piece of a flight alone."""

    samples: Flight
    """The piece."""

    physical: Physical
    """The parameters."""


def parameter_history(flights: Flights) -> list[ParametersOfPiece]:
    """Estimates the physical parameters of each piece of a flight, from this piece alone.

    The pieces are those of :func:`_flight_pieces`. Pieces without an estimate, such as those in which no motor moves,
    are left out.

    Args:
        flights: segments of one flight, in order of time.

    Returns:
        The parameters of the pieces, in order of time.
    """
    history = []
    for piece in _flight_pieces(flights):
        parameters = physical(piece)
        if isinstance(parameters, Physical):
            history.append(ParametersOfPiece(piece, parameters))
    return history


def _flight_pieces(flights: Flights) -> Iterator[Flight]:
    """Yields the pieces of a flight over which its physical parameters are estimated.

    All pieces of a segment are equally long, about ``PIECE_SECONDS`` or longer, and there are about ``MAX_PIECES`` in
    all.

    Args:
        flights: segments of one flight, in order of time.

    Yields:
        Pieces of the flight in the order of time.
    """
    total_seconds = sum(len(flight.time) * flight.dt for flight in flights)
    piece_seconds = max(PIECE_SECONDS, total_seconds / MAX_PIECES)
    for flight in flights:
        count = max(1, int(len(flight.time) * flight.dt / piece_seconds))
        bounds = np.linspace(0, len(flight.time), count + 1).astype(int).tolist()
        for start, end in zip(bounds[:-1], bounds[1:], strict=True):
            yield flight[start:end]
