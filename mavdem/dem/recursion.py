"""Recursion: a linear model run over many samples at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

WORST_MODES = 1e8
"""Condition of the eigenvectors beyond which it runs sample by sample instead of mode by mode."""


def recursion(F: Array, pushes: Array, first: Array) -> Array:
    """x₁ … x_T of x_{t} = F x_{t−1} + push_t from x₀ = ``first``, mode by mode, in which it is vectorized."""
    if not pushes.size:
        return np.empty_like(pushes)
    eigenvalues, modes = np.linalg.eig(F)
    if np.linalg.cond(modes) > WORST_MODES:
        return _recursion_by_sample(F, pushes, first)
    inward = np.linalg.inv(modes)
    start, driven = inward @ first, pushes @ inward.T
    states = [
        lfilter([1.0], [1.0, -value], driven[:, i].astype(complex), zi=[value * start[i]])[0]
        for i, value in enumerate(eigenvalues)
    ]
    return np.asarray((np.stack(states, axis=1) @ modes.T).real)


def _recursion_by_sample(F: Array, pushes: Array, first: Array) -> Array:
    states = np.empty_like(pushes)
    state = first
    for t, push in enumerate(pushes):
        state = F @ state + push
        states[t] = state
    return states
