"""Layouts: their combinations are at right angles, their evidence is that of the Gaussian, and the data choose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from simulated import simulated

from mavdem import Settings, learn
from mavdem.dem.layout import Likelihood, layouts
from mavdem.dem.model import unpack

COMPLETE = Settings(order=3, d=2, window=9, parameter_precision=1.0)


@pytest.mark.parametrize("rotors", [3, 4, 6, 8])
def test_quiet_combinations_are_of_unit_length_and_at_right_angles(rotors):
    for layout in layouts(rotors):
        np.testing.assert_allclose(layout.quiet @ layout.quiet.T, np.eye(len(layout.quiet)), atol=1e-12)
        np.testing.assert_allclose(layout.quiet[0], layout.quiet[0, 0])
    assert sum(np.exp(layout.log_share) for layout in layouts(rotors)) == pytest.approx(1)


def test_of_four_rotors_an_x_turns_by_two_against_two_and_a_plus_by_one_against_one():
    turning = [np.linalg.svd(layout.quiet)[2][-1] for layout in layouts(4)[1:]]
    sizes = sorted(tuple(np.round(np.sort(np.abs(way)), 3)) for way in turning)
    assert sizes == [(0.0, 0.0, 0.707, 0.707)] * 6 + [(0.5, 0.5, 0.5, 0.5)] * 3
    assert len({tuple(np.round(np.outer(way, way).ravel(), 3)) for way in turning}) == 9


@pytest.mark.parametrize("inputs", [1, 2])
def test_inputs_that_are_no_rotors_have_no_layout(inputs):
    assert layouts(inputs) == ()


def test_the_evidence_is_that_of_a_linear_gaussian_model():
    """Data y = J θ + e with a Gaussian prior have a Gaussian evidence; differences of priors are what counts."""
    rng = np.random.default_rng(0)
    J, at, y = rng.standard_normal((12, 4)), rng.standard_normal(4), rng.standard_normal(12)
    likelihood = Likelihood(at, J.T @ (y - J @ at), J.T @ J)
    ours, exact = [], []
    for _ in range(3):
        root, mean = rng.standard_normal((4, 4)), rng.standard_normal(4)
        precision = root @ root.T + np.eye(4)
        ours.append(likelihood.log_evidence(mean, precision))
        exact.append(multivariate_normal(J @ mean, J @ np.linalg.inv(precision) @ J.T + np.eye(12)).logpdf(y))
    np.testing.assert_allclose(np.diff(ours), np.diff(exact), rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_an_x_is_found_by_what_rolls_it(seed):
    learned = learn(simulated(wind=0.5, lag=0.05, seed=seed)[:700], COMPLETE)
    assert learned.trajectory is not None and learned.trajectory.layout is not None
    truth = np.array([-1.0, 1.0, 1.0, -1.0]) / 2
    quiet = learned.trajectory.layout.quiet
    # The truth is all that is not quiet: of a layout that knows less, it would be at right angles to the lift alone.
    np.testing.assert_allclose(quiet.T @ quiet, np.eye(4) - np.outer(truth, truth), atol=1e-12)


def test_motors_that_stand_otherwise_are_believed_where_they_tell():
    """The same flight, of which one motor is said to be what all four do together: no layout knows such a vehicle."""
    flight = simulated(wind=0.2, lag=0.05)
    mixed = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.4, -0.3, 0.2, 1.0]])
    other = type(flight)(flight.time, flight.inputs @ mixed.T, flight.outputs, dt=flight.dt)
    learned = learn(other[:700], COMPLETE)
    assert learned.trajectory is not None
    n, r, m = 3, 5, 2
    A, B, _ = unpack(learned.theta, n, r, m)
    effect = (B[1] - A[1, 2] * B[2] / A[2, 2])[:4] @ mixed
    truth = np.array([-1.0, 1.0, 1.0, -1.0])
    assert abs(effect @ truth) / np.linalg.norm(effect) / 2 > 0.97
