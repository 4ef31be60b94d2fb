import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.signal import cont2discrete

from mavdem.dem.engine.model import LinearModel, discretize, pack, unpack


def test_parameters_are_the_rows_of_a_then_b_then_c():
    A, B, C = np.arange(4.0).reshape(2, 2), np.arange(4.0, 10).reshape(2, 3), np.arange(10.0, 12).reshape(1, 2)
    theta = pack(A, B, C)
    np.testing.assert_array_equal(theta, np.arange(12))
    # The paper's θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], vec stacking columns.
    np.testing.assert_array_equal(theta, np.concatenate([M.T.ravel(order="F") for M in (A, B, C)]))
    for part, original in zip(unpack(theta, 2, 3, 1), (A, B, C), strict=True):
        np.testing.assert_array_equal(part, original)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 4), r=st.integers(1, 3))
def test_first_order_hold_agrees_with_scipy(seed, n, r):
    rng = np.random.default_rng(seed)
    A, B, dt = rng.standard_normal((n, n)), rng.standard_normal((n, r)), 0.05
    step = discretize(A, B, dt)
    np.testing.assert_allclose(step.state, expm(A * dt), atol=1e-12)
    # SciPy's first-order hold moves Γ₁ into the output equation: its input matrix is Γ₀ + Φ Γ₁.
    phi, gamma, *_ = cont2discrete((A, B, np.eye(n), np.zeros((n, r))), dt, "foh")
    np.testing.assert_allclose(step.input_now + step.state @ step.input_next, gamma, atol=1e-12)


def test_spectral_abscissa_shows_stability():
    stable = LinearModel(np.diag([-1.0, -3.0]), *(np.zeros((2, 2)),) * 2, *(np.zeros(2),) * 3)
    assert stable.spectral_abscissa == pytest.approx(-1.0)
    assert stable._replace(A=np.array([[0.0, 1.0], [4.0, 0.0]])).spectral_abscissa == pytest.approx(2.0)
