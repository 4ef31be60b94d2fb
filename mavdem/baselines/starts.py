"""Where segments begin: the state of each one's first sample, estimated from that segment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavdem.baselines.state_space import StateSpace
from mavdem.baselines.units import LEAST_VARIANCE, Segments
from mavdem.dem.recursion import recursion

Array = NDArray[np.float64]


def estimated_starts(model: StateSpace, segments: Segments, innovation: Array) -> Array:
    """(segments, n): the most probable first states, before which they are of mean 0 and variance 1.

    Args:
        model: in units in which its states have about that variance.
        segments: inputs and outputs of each, in the same units.
        innovation: (m, m) covariance of the prediction errors.
    """
    n = len(model.A)
    variance, axes = np.linalg.eigh(innovation)
    whiten = axes / np.sqrt(np.maximum(variance, LEAST_VARIANCE))
    longest = max(len(outputs) for _, outputs in segments)
    predictor = model.A - model.K @ model.C
    still = np.zeros((longest - 1, n))
    decays = np.stack([np.vstack([unit, recursion(predictor, still, unit)]) for unit in np.eye(n)], axis=2)
    responses = whiten.T @ model.C @ decays
    starts = []
    for inputs, outputs in segments:
        errors = (outputs - model.predicted(np.zeros(n), inputs, outputs)) @ whiten
        effects = np.vstack([responses[: len(errors)].reshape(-1, n), np.eye(n)])
        starts.append(np.linalg.lstsq(effects, np.append(errors.ravel(), np.zeros(n)), rcond=None)[0])
    return np.array(starts)
