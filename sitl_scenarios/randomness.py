"""Randomness: one source for each purpose, all from the scenario's seed."""

from __future__ import annotations

import numpy as np

SENSORS, WIND, MOMENT = range(3)
"""Purposes; winds and moments are numbered further, each in its own list."""


def generator(seed: int, *purpose: int) -> np.random.Generator:
    """The source of randomness for one purpose; what others draw does not change it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=purpose))
