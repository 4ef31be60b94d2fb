"""Motors that lose thrust slowly: the whole flight names them, and neither noise, wind, load nor a gust does."""

import numpy as np
from frames import FRAMES, geometry
from numpy.random import default_rng
from pytest import mark

from mavdem.motors.gradual_loss import gradual_loss
from mavdem.motors.signatures import motor_signatures

RATE = 10.0
SIGNATURES = {motors: motor_signatures(geometry(motors)) for motors in FRAMES}


def flight(motors, seconds=30.0, sd=0.01, seed=1):
    """Times (N,), s, and commands (N, k) of a sound vehicle in wind, about 0.6 of the range."""
    time = 50.0 + np.arange(round(seconds * RATE)) / RATE
    allocation = np.linalg.pinv(SIGNATURES[motors].mixer_rows)
    noise = default_rng(seed).standard_normal((len(time), allocation.shape[1]))
    return time, 0.6 * (1 + sd * noise @ allocation.T)


def ramp(time, start, seconds):
    """The course of a slow change, from 0 to 1, that begins ``start`` seconds after the flight did."""
    return np.clip((time - time[0] - start) / seconds, 0.0, 1.0)


def with_slow_loss(motors, motor, work, start=12.0, seconds=10.0, **flown):
    """Times and commands of a vehicle whose motor slowly needs so much more work than the mean one."""
    time, commands = flight(motors, **flown)
    response = SIGNATURES[motors].weak_motor_commands[motor]
    return time, commands + 0.6 * work * np.outer(ramp(time, start, seconds), response)


def with_slow_torque(roll=0.0, pitch=0.0, yaw=0.0):
    """Times and commands of a quadrotor whose balance slowly changes by so much, relative to its thrust."""
    time, commands = flight(4)
    allocation = np.linalg.pinv(SIGNATURES[4].mixer_rows)
    change = allocation @ [0.0, roll, pitch, yaw]
    return time, commands + 0.6 * np.outer(ramp(time, 12.0, 10.0), change)


def found(flown, lean=(0.0, 0.0)):
    """The loss of a flight with one lean, roll and pitch in degrees."""
    time, commands = flown
    leans = np.tile(np.radians(lean), (len(time), 1))
    return gradual_loss(time, commands, leans, geometry(commands.shape[1]))


@mark.slow
@mark.parametrize("motors", FRAMES)
def test_the_motor_that_lost_thrust_slowly_is_named(motors):
    for motor in range(motors):
        loss = found(with_slow_loss(motors, motor, work=0.35))
        assert loss.motor == geometry(motors).motors[motor]
        assert abs(loss.onset_time - 62.0) < 4.0
        assert loss.is_weak


def test_the_loss_of_thrust_is_inside_its_interval():
    loss = found(with_slow_loss(4, 2, work=0.3))
    lowest, highest = loss.loss
    # A third more command is a quarter less thrust, if thrust goes with the command, and 43 % if with its square.
    assert lowest < 1 - 1 / 1.3 < highest
    assert highest < 0.6


@mark.slow
@mark.parametrize("motors", FRAMES)
def test_a_sound_flight_names_no_motor(motors):
    for seed in range(20):
        assert found(flight(motors, seed=seed)) is None


@mark.parametrize(
    "torque", [{"roll": 0.1}, {"pitch": -0.1}, {"yaw": 0.15}, {"roll": 0.08, "pitch": 0.08}]
)
def test_wind_load_and_yaw_name_no_motor(torque):
    assert found(with_slow_torque(**torque)) is None


def test_a_load_that_shifts_in_wind_towards_a_motor_names_no_motor():
    """It changes yaw too, as a loss does, but not all axes alike."""
    assert found(with_slow_torque(roll=-0.075, pitch=0.04, yaw=0.064)) is None


def test_a_small_change_of_the_balance_names_no_motor():
    assert found(with_slow_loss(4, 1, work=0.1)) is None


def test_a_change_shortly_before_the_end_names_no_motor():
    assert found(with_slow_loss(4, 1, work=0.3, start=25.0, seconds=2.0)) is None


def test_a_flight_of_eight_seconds_names_no_motor():
    time, commands = with_slow_loss(4, 1, work=0.3, start=4.0, seconds=2.0)
    is_short = time < time[0] + 8.0
    assert found((time[is_short], commands[is_short])) is None
