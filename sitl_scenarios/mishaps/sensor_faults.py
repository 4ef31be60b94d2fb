"""Errors of sensors and of the state estimate, cycle by cycle, that a simulated mishap such as a GPS loss causes.

The estimated height comes from a complementary filter: the accelerometer integrated twice, and corrected towards the
barometer with the natural frequency ``HEIGHT_FILTER_FREQUENCY``, critically damped.
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

BAROMETER_AGREEMENT = 5.0
"""How many times smaller the innovation is of a barometer that the filter follows: the filter moves towards it."""


@dataclass
class SensorErrors:
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
    """Errors of sensors and state estimate by the mishap of one flight, advanced once per cycle of the autopilot."""

    mishap: Mishap | None
    """What goes wrong; None: nothing does."""
    cycle: float
    """Period of the autopilot's loop, s."""
    sensor_errors: SensorErrors = field(default_factory=SensorErrors)
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
        """Adds the errors of the mishap to the estimated state, and sets ``sensor_errors`` for this cycle.

        Args:
            time: Seconds after arming; negative before.
            state: True state.
            estimate: Estimate with sound sensors.

        Returns:
            The estimate with errors of east position and speed, height and climb rate; or, before the autopilot resets
            a wrong heading, with an error of the heading alone.
        """
        self.sensor_errors = SensorErrors()
        match self.mishap:
            case LoosePropeller(start=start, vibration=vibration) if time >= start:
                self.sensor_errors.vibration = vibration
            case HeightRunaway():
                self._advance_runaway(self.mishap, time)
            case VibrationRectification(start=start) if time >= start:
                self.sensor_errors.vibration = self.mishap.vibration
                self.sensor_errors.force_bias = self.mishap.bias
                self._advance_height_filter(self.mishap.bias, barometer_error=0.0)
            case BarometerDrift(start=start, seconds=seconds, metres=metres) if time >= start:
                self.sensor_errors.height_error = metres * min((time - start) / seconds, 1.0)
                self._advance_height_filter(0.0, barometer_error=self.sensor_errors.height_error)
            case BarometerStuck(start=start) if time >= start:
                self._hold_barometer_height(state)
            case GpsLoss(start=start) if time >= start:
                self.sensor_errors.fix_type = NO_FIX
                self.sensor_errors.satellites = LOST_SATELLITES
                # Without satellites the error of the acceleration is integrated to speed and position.
                self.drift_speed += DRIFT_ACCELERATION * self.cycle
                self.drift += self.drift_speed * self.cycle
            case GpsGlitch(start=start) if start <= time < start + self.mishap.seconds:
                # The filter rejects the jump, so that the estimate stays right.
                self.sensor_errors.east_error = self.mishap.metres
                self.sensor_errors.position_ratio = abs(self.mishap.metres) / POSITION_LIMIT
            case YawReset(start=start, degrees=degrees) if time < start:
                # The heading is wrong from the beginning, and right from the reset on.
                self.sensor_errors.compass_ratio = abs(degrees) / USUAL_COMPASS_ERROR
                return estimate._replace(attitude=_with_turned_heading(estimate.attitude, degrees))
        north, east, down = estimate.position
        north_speed, east_speed, down_speed = estimate.velocity
        return estimate._replace(
            position=(north, east + self.drift, down - self.height_error),
            velocity=(north_speed, east_speed + self.drift_speed, down_speed - self.climb_error),
        )

    def _advance_runaway(self, mishap: HeightRunaway, time: float) -> None:
        """Advances the errors of height and climb rate by a cycle in a flight whose height estimate runs away.

        While the mishap lasts, the accelerometer measures too little upward force because of its vibration. The filter
        integrates that to a climb rate and a height that are too low, and rejects the barometer, which disagrees.
        Afterwards both errors decay with the time constant ``RESET_SECONDS``.

        Args:
            mishap: Mishap with its start and duration, s, bias of the accelerometer and vibration, m/s².
            time: Seconds after arming.
        """
        seconds_since_start = time - mishap.start
        if seconds_since_start < 0.0:
            return
        if seconds_since_start < mishap.seconds:
            self.sensor_errors.vibration = mishap.vibration
            self.sensor_errors.force_bias = mishap.bias
            self.climb_error -= mishap.bias * self.cycle
            self.height_error += self.climb_error * self.cycle
            self.sensor_errors.height_ratio = abs(self.height_error) / HEIGHT_GATE
        else:
            decay = 1.0 - self.cycle / RESET_SECONDS
            self.climb_error *= decay
            self.height_error *= decay

    def _advance_height_filter(self, bias: float, barometer_error: float) -> None:
        """Advances the errors of estimated height and climb rate by a cycle, where the filter follows the barometer.

        The height is estimated by a critically damped complementary filter of accelerometer and barometer with the
        natural frequency ω. Its error e, m upwards, follows ë = −b − 2ω ė − ω² (e − z) with the errors b and z of the
        two sensors.

        Args:
            bias: Amount b by which the accelerometer reads too low, m/s².
            barometer_error: Error z of the barometer, m upwards.
        """
        frequency = HEIGHT_FILTER_FREQUENCY
        difference = self.height_error - barometer_error
        acceleration = -bias - 2 * frequency * self.climb_error - frequency**2 * difference
        self.climb_error += acceleration * self.cycle
        self.height_error += self.climb_error * self.cycle
        self.sensor_errors.height_ratio = abs(difference) / HEIGHT_GATE / BAROMETER_AGREEMENT

    def _hold_barometer_height(self, state: State) -> None:
        """Keeps the barometer at the height where it got stuck; the filter rejects it and uses the satellites' height.

        Args:
            state: True state, which the stuck height is compared with.
        """
        height = -state.position[2]
        if self.stuck_height is None:
            self.stuck_height = height
        self.sensor_errors.stuck_height = self.stuck_height
        self.sensor_errors.height_ratio = abs(height - self.stuck_height) / HEIGHT_GATE


def _with_turned_heading(attitude: Quaternion, degrees: float) -> Quaternion:
    """Returns an attitude with another heading, ``degrees`` clockwise of its own."""
    half = radians(degrees) / 2
    w, x, y, z = attitude
    # The product of a rotation about the vertical, (cos, 0, 0, sin), and the attitude.
    c, s = cos(half), sin(half)
    return c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
