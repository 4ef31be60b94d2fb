from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import hermite

from mavdem.dem.engine.coordinates import (
    derivative_operator,
    embed,
    taylor_weights,
    temporal_covariance,
    temporal_precision,
)


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


@pytest.mark.parametrize(("window", "at"), [(2, 1), (3, 1), (4, 2), (9, 4)])
def test_embedding_is_the_weights_applied_to_each_window(window, at):
    samples = np.random.default_rng(0).standard_normal((30, 2))
    weights = taylor_weights(1, 0.2, window, at)
    embedded = embed(samples, 1, 0.2, window, at)
    assert len(embedded) == 30 - window + 1
    for i in range(30 - window + 1):
        np.testing.assert_allclose(embedded[i], (weights @ samples[i : i + window]).ravel(), atol=1e-9)


def test_derivative_operator_shifts_up_one_order():
    shifted = derivative_operator(2, 2) @ np.arange(6.0)
    np.testing.assert_array_equal(shifted, [2, 3, 4, 5, 0, 0])


@pytest.mark.parametrize("s", [0.01, 1.0, 7.0])
def test_first_entries_are_those_printed_in_the_paper(s):
    expected = [[1, 0, -1 / (2 * s**2)], [0, 1 / (2 * s**2), 0], [-1 / (2 * s**2), 0, 3 / (4 * s**4)]]
    np.testing.assert_allclose(temporal_covariance(2, s), expected)


def test_entries_are_derivatives_of_the_autocorrelation_at_zero():
    # d^k/dτ^k exp(−τ²/4s²) at 0 is (−1/(2s))^k H_k(0) with physicists' Hermite polynomials.
    s, order = 1.7, 6
    covariance = temporal_covariance(order, s)
    for i in range(order + 1):
        for j in range(order + 1):
            hermite_at_zero = hermite.hermval(0.0, [0] * (i + j) + [1])
            expected = (-1) ** i * (-1 / (2 * s)) ** (i + j) * hermite_at_zero
            assert covariance[i, j] == pytest.approx(expected, abs=1e-12 * factorial(i + j))


@pytest.mark.parametrize("s", [1e-3, 0.5, 100.0])
@pytest.mark.parametrize("order", [0, 1, 2, 6])
def test_precision_is_the_inverse_in_any_unit_of_time(order, s):
    # Relative to the size of each row and column, which runs over s^-2p.
    units = s ** np.arange(order + 1)
    product = temporal_covariance(order, s) @ temporal_precision(order, s)
    np.testing.assert_allclose(product * np.outer(units, 1 / units), np.eye(order + 1), atol=1e-8)
