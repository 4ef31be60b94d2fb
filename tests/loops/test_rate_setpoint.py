"""What a recorded rate setpoint contains: the attitude controller's correction, and the feed-forward of its angle."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed, columns
from made_up_loop import made_up
from numpy.random import default_rng
from pytest import mark

from mavdem.assessment.flights import settled_flight
from mavdem.dataset.signals import Signals
from mavdem.loops.rate_setpoint import has_rate_feedforward

HOVER = Hover(hovering=30.0)
CONTROLLER = made_up().controller


def flight_by_yaw(*, with_feedforward):
    """A hover at 20 Hz whose heading follows a wandering setpoint, with the rate setpoint of PX4's controller."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    time = telemetry.messages["ATTITUDE"]["time"]
    heading_setpoint = 0.002 * default_rng(1).standard_normal(len(time)).cumsum()
    heading = np.interp(time - 0.2, time, heading_setpoint)
    rate_setpoint = CONTROLLER.angle_gain * (heading_setpoint - heading)
    if with_feedforward:
        rate_setpoint = rate_setpoint + np.gradient(heading_setpoint, time)
    telemetry = changed(telemetry, "ATTITUDE", yaw=heading, yawspeed=np.gradient(heading, time))
    half = heading_setpoint / 2
    quaternions = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    rates = {"body_roll_rate": 0.0, "body_pitch_rate": 0.0, "body_yaw_rate": rate_setpoint}
    target = columns(time, type_mask=0, q=quaternions, **rates)
    return changed(telemetry, "ATTITUDE_TARGET", **target)


@mark.parametrize("autopilot", ["PX4", "ARDUPILOTMEGA"])
@mark.parametrize("with_feedforward", [False, True])
def test_without_a_parameter_feedforward_shows_in_the_rate_setpoint(with_feedforward, autopilot):
    telemetry = replace(flight_by_yaw(with_feedforward=with_feedforward), autopilot=autopilot)
    signals = Signals(telemetry).for_axis("yaw")
    segments = settled_flight(signals)
    assert has_rate_feedforward(signals, segments, CONTROLLER) is with_feedforward
    # Roll does not follow its setpoint here, and without a controller the angle's gain is not known.
    assert not has_rate_feedforward(signals.for_axis("roll"), segments, CONTROLLER)
    assert not has_rate_feedforward(signals, segments, None)


def test_the_feedforward_of_ardupilot_is_a_parameter():
    telemetry = flight_by_yaw(with_feedforward=False)
    for value in (0.0, 1.0):
        parameters = {"ATC_RATE_FF_ENAB": value}
        signals = Signals(replace(telemetry, autopilot="ARDUPILOTMEGA", parameters=parameters))
        assert has_rate_feedforward(signals.for_axis("roll"), (), None) is bool(value)
