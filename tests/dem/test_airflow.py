"""The motion that drag and wind are identified from."""

import numpy as np
from numpy.testing import assert_allclose
from refusals import refused
from scipy.constants import g as GRAVITY  # noqa: N812

import mavdem
from mavdem.dem.airflow.model import motion
from mavdem.facts.online import Airflow


def test_thrust_that_climbs_and_sinks_makes_no_force_across_itself():
    """Specific force along body x and y is what thrust and weight do not explain, however much the thrust varies."""
    time = np.arange(0.0, 20.0, 0.01)
    roll = 0.2
    pitch = -0.1
    yaw = 0.7
    thrust_axis = np.array(
        [
            np.cos(roll) * np.sin(pitch) * np.cos(yaw) + np.sin(roll) * np.sin(yaw),
            np.cos(roll) * np.sin(pitch) * np.sin(yaw) - np.sin(roll) * np.cos(yaw),
            np.cos(roll) * np.cos(pitch),
        ]
    )
    # Of a thrust of (1.2 + 0.3 cos t) of the weight; the vehicle climbs or sinks at up to 5 m/s² all the time.
    impulse = GRAVITY * (1.2 * time + 0.3 * np.sin(time))
    velocity = np.outer(GRAVITY * time, [0, 0, 1]) - np.outer(impulse, thrust_axis)
    attitude = np.tile([roll, pitch, yaw], (len(time), 1))
    moved = motion(time, attitude, velocity, 0.2)
    assert moved.known.sum() > 90 and abs(np.diff(moved.velocity[:, 2])).max() > 0.5
    assert_allclose(moved.force[moved.known], 0.0, atol=1e-9)


def test_what_gives_no_wind_is_refused_with_its_reason():
    time = np.arange(0.0, 60.0, 0.1)
    attitude = np.column_stack([0.3 * np.sin(time), 0.2 * np.cos(time), 0.0 * time])
    still = np.zeros_like(attitude)
    unknown = attitude + [0.0, 0.0, np.nan]
    fact = refused(mavdem.estimate_wind, time, unknown, still)
    assert (fact.code, fact.figures["missing"]) == (Airflow.MOTION_UNKNOWN, "yaw")
    fact = refused(mavdem.estimate_wind, time, attitude, still)
    assert fact.code is Airflow.VELOCITY_INCONSISTENT
    few = slice(40)
    fact = refused(mavdem.estimate_wind, time[few], still[few], still[few])
    assert fact.code is Airflow.MOTION_TOO_SHORT
