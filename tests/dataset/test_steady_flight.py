"""Steady flight: neither where the nose turns nor where the attitude strays from its setpoint."""

import numpy as np
from hover import Hover, changed, columns
from pytest import approx, mark

from mavdem.dataset.intervals import total_duration
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import steady_intervals
from mavdem.ingest.vocabulary import attitude_target, quaternion

pytestmark = mark.slow

HOVER = Hover(hovering=40.0)


def steady_seconds(turn=0.0, stray=0.0):
    """Returns the duration of steady flight in a hover of 40 s.

    For 5 s the nose turns at a rate, °/s; for the next 5 s roll deviates from its setpoint by an angle, °.
    """
    telemetry = HOVER.telemetry(attitude_time=20.0, motor_time=20.0)
    time = HOVER.stamps(20.0)
    yaw = (np.radians(turn) * np.clip(time - 20.0, 0.0, 5.0) + np.pi) % (2 * np.pi) - np.pi
    roll = HOVER.roll(time) + np.radians(stray) * ((time >= 25) & (time < 30))
    setpoint = quaternion(HOVER.roll(time), 0 * time, 0 * time)
    telemetry = changed(telemetry, "ATTITUDE", yaw=yaw, roll=roll)
    telemetry = changed(telemetry, "ATTITUDE_TARGET", **columns(time, **attitude_target(setpoint)))
    return total_duration(steady_intervals(Signals(telemetry, inputs="motors"), 0))


def test_a_turn_and_what_strays_are_not_steady():
    whole = steady_seconds()
    assert whole == approx(40.0, abs=3.0)
    assert steady_seconds(turn=9.5) == whole
    # The second after the turn is lost too, over which headings are compared.
    assert whole - steady_seconds(turn=11.0) == approx(4.2, abs=0.1)
    assert steady_seconds(stray=14.0) == whole
    assert whole - steady_seconds(stray=16.0) == approx(5.0, abs=0.2)
    assert steady_seconds(turn=180.0, stray=16.0) == approx(whole - 10.0, abs=0.2)
