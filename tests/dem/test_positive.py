import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_models import positive_definite

from mavdem.dem.engine.linalg import inverse, logdet, solve


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
