"""Motors that run on after a crash, as a fact (a coded finding).

Propellers under power injure whoever lifts the vehicle, and blocked motors burn. So the motors must stop at once when
the vehicle has hit the ground or toppled over.
"""

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.flight_states import min_running_command
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.witnesses.accelerometer import REST_SECONDS, still_windows

MIN_RUN_SECONDS = 5.0
"""Time, s, from which on motors that still run count as left running.

ArduPilot's crash check stops them 2 s after a crash, and a pilot who sees it needs about as long to disarm.
"""

CRASH_CHECK_PARAMETER = "FS_CRASH_CHECK"
"""Parameter of ArduPilot: 0 if the autopilot does not stop the motors after a crash, otherwise 1 or 2."""


def motors_left_running(signals: Signals, crash: Fact) -> Fact | None:
    """Returns the fact that motors ran on after a crash, although the vehicle lay still.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        crash: the event that the vehicle hit the ground or something else, or toppled over, with its time and boot.

    Returns:
        An event at the time when the motors had run ``MIN_RUN_SECONDS`` too long. Its figures are the ``duration``, s,
        from the crash until the motors stopped, ``is_permanent`` if they ran to the end of the record, the code of the
        ``crash``, and the value of ``FS_CRASH_CHECK`` as ``crash_check``; None if the vehicle has no such parameter.
        None if the motors stopped sooner, the vehicle moved, or the log does not show it.
    """
    boot = crash.figures["boot"]
    running_time = _running_time_after(signals, boot, crash.start_time)
    if running_time is None:
        return None
    stop_time, is_permanent = running_time
    if _still_seconds(signals, boot, crash.start_time, stop_time) < MIN_RUN_SECONDS:
        return None
    event = Fact(
        MotionEvent.MOTORS_RAN_ON,
        time=crash.start_time + MIN_RUN_SECONDS,
        duration=stop_time - crash.start_time,
        crash=str(crash.code),
        crash_check=signals.telemetry.parameters.get(CRASH_CHECK_PARAMETER),
        boot=boot,
    )
    return event.replace(is_permanent=True) if is_permanent else event


def _running_time_after(
    signals: Signals, boot: int, crash_time: float
) -> tuple[float, bool] | None:
    """Returns until when at least one motor ran without a pause after a crash.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        crash_time: time of the crash, s since boot.

    Returns:
        The time of the last sample before all motors idled or stood still, s since boot, and whether it is the last
        sample of the record. None if the outputs of the motors were not recorded after the crash.
    """
    motors = signals.motors
    if motors is None:
        return None
    commands = motors.range_fractions(boot)
    is_after_crash = commands.time >= crash_time
    times: Array = commands.time[is_after_crash]
    if not len(times):
        return None
    highest_commands = commands.values[is_after_crash].max(axis=1)
    idle_samples = np.flatnonzero(highest_commands < min_running_command(motors))
    is_permanent = not len(idle_samples)
    last_running_sample = len(times) - 1 if is_permanent else max(int(idle_samples[0]) - 1, 0)
    return float(times[last_running_sample]), is_permanent


def _still_seconds(signals: Signals, boot: int, start: float, end: float) -> float:
    """Returns for how long the vehicle was still between two times of a boot, s since boot; 0 without body rates."""
    windows = still_windows(signals, boot)
    if windows is None:
        return 0.0
    is_inside = (windows.start >= start) & (windows.start + REST_SECONDS <= end)
    return REST_SECONDS * int(np.count_nonzero(windows.is_still & is_inside))
