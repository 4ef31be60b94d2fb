"""Smoothers against the joint Gaussian of all states and outputs, by brute force; gains against SciPy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.stats import multivariate_normal

from mavdem.dem.engine import kalman
from mavdem.dem.engine.kalman import GaussianModel, smoothed, steady_covariance, steady_gain


def random_gaussian_model(seed, n, k, m, radius=0.9):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    roots = rng.standard_normal((n, n)), rng.standard_normal((m, m))
    return GaussianModel(
        A,
        rng.standard_normal((n, k)),
        rng.standard_normal(n),
        rng.standard_normal((m, n)),
        rng.standard_normal((m, k)),
        rng.standard_normal(m),
        *(0.1 * root @ root.T + 0.01 * np.eye(len(root)) for root in roots),
    )


def joint(model, start, inputs, outputs, spread=None):
    """Mean and covariance of all states given all outputs, and the outputs' log-likelihood.

    ``spread`` (n, n) is the covariance of the first state, one unless given.
    """
    A, B, offset, C, D, trim, Q, R = model
    samples, n = len(outputs), len(A)
    # States are a linear map of the first one and all noises.
    effects, means = np.zeros((samples, n, samples, n)), [start]
    for t in range(samples):
        for s in range(t + 1):
            effects[t, :, s] = np.linalg.matrix_power(A, t - s)
    for u in inputs[:-1]:
        means.append(A @ means[-1] + B @ u + offset)
    effects = effects.reshape(samples * n, samples * n)
    noises = np.kron(np.eye(samples), Q)
    noises[:n, :n] = np.eye(n) if spread is None else spread
    prior, mean = effects @ noises @ effects.T, np.concatenate(means)
    seen, targets = np.kron(np.eye(samples), C), (outputs - inputs @ D.T - trim).ravel()
    of_targets = seen @ prior @ seen.T + np.kron(np.eye(samples), R)
    gain = prior @ seen.T @ np.linalg.inv(of_targets)
    return (
        (mean + gain @ (targets - seen @ mean)).reshape(samples, n),
        (prior - gain @ seen @ prior).reshape(samples, n, samples, n),
        multivariate_normal(seen @ mean, of_targets).logpdf(targets),
    )


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 3),
    k=st.integers(0, 2),
    m=st.integers(1, 3),
    samples=st.integers(2, 25),
    radius=st.floats(0.1, 1.1),
    stands_still=st.sampled_from([1e-11, 0.0]),
)
def test_it_is_the_joint_gaussian_given_the_outputs(seed, n, k, m, samples, radius, stands_still):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(kalman, "STEADY", stands_still)
        rng = np.random.default_rng(seed)
        model = random_gaussian_model(seed, n, k, m, radius)
        start, inputs, outputs = (rng.standard_normal(shape) for shape in (n, (samples, k), (samples, m)))
        states = smoothed(model, start, inputs, outputs)
    means, covariances, log_likelihood = joint(model, start, inputs, outputs)
    scale = np.abs(means).max() + 1
    np.testing.assert_allclose(states.means, means, atol=1e-7 * scale)
    for t in range(samples):
        np.testing.assert_allclose(states.covariances[t], covariances[t, :, t], atol=1e-7)
        if t:
            np.testing.assert_allclose(states.lagged[t - 1], covariances[t, :, t - 1], atol=1e-7)
    assert states.log_likelihood == pytest.approx(log_likelihood, rel=1e-7, abs=1e-6)


def test_covariances_that_stand_still_are_those_that_go_on(monkeypatch):
    model = random_gaussian_model(0, 2, 1, 2)
    rng = np.random.default_rng(0)
    data = rng.standard_normal(2), rng.standard_normal((3000, 1)), rng.standard_normal((3000, 2))
    quick = smoothed(model, *data)
    monkeypatch.setattr(kalman, "STEADY", 0.0)
    whole = smoothed(model, *data)
    for one, other in zip(quick, whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_a_covariance_that_is_none_is_reported():
    model = random_gaussian_model(0, 2, 1, 2)
    data = np.zeros(2), np.zeros((5, 1)), np.zeros((5, 2))
    with pytest.raises(np.linalg.LinAlgError):
        smoothed(model._replace(R=-10 * np.eye(2)), *data)
    with np.errstate(all="ignore"), pytest.raises(np.linalg.LinAlgError):
        smoothed(model._replace(A=1e200 * np.eye(2)), *data)


@pytest.mark.parametrize("noise", [1.0, 1e-4, 1e-8])
@pytest.mark.parametrize("radius", [0.5, 0.999, 1.2])
def test_the_steady_covariance_solves_riccati_s_equation(noise, radius):
    """Of stable and unstable systems, side by side, with correlated noises and nearly exact measurements."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((20, 4, 4))
    A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    C, root = rng.standard_normal((20, 2, 4)), rng.standard_normal((20, 6, 6))
    root[:, 4:] *= np.sqrt(noise)
    joint = root @ np.swapaxes(root, 1, 2)
    Q, S, R = joint[:, :4, :4], joint[:, :4, 4:], joint[:, 4:, 4:]
    expected = np.array([solve_discrete_are(a.T, c.T, q, r, s=s) for a, c, q, r, s in zip(A, C, Q, R, S, strict=True)])
    found = steady_covariance(A, C, Q, R, S)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    gain, P = steady_gain(A[0], C[0], Q[0], R[0], S[0])
    np.testing.assert_allclose(P, expected[0], atol=1e-6 * np.abs(expected[0]).max())
    innovations = C[0] @ expected[0] @ C[0].T + R[0]
    np.testing.assert_allclose(gain @ innovations, A[0] @ expected[0] @ C[0].T + S[0], atol=1e-6 * np.abs(P).max())


def test_a_state_that_grows_unseen_has_no_steady_filter():
    with pytest.raises(np.linalg.LinAlgError, match="no steady filter"):
        steady_gain(np.diag([1.1, 0.5]), np.array([[0.0, 1.0]]), np.eye(2), np.eye(1))
