"""The fact (coded finding) that a vehicle turned over because its setpoint did: a flip, a roll, a stick at its end.

Modes that level the vehicle limit the lean that can be commanded (ANGLE_MAX of ArduPilot, MPC_MAN_TILT_MAX of PX4); in
Acro the setpoint turns on for as long as the stick is held. A vehicle that follows such a setpoint is sound, and no
motor is to blame for what it hits. A vehicle that tumbles drags its setpoint along, since autopilots limit the error
between the two; then the vehicle leads and the setpoint follows.
"""

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.attitude_losses import LOST_ANGLE
from mavdem.dataset.attitude import down_in_body
from mavdem.dataset.axes import TILT_COLUMNS
from mavdem.dataset.extreme_tilt import MAX_TILT
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import AttitudeTracking, attitude_tracking
from mavdem.facts import Fact
from mavdem.facts.ending import FailedFirst

OVERTURN_SECONDS = 2.0
"""Seconds before an impact or loss in which a commanded overturn explains it: a vehicle falls 20 m in that time."""


def commanded_overturn(signals: Signals, boot: int, loss_time: float) -> Fact | None:
    """Returns the fact that the setpoint turned the vehicle over shortly before a loss; None if it did not.

    The setpoint must lean further than ``MAX_TILT``, and further than the vehicle, which must follow it to within
    ``LOST_ANGLE``: then the command came first.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        loss_time: time when the vehicle was lost, s since boot.

    Returns:
        A fact with the largest lean of the setpoint in the ``OVERTURN_SECONDS`` before, as the figure ``angle``, the
        time at which it exceeded ``MAX_TILT``, and the flight mode of that time as its subject; empty if not known.
    """
    tracking = attitude_tracking(signals, boot)
    if tracking is None:
        return None
    commanded_lean = lean_angle(tracking.setpoints)
    seconds_to_loss = loss_time - tracking.time
    is_shortly_before = (seconds_to_loss >= 0) & (seconds_to_loss < OVERTURN_SECONDS)
    overturned_samples = np.flatnonzero(is_shortly_before & (commanded_lean > MAX_TILT))
    if not len(overturned_samples):
        return None

    first_sample = int(overturned_samples[0])
    vehicle_lean = lean_angle(tracking.angles[:, TILT_COLUMNS])
    vehicle_leads = vehicle_lean[first_sample] > commanded_lean[first_sample]
    if vehicle_leads or _tracking_error(tracking, first_sample) > LOST_ANGLE:
        return None
    overturn_time = tracking.time[first_sample]
    return Fact(
        FailedFirst.OVERTURN_COMMANDED_FIRST,
        time=overturn_time,
        subject=signals.mode_at(boot, overturn_time),
        angle=commanded_lean[overturned_samples].max(),
    )


def lean_angle(angles: Array) -> Array:
    """Returns (N,) how far the vertical axis of the body is from the vertical, rad.

    Args:
        angles: (N, 2) roll and pitch, rad; NaN where they are not known, which makes the lean NaN.
    """
    return np.arccos(np.clip(np.cos(angles).prod(axis=1), -1.0, 1.0))


def _tracking_error(tracking: AttitudeTracking, sample: int) -> float:
    """Returns the angle between the vertical axes of the vehicle and of its setpoint at one sample.

    Angles of roll and pitch cannot be subtracted here: beyond 90° of pitch both change by half a turn.

    Args:
        tracking: the attitude and its setpoint.
        sample: index of the sample.

    Returns:
        The angle, rad.
    """
    vehicle_roll, vehicle_pitch = tracking.angles[sample, :2]
    commanded_roll, commanded_pitch = tracking.setpoints[sample]
    vehicle_down = down_in_body(vehicle_roll, vehicle_pitch)
    commanded_down = down_in_body(commanded_roll, commanded_pitch)
    return float(np.arccos(np.clip(vehicle_down @ commanded_down, -1.0, 1.0)))
