"""The balance of a flight against one that is known, and recorded flights with one propeller shortened."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from frames import FRAMES, geometry
from numpy.random import default_rng
from numpy.testing import assert_allclose
from propellers import health_figures
from pytest import approx, fixture, mark
from recorded_flights import shared
from scipy.ndimage import convolve1d

from mavdem.motors.balance import SteadyRun, motor_balance
from mavdem.motors.health import assess_motor_health
from mavdem.motors.signatures import motor_signatures

QUAD_X = motor_signatures(geometry())
UNKNOWN = motor_signatures(geometry(positions=(), spins=()))
MEAN = np.array([0.03, -0.02, 0.01])
EFFECT = np.array([[0.8, 0.0], [0.1, -0.4], [0.3, -0.2]])


def flight_in_gusts(seed, seconds=60.0):
    """Times, commands, and a lean (N, 2), rad, in gusts of some seconds."""
    rng = default_rng(seed)
    time = np.arange(0.0, seconds, 0.02)
    noise = rng.normal(scale=0.005, size=(len(time), 2))
    lean = [0.05, -0.03] + convolve1d(noise, np.hanning(200), axis=0, mode="constant")
    balance = MEAN + (lean - lean.mean(axis=0)) @ EFFECT.T
    shares = np.column_stack([np.ones(len(time)), balance]) @ np.linalg.pinv(QUAD_X.mixer_rows).T
    return time, 0.5 * rng.normal(shares, 0.02), lean


def figures(time, commands, lean, signatures=QUAD_X):
    return motor_balance([SteadyRun(time, commands, lean)], signatures, time[-1] - time[0])


@mark.slow
def test_mean_and_effect_of_lean_are_found_within_their_errors():
    """Over 60 simulated flights, errors divided by their stated standard deviations must have mean 0 and spread 1."""
    standard_scores = []
    for seed in range(60):
        time, commands, lean = flight_in_gusts(seed)
        balance = figures(time, commands, lean)
        scores_of_effect = (balance.lean_effect - EFFECT) / balance.lean_effect_error
        standard_scores.append([*(balance.mean - MEAN) / balance.error, *scores_of_effect.ravel()])
        assert balance.lean == approx(lean.mean(axis=0), abs=1e-3)
    # Standard scores: their mean is 0 and their size 1, within what 60 flights show (3 standard errors).
    assert abs(np.mean(standard_scores, axis=0)).max() < 3 / np.sqrt(60) * 1.2
    spread = np.std(standard_scores, axis=0)
    assert spread.max() < 1.5 and spread.min() > 0.6
    # The battery does not change it.
    charged, empty = (figures(time, scale * commands, lean) for scale in (0.8, 1.2))
    assert_allclose(charged.mean, empty.mean)


@mark.slow
def test_effects_of_lean_from_six_blocks_hold_the_truth():
    """Flights of only six blocks of 3 s: the intervals must account for so few degrees of freedom."""
    time = np.linspace(0.0, 18.0, 900)
    inside = []
    for seed in range(200):
        rng = default_rng(seed)
        # One lean and one error of the balance for each block of 3 s: there is no effect of lean.
        lean = np.repeat(rng.normal(scale=0.03, size=(6, 2)), 150, axis=0)
        errors = np.repeat(rng.normal(scale=0.005, size=(6, 3)), 150, axis=0)
        shares = np.column_stack([np.ones(len(time)), errors]) @ np.linalg.pinv(QUAD_X.mixer_rows).T
        balance = figures(time, 0.5 * shares, lean)
        inside.append(abs(balance.lean_effect) < 1.645 * balance.lean_effect_error)
    # 90 %, less the 3 standard errors of 200 flights; normal errors that ignore that there are 6 blocks hold 82 %.
    assert np.mean(inside) > 0.9 - 3 * np.sqrt(0.9 * 0.1 / 200)


def test_what_cannot_be_seen_is_not_known():
    time, commands, lean = flight_in_gusts(1)
    steady = figures(time, commands, np.full((len(time), 2), 0.02))
    assert np.isnan(steady.lean_effect).all() and np.isfinite(steady.mean).all()
    without_spins = motor_signatures(geometry(spins=()))
    assert np.isnan(figures(time, commands, lean, without_spins).mean).tolist() == [0, 0, 1]
    assert figures(time, commands, lean, UNKNOWN) is None
    assert figures(*flight_in_gusts(1, seconds=15.0)) is None


@fixture(params=FRAMES)
def layout(request):
    return geometry(request.param)


def trimmed(layout, thrusts):
    """Commands by which a mixer holds the forces of a hover where motor i gives ``thrusts[i]`` for a command of 1."""
    forward, right = np.array(layout.positions).T
    forces = np.array([np.ones(len(right)), -right, forward, layout.spins])
    mixer = np.linalg.pinv(forces)
    return mixer @ np.linalg.solve(forces * thrusts @ mixer, forces.sum(axis=1))


def test_a_weak_motor_changes_the_trim_as_its_signature_says(layout):
    signatures = motor_signatures(layout)
    for motor, one in enumerate(np.eye(len(layout.motors))):
        change = (trimmed(layout, 1 - 1e-5 * one) - trimmed(layout, 1.0)) / 1e-5
        assert_allclose(change, signatures.weak_motor_commands[motor], atol=1e-4)
        assert_allclose(
            signatures.mixer_rows @ change, signatures.weak_motor_balance[motor], atol=1e-4
        )


def test_axes_and_names_are_those_of_the_layout(layout):
    """For each frame, motors can be identified if positions and spins are known and differ."""
    count = len(layout.motors)
    signatures = motor_signatures(layout)
    assert signatures.axes == ("thrust", "roll", "pitch", "yaw")
    assert UNKNOWN.axes == ("thrust",)
    assert_allclose(
        signatures.mixer_rows[1:], [layout.mixer_row(axis) for axis in signatures.axes[1:]]
    )
    # A motor can be named where places and spins are known and differ.
    assert signatures.is_motor_identifiable
    coaxial = {name: getattr(layout, name) * 2 for name in ("motors", "positions", "spins")}
    spins = (), (0,) * count, (1, *(0,) * (count - 1))
    for other in (coaxial, {"positions": ()}, *({"spins": known} for known in spins)):
        assert not motor_signatures(replace(layout, **other)).is_motor_identifiable


@mark.slow
def test_a_propeller_cut_a_little_is_a_drift_in_flights_one_after_the_other():
    good, cut = [], []
    for name in ("hover_good_1", "hover_good_2", "straight_good_1"):
        good.append(health_figures(shared(f"real/propeller/{name}.BIN")))
    for day, name in enumerate(("hover_cut10mm_1", "straight_cut10mm_1"), 14):
        figures = health_figures(shared(f"real/propeller/{name}.BIN"))
        cut.append(replace(figures, date=datetime(2022, 3, day, tzinfo=UTC)))
    assert {balance.health for balance in assess_motor_health(cut, good)} == {"drift"}
