"""The linear model, the parameter vector it is packed into, and its motion from sample to sample."""

from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from mavdem.arrays import Array

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """ẋ = A x + B (u − input_trim) + offset + w,  y = C x + output_trim + z, Eq. ``general_LTI`` with its trim.

    The state x is a deviation from trim, in the units of the outputs for the first states.
    """

    A: Array  # (n, n) 1/s
    B: Array  # (n, r)
    C: Array  # (m, n)
    offset: Array  # (n,) what the trim inputs leave over, per second
    input_trim: Array  # (r,)
    output_trim: Array  # (m,)

    @property
    def spectral_abscissa(self) -> float:
        """The largest real part among the eigenvalues of A, 1/s: positive means unstable."""
        return float(np.linalg.eigvals(self.A).real.max())


def pack(A: NDArray[Scalar], B: NDArray[Scalar], C: NDArray[Scalar]) -> NDArray[Scalar]:
    """Returns θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)]: the rows of A, then of B, then of C."""
    return np.concatenate([A.ravel(), B.ravel(), C.ravel()])


def unpack(
    theta: NDArray[Scalar],
    n: int,
    r: int,
    m: int,
) -> tuple[NDArray[Scalar], NDArray[Scalar], NDArray[Scalar]]:
    """Returns A (n, n), B (n, r) and C (m, n) out of θ (n² + n·r + m·n,)."""
    a = n * n
    b = n * n + n * r
    return theta[:a].reshape(n, n), theta[a:b].reshape(n, r), theta[b:].reshape(m, n)


class Transition(NamedTuple):
    """x⁺ = Φ x + Γ₀ u + Γ₁ u⁺: one sampling step, exact for inputs that run linearly between samples."""

    Phi: Array  # (..., n, n) Φ
    Gamma0: Array  # (..., n, r) Γ₀
    Gamma1: Array  # (..., n, r) Γ₁


def discretize(A: Array, B: Array, dt: float) -> Transition:
    """Returns the exact transition over ``dt`` s with first-order hold (Franklin, Powell and Workman, sec. 4.3.2).

    A and B are (..., n, n) and (..., n, r), of one model or of several.
    """
    n, r = B.shape[-2:]
    held = n + r
    generator = np.zeros((*B.shape[:-2], held + r, held + r))
    generator[..., :n, :n] = A * dt
    generator[..., :n, n:held] = B * dt
    generator[..., n:held, held:] = np.eye(r)
    flow = expm(generator)
    ramp = flow[..., :n, held:]
    return Transition(flow[..., :n, :n], flow[..., :n, n:held] - ramp, ramp)


# condition of the eigenvectors that costs half of the digits: it runs sample by sample instead of mode by mode
MAX_MODE_CONDITION = 1 / np.sqrt(np.finfo(np.float64).eps)


def linear_recursion(F: Array, pushes: Array, first: Array) -> Array:
    """Returns x₁ … x_T of x_{t} = F x_{t−1} + push_t from x₀ = ``first``, mode by mode, in which it is vectorized."""
    from scipy.signal import lfilter  # it takes half a second to import

    if not pushes.size:
        return np.empty_like(pushes)
    eigenvalues, modes = np.linalg.eig(F)
    if np.linalg.cond(modes) > MAX_MODE_CONDITION:
        return np.array(
            [*accumulate(pushes, lambda state, push: F @ state + push, initial=first)][1:]
        )
    # Of a conjugate pair one is enough: the other has the same real part.
    kept = eigenvalues.imag >= 0
    shares = 1.0 + (eigenvalues.imag[kept] > 0)
    inward = np.linalg.inv(modes)[kept]
    starts = inward @ first
    driven = inward @ pushes.T
    states = [
        lfilter([1.0], [1.0, -value], row, zi=[value * start])[0]
        for value, start, row in zip(eigenvalues[kept], starts, driven, strict=True)
    ]
    return (np.array(states).T @ (shares * modes[:, kept]).T).real
