"""The command of all motors that rises as a battery empties."""

import numpy as np
from hover import Hover, changed
from pytest import approx, mark

from mavdem.assessment.command_rise import command_rise
from mavdem.dataset.signals import Signals

HOVER = Hover()


@mark.parametrize("rise, is_stated", [(0.2, True), (0.05, False)])
def test_a_command_that_rises_over_a_hover_is_stated_at_both_ends(rise, is_stated):
    """From 60 % of the range the command rises evenly over the 40 s of the hover."""
    telemetry = HOVER.telemetry()
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    factor = np.interp(time, [HOVER.level, HOVER.sinking], [1.0, 1.0 + rise])
    outputs = {
        f"servo{motor}_raw": 1000.0 + factor * (HOVER.motors(time)[:, motor - 1] - 1000.0)
        for motor in (1, 2, 3, 4)
    }
    signals = Signals(changed(telemetry, "SERVO_OUTPUT_RAW", **outputs))
    stated_rise = command_rise(signals, boot=0, end_time=HOVER.end)
    assert (stated_rise is not None) is is_stated
    # The averages are those 5 s after the beginning, and 5 s before the end.
    if stated_rise is not None:
        assert stated_rise.first_command == approx(0.6 * (1 + rise / 8), abs=0.02)
        assert stated_rise.last_command == approx(0.6 * (1 + 7 * rise / 8), abs=0.02)
    assert command_rise(signals, boot=0, end_time=HOVER.level + 10.0) is None
