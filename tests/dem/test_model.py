import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_models import positive_definite
from scipy.linalg import expm, solve_discrete_are
from scipy.signal import cont2discrete
from textbook_filter import TextbookFilter

from mavdem.dem.engine.linalg import inverse, logdet, solve
from mavdem.dem.engine.model import WORST_MODES, LinearModel, discretize, pack, recursion, unpack
from mavdem.dem.engine.state_space import filter_gain


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


@given(seed=st.integers(0, 10**6), size=st.integers(1, 8))
def test_agrees_with_numpy_whatever_the_units(seed, size):
    rng = np.random.default_rng(seed)
    matrix = positive_definite(rng, size)
    right = rng.standard_normal((size, 3))
    np.testing.assert_allclose(solve(matrix, right), np.linalg.solve(matrix, right), atol=1e-10)
    np.testing.assert_allclose(solve(matrix, right[:, 0]), np.linalg.solve(matrix, right[:, 0]), atol=1e-10)
    units = 10.0 ** rng.integers(-12, 12, size)
    scaled = matrix * np.outer(units, units)
    np.testing.assert_allclose(inverse(scaled) * np.outer(units, units), np.linalg.inv(matrix), atol=1e-9)
    np.testing.assert_array_equal(inverse(scaled), inverse(scaled).T)
    assert logdet(scaled) == pytest.approx(np.linalg.slogdet(matrix)[1] + 2 * np.log(units).sum(), abs=1e-8)


@pytest.mark.parametrize("matrix", [np.diag([1.0, -1.0]), np.ones((2, 2)) - np.eye(2), np.array([[1.0, 2], [2, 1]])])
@pytest.mark.parametrize("function", [inverse, logdet, lambda matrix: solve(matrix, np.ones(2))])
def test_a_matrix_that_is_not_positive_definite_is_refused(matrix, function):
    with pytest.raises(np.linalg.LinAlgError):
        function(matrix)


DEFECTIVE = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])
FORGETTING = np.array([[0.9, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
GROWING = np.array([[1.01, 1.0, 0.0], [0.0, 1.01, 1.0], [0.0, 0.0, 0.9]])


@pytest.mark.parametrize("samples", [1, 2, 3, 20, 25, 26, 400])
@pytest.mark.parametrize("F", [DEFECTIVE, FORGETTING, GROWING])
def test_defective_dynamics_run_as_sample_by_sample(F, samples):
    assert np.linalg.cond(np.linalg.eig(F)[1]) > WORST_MODES
    pushes = np.random.default_rng(0).standard_normal((samples, 3))
    before = pushes.copy()
    states = recursion(F, pushes, np.ones(3))
    expected, state = [], np.ones(3)
    for push in pushes:
        state = F @ state + push
        expected.append(state)
    np.testing.assert_allclose(states, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(pushes, before)


def random_filter(seed, n=3, r=2, m=2, dt=0.02):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) * 3 - 2 * np.eye(n)
    B, C = rng.standard_normal((n, r)), np.eye(m, n)
    gain = filter_gain(A, C, dt, rng.uniform(1e-4, 1e-2, m), np.diag(rng.uniform(0.1, 10, n)), dt)
    return TextbookFilter.of(A, B, C, dt, gain)


@given(seed=st.integers(0, 10**6))
def test_the_innovation_form_is_the_filter_of_textbooks(seed):
    textbook = random_filter(seed)
    predictor = textbook.predictor
    rng = np.random.default_rng(seed)
    y, u = rng.standard_normal((40, 2)), rng.standard_normal((40, 2))
    corrected, ahead = textbook.corrected(u, y)
    scale = np.abs(corrected).max()
    np.testing.assert_allclose(predictor.one_step(u, y), ahead, atol=1e-8 * scale)
    # The state of the innovation form is the predicted one, less what the sample's own inputs add.
    predicted = [textbook._moved(state, now, now * 0) for state, now in zip(corrected, u, strict=True)]
    start = predictor.second(u[0], y[0])
    states = predictor.filtered(start, u[1:], y[1:])
    np.testing.assert_allclose(states, predicted, atol=1e-8 * scale)
    np.testing.assert_allclose(predictor.at_end(u, y), states[-1], atol=0)
    np.testing.assert_allclose(predictor.following(states[5], u[6], y[6]), states[6], atol=1e-8 * scale)

    forecast = textbook.forecast(corrected[9], u[9:])
    scale = np.abs(forecast).max()
    np.testing.assert_allclose(predictor.simulated(states[9], u[10:]), forecast, atol=1e-8 * scale)
    from_there = predictor.simulated_from(np.array([10]), 30, states[[9]], u)
    np.testing.assert_allclose(from_there[0], forecast, atol=1e-8 * scale)
    every = predictor.simulated_every(7, start, u[1:], y[1:])
    np.testing.assert_allclose(every[14:21], textbook.forecast(corrected[14], u[14:])[:7], atol=1e-8 * scale)


def test_one_sample_has_no_prediction():
    predictor = random_filter(0).predictor
    assert predictor.one_step(np.ones((1, 2)), np.ones((1, 2))).shape == (0, 2)
    assert predictor.simulated(np.ones(3), np.ones((0, 2))) == pytest.approx(np.empty((0, 2)))


@pytest.mark.parametrize("smoothness", [0.002, 0.5])
def test_coloured_noises_count_with_their_power_at_low_frequency(smoothness):
    """Of w 2s√π in continuous time; of samples of z the same over the step, but not less than their variance."""
    dt, process, measurement = 0.02, np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([0.01, 0.04])
    A, C = np.array([[0.0, 1.0], [-9.0, -4.0]]), np.eye(2)
    gain = filter_gain(A, C, dt, measurement, process, smoothness)
    power = 2 * smoothness * np.sqrt(np.pi)
    Q, R = process * power * dt, np.diag(measurement) * (power / dt if power > dt else 1.0)
    P = solve_discrete_are(expm(A * dt).T, C.T, Q, R)
    np.testing.assert_allclose(gain, P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=1e-9)
