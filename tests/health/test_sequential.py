"""The sequential test finds a motor that works harder, names it, and says nothing of noise, yaw or a shifted load."""

import numpy as np
import pytest

from mavdem.health.balance import motor_signatures
from mavdem.health.in_flight import HOURS_TO_FALSE_ALARM, BalanceTest

RATE, BREAKS = 10.0, 20.0  # Hz, s
X = np.sqrt(0.5) * np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)])
HEXA = np.array([(np.cos(at), np.sin(at)) for at in np.radians([90, -90, -30, 150, 30, -150])])
QUAD = motor_signatures(4, X, (1, 1, -1, -1))
SIX = motor_signatures(6, HEXA, (-1, 1, -1, 1, 1, -1))
OCTO = np.array([(np.cos(at), np.sin(at)) for at in np.radians(np.arange(22.5, 360, 45))])
EIGHT = motor_signatures(8, OCTO, (1, -1) * 4)


def coloured(seed, samples, sd, seconds):
    """(N, 4) noise of an exponential autocorrelation, of thrust, roll, pitch and yaw."""
    keeps = np.exp(-1 / (RATE * seconds))
    draws = np.random.default_rng(seed).standard_normal((samples, 4)) * np.sqrt(1 - keeps**2)
    noise = np.empty_like(draws)
    latest = np.zeros(4)
    for row, draw in enumerate(draws):
        noise[row] = latest = keeps * latest + draw
    return sd * noise


def flight(seed, seconds=45.0, sd=0.01, coloured_by=0.5, signatures=QUAD):
    """Times (N,) and commands (N, k) of a sound vehicle in wind, about 0.6 of the range."""
    time = np.arange(round(seconds * RATE)) / RATE + 100.0
    noise = coloured(seed, len(time), sd, coloured_by)
    return time, 0.6 * (1 + signatures.commands(noise))


def changes(time, commands, signatures=QUAD):
    test = BalanceTest(signatures)
    found = [test.take(at, row) for at, row in zip(time.tolist(), commands, strict=True)]
    return [one for one in found if one is not None]


def after(time, rise):
    """(N, 4) commands that rise (4,) from the break on."""
    return np.outer(time >= 100.0 + BREAKS, rise)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("motor", range(4))
def test_a_motor_that_works_an_eighth_harder_is_named_within_five_seconds(motor, seed):
    time, commands = flight(seed)
    rise = 0.125 * 0.6 * np.eye(4)[motor]
    [first, *rest] = changes(time, commands + after(time, rise))
    assert first.motor == motor and not rest
    assert BREAKS < first.time - 100.0 <= BREAKS + 5.0
    assert first.since == pytest.approx(100.0 + BREAKS, abs=2.0)
    assert first.size == pytest.approx(0.125 / (1 + 0.125 / 4), abs=0.04)
    assert 0.95 < first.probability <= 1


@pytest.mark.parametrize("motor", range(6))
def test_of_six_motors_too(motor):
    time, commands = flight(motor, sd=0.005, signatures=SIX)
    rise = 0.3 * 0.6 * SIX.weak_motor_commands[motor]
    [first, *_] = changes(time, commands + after(time, rise), SIX)
    assert first.motor == motor and first.time - 100.0 <= BREAKS + 5.0


@pytest.mark.parametrize("signatures", [SIX, EIGHT])
def test_the_size_is_that_of_the_motor_s_own_command_also_where_its_neighbours_help(signatures):
    time, commands = flight(5, sd=0.003, signatures=signatures)
    pattern = signatures.weak_motor_commands[0]
    rise = 0.15 * pattern / pattern[0]
    [first, *_] = changes(time, commands + after(time, 0.6 * rise), signatures)
    assert first.motor == 0
    assert first.size == pytest.approx(0.15 / (1 + rise.mean()), abs=0.03)


@pytest.mark.parametrize("shift", [(0.05, 0.0), (0.0, -0.06), (-0.05, 0.05), (0.03, 0.06)])
def test_a_shifted_load_is_called_that_once_it_has_lasted(shift):
    time, commands = flight(7)
    rise = 0.6 * QUAD.commands([0.0, *shift, 0.0])
    [first, *rest] = changes(time, commands + after(time, rise))
    assert first.motor is None and not rest
    assert BREAKS + 8.0 <= first.time - 100.0 < BREAKS + 15.0
    assert first.size == pytest.approx(np.hypot(*shift), abs=0.015)


@pytest.mark.parametrize("change", [(0.0, 0.0, 0.0, 0.05), (0.15, 0.0, 0.0, 0.0)])
def test_yaw_alone_and_thrust_alone_are_no_motor(change):
    time, commands = flight(8)
    assert not changes(time, commands + after(time, 0.6 * QUAD.commands(change)))


@pytest.mark.parametrize(("sd", "seconds"), [(0.01, 0.1), (0.02, 3.0)])
def test_coloured_noise_gives_no_alarm(sd, seconds):
    """Over five minutes each; what is slow is more than the test was told of at first, and it must learn that."""
    time, commands = flight(3, 300.0, sd, seconds)
    assert HOURS_TO_FALSE_ALARM > 2 * 300 / 3600
    assert not [one for one in changes(time, commands) if one.motor is not None]


def test_a_gust_that_passes_is_no_change():
    time, commands = flight(4, 60.0, 0.005)
    gust = np.exp(-((time - 130.0) ** 2) / 2 / 1.5**2)
    assert not changes(time, commands + 0.6 * np.outer(gust, QUAD.commands([0.0, 0.06, 0.04, 0.01])))


def test_manoeuvres_that_begin_make_it_wait():
    """Steps to the side after calm hover: to one side and the other, harder than a weak motor."""
    time, commands = flight(5, 60.0, 0.003)
    steps = np.where(time > 120.0, np.sin(2 * np.pi * (time - 120.0) / 1.5), 0.0)
    wild = commands + 0.6 * np.outer(steps, QUAD.commands([0.0, 0.15, 0.0, 0.04]))
    assert not changes(time, wild)


def test_seconds_before_it_knows_the_flight_are_no_reference():
    time, commands = flight(6, 30.0)
    rise = 0.6 * np.outer(time >= 105.0, 0.2 * np.eye(4)[0])
    assert not changes(time, commands + rise)


def test_samples_that_leave_every_second_block_short_show_nothing():
    """Of 5 Hz: blocks of two and three samples take turns."""
    time, commands = flight(1)
    every = slice(None, None, 2)
    assert not changes(time[every], (commands + after(time, 0.2 * np.eye(4)[0]))[every])


def test_no_motor_can_be_named_where_it_is_not_known_how_they_turn():
    with pytest.raises(ValueError, match="places and spins"):
        BalanceTest(motor_signatures(4, X))
