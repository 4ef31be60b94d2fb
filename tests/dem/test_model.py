"""Linear algebra, generalized coordinates, linear systems and their filters, against SciPy and by brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import hermite
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import MonkeyPatch, approx, mark, raises
from random_models import positive_definite, seeds
from scipy.linalg import expm, solve_discrete_are
from scipy.signal import cont2discrete, lfilter
from scipy.special import factorial
from scipy.stats import multivariate_normal
from textbook_filter import TextbookFilter

from mavdem.dem.engine import kalman
from mavdem.dem.engine.generalized_coordinates import (
    taylor_weights,
    temporal_covariance,
    temporal_precision,
)
from mavdem.dem.engine.kalman import LinearGaussianModel, smooth_states, steady_state_gain
from mavdem.dem.engine.linalg import inverse, logdet, normal_draws, solve
from mavdem.dem.engine.model import (
    MAX_MODE_CONDITION,
    discretize,
    linear_recursion,
    pack,
    scalar_recursion,
    unpack,
)
from mavdem.dem.engine.state_space import filter_gain


def test_parameters_are_the_rows_of_a_then_b_then_c():
    A = np.arange(4.0).reshape(2, 2)
    B = np.arange(4.0, 10).reshape(2, 3)
    C = np.arange(10.0, 12).reshape(1, 2)
    theta = pack(A, B, C)
    # The paper's θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], vec stacking columns.
    assert_array_equal(theta, np.concatenate([M.T.ravel(order="F") for M in (A, B, C)]))
    for part, original in zip(unpack(theta, 2, 3, 1), (A, B, C), strict=True):
        assert_array_equal(part, original)


@mark.slow
@given(seed=seeds, n=st.integers(1, 4), r=st.integers(1, 3))
def test_first_order_hold_agrees_with_scipy(seed, n, r):
    rng = default_rng(seed)
    A = rng.standard_normal((n, n))
    B = rng.standard_normal((n, r))
    dt = 0.05
    step = discretize(A, B, dt)
    assert_allclose(step.Phi, expm(A * dt), atol=1e-12)
    # SciPy's first-order hold moves Γ₁ into the output equation: its input matrix is Γ₀ + Φ Γ₁.
    phi, gamma, *_ = cont2discrete((A, B, np.eye(n), np.zeros((n, r))), dt, "foh")
    assert_allclose(step.Gamma0 + step.Phi @ step.Gamma1, gamma, atol=1e-12)


@mark.slow
@given(seed=seeds, size=st.integers(1, 8))
def test_agrees_with_numpy_whatever_the_units(seed, size):
    """Solutions, inverses and determinants stay accurate where units differ by 24 orders of magnitude."""
    rng = default_rng(seed)
    matrix = positive_definite(rng, size)
    right = rng.standard_normal((size, 3))
    assert_allclose(solve(matrix, right), np.linalg.solve(matrix, right), atol=1e-10)
    units = 10.0 ** rng.integers(-12, 12, size)
    scaled = matrix * np.outer(units, units)
    assert_allclose(inverse(scaled) * np.outer(units, units), np.linalg.inv(matrix), atol=1e-9)
    assert_array_equal(inverse(scaled), inverse(scaled).T)
    assert logdet(scaled) == approx(
        np.linalg.slogdet(matrix)[1] + 2 * np.log(units).sum(), abs=1e-8
    )


@mark.parametrize(
    "matrix", [np.diag([1.0, -1.0]), np.ones((2, 2)) - np.eye(2), np.array([[1.0, 2], [2, 1]])]
)
@mark.parametrize("function", [inverse, logdet, lambda matrix: solve(matrix, np.ones(2))])
def test_a_matrix_that_is_not_positive_definite_is_refused(matrix, function):
    with raises(np.linalg.LinAlgError):
        function(matrix)


DEFECTIVE = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])
FORGETTING = np.array([[0.9, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
GROWING = np.array([[1.01, 1.0, 0.0], [0.0, 1.01, 1.0], [0.0, 0.0, 0.9]])


@mark.parametrize("samples", [1, 2, 26, 400])
@mark.parametrize("F", [DEFECTIVE, FORGETTING, GROWING])
def test_defective_dynamics_run_as_sample_by_sample(F, samples):
    assert np.linalg.cond(np.linalg.eig(F)[1]) > MAX_MODE_CONDITION
    pushes = default_rng(0).standard_normal((samples, 3))
    states = linear_recursion(F, pushes, np.ones(3))
    expected = []
    state = np.ones(3)
    for push in pushes:
        state = F @ state + push
        expected.append(state)
    assert_allclose(states, expected, rtol=1e-9, atol=1e-9)


@mark.slow
@given(seed=seeds)
@settings(max_examples=30)
def test_the_innovation_form_is_the_filter_of_textbooks(seed):
    """The predictor equals a Kalman filter with separate prediction and correction, for random systems."""
    rng = default_rng(seed)
    dt = 0.02
    A = rng.standard_normal((3, 3)) * 3 - 2 * np.eye(3)
    B = rng.standard_normal((3, 2))
    C = np.eye(2, 3)
    gain = filter_gain(A, C, dt, rng.uniform(1e-4, 1e-2, 2), np.diag(rng.uniform(0.1, 10, 3)), dt)
    textbook = TextbookFilter.of(A, B, C, dt, gain)
    predictor = textbook.predictor
    y = rng.standard_normal((40, 2))
    u = rng.standard_normal((40, 2))
    corrected, ahead = textbook.corrected(u, y)
    scale = abs(corrected).max()
    assert_allclose(predictor.one_step_predictions(u, y), ahead, atol=1e-8 * scale)
    # The state of the innovation form is the predicted one, less what the sample's own inputs add.
    predicted = [
        textbook._moved(state, now, now * 0) for state, now in zip(corrected, u, strict=True)
    ]
    start = predictor.second_state(u[0], y[0])
    states = predictor.predicted_states(start, u[1:], y[1:])
    assert_allclose(states, predicted, atol=1e-8 * scale)
    assert_allclose(predictor.state_after(u, y), states[-1], atol=0)

    forecast = textbook.forecast(corrected[9], u[9:])
    scale = abs(forecast).max()
    assert_allclose(predictor.simulate(states[9], u[10:]), forecast, atol=1e-8 * scale)
    from_there = predictor.simulate_from(np.array([10]), 30, states[[9]], u)
    assert_allclose(from_there[0], forecast, atol=1e-8 * scale)
    every = predictor.rolling_forecast(7, start, u[1:], y[1:])
    assert_allclose(every[14:21], textbook.forecast(corrected[14], u[14:])[:7], atol=1e-8 * scale)
    # One sample has no prediction.
    assert predictor.one_step_predictions(np.ones((1, 2)), np.ones((1, 2))).shape == (0, 2)
    assert predictor.simulate(np.ones(3), np.ones((0, 2))).shape == (0, 2)


@mark.parametrize("smoothness", [0.002, 0.5])
def test_coloured_noises_count_with_their_power_at_low_frequency(smoothness):
    """Of w 2s√π in continuous time; of samples of z the same over the step, but not less than their variance."""
    dt = 0.02
    process = np.array([[2.0, 0.3], [0.3, 1.0]])
    measurement = np.array([0.01, 0.04])
    A = np.array([[0.0, 1.0], [-9.0, -4.0]])
    C = np.eye(2)
    gain = filter_gain(A, C, dt, measurement, process, smoothness)
    power = 2 * smoothness * np.sqrt(np.pi)
    Q = process * power * dt
    R = np.diag(measurement) * (power / dt if power > dt else 1.0)
    P = solve_discrete_are(expm(A * dt).T, C.T, Q, R)
    assert_allclose(gain, P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=1e-9)


@mark.parametrize("order, window, at", [(0, 1, 0), (2, 3, 1), (3, 9, 4), (6, 15, 0), (6, 7, 6)])
def test_derivatives_of_polynomials_are_exact(order, window, at):
    """Of all powers of the time in steps, whose derivatives are their factorials."""
    powers = np.vander(np.arange(window) - float(at), order + 1, increasing=True)
    per_step = 0.02 ** np.arange(order + 1)
    derivatives = per_step[:, None] * taylor_weights(order, 0.02, window, at) @ powers
    assert_allclose(derivatives, np.diag(factorial(np.arange(order + 1))), atol=1e-7)


def test_entries_are_derivatives_of_the_autocorrelation_at_zero():
    # d^k/dτ^k exp(−τ²/4s²) at 0 is (−1/(2s))^k H_k(0) with physicists' Hermite polynomials.
    s = 1.7
    i, j = np.indices((7, 7))
    hermite_at_zero = hermite.hermval(0.0, np.eye(13))[i + j]
    expected = (-1.0) ** i * (-1 / (2 * s)) ** (i + j) * hermite_at_zero
    assert_allclose(temporal_covariance(6, s), expected, rtol=1e-12)


@mark.parametrize("s", [1e-3, 0.5, 100.0])
@mark.parametrize("order", [0, 1, 2, 6])
def test_precision_is_the_inverse_in_any_unit_of_time(order, s):
    # Relative to the size of each row and column, which runs over s^-2p.
    units = s ** np.arange(order + 1)
    product = temporal_covariance(order, s) @ temporal_precision(order, s)
    assert_allclose(product * np.outer(units, 1 / units), np.eye(order + 1), atol=1e-8)


def random_gaussian_model(seed, n, k, m, radius=0.9):
    rng = default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= radius / abs(np.linalg.eigvals(A)).max()
    roots = rng.standard_normal((n, n)), rng.standard_normal((m, m))
    return LinearGaussianModel(
        A,
        rng.standard_normal((n, k)),
        rng.standard_normal(n),
        rng.standard_normal((m, n)),
        rng.standard_normal(m),
        *(0.1 * root @ root.T + 0.01 * np.eye(len(root)) for root in roots),
    )


def joint(model, start, inputs, outputs, spread=None):
    """Mean and covariance of all states given all outputs, and the outputs' log-likelihood.

    ``spread`` (n, n) is the covariance of the first state, one unless given.
    """
    A, B, offset, C, trim, Q, R = model
    samples = len(outputs)
    n = len(A)
    # States are a linear map of the first one and all noises.
    effects = np.zeros((samples, n, samples, n))
    means = [start]
    for t in range(samples):
        for s in range(t + 1):
            effects[t, :, s] = np.linalg.matrix_power(A, t - s)
    for u in inputs[:-1]:
        means.append(A @ means[-1] + B @ u + offset)
    effects = effects.reshape(samples * n, samples * n)
    noises = np.kron(np.eye(samples), Q)
    noises[:n, :n] = np.eye(n) if spread is None else spread
    prior = effects @ noises @ effects.T
    mean = np.concatenate(means)
    seen = np.kron(np.eye(samples), C)
    targets = (outputs - trim).ravel()
    of_targets = seen @ prior @ seen.T + np.kron(np.eye(samples), R)
    gain = prior @ seen.T @ np.linalg.inv(of_targets)
    return (
        (mean + gain @ (targets - seen @ mean)).reshape(samples, n),
        (prior - gain @ seen @ prior).reshape(samples, n, samples, n),
        multivariate_normal(seen @ mean, of_targets).logpdf(targets),
    )


@mark.slow
@given(
    seed=seeds,
    n=st.integers(1, 3),
    k=st.integers(0, 2),
    m=st.integers(1, 3),
    samples=st.integers(2, 25),
    radius=st.floats(0.1, 1.1),
    steady_change=st.sampled_from([1e-11, 0.0]),
)
def test_it_is_the_joint_gaussian_given_the_outputs(seed, n, k, m, samples, radius, steady_change):
    """The smoother's means and covariances equal those of the joint Gaussian of all states, given the outputs."""
    with MonkeyPatch.context() as patched:
        patched.setattr(kalman, "STEADY_CHANGE", steady_change)
        rng = default_rng(seed)
        model = random_gaussian_model(seed, n, k, m, radius)
        start, inputs, outputs = (
            rng.standard_normal(shape) for shape in (n, (samples, k), (samples, m))
        )
        states = smooth_states(model, start, inputs, outputs)
    means, covariances, log_likelihood = joint(model, start, inputs, outputs)
    scale = abs(means).max() + 1
    assert_allclose(states.means, means, atol=1e-7 * scale)
    for t in range(samples):
        assert_allclose(states.covariances[t], covariances[t, :, t], atol=1e-7)
        if t:
            assert_allclose(states.lag_one_covariances[t - 1], covariances[t, :, t - 1], atol=1e-7)
    assert states.log_likelihood == approx(log_likelihood, rel=1e-7, abs=1e-6)


@mark.parametrize("radius", [0.5, 0.999])
def test_a_smoother_with_steady_gains_equals_the_exact_one(radius, monkeypatch):
    """Over 400 samples, where gains and smoothing precisions become steady: to 1e-8 of the largest value."""
    rng = default_rng(0)
    model = random_gaussian_model(0, 2, 1, 2, radius)
    segment = (rng.standard_normal(2), rng.standard_normal((400, 1)), rng.standard_normal((400, 2)))
    steady = smooth_states(model, *segment)
    monkeypatch.setattr(kalman, "STEADY_CHANGE", -1.0)
    exact = smooth_states(model, *segment)
    for name in ("means", "covariances", "lag_one_covariances"):
        values = getattr(exact, name)
        assert_allclose(getattr(steady, name), values, rtol=0, atol=1e-8 * abs(values).max())
    assert steady.log_likelihood == approx(exact.log_likelihood, rel=1e-10)


@mark.parametrize("factor", [0.9, -1.01, 0.9 + 0.1j])
def test_a_scalar_recursion_is_a_recursive_filter_of_first_order(factor):
    forcing = default_rng(0).standard_normal(50) * type(factor)(1)
    expected, _ = lfilter([1.0], [1.0, -factor], forcing, zi=[factor * 0.5])
    assert_allclose(scalar_recursion(factor, forcing, 0.5), expected, rtol=1e-12)


@mark.parametrize("noise", [1.0, 1e-4, 1e-8])
@mark.parametrize("radius", [0.5, 0.999, 1.2])
def test_the_steady_gain_is_that_of_riccati_s_equation(noise, radius):
    """Of stable and unstable systems, with correlated noises and nearly exact measurements; also of several at once."""
    rng = default_rng(0)
    A = rng.standard_normal((4, 4))
    A *= radius / abs(np.linalg.eigvals(A)).max()
    C = rng.standard_normal((2, 4))
    root = rng.standard_normal((6, 6))
    root[4:] *= np.sqrt(noise)
    Q, S, _, R = (half for rows in np.split(root @ root.T, [4]) for half in np.split(rows, [4], 1))
    expected = solve_discrete_are(A.T, C.T, Q, R, s=S)
    gain, P = steady_state_gain(A, C, Q, R, S)
    assert_allclose(P, expected, atol=1e-6 * abs(expected).max())
    innovations = C @ expected @ C.T + R
    assert_allclose(gain @ innovations, A @ expected @ C.T + S, atol=1e-6 * abs(expected).max())
    several, _ = steady_state_gain(A[None], C, Q[None], R[None], S[None])
    assert_allclose(several[0], gain, atol=1e-6 * abs(gain).max())


def test_a_state_that_grows_unseen_has_no_steady_gain():
    with raises(np.linalg.LinAlgError, match="no steady filter"):
        steady_state_gain(np.diag([1.1, 0.5]), np.array([[0.0, 1.0]]), np.eye(2), np.eye(1))


def test_draws_have_the_mean_and_the_covariance_that_are_asked_for():
    # The covariance is singular.
    mean, root = np.arange(3.0), default_rng(0).standard_normal((3, 2))
    drawn = normal_draws(mean, root @ root.T, 40, seed=1)
    assert_allclose(drawn.mean(axis=0), mean, atol=1e-12)
    assert_allclose(np.cov(drawn, rowvar=False, ddof=0), root @ root.T, atol=1e-12)
    assert len(normal_draws(mean, root @ root.T, 41, seed=1)) == 41
