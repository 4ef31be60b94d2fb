"""The continuous linear state-space model: its parameter vector θ, its discretization, and its recursion in time."""

from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from mavdem.arrays import Array

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """The linear model of the vehicle about its trim, Eq. ``general_LTI``, in physical units.

        ẋ = A x + B (u − input_trim) + offset + w,    y = C x + output_trim + z

    The first states have the units of the outputs (rad, rad/s); w and z are process and measurement noise.
    """

    A: Array
    """(n, n) system matrix, 1/s."""

    B: Array
    """(n, r) input matrix, units of the states per second and per unit of the inputs."""

    C: Array
    """(m, n) output matrix."""

    offset: Array
    """(n,) constant rate of the states that remains at the trim inputs, units of the states per second."""

    input_trim: Array
    """(r,) inputs about which the model is linear, in the unit of the recorded inputs."""

    output_trim: Array
    """(m,) outputs about which the model is linear, rad and rad/s."""

    @property
    def spectral_abscissa(self) -> float:
        """Largest real part of the eigenvalues of A, 1/s. The model is unstable where it is positive."""
        return float(np.linalg.eigvals(self.A).real.max())


def pack(A: NDArray[Scalar], B: NDArray[Scalar], C: NDArray[Scalar]) -> NDArray[Scalar]:
    """Packs A (n, n), B (n, r) and C (m, n) into θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], as the paper does.

    Row after row of A, then of B, then of C; :func:`unpack` is the inverse.
    """
    return np.concatenate([A.ravel(), B.ravel(), C.ravel()])


class ModelMatrices(NamedTuple, Generic[Scalar]):
    """What θ has of a model with n states, r inputs and m outputs, arranged like its matrices."""

    A: NDArray[Scalar]
    """(n, n) of the states."""

    B: NDArray[Scalar]
    """(n, r) of the inputs."""

    C: NDArray[Scalar]
    """(m, n) of the outputs."""


def unpack(
    theta: NDArray[Scalar],
    n: int,
    r: int,
    m: int,
) -> ModelMatrices[Scalar]:
    """Unpacks θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] into the matrices of the model.

    Args:
        theta: (n² + n·r + m·n,) the parameter vector, or another vector in its order, such as variances.
        n: number of states.
        r: number of inputs.
        m: number of outputs.

    Returns:
        The matrices, views of ``theta``.
    """
    end_of_A = n * n
    end_of_B = n * n + n * r
    return ModelMatrices(
        A=theta[:end_of_A].reshape(n, n),
        B=theta[end_of_A:end_of_B].reshape(n, r),
        C=theta[end_of_B:].reshape(m, n),
    )


class Transition(NamedTuple):
    """The model over one sampling step, x_{t+1} = Φ x_t + Γ₀ u_t + Γ₁ u_{t+1}.

    It is exact for inputs that change linearly between samples (first-order hold). Leading axes are several models.
    """

    Phi: Array
    """(…, n, n) state transition matrix Φ."""

    Gamma0: Array
    """(…, n, r) effect Γ₀ of the inputs at the start of the step."""

    Gamma1: Array
    """(…, n, r) effect Γ₁ of the inputs at the end of the step."""


def discretize(A: Array, B: Array, dt: float) -> Transition:
    """Discretizes ẋ = A x + B u with a first-order hold of the inputs.

    With inputs that change linearly over the step, the states, the inputs and the change of the inputs follow one
    autonomous linear system, so that all three matrices are blocks of one matrix exponential (Franklin, Powell and
    Workman, Digital Control of Dynamic Systems, 3rd ed., sec. 4.3.2).

    Args:
        A: (…, n, n) system matrices, 1/s; leading axes are several models.
        B: (…, n, r) input matrices.
        dt: sampling step, s.

    Returns:
        Φ (…, n, n), Γ₀ and Γ₁ (…, n, r) of one step.
    """
    n, r = B.shape[-2:]
    end_of_inputs = n + r
    # The state [x; u; change of u over the step], in units of the step: x' = A dt x + B dt u, u' = change.
    generator = np.zeros((*B.shape[:-2], end_of_inputs + r, end_of_inputs + r))
    generator[..., :n, :n] = A * dt
    generator[..., :n, n:end_of_inputs] = B * dt
    generator[..., n:end_of_inputs, end_of_inputs:] = np.eye(r)
    flow = scipy.linalg.expm(generator)
    effect_of_start = flow[..., :n, n:end_of_inputs]
    effect_of_change = flow[..., :n, end_of_inputs:]
    # The change is u_{t+1} − u_t: its effect is added for the inputs at the end, and subtracted for those at the start.
    return Transition(
        Phi=flow[..., :n, :n], Gamma0=effect_of_start - effect_of_change, Gamma1=effect_of_change
    )


MAX_MODE_CONDITION = 1 / np.sqrt(np.finfo(np.float64).eps)
"""Condition number of the eigenvectors above which a recursion runs sample by sample.

At this number, 7e7, the transformation to the eigenvectors loses half of the digits of a float.
"""


def linear_recursion(F: Array, forcing: Array, x0: Array) -> Array:
    """Runs the recursion x_t = F x_{t−1} + g_t over all samples, vectorized over time.

    With F = V Λ V⁻¹ the coordinates V⁻¹ x follow one scalar recursion for each eigenvalue, which is solved for all
    samples at once. If the matrix of eigenvectors is too ill conditioned, as for a defective F, the recursion runs
    sample by sample.

    Args:
        F: (n, n) state transition matrix.
        forcing: (T, n) terms g₁ … g_T that are added at each step.
        x0: (n,) state before the first step.

    Returns:
        States x₁ … x_T, (T, n).
    """
    if not forcing.size:
        return np.empty_like(forcing)
    eigenvalues, eigenvectors = np.linalg.eig(F)
    if np.linalg.cond(eigenvectors) > MAX_MODE_CONDITION:
        return _sample_by_sample(F, forcing, x0)
    # Only one of each pair of conjugate eigenvalues is used, and counted twice: the other adds the same real part.
    is_used = eigenvalues.imag >= 0
    multiplicity = np.where(eigenvalues.imag[is_used] > 0, 2.0, 1.0)
    to_modes = np.linalg.inv(eigenvectors)[is_used]
    modes_at_start = to_modes @ x0
    forcing_of_modes = to_modes @ forcing.T
    modes = []
    for eigenvalue, start, terms in zip(
        eigenvalues[is_used], modes_at_start, forcing_of_modes, strict=True
    ):
        modes.append(scalar_recursion(eigenvalue, terms, start))
    states_of_modes = multiplicity * eigenvectors[:, is_used]
    return (np.array(modes).T @ states_of_modes.T).real


def _sample_by_sample(F: Array, forcing: Array, x0: Array) -> Array:
    """Runs the recursion of :func:`linear_recursion` step by step, which needs no eigenvectors.

    Args:
        F: (n, n) state transition of one step.
        forcing: (T, n) terms that are added at each step.
        x0: (n,) initial state.

    Returns:
        States x₁ … x_T, (T, n).
    """
    states = []
    state = x0
    for term in forcing:
        state = F @ state + term
        states.append(state)
    return np.array(states)


def scalar_recursion(factor: complex, forcing: NDArray[Any], start: complex) -> NDArray[Any]:
    """Runs the recursion x_t = λ x_{t−1} + g_t over all samples at once.

    It is a triangular system of equations with two diagonals, x_t − λ x_{t−1} = g_t, which BLAS solves (``tbsv``).
    ``scipy.signal.lfilter`` returns the same, but its import takes half a second.

    Args:
        factor: λ, real if the forcing is real.
        forcing: (T,) real or complex terms g₁ … g_T, at least one.
        start: x₀, the value before the first step.

    Returns:
        x₁ … x_T, (T,), of the type of the forcing.
    """
    solve_banded: Any = (
        scipy.linalg.blas.ztbsv if np.iscomplexobj(forcing) else scipy.linalg.blas.dtbsv
    )
    # LAPACK's band storage: the first row is the main diagonal, the second the one below it.
    diagonals = np.ones((2, len(forcing)), forcing.dtype, order="F")
    diagonals[1] = -factor
    right_side = forcing.copy()
    right_side[0] += factor * start
    solution: NDArray[Any] = solve_banded(1, diagonals, right_side, lower=1, diag=1)
    return solution
