"""Motor alarms of a recorded flight: the test that watches motors while a vehicle flies, over its log."""

from __future__ import annotations

import numpy as np

from mavdem.alignment.phases import settled
from mavdem.alignment.signals import Signals
from mavdem.health.motor_watch import MotorAlarm, MotorWatch


def motor_alarms(signals: Signals) -> tuple[MotorAlarm, ...]:
    """What a live session would have said of a vehicle's motors, boot by boot.

    Live, the end of the climb-out is known half a second late and a landing when it has happened, so that times differ
    by as much. Logs with fewer than 6 samples of the motors a second show nothing.
    """
    motors = signals.motors
    if motors is None:
        return ()
    layout, found = motors.layout, list[MotorAlarm]()
    for boot in np.unique(motors.boot):
        place = layout.names, layout.motors, layout.positions, layout.spins
        watch = MotorWatch(*place, layout.positions_assumed, int(boot))
        rows = motors.boot == boot
        time, commands = motors.time[rows], motors.scale.fraction(motors.outputs[rows])
        flying = np.zeros(len(time), dtype=bool)
        for begin, end in settled(signals, int(boot)):
            flying |= (time >= begin) & (time <= end)
        for at in np.flatnonzero(flying):
            watch.take(float(time[at]), commands[at], True)
        found += watch.alarms
    return tuple(found)
