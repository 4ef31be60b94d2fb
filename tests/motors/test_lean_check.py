"""A lasting shift of the trims is the wind's if the lean against the wind explains it, and else it is not."""

import numpy as np
from frames import geometry
from numpy.random import default_rng
from pytest import mark

from mavdem.motors.balance import SteadyRun
from mavdem.motors.lean_check import is_beyond_lean
from mavdem.motors.signatures import motor_signatures

QUAD = motor_signatures(geometry(4))
SHIFT = 40.0


def flown(lean_step, torque_step, seconds=80.0, lean_effect=0.3):
    """A quadrotor whose mean pitch, rad, and pitch trim step at ``SHIFT``; the trim follows the lean besides."""
    time = np.arange(round(seconds * 10.0)) / 10.0
    draws = default_rng(5)
    is_after = time >= SHIFT
    # Gusts of some seconds move both angles.
    gusts = np.array([np.interp(time, *_gust_points(draws, seconds)) for _ in range(2)])
    lean = (gusts + np.outer([0.0, lean_step], is_after)).T
    balance = np.zeros((len(time), 4))
    balance[:, 0] = 1.0
    balance[:, 1:3] = lean_effect * lean + 0.005 * draws.standard_normal((len(time), 2))
    balance[:, 2] += torque_step * is_after
    commands = 0.6 * balance @ np.linalg.pinv(QUAD.mixer_rows).T
    return SteadyRun(time, commands, lean)


def _gust_points(draws, seconds):
    times = np.arange(0.0, seconds + 4.0, 4.0)
    return times, 0.02 * draws.standard_normal(len(times))


@mark.parametrize(
    "lean_step, torque_step, is_beyond",
    [(0.15, 0.0, False), (0.0, 0.0, False), (0.0, 0.04, True), (0.05, -0.04, True)],
    ids=["wind alone", "nothing", "load alone", "load, and wind"],
)
def test_a_shift_is_beyond_the_lean_only_with_a_torque_that_no_lean_asks_for(
    lean_step, torque_step, is_beyond
):
    run = flown(lean_step, torque_step)
    assert is_beyond_lean(run, QUAD, SHIFT) is is_beyond


@mark.parametrize(("lean_step", "torque_step"), [(0.15, 0.0), (0.0, 0.04)])
@mark.parametrize("seconds_after", [9.0, 13.0])
def test_ten_seconds_after_a_shift_are_enough(seconds_after, lean_step, torque_step):
    run = flown(lean_step, torque_step, seconds=SHIFT + seconds_after)
    is_late = run.time > SHIFT - 16.0
    short_run = SteadyRun(run.time[is_late], run.commands[is_late], run.lean[is_late])
    assert is_beyond_lean(short_run, QUAD, SHIFT) is (torque_step > 0)


@mark.filterwarnings("error")
def test_constant_commands_have_no_shift_and_a_step_between_constants_is_one():
    lean = flown(0.0, 0.0).lean
    time = flown(0.0, 0.0).time
    commands = np.full((len(time), 4), 0.5)
    assert not is_beyond_lean(SteadyRun(time, commands, lean), QUAD, SHIFT)
    stepped = np.where(np.outer(time > SHIFT, [1, 0, 1, 0]), 0.6, commands)
    assert is_beyond_lean(SteadyRun(time, stepped, lean), QUAD, SHIFT)


def test_without_the_lean_or_flight_enough_the_wind_may_explain_a_shift():
    run = flown(0.0, 0.04)
    unknown_lean = SteadyRun(run.time, run.commands, np.full_like(run.lean, np.nan))
    assert not is_beyond_lean(unknown_lean, QUAD, SHIFT)
    assert not is_beyond_lean(run, QUAD, 78.0)
    assert not is_beyond_lean(flown(0.0, 0.04, seconds=47.0), QUAD, SHIFT + 3.0)
