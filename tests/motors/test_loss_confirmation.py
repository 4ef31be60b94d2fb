"""A change that looks like a weak motor and is over after some seconds is withdrawn; a loss that lasts is not."""

import numpy as np
from frames import geometry
from numpy.random import default_rng
from pytest import approx, fixture, mark
from scipy.signal import lfilter

from mavdem.facts import Level
from mavdem.motors.loss_detection import MotorLossDetector
from mavdem.motors.motor_changes import (
    MIN_LOSS_SECONDS,
    MotorChange,
    lasting_changes,
    thrust_losses,
)

RATE = 10.0
START = 30.0
"""Seconds at which the change begins."""


def commands(seed, duration, motor=0, rise=0.2, noise=0.02):
    """Returns times (N,), s, and commands (N, 4) of a flight in gusts. One motor works harder for a duration, s."""
    time = np.arange(round(90.0 * RATE)) / RATE
    draws = default_rng(seed).standard_normal((len(time), 4))
    decay = np.exp(-1 / (0.5 * RATE))
    gusts = noise * lfilter([np.sqrt(1 - decay**2)], [1.0, -decay], draws, axis=0)
    values = 0.6 * (1 + gusts)
    values[:, motor] += 0.6 * rise * ((time >= START) & (time < START + duration))
    return time, values


def alarms_of(time, values):
    detector = MotorLossDetector(geometry(4))
    for at, row in zip(time.tolist(), values, strict=True):
        detector.update(at, row, 0.0)
    return detector


@fixture(params=range(2))
def seed(request):
    return request.param


@mark.slow
@mark.parametrize("duration", [3.0, 5.0, 6.5])
def test_a_transient_of_some_seconds_is_no_loss(seed, duration):
    detector = alarms_of(*commands(seed, duration))
    assert not detector.weak_motors
    assert thrust_losses(detector.alarms) == []


@mark.slow
def test_a_loss_that_lasts_is_not_withdrawn(seed):
    detector = alarms_of(*commands(seed, np.inf))
    assert [*detector.weak_motors] == [0]
    [loss] = thrust_losses(detector.alarms)
    assert loss.level is Level.BAD
    assert loss.time == approx(START, abs=2.0)


@mark.slow
def test_a_loss_that_ended_later_is_to_be_watched(seed):
    detector = alarms_of(*commands(seed, 20.0))
    assert not detector.weak_motors
    [loss] = thrust_losses(detector.alarms)
    assert loss.level is Level.WATCH
    assert [loss.time, loss.end_time] == approx([START, START + 20.0], abs=3.0)


@mark.parametrize("seconds, count", [(MIN_LOSS_SECONDS - 0.5, 0), (MIN_LOSS_SECONDS + 0.5, 1)])
def test_a_loss_counts_from_eight_seconds_on(seconds, count):
    loss = MotorChange(11.0, 10.0, 2, "motor 2", 0.3, 0.99, loss=(0.2, 0.4))
    end = loss._replace(time=30.0, onset_time=10.0 + seconds, size=0.0)
    assert len(thrust_losses([loss, end])) == count


def test_a_withdrawn_loss_and_its_recovery_go_as_a_pair():
    loss = MotorChange(11.0, 10.0, 2, "motor 2", 0.3, 0.99, loss=(0.2, 0.4))
    torque = loss._replace(time=20.0, onset_time=19.0, motor=None, name="")
    early_end = loss._replace(time=18.0, onset_time=9.5 + MIN_LOSS_SECONDS, size=0.0, loss=())
    late_end = loss._replace(time=30.0, onset_time=28.0, size=0.0, loss=())
    assert lasting_changes([loss, early_end, torque]) == [torque]
    assert lasting_changes([loss, torque, late_end]) == [loss, torque, late_end]
    assert lasting_changes([loss, torque]) == [loss, torque]
    assert lasting_changes([late_end]) == []
