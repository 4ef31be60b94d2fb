"""Spins about yaw that nobody commanded, as facts (coded findings).

A multirotor yaws by the drag of its propellers, its weakest control. So a lost motor, a twisted arm or a motor at its
limit may turn the vehicle on and on, while roll and pitch still follow their setpoints. ArduPilot moves the heading
setpoint along with the vehicle, so that only the setpoint of the yaw rate shows such a spin.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.attitude_error import recent_range, samples_to_follow
from mavdem.dataset.axes import AXES, YAW
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.setpoints import held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import HEADING_CHANGE_SECONDS, MAX_HEADING_CHANGE
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent

MIN_EXCESS_RATE = MAX_HEADING_CHANGE / HEADING_CHANGE_SECONDS
"""Yaw rate, rad/s, beyond the commanded one from which on a vehicle turns by itself: more than gusts make of it."""

MIN_TURNS = 1.0
"""Turns beyond the commanded ones that make a spin.

A gust, or a yaw controller at its limit for a moment, leaves the heading some tens of degrees off. A vehicle that
passed every heading did not hold any of them.
"""


def yaw_spins(signals: Signals, boot: int, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event for each time in which the vehicle yawed by more than a turn without a command.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, or of its part before the vehicle was lost, s since boot.

    Yields:
        Facts with start and end, the number of ``turns`` beyond the commanded ones, positive to the right, and the
        highest yaw rate as ``body_rate``, rad/s.
    """
    yaw_rate = _rate_in_flight(signals, boot, flight_interval)
    if yaw_rate is None:
        return
    excess_rate = _rate_beyond_command(signals, boot, yaw_rate)
    for samples in _samples_of_rotations(yaw_rate.time, excess_rate):
        times = yaw_rate.time[samples]
        excess_angle = float(np.trapezoid(excess_rate[samples], times))
        turns = excess_angle / (2 * np.pi)
        if abs(turns) >= MIN_TURNS:
            yield Fact(
                MotionEvent.SPUN,
                time=float(times[0]),
                end_time=float(times[-1]),
                turns=turns,
                body_rate=float(abs(yaw_rate.values[samples]).max()),
                boot=boot,
            )


def _samples_of_rotations(time: Array, excess_rate: Array) -> list[slice]:
    """Returns the samples of each rotation to one side that is faster than ``MIN_EXCESS_RATE`` throughout.

    A rotation ends where no sample follows for ``MAX_SETPOINT_DELAY``, in which a vehicle may do what it is commanded
    to: what it did meanwhile was not recorded.

    Args:
        time: (N,) times of the samples, s.
        excess_rate: (N,) yaw rate beyond the commanded one, rad/s, positive to the right.
    """
    # 1 to the right, -1 to the left, 0 where the vehicle turns about as it was commanded to.
    direction = np.where(abs(excess_rate) > MIN_EXCESS_RATE, np.sign(excess_rate), 0.0)
    # A rotation may begin with the first sample and end with the last one: zeros are put around them.
    is_change = np.diff(direction, prepend=0.0, append=0.0) != 0
    is_change[1:-1] |= np.diff(time) > MAX_SETPOINT_DELAY
    changes = np.flatnonzero(is_change)
    # Between two changes the direction is the same.
    rotations_and_pauses = [slice(first, end) for first, end in pairwise(changes)]
    return [samples for samples in rotations_and_pauses if direction[samples.start] != 0]


def _rate_in_flight(
    signals: Signals, boot: int, flight_interval: TimeInterval
) -> TimeSeries | None:
    """Returns the yaw rate, rad/s, in a flight; None if fewer than two samples were recorded.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, or of its part before the vehicle was lost, s since boot.
    """
    # A log may have the attitude without yaw, or none.
    if len(signals.attitudes) < len(AXES):
        return None
    rate = series_of_boot(signals.attitudes[YAW].rate_series, boot)
    if rate is None:
        return None
    rate_in_flight = rate.within(flight_interval)
    return rate_in_flight if len(rate_in_flight.time) >= 2 else None


def _rate_beyond_command(signals: Signals, boot: int, yaw_rate: TimeSeries) -> Array:
    """Returns by how much the vehicle yaws faster than it was commanded to at any time in the second before.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        yaw_rate: yaw rate (N,), rad/s, at least two samples of the boot.

    Returns:
        (N,) rad/s, positive to the right; 0 where no yaw rate was commanded.
    """
    # Those of the yaw angle are in rad.
    yaw_setpoints = signals.for_axis(AXES[YAW]).setpoints
    rate_setpoints = [setpoint for setpoint in yaw_setpoints if setpoint.unit == "rad/s"]
    if not rate_setpoints:
        return np.zeros(len(yaw_rate.time))
    setpoint = held_setpoint(rate_setpoints[0], boot, yaw_rate.time)
    commanded = recent_range(np.nan_to_num(setpoint), samples_to_follow(yaw_rate.time))
    # A vehicle that turns more slowly than commanded does not spin: rest counts as commanded too.
    lowest_rate = np.minimum(commanded.lowest, 0.0)
    highest_rate = np.maximum(commanded.highest, 0.0)
    excess_rate = yaw_rate.values - np.clip(yaw_rate.values, lowest_rate, highest_rate)
    has_setpoint = np.isfinite(setpoint)
    return np.where(has_setpoint, excess_rate, 0.0)
