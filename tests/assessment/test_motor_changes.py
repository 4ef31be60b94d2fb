"""Samples of flights at which motors changed, by the alarms of their own boot."""

from dataclasses import replace

import numpy as np
from made_up_loop import made_up
from pytest import approx, mark
from simulated import simulated

from mavdem.assessment.axis.figures import MotorChanges, motor_changes
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ParameterDoubt
from mavdem.motors.motor_changes import MotorChange
from mavdem.plant.identifiability import PARAMETERS

LOSS = MotorChange(13.0, 10.0, 2, "motor 2", 0.3, 0.99, boot=0, loss=(0.2, 0.4))
RECOVERY = MotorChange(17.0, 14.0, 2, "motor 2", 0.0, 0.99, boot=0)
STEADY_TORQUE = MotorChange(13.0, 12.0, None, "", 0.1, 0.97, boot=0)


def flight_of(boot):
    """A flight of 20 s that begins 5 s after the start of a boot."""
    flight = simulated(samples=2000)
    time = 5.0 + 0.01 * np.arange(2000)
    return replace(flight, time=time, provenance={"segment": {"boot": boot}})


def test_a_loss_without_recovery_is_not_one_of_a_later_boot():
    changes = motor_changes([LOSS], [flight_of(0), flight_of(1)])
    assert changes.samples == [500]
    assert changes.has_weak_motor[:2000].sum() == approx(1700, abs=1)
    assert not changes.has_weak_motor[2000:].any()


def test_a_loss_of_a_later_boot_has_its_samples_there():
    changes = motor_changes([LOSS._replace(boot=1)], [flight_of(0), flight_of(1)])
    assert changes.samples == [2500]
    assert not changes.has_weak_motor[:2000].any()


def test_a_motor_that_recovers_is_weak_from_its_loss_to_then():
    changes = motor_changes([LOSS, RECOVERY], [flight_of(0)])
    assert changes.samples == [500, 900]
    # The times are known to 2 s.
    assert changes.has_weak_motor.sum() == approx(800, abs=2)


def test_a_change_of_the_steady_torque_is_none_of_a_motor():
    changes = motor_changes([STEADY_TORQUE], [flight_of(0)])
    assert changes.samples == []
    assert not changes.has_weak_motor.any()


@mark.slow
@mark.parametrize("samples, status", [([], Status.REPORTED), ([50], Status.BIASED)])
def test_an_effect_is_none_of_the_whole_flight_where_a_motor_changed(samples, status):
    plant = made_up().plant
    checked = MotorChanges(samples, np.zeros(100, bool)).checked_parameters(plant)
    assert checked.status == dict.fromkeys(PARAMETERS, status)
    if samples:
        assert checked.reasons["effect"].code is ParameterDoubt.MOTOR_CHANGED
        assert "mean of before and after" in checked.reasons["effect"].sentence
