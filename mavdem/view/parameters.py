"""Parameters: the entries of A, B and C by name, which of them the data were left to decide, and how surely."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from mavdem.dem import Learned
from mavdem.flight import Flight
from mavdem.view.outlook import LEVEL
from mavdem.view.units import state_names


def left_free(learned: Learned) -> dict[str, NDArray[np.bool_]]:
    """Which entries of A, B and C, each in the order of θ, the prior left to the data."""
    model = learned.model
    A, B, C = np.split(~learned.known, [model.A.size, model.A.size + model.B.size])
    return {"A": A, "B": B, "C": C}


def entries(flight: Flight, learned: Learned) -> dict[str, list[tuple[str, str]]]:
    """What each entry of A, B and C acts on, and what through: names of row and column, each in the order of θ."""
    states = state_names(flight, learned)
    return {
        "A": [(row, column) for row in states for column in states],
        "B": [(row, column) for row in states for column in flight.input_names],
        "C": [(row, column) for row in flight.output_names for column in states],
    }


def estimate_band(
    mean: NDArray[np.float64], sd: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The edges between which a Gaussian posterior holds an estimate to lie with probability ``LEVEL``."""
    half = norm.ppf(0.5 + LEVEL / 2) * sd
    return mean - half, mean + half
