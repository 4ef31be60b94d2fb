"""Skill by horizon: what counts at which, and beside what."""

from __future__ import annotations

import numpy as np
import pytest

from mavdem import Flight, baselines, evaluate
from mavdem.evaluate import HORIZONS, horizons, skill, skill_by_horizon

RNG = np.random.default_rng(0)
WALK = RNG.standard_normal((850, 2)).cumsum(axis=0) * [1, 10]
FLIGHT = Flight(0.01 * np.arange(850), RNG.standard_normal((850, 2)), WALK)
TRAIN, TEST = FLIGHT[:700], FLIGHT[700:]


def test_the_constant_mean_has_one_at_every_horizon():
    for one in skill_by_horizon(baselines.constant_mean(TRAIN), TRAIN, TEST):
        assert one.relative == pytest.approx(1)
        np.testing.assert_allclose(one.relative_per_output, 1)


def test_each_sample_counts_once_and_the_last_horizon_is_the_mspe():
    hold = baselines.hold(TRAIN)
    found = {one.steps: one for one in skill_by_horizon(hold, TRAIN, TEST)}
    assert tuple(found) == HORIZONS
    before = np.vstack([TRAIN.outputs[-1:], TEST.outputs[24:-1:25]])
    errors = (TEST.outputs - np.repeat(before, 25, axis=0)) ** 2 / TRAIN.outputs.var(axis=0)
    np.testing.assert_allclose(found[25].per_output, errors.mean(axis=0))
    assert found[25].total == pytest.approx(errors.mean(axis=0).sum())
    whole = hold.forecast(TEST.inputs)
    assert found[150].relative == pytest.approx(evaluate.relative_mspe(TRAIN, TEST, whole))
    np.testing.assert_allclose(
        found[150].per_output * TRAIN.outputs.var(axis=0), evaluate.mspe(TEST.outputs, whole).per_output
    )


def test_a_random_walk_held_errs_more_the_longer():
    """Of a walk of unit steps the error k steps on is k, so their mean up to it (k + 1) / 2."""
    walks = np.random.default_rng(1).standard_normal((850, 40)).cumsum(axis=0)
    flight = Flight(0.01 * np.arange(850), FLIGHT.inputs, walks)
    train, test = flight[:700], flight[700:]
    found = skill_by_horizon(baselines.hold(train), train, test, (1, 5, 10, 25))
    errors = [(one.per_output * train.outputs.var(axis=0)).mean() for one in found]
    # Of 40 walks of 150/k pieces: errors within a piece are one, so five deviations of a χ² of so many, at most.
    for steps, error in zip((1, 5, 10, 25), errors, strict=True):
        assert error == pytest.approx((steps + 1) / 2, rel=5 * np.sqrt(2 / (40 * 150 / steps)))


def test_units_do_not_matter():
    scaled = Flight(FLIGHT.time, FLIGHT.inputs, FLIGHT.outputs * [57.3, 0.01] + 5)
    one, other = (
        skill(flight[:700], flight[700:], baselines.hold(flight[:700]).forecast(flight.inputs[700:]), 150)
        for flight in (FLIGHT, scaled)
    )
    assert one.relative == pytest.approx(other.relative)
    np.testing.assert_allclose(one.per_output, other.per_output)


def test_a_forecast_beyond_all_numbers_errs_infinitely():
    found = skill(TRAIN, TEST, np.full_like(TEST.outputs, np.nan), 150)
    assert found.total == found.relative == np.inf


def test_neither_erring_is_alike():
    still = Flight(TEST.time, TEST.inputs, np.tile(TRAIN.outputs.mean(axis=0), (150, 1)))
    assert skill(TRAIN, still, still.outputs, 150).relative == 1


def test_horizons_are_those_of_the_test_part():
    assert horizons(150, 0.01) == HORIZONS
    assert horizons(100, 1 / 120) == (1, 5, 10, 25, 50, 100)
    assert horizons(200, 0.02) == (*HORIZONS, 200)
    assert horizons(1, 0.01) == (1,)
    assert horizons(600, 1 / 400) == (4, 20, 40, 100, 200, 600)
