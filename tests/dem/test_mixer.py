"""Mixer geometry: its combinations are orthonormal, and the parameters of the vehicle or the data choose it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from simulated import GAIN, simulated

from mavdem import Flight, Settings, learn
from mavdem.dem.engine.gauss_newton import Quadratic
from mavdem.dem.engine.model import unpack
from mavdem.dem.forecast.mixer import mixer_priors
from mavdem.dem.record import Record

COMPLETE = Settings(order=3, d=2, window=9, parameter_precision=1.0)


@pytest.mark.parametrize("rotors", [3, 4, 6, 8])
def test_quiet_combinations_are_of_unit_length_and_at_right_angles(rotors):
    any_way, *named = mixer_priors(rotors)
    assert any_way.quiet.shape == (0, rotors)
    for layout in named:
        np.testing.assert_allclose(layout.quiet @ layout.quiet.T, np.eye(len(layout.quiet)), atol=1e-12)
        np.testing.assert_allclose(layout.quiet[0], rotors**-0.5)


def test_of_four_rotors_an_x_turns_by_two_against_two_and_a_plus_by_one_against_one():
    turning = [layout.turning for layout in mixer_priors(4)[1:]]
    assert mixer_priors(4)[0].turning is None and mixer_priors(6)[1].turning is None
    for layout, way in zip(mixer_priors(4)[1:], turning, strict=True):
        np.testing.assert_allclose(layout.quiet @ way, 0, atol=1e-12)
    sizes = sorted(tuple(np.round(np.sort(np.abs(way)), 3)) for way in turning)
    assert sizes == [(0.0, 0.0, 0.707, 0.707)] * 6 + [(0.5, 0.5, 0.5, 0.5)] * 3
    assert len({tuple(np.round(np.outer(way, way).ravel(), 3)) for way in turning}) == 9


@pytest.mark.parametrize("inputs", [1, 2])
def test_inputs_that_are_no_rotors_have_no_layout(inputs):
    assert mixer_priors(inputs) == ()


def test_the_height_is_that_of_a_linear_gaussian_model():
    """Of data y = J θ + e with a Gaussian prior, at its most probable θ; differences of priors are what counts."""
    rng = np.random.default_rng(0)
    J, at, y = rng.standard_normal((12, 4)), rng.standard_normal(4), rng.standard_normal(12)
    likelihood = Quadratic(at, 0.0, J.T @ (y - J @ at), J.T @ J)
    ours, exact = [], []
    for _ in range(3):
        root, mean = rng.standard_normal((4, 4)), rng.standard_normal(4)
        precision = root @ root.T + np.eye(4)
        best = np.linalg.solve(J.T @ J + precision, J.T @ y + precision @ mean)
        ours.append(likelihood.highest(mean, precision))
        exact.append(-0.5 * np.sum((y - J @ best) ** 2) - 0.5 * (best - mean) @ precision @ (best - mean))
    np.testing.assert_allclose(np.diff(ours), np.diff(exact), rtol=1e-9)


def found(flight: Flight) -> np.ndarray:
    """The combination of four motors that turns the vehicle, with the layout that a flight is learnt with."""
    learned = learn(flight, COMPLETE)
    assert learned.simulation_fit is not None and learned.simulation_fit.layout is not None
    turning = learned.simulation_fit.layout.turning
    assert turning is not None
    return turning


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


def test_motors_in_a_plus_are_recognised():
    """The same motion, by two motors that do what the four did together, and two that turn as they like."""
    flight = simulated(wind=0.2, lag=0.05)[:700]
    pushes = flight.inputs - 1500
    roll, others = pushes @ np.sign(GAIN) / 2, np.roll(pushes[:, :2], 350, axis=0)
    motors = np.column_stack([others[:, 0] + roll, others[:, 1], others[:, 0] - roll, -others[:, 1]])
    assert cosine(effect(Flight(flight.time, 1500 + motors, flight.outputs, dt=flight.dt)), [1, 0, -1, 0]) > 0.97


def test_motors_in_another_geometry_are_recognised():
    """The same flight, of which one motor is said to be what others do together: no layout knows such a vehicle."""
    flight = simulated(wind=0.2, lag=0.05)
    mixed = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.4, -0.3, 0.2, 1.0]])
    other = Flight(flight.time, flight.inputs @ mixed.T, flight.outputs, dt=flight.dt)[:700]
    assert cosine(effect(other) @ mixed, np.sign(GAIN)) > 0.97


@pytest.mark.slow
def test_a_known_geometry_takes_the_place_of_the_one_that_is_inferred():
    flight = simulated(wind=1.0, lag=0.05)[:700]
    settings = Settings(order=3, d=2, window=9, parameter_precision=1.0)
    inferred = learn(flight, settings)
    known = learn(_with_directions(flight, np.array([0.2, -0.2, -0.2, 0.2])), settings)
    assert inferred.simulation_fit is not None and known.simulation_fit is not None
    np.testing.assert_allclose(known.simulation_fit.layout.turning, np.array([1, -1, -1, 1]) / 2, atol=1e-12)
    np.testing.assert_allclose(known.simulation_fit.theta, inferred.simulation_fit.theta, atol=1e-4)
    other = learn(_with_directions(flight, np.array([1.0, 1.0, -1.0, -1.0])), settings)
    assert other.simulation_fit is not None
    assert np.abs(other.simulation_fit.theta - inferred.simulation_fit.theta).max() > 1e-2


@pytest.mark.parametrize("wrong", [np.ones(3), np.full(4, np.nan)])
def test_directions_that_are_none_are_refused(wrong):
    with pytest.raises(ValueError, match="effect_directions must be"):
        Record.of(_with_directions(simulated()[:100], wrong))


def test_segments_of_different_geometries_have_none_in_common():
    flight = simulated()[:200]
    same, other = (np.array([1.0, -1.0, -1.0, 1.0]) * sign for sign in (1, -1))
    assert Record.of([_with_directions(flight, same)] * 2).effect_directions is not None
    assert Record.of([_with_directions(flight, same), _with_directions(flight, other)]).effect_directions is None
    assert Record.of([_with_directions(flight, same), flight]).effect_directions is None
    assert Record.of(_with_directions(flight, np.zeros(4))).effect_directions is None
    halves = Record.of(_with_directions(flight, same)).halves()
    assert all(half.effect_directions is not None for half in halves)


def _with_directions(flight, directions):
    return SimpleNamespace(inputs=flight.inputs, outputs=flight.outputs, dt=flight.dt, effect_directions=directions)
