"""A linear model run over many samples: mode by mode, or block by block where its modes are no basis."""

import numpy as np
import pytest

from mavdem.dem.engine.model import WORST_MODES, recursion

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
