"""The balance of a flight against one whose balance, lean and effect of lean are known."""

from __future__ import annotations

import numpy as np
import pytest

from mavdem.health.balance import balance_figures, motor_signatures

QUAD_X = motor_signatures(4, [(1, 1), (-1, -1), (1, -1), (-1, 1)], [1, 1, -1, -1])
MEAN = np.array([0.03, -0.02, 0.01])
EFFECT = np.array([[0.8, 0.0], [0.1, -0.4], [0.3, -0.2]])


def gusts(rng: np.random.Generator, samples: int) -> np.ndarray:
    """(N, 2) lean in gusts of some seconds, rad."""
    kernel = np.hanning(200)
    return np.array([np.convolve(rng.normal(size=samples), kernel, "same") for _ in range(2)]).T * 0.005


def flown(seed: int, seconds: float = 60.0, noise: float = 0.02):
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 0.02)
    lean = np.array([0.05, -0.03]) + gusts(rng, len(time))
    balance = MEAN + (lean - lean.mean(axis=0)) @ EFFECT.T
    shares = QUAD_X.commands(np.column_stack([np.ones(len(time)), balance]))
    return time, 0.5 * (shares + noise * rng.normal(size=shares.shape)), lean


def test_mean_and_effect_of_lean_are_found_within_their_errors():
    away = []
    for seed in range(60):
        time, commands, lean = flown(seed)
        found = balance_figures(time, commands, lean, QUAD_X)
        assert found is not None
        away.append(
            [*(found.mean - MEAN) / found.error, *((found.lean_effect - EFFECT) / found.lean_effect_error).ravel()]
        )
        assert found.lean == pytest.approx(lean.mean(axis=0), abs=1e-3)
    # Standard scores: their mean is 0 and their size 1, within what 60 flights show (3 standard errors).
    assert np.abs(np.mean(away, axis=0)).max() < 3 / np.sqrt(60) * 1.2
    assert np.std(away, axis=0).max() < 1.5
    assert np.std(away, axis=0).min() > 0.6


def test_the_battery_does_not_change_the_balance():
    time, commands, lean = flown(3)
    charged, empty = (balance_figures(time, scale * commands, lean, QUAD_X) for scale in (0.8, 1.2))
    assert charged is not None
    assert empty is not None
    np.testing.assert_allclose(charged.mean, empty.mean)


def test_a_steady_lean_has_no_effect_that_could_be_seen():
    time, commands, _ = flown(1)
    found = balance_figures(time, commands, np.full((len(time), 2), 0.02), QUAD_X)
    assert found is not None
    assert np.isnan(found.lean_effect).all()
    assert np.isfinite(found.mean).all()


def test_what_is_too_short_or_of_unknown_motors_has_no_figures():
    time, commands, lean = flown(1, seconds=15.0)
    assert balance_figures(time, commands, lean, QUAD_X) is None
    time, commands, lean = flown(1)
    assert balance_figures(time, commands, lean, motor_signatures(4)) is None


def test_axes_that_the_layout_does_not_tell_are_nan():
    time, commands, lean = flown(1)
    found = balance_figures(time, commands, lean, motor_signatures(4, [(1, 1), (-1, -1), (1, -1), (-1, 1)]))
    assert found is not None
    assert np.isfinite(found.mean[:2]).all()
    assert np.isnan(found.mean[2])
