"""The steady Kalman filter: from the covariances of a model's errors to its gain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

Array = NDArray[np.float64]

LEAST_NOISE = (1e-12, 1e-9, 1e-6)
"""Variances that are added to all noises, the next where no filter settles with one before: data without noise leave
the gain open. In the methods' units, in which outputs and states have a variance of about 1."""


def steady_gain(A: Array, C: Array, Q: Array, R: Array, S: Array) -> Array:
    """(n, m) K of the innovation form of x⁺ = A x + … + w, y = C x + … + v, with which A − K C is stable.

    By the algebraic Riccati equation (Van Overschee and De Moor, Subspace Identification for Linear Systems, 1996,
    sec. 4.2.2, Table 4.1; Katayama, Subspace Methods for System Identification, 2005, sec. 5.3).

    Args:
        A, C: (n, n), (m, n).
        Q, R, S: covariances E wwᵀ (n, n), E vvᵀ (m, m) and E wvᵀ (n, m).

    Raises:
        numpy.linalg.LinAlgError: no filter settles, as when an unstable state is not seen in the outputs.
    """
    n, m = S.shape
    for least in LEAST_NOISE:
        Q_, R_ = Q + least * np.eye(n), R + least * np.eye(m)
        try:
            P = solve_discrete_are(A.T, C.T, Q_, R_, s=S)
        except (ValueError, np.linalg.LinAlgError):
            continue
        gain = np.linalg.solve(C @ P @ C.T + R_, (A @ P @ C.T + S).T).T
        if np.abs(np.linalg.eigvals(A - gain @ C)).max() < 1:
            return np.asarray(gain)
    raise np.linalg.LinAlgError("no filter settles: an unstable state may not be seen in the outputs")
