import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdem.dem.engine.coordinates import derivative_operator, embed, taylor_weights


@given(order=st.integers(0, 6), extra=st.integers(0, 8), dt=st.floats(1e-3, 10), data=st.data())
def test_derivatives_of_polynomials_are_exact(order, extra, dt, data):
    window = order + 1 + extra
    at = data.draw(st.integers(0, window - 1))
    coefficients = np.array(data.draw(st.lists(st.floats(-1, 1), min_size=order + 1, max_size=order + 1)))
    # A polynomial in steps, so that its size does not depend on dt.
    polynomial = np.polynomial.Polynomial(coefficients)
    samples = polynomial(np.arange(window) - at)
    derivatives = taylor_weights(order, dt, window, at) @ samples
    expected = [polynomial.deriv(k)(0) / dt**k if k else polynomial(0) for k in range(order + 1)]
    per_step = dt ** np.arange(order + 1)
    np.testing.assert_allclose(derivatives * per_step, expected * per_step, atol=1e-7)


def test_two_samples_give_a_backward_difference_and_three_a_central_one():
    np.testing.assert_allclose(taylor_weights(1, 0.5, 2, 1), [[0, 1], [-2, 2]], atol=1e-12)
    np.testing.assert_allclose(taylor_weights(2, 0.5, 3, 1), [[0, 1, 0], [-1, 0, 1], [4, -8, 4]], atol=1e-12)


def test_embedding_is_order_major_and_pads_nothing():
    time = 0.1 * np.arange(20)
    samples = np.stack([time**2, 3 * time], axis=1)
    embedded = embed(samples, 2, 0.1, 5, 2)
    at = time[2:-2]
    expected = np.stack([at**2, 3 * at, 2 * at, 0 * at + 3, 0 * at + 2, 0 * at], axis=1)
    np.testing.assert_allclose(embedded, expected, atol=1e-9)


@pytest.mark.parametrize(("window", "at"), [(2, 1), (3, 1), (4, 2), (9, 4)])
def test_embedding_is_the_weights_applied_to_each_window(window, at):
    samples = np.random.default_rng(0).standard_normal((30, 2))
    weights = taylor_weights(1, 0.2, window, at)
    embedded = embed(samples, 1, 0.2, window, at)
    for i in range(30 - window + 1):
        np.testing.assert_allclose(embedded[i], (weights @ samples[i : i + window]).ravel(), atol=1e-9)


def test_derivative_operator_shifts_up_one_order():
    shifted = derivative_operator(2, 2) @ np.arange(6.0)
    np.testing.assert_array_equal(shifted, [2, 3, 4, 5, 0, 0])
