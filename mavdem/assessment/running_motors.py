"""Motors that run on after a crash, as a fact (a coded finding).

Propellers under power injure whoever lifts the vehicle, and blocked motors burn. So the motors must stop at once when
the vehicle has hit the ground or toppled over.
"""

from math import inf
from typing import NamedTuple

import numpy as np

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


class _MotorRun(NamedTuple):
    """How long the motors ran after a crash."""

    end_time: float
    """The last time, s since boot, at which a motor still ran without a pause since the crash."""
    is_cut: bool
    """Whether the record ends there, so that the motors may have run on."""


def motors_left_running(signals: Signals, crash: Fact) -> Fact | None:
    """Returns the fact (coded finding) that motors ran on after a crash, although the vehicle lay still.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        crash: the event that the vehicle hit the ground or something else, or toppled over, with its time and boot.

    Returns:
        An event ``MIN_RUN_SECONDS`` after the crash; None if the motors stopped sooner, the vehicle moved, or the log
        does not show it. Its figures, besides the ``boot``, are:

        - ``duration``: seconds from the crash until the motors stopped;
        - ``is_permanent``: true if they ran to the end of the record, missing otherwise;
        - ``crash``: code of the crash;
        - ``crash_check``: value of ``FS_CRASH_CHECK``; None if the vehicle has no such parameter.
    """
    boot = crash.figures["boot"]
    crash_time = crash.start_time
    run = _motor_run_after(signals, boot, crash_time)
    if run is None or _still_seconds(signals, boot, crash_time, run.end_time) < MIN_RUN_SECONDS:
        return None
    event = Fact(
        MotionEvent.MOTORS_RAN_ON,
        time=crash_time + MIN_RUN_SECONDS,
        duration=run.end_time - crash_time,
        crash=str(crash.code),
        crash_check=signals.telemetry.parameters.get(CRASH_CHECK_PARAMETER),
        boot=boot,
    )
    return event.replace(is_permanent=True) if run.is_cut else event


def _motor_run_after(signals: Signals, boot: int, crash_time: float) -> _MotorRun | None:
    """Returns until when at least one motor ran without a pause after a crash.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        crash_time: time of the crash, s since boot.

    Returns:
        The end of that run; None if the outputs of the motors were not recorded after the crash.
    """
    motors = signals.motors
    if motors is None:
        return None
    commands = motors.range_fractions(boot).within((crash_time, inf))
    times = commands.time
    if not len(times):
        return None
    # One motor that runs is enough.
    highest_commands = commands.values.max(axis=1)
    is_idle = highest_commands < min_running_command(motors)
    # Where the outputs were not recorded for so long, the motors may have stopped unseen.
    is_after_gap = np.diff(times, prepend=crash_time) > MIN_RUN_SECONDS
    end_samples = np.flatnonzero(is_idle | is_after_gap)
    if not len(end_samples):
        return _MotorRun(float(times[-1]), is_cut=True)
    if end_samples[0] == 0:
        return _MotorRun(crash_time, is_cut=False)
    last_running_sample = int(end_samples[0]) - 1
    return _MotorRun(float(times[last_running_sample]), is_cut=False)


def _still_seconds(signals: Signals, boot: int, start: float, end: float) -> float:
    """Returns for how many seconds between two times the vehicle was still; 0 without body rates.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        start: first of the two times, s since boot.
        end: second of the two times, s since boot.
    """
    # Each window lasts REST_SECONDS, and none overlaps another.
    windows = still_windows(signals, boot)
    if windows is None:
        return 0.0
    is_between = (windows.start >= start) & (windows.start + REST_SECONDS <= end)
    return REST_SECONDS * int(np.count_nonzero(windows.is_still & is_between))
