"""The latest attitude of a live vehicle with its setpoint, and its heading while roll and pitch follow theirs."""

from math import inf, isfinite, nan
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.dataset.extreme_tilt import MAX_TILT
from mavdem.dataset.setpoints import MAX_SETPOINT_AGE
from mavdem.dataset.signals import plane_positions
from mavdem.dataset.steady_flight import is_far_from_setpoint
from mavdem.live.global_position import GlobalPosition
from mavdem.live.messages import AttitudeSample, TiltSetpoint

MAX_POSITION_AGE = 1.0
"""Age up to which a position counts as the present one, s: autopilots send it once a second or faster; a choice."""


class LatestPose(NamedTuple):
    """The latest attitude that came."""

    time: float
    """Time, s of the boot clock."""

    angles: Numbers
    """Roll, pitch and yaw, rad."""

    rates: Numbers
    """Body rates about the forward, right and downward axis, rad/s."""

    setpoint: TiltSetpoint
    """Roll and pitch that the attitude controller tracks, rad; NaN where they are not known."""

    position: Numbers | None = None
    """The latest position, north, east and down of the autopilot's origin, m; None where none comes."""


class PoseTracker:
    """Joins each attitude with the latest setpoint, and decides whether the vehicle follows it.

    Attributes:
        pose: the latest; None before any.
        takeoff_position: north, east and down of where the vehicle stood before its latest take-off, m; None where no
            position came there. A vehicle that was first received in flight seems to have stood where it was then.
        heading: yaw, rad; NaN while roll or pitch stray from their setpoint, or the vehicle is not upright.
    """

    def __init__(self) -> None:
        """Begins without an attitude, a setpoint and a position; times of values that never came are minus infinity."""
        self.pose: LatestPose | None = None
        self.takeoff_position: Numbers | None = None
        self.heading = 0.0
        self._setpoint_time = -inf
        self._setpoint = TiltSetpoint()
        self._position_time = -inf
        self._position: Numbers = ()
        # Whether LOCAL_POSITION_NED has come in this boot: then GLOBAL_POSITION_INT, whose origin differs, is not used.
        self._has_local_position = False
        # Latitude and longitude of the first GLOBAL_POSITION_INT with a position, degrees (2,): the origin of all.
        self._global_origin: Array | None = None
        # Where the vehicle last stood on the ground.
        self._ground_position: Numbers | None = None

    def restart(self) -> None:
        """Forgets setpoint and positions, at a reboot, after which clock and origin begin again."""
        self.takeoff_position = None
        self._ground_position = None
        self._setpoint_time = -inf
        self._position_time = -inf
        self._has_local_position = False
        self._global_origin = None

    def add_position(self, time: float, position: Numbers, *, is_flying: bool = True) -> None:
        """Stores the latest position by LOCAL_POSITION_NED, which the next attitudes get, unless it is not finite.

        Args:
            time: time on the boot clock, s.
            position: north, east and down, m.
            is_flying: whether the vehicle is in the air.
        """
        is_finite = all(isfinite(coordinate) for coordinate in position)
        if not is_finite:
            return
        if not self._has_local_position:
            self._has_local_position = True
            # Positions so far were by GLOBAL_POSITION_INT, and relative to another origin.
            self._ground_position = None
            self.takeoff_position = None
        self._store_position(time, position, is_flying=is_flying)

    def add_global_position(
        self, time: float, position: GlobalPosition, *, is_flying: bool
    ) -> None:
        """Stores the latest position by GLOBAL_POSITION_INT; it is ignored where LOCAL_POSITION_NED comes.

        Args:
            time: time on the boot clock, s.
            position: the position in the message.
            is_flying: whether the vehicle is in the air.
        """
        if self._has_local_position:
            return
        # The autopilot's own position has a height.
        assert position.height is not None
        degrees = np.array([position.latitude, position.longitude])
        if self._global_origin is None:
            self._global_origin = degrees
        [[north, east]] = plane_positions(degrees[np.newaxis], self._global_origin).tolist()
        self._store_position(time, (north, east, -position.height), is_flying=is_flying)

    def _store_position(self, time: float, position: Numbers, *, is_flying: bool) -> None:
        """Stores the latest position, and the place of the take-off when the vehicle leaves the ground.

        Args:
            time: time on the boot clock, s.
            position: north, east and down, m.
            is_flying: whether the vehicle is in the air.
        """
        self._position_time = time
        self._position = position
        if not is_flying:
            self._ground_position = position
        elif self._ground_position is not None:
            # Where the vehicle stood last is the place of its take-off.
            self.takeoff_position = self._ground_position

    def add_setpoint(self, time: float, setpoint: TiltSetpoint) -> None:
        """Stores the latest setpoint of the attitude, which the next attitudes are compared with.

        Args:
            time: time on the boot clock, s.
            setpoint: setpoints of roll and pitch.
        """
        self._setpoint_time = time
        self._setpoint = setpoint

    def add_attitude(self, time: float, sample: AttitudeSample) -> LatestPose:
        """Joins an attitude with the latest setpoint and position to the latest pose, and decides on the heading.

        The heading serves the test for weak motors, which compares steady flight only. So it is NaN in manoeuvres:
        where the vehicle is not upright, or roll or pitch stray from their setpoint. A setpoint older than
        ``MAX_SETPOINT_AGE`` is unknown. Without one, every upright attitude counts as steady.

        Args:
            time: time on the boot clock, s.
            sample: roll, pitch and yaw, rad, and body rates, rad/s.

        Returns:
            The pose.
        """
        has_setpoint = abs(time - self._setpoint_time) <= MAX_SETPOINT_AGE
        has_position = time - self._position_time <= MAX_POSITION_AGE
        setpoint = self._setpoint if has_setpoint else TiltSetpoint()
        pose = LatestPose(
            time,
            angles=(sample.roll, sample.pitch, sample.yaw),
            rates=(sample.roll_rate, sample.pitch_rate, sample.yaw_rate),
            setpoint=setpoint,
            position=self._position if has_position else None,
        )
        self.pose = pose
        is_steady = abs(sample.roll) < MAX_TILT and abs(sample.pitch) < MAX_TILT
        if is_steady and has_setpoint:
            tilt = np.array([sample.roll, sample.pitch])
            is_steady = not is_far_from_setpoint(tilt, np.array(setpoint))
        self.heading = sample.yaw if is_steady else nan
        return pose
