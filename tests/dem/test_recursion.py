"""A linear model run over many samples: mode by mode, or sample by sample where its modes are no basis."""

import numpy as np

from mavdem.dem.recursion import WORST_MODES, recursion


def test_defective_dynamics_run_sample_by_sample():
    F = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])
    assert np.linalg.cond(np.linalg.eig(F)[1]) > WORST_MODES
    pushes = np.random.default_rng(0).standard_normal((20, 3))
    states = recursion(F, pushes, np.ones(3))
    state = np.ones(3)
    for push, expected in zip(pushes, states, strict=True):
        state = F @ state + push
        np.testing.assert_allclose(expected, state)
