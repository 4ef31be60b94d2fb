"""A motor at its limit stands out only if no other works as hard in the mean."""

import numpy as np
from partial_records import partial_record
from pytest import mark

from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.facts.motors import MotorsLight
from mavdem.ingest.motors import MotorGeometry
from mavdem.ingest.output_scale import OutputScale
from mavdem.live.motor_limits import motor_at_upper_limit
from mavdem.live.samples import DECISION_SECONDS

NAMES = ("motor 1", "motor 2", "motor 3", "motor 4")
TIME = np.arange(0.0, DECISION_SECONDS, 0.05)


@mark.parametrize(
    "commands, equally_loaded",
    [
        # Motor 3 lost thrust: its opposite, motor 4, gives way.
        ((1500.0, 1500.0, 2000.0, 1200.0), ()),
        # Wind from the left: both motors of that side work hard.
        ((1400.0, 1900.0, 2000.0, 1400.0), ("motor 2",)),
    ],
)
def test_a_motor_beside_which_another_works_as_hard_is_not_called_weak(commands, equally_loaded):
    """A motor is at its upper limit.

    With a second motor commanded nearly as high, the load and not the motor is the explanation.
    """
    motors = partial_record(
        MotorOutputs,
        time=TIME,
        outputs=np.tile(commands, (len(TIME), 1)),
        geometry=partial_record(MotorGeometry, names=NAMES),
        scale=OutputScale("PWM", "µs", 1000.0, 2000.0, 1.0),
    )
    limited = motor_at_upper_limit(motors, motors.outputs >= 2000.0, TIME[-1])
    assert limited.code is MotorsLight.MOTOR_LIMITED
    assert limited.figures["names"] == ("motor 3",)
    assert limited.figures["equally_loaded"] == equally_loaded
    assert ("before motor 3" in limited.remedy) is (not equally_loaded)
    assert limited.subject == ("" if equally_loaded else "motor 3")
