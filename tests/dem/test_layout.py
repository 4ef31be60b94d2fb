"""Layouts: their combinations are at right angles, their height is that of the Gaussian, and the data choose."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import GAIN, simulated

from mavdem import Flight, Settings, learn
from mavdem.dem.layout import Likelihood, layouts
from mavdem.dem.model import unpack

COMPLETE = Settings(order=3, d=2, window=9, parameter_precision=1.0)


@pytest.mark.parametrize("rotors", [3, 4, 6, 8])
def test_quiet_combinations_are_of_unit_length_and_at_right_angles(rotors):
    any_way, *named = layouts(rotors)
    assert any_way.quiet.shape == (0, rotors)
    for layout in named:
        np.testing.assert_allclose(layout.quiet @ layout.quiet.T, np.eye(len(layout.quiet)), atol=1e-12)
        np.testing.assert_allclose(layout.quiet[0], rotors**-0.5)


def test_of_four_rotors_an_x_turns_by_two_against_two_and_a_plus_by_one_against_one():
    turning = [layout.turning for layout in layouts(4)[1:]]
    assert layouts(4)[0].turning is None and layouts(6)[1].turning is None
    for layout, way in zip(layouts(4)[1:], turning, strict=True):
        np.testing.assert_allclose(layout.quiet @ way, 0, atol=1e-12)
    sizes = sorted(tuple(np.round(np.sort(np.abs(way)), 3)) for way in turning)
    assert sizes == [(0.0, 0.0, 0.707, 0.707)] * 6 + [(0.5, 0.5, 0.5, 0.5)] * 3
    assert len({tuple(np.round(np.outer(way, way).ravel(), 3)) for way in turning}) == 9


@pytest.mark.parametrize("inputs", [1, 2])
def test_inputs_that_are_no_rotors_have_no_layout(inputs):
    assert layouts(inputs) == ()


def test_the_height_is_that_of_a_linear_gaussian_model():
    """Of data y = J θ + e with a Gaussian prior, at its most probable θ; differences of priors are what counts."""
    rng = np.random.default_rng(0)
    J, at, y = rng.standard_normal((12, 4)), rng.standard_normal(4), rng.standard_normal(12)
    likelihood = Likelihood(at, J.T @ (y - J @ at), J.T @ J)
    ours, exact = [], []
    for _ in range(3):
        root, mean = rng.standard_normal((4, 4)), rng.standard_normal(4)
        precision = root @ root.T + np.eye(4)
        best = np.linalg.solve(J.T @ J + precision, J.T @ y + precision @ mean)
        ours.append(likelihood.height(mean, precision))
        exact.append(-0.5 * np.sum((y - J @ best) ** 2) - 0.5 * (best - mean) @ precision @ (best - mean))
    np.testing.assert_allclose(np.diff(ours), np.diff(exact), rtol=1e-9)


def found(flight: Flight) -> np.ndarray:
    """The combination of four motors that turns the vehicle, with the layout that a flight is learnt with."""
    learned = learn(flight, COMPLETE)
    assert learned.trajectory is not None and learned.trajectory.layout is not None
    turning = learned.trajectory.layout.turning
    assert turning is not None
    return turning


@pytest.mark.parametrize("seed", range(3))
def test_an_x_is_found_by_what_rolls_it(seed):
    turning = found(simulated(wind=0.5, lag=0.05, seed=seed)[:700])
    assert abs(turning @ [-0.5, 0.5, 0.5, -0.5]) == pytest.approx(1)


def test_an_x_is_found_where_nothing_but_roll_is_flown():
    """Then the layouts that hold the very combination that moves must not win by holding it."""
    flight = simulated(wind=0.5, lag=0.05)[:700]
    way = np.array([-0.5, 0.5, 0.5, -0.5])
    only = Flight(flight.time, 1500 + (flight.inputs - 1500) @ np.outer(way, way), flight.outputs, dt=flight.dt)
    assert abs(found(only) @ way) == pytest.approx(1)


def effect(flight: Flight) -> np.ndarray:
    """(4,) what motors do to the rate once their lag has passed, as it is learnt."""
    A, B, _ = unpack(learn(flight, COMPLETE).theta, 3, 5, 2)
    return (B[1] - A[1, 2] * B[2] / A[2, 2])[:4]


def cosine(one: np.ndarray, other: np.ndarray) -> float:
    return float(one @ other / np.linalg.norm(one) / np.linalg.norm(other))


def test_motors_in_a_plus_are_believed():
    """The same motion, by two motors that do what the four did together, and two that turn as they like."""
    flight = simulated(wind=0.2, lag=0.05)[:700]
    pushes = flight.inputs - 1500
    roll, others = pushes @ np.sign(GAIN) / 2, np.roll(pushes[:, :2], 350, axis=0)
    motors = np.column_stack([others[:, 0] + roll, others[:, 1], others[:, 0] - roll, -others[:, 1]])
    assert cosine(effect(Flight(flight.time, 1500 + motors, flight.outputs, dt=flight.dt)), [1, 0, -1, 0]) > 0.97


def test_motors_that_stand_otherwise_are_believed():
    """The same flight, of which one motor is said to be what others do together: no layout knows such a vehicle."""
    flight = simulated(wind=0.2, lag=0.05)
    mixed = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.4, -0.3, 0.2, 1.0]])
    other = Flight(flight.time, flight.inputs @ mixed.T, flight.outputs, dt=flight.dt)[:700]
    assert cosine(effect(other) @ mixed, np.sign(GAIN)) > 0.97
