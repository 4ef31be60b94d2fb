import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdem.dem import prediction
from mavdem.dem.prediction import Predictor


def random_predictor(seed, n=3, r=2, m=2, dt=0.02):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) * 3 - 2 * np.eye(n)
    return Predictor.of(
        A, rng.standard_normal((n, r)), np.eye(m, n), dt, rng.uniform(1e-4, 1e-2, m), rng.uniform(0.1, 10, n), dt
    )


@given(seed=st.integers(0, 10**6))
def test_filter_and_forecast_run_the_recursion_they_stand_for(seed):
    predictor = random_predictor(seed)
    rng = np.random.default_rng(seed)
    y, u = rng.standard_normal((40, 2)), rng.standard_normal((40, 2))
    (phi, gamma0, gamma1), C, K = predictor.transition, predictor.C, predictor.gain
    states = [np.linalg.pinv(C) @ y[0]]
    ahead = []
    for t in range(1, 40):
        predicted = phi @ states[-1] + gamma0 @ u[t - 1] + gamma1 @ u[t]
        ahead.append(C @ predicted)
        states.append(predicted + K @ (y[t] - C @ predicted))
    scale = np.abs(states).max()
    np.testing.assert_allclose(predictor.filtered(y, u), states, atol=1e-8 * scale)
    np.testing.assert_allclose(predictor.one_step(y, u), ahead, atol=1e-8 * scale)

    state, forecast = states[9], []
    for t in range(10, 40):
        state = phi @ state + gamma0 @ u[t - 1] + gamma1 @ u[t]
        forecast.append(C @ state)
    scale = np.abs(forecast).max()
    np.testing.assert_allclose(predictor.forecast(states[9], u[9:]), forecast, atol=1e-8 * scale)
    errors = predictor.forecast_errors(y, u, 30, np.array([9]))
    np.testing.assert_allclose(errors[0], y[10:] - forecast, atol=1e-8 * scale)


def test_defective_dynamics_run_sample_by_sample(monkeypatch):
    F = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])
    assert np.linalg.cond(np.linalg.eig(F)[1]) > prediction.WORST_MODES
    pushes = np.random.default_rng(0).standard_normal((20, 3))
    states = prediction._recursion(F, pushes, np.ones(3))
    state = np.ones(3)
    for push, expected in zip(pushes, states, strict=True):
        state = F @ state + push
        np.testing.assert_allclose(expected, state)


def test_gain_is_the_steady_state_of_the_kalman_filter():
    predictor = random_predictor(4)
    rng = np.random.default_rng(4)
    rng.standard_normal((3, 3)), rng.standard_normal((3, 2))
    R, w = np.diag(rng.uniform(1e-4, 1e-2, 2)), rng.uniform(0.1, 10, 3)
    Q = np.diag(w) * 2 * 0.02 * np.sqrt(np.pi) * 0.02
    phi, C = predictor.transition.state, predictor.C
    P = np.eye(3)
    for _ in range(2000):
        P = phi @ P @ phi.T + Q
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        P = P - K @ C @ P
    np.testing.assert_allclose(predictor.gain, K, rtol=1e-6)


def test_an_unseen_unstable_state_leaves_the_outputs_as_they_are():
    A, C = np.diag([1.0, -1.0]), np.array([[0.0, 1.0]])
    predictor = Predictor.of(A, np.zeros((2, 1)), C, 0.1, np.array([0.1]), np.array([1.0, 1.0]), 0.1)
    np.testing.assert_allclose(predictor.gain, [[0], [1]])


def test_one_sample_has_no_prediction():
    predictor = random_predictor(0)
    assert predictor.one_step(np.ones((1, 2)), np.ones((1, 2))).shape == (0, 2)
    assert predictor.forecast(np.ones(3), np.ones((1, 2))) == pytest.approx(np.empty((0, 2)))
