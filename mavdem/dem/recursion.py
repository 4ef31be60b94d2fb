"""Recursion: a linear model run over many samples at once."""

from __future__ import annotations

from math import isqrt

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

WORST_MODES = 1e8
"""Condition of the eigenvectors beyond which it runs block by block instead of mode by mode."""


def recursion(F: Array, pushes: Array, first: Array) -> Array:
    """x₁ … x_T of x_{t} = F x_{t−1} + push_t from x₀ = ``first``, mode by mode, in which it is vectorized."""
    if not pushes.size:
        return np.empty_like(pushes)
    eigenvalues, modes = np.linalg.eig(F)
    if np.linalg.cond(modes) > WORST_MODES:
        return _recursion_by_block(F, pushes, first)
    inward = np.linalg.inv(modes)
    start, driven = inward @ first, pushes @ inward.T
    states = [
        lfilter([1.0], [1.0, -value], driven[:, i].astype(complex), zi=[value * start[i]])[0]
        for i, value in enumerate(eigenvalues)
    ]
    return np.asarray((np.stack(states, axis=1) @ modes.T).real)


def _recursion_by_block(F: Array, pushes: Array, first: Array) -> Array:
    """Blocks side by side from 0, then what each begins with: 3 √T steps in place of T."""
    samples, n = pushes.shape
    length = isqrt(samples - 1) + 1
    blocks = np.zeros((-(-samples // length), length, n))
    blocks.reshape(-1, n)[:samples] = pushes
    powers = np.empty((length, n, n))
    powers[0] = F
    for step in range(1, length):
        blocks[:, step] += blocks[:, step - 1] @ F.T
        powers[step] = F @ powers[step - 1]
    state = first
    for block in blocks:
        block += powers @ state
        state = block[-1]
    return blocks.reshape(-1, n)[:samples]
