"""Faults of sensors and estimator: what the autopilot measures and estimates wrongly, cycle by cycle.

The estimated height comes from a complementary filter: the accelerometer integrated twice, and drawn to the barometer
with the natural frequency ``HEIGHT_FILTER_FREQUENCY``, critically damped. Its error e (upwards, m) by a bias b of the
accelerometer and an error z of the barometer follows ë = −b − 2ω ė − ω² (e − z).
"""

from dataclasses import dataclass, field
from math import cos, radians, sin

from sitl_scenarios.dynamics import State
from sitl_scenarios.mishaps.specs import (
    BarometerDrift,
    BarometerStuck,
    GpsGlitch,
    GpsLoss,
    HeightRunaway,
    LoosePropeller,
    Mishap,
    VibrationRectification,
    YawReset,
)
from sitl_scenarios.vectors import Quaternion

HEIGHT_FILTER_FREQUENCY = 0.5
"""Natural frequency of the estimated height's filter, rad/s, as in ArduPilot's AP_InertialNav with 2 s."""

RESET_SECONDS = 0.3
"""Time constant with which an estimate that ran away comes back once its cause is gone, s; a choice."""

DRIFT_ACCELERATION = 0.06
"""Acceleration of the error of a horizontal position without satellites, m/s²: a lean that is wrong by 0.35°."""

LOST_SATELLITES = 3
"""Satellites that are left when the fix is lost."""

NO_FIX = 1
"""GPS_FIX_TYPE_NO_FIX."""

FIX_3D = 3
"""GPS_FIX_TYPE_3D_FIX."""

HEIGHT_GATE = 2.5
"""Difference of barometer and estimate, m, that the filter just accepts: five times half a metre (EKF2_BARO_GATE)."""

POSITION_LIMIT = 25.0
"""Jump of the satellites' position, m, that the filter just accepts: EK3_GLITCH_RAD of ArduPilot."""

USUAL_COMPASS_ERROR = 60.0
"""Error of the heading, degrees, at which the compass would just be rejected; a choice."""

FOLLOWED_SHARE = 5.0
"""How many times better the height agrees with a barometer that the filter follows."""


@dataclass
class Readings:
    """What the sensors read wrongly in one cycle, and how well the filter's measurements agree."""

    height_error: float = 0.0
    """Error of the barometer's height, m upwards."""
    stuck_height: float | None = None
    """Height at which the barometer is stuck, m; None where it is not."""
    east_error: float = 0.0
    """Error of the satellites' position to the east, m."""
    fix_type: int = FIX_3D
    """GPS_FIX_TYPE."""
    satellites: int = 14
    """Satellites that are used."""
    vibration: float = 0.0
    """Vibration beyond a sound vehicle's, m/s²."""
    force_bias: float = 0.0
    """What the accelerometer reads too little of the upward force, m/s²."""
    position_ratio: float = 0.0
    """Innovation of the horizontal position by what the filter accepts, beyond the usual one."""
    height_ratio: float = 0.0
    """The same of the height."""
    compass_ratio: float = 0.0
    """The same of the compass."""


@dataclass
class SensorFaults:
    """The faults of one flight, advanced once per cycle of the autopilot."""

    mishap: Mishap | None
    """What goes wrong; None: nothing does."""
    cycle: float
    """Period of the autopilot's loop, s."""
    readings: Readings = field(default_factory=Readings)
    """Errors in the current cycle."""
    height_error: float = 0.0
    """Error of the estimated height, m upwards."""
    climb_error: float = 0.0
    """Error of the estimated climb rate, m/s."""
    drift_speed: float = 0.0
    """Error of the estimated speed to the east without satellites, m/s."""
    drift: float = 0.0
    """Error of the estimated position to the east without satellites, m."""
    stuck_height: float | None = None
    """Height at which the barometer got stuck, m; None before."""

    def faulty_estimate(self, time: float, state: State, estimate: State) -> State:
        """Distorts the estimated state as faulty sensors do, and sets the ``readings`` of this cycle.

        Args:
            time: Seconds after arming; negative before.
            state: True state.
            estimate: Estimate with sound sensors.

        Returns:
            The estimate with drift, error of height and error of climb rate.
        """
        self.readings = Readings()
        match self.mishap:
            case LoosePropeller(start=start, vibration=vibration) if time >= start:
                self.readings.vibration = vibration
            case HeightRunaway():
                self._advance_height_error(self.mishap, time)
            case VibrationRectification(start=start) if time >= start:
                self.readings.vibration = self.mishap.vibration
                self.readings.force_bias = self.mishap.bias
                self._filter_height(self.mishap.bias, 0.0)
            case BarometerDrift(start=start, seconds=seconds, metres=metres) if time >= start:
                self.readings.height_error = metres * min((time - start) / seconds, 1.0)
                self._filter_height(0.0, self.readings.height_error)
            case BarometerStuck(start=start) if time >= start:
                self._stick(state)
            case GpsLoss(start=start) if time >= start:
                self.readings.fix_type = NO_FIX
                self.readings.satellites = LOST_SATELLITES
                self.drift_speed += DRIFT_ACCELERATION * self.cycle
                self.drift += self.drift_speed * self.cycle
            case GpsGlitch(start=start) if start <= time < start + self.mishap.seconds:
                self.readings.east_error = self.mishap.metres
                self.readings.position_ratio = abs(self.mishap.metres) / POSITION_LIMIT
            case YawReset(start=start, degrees=degrees) if time < start:
                self.readings.compass_ratio = abs(degrees) / USUAL_COMPASS_ERROR
                return estimate._replace(attitude=_with_turned_heading(estimate.attitude, degrees))
        north, east, down = estimate.position
        north_speed, east_speed, down_speed = estimate.velocity
        return estimate._replace(
            position=(north, east + self.drift, down - self.height_error),
            velocity=(north_speed, east_speed + self.drift_speed, down_speed - self.climb_error),
        )

    def _advance_height_error(self, mishap: HeightRunaway, time: float) -> None:
        """Lets the estimated height fall while the mishap lasts, and returns it to the true height afterwards.

        The accelerometer measures too little upward force. The filter integrates that to a climb rate and a height that
        are too low, and rejects the barometer, which disagrees.

        Args:
            mishap: Mishap with its start and duration, s, bias of the accelerometer and vibration, m/s².
            time: Seconds after arming.
        """
        seconds_since_start = time - mishap.start
        if 0.0 <= seconds_since_start < mishap.seconds:
            self.readings.vibration = mishap.vibration
            self.readings.force_bias = mishap.bias
            self.climb_error -= mishap.bias * self.cycle
            self.height_error += self.climb_error * self.cycle
            self.readings.height_ratio = abs(self.height_error) / HEIGHT_GATE
        elif seconds_since_start >= mishap.seconds:
            decay = 1.0 - self.cycle / RESET_SECONDS
            self.climb_error *= decay
            self.height_error *= decay

    def _filter_height(self, bias: float, barometer_error: float) -> None:
        """Advances the error of the estimated height and climb rate by a cycle.

        Args:
            bias: Amount by which the accelerometer reads too low, m/s².
            barometer_error: Error of the barometer, m upwards.
        """
        frequency = HEIGHT_FILTER_FREQUENCY
        difference = self.height_error - barometer_error
        acceleration = -bias - 2 * frequency * self.climb_error - frequency**2 * difference
        self.climb_error += acceleration * self.cycle
        self.height_error += self.climb_error * self.cycle
        self.readings.height_ratio = abs(difference) / HEIGHT_GATE / FOLLOWED_SHARE

    def _stick(self, state: State) -> None:
        """Holds the barometer's height; the filter rejects it, and keeps the height by the satellites."""
        height = -state.position[2]
        if self.stuck_height is None:
            self.stuck_height = height
        self.readings.stuck_height = self.stuck_height
        self.readings.height_ratio = abs(height - self.stuck_height) / HEIGHT_GATE


def _with_turned_heading(attitude: Quaternion, degrees: float) -> Quaternion:
    """Returns an attitude with another heading, ``degrees`` clockwise of its own."""
    half = radians(degrees) / 2
    w, x, y, z = attitude
    # The product of a rotation about the vertical, (cos, 0, 0, sin), and the attitude.
    c, s = cos(half), sin(half)
    return c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
