"""Vehicles: mass, inertia, thrust curve and drag of simulated multirotors, published ones or a scenario's own.

Figures and sources of the published vehicles are in ``airframes.toml``.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt

from pydantic import TypeAdapter

from mavdem.files import load_adjacent_toml
from sitl_scenarios.motion import Pair
from sitl_scenarios.rotors import CIRCLES, Shape, rotor_count
from sitl_scenarios.scenario import BodySpec, VehicleSpec

GRAVITY = 9.81
"""Acceleration of free fall, m/s², as in the paper's table of systems."""

FULL_BATTERY_VOLTAGE = 12.6
"""Voltage of a charged battery of three lithium-polymer cells, V."""

AIR_DENSITY = 1.225
"""Density of the standard atmosphere at sea level, kg/m³ (ISO 2533)."""

UNKNOWN_ROTOR_SPEED = 1000.0
"""Speed assigned to the rotors of a scenario's own body at full command, rad/s.

Any value will do: only thrust and torque act on such a body, and their coefficients are chosen to fit the speed.
"""


@dataclass(frozen=True)
class Airframe:
    """Rigid body and rotors of a multirotor, in SI units.

    A "command" is in the vehicle's own unit: 0 at a PWM pulse of 1000 µs, ``full_command`` at 2000 µs.
    """

    mass: float
    """Mass, kg."""
    inertia: tuple[float, float, float]
    """Moments of inertia about forward, right and down, kg m²; the products of inertia are taken to be zero."""
    arm: Pair
    """How far forward and right of the centre of mass the rotors of the X frame are, m."""
    hub_height: float
    """Height of the rotors above the centre of mass, m; the drag of the hull acts there too."""
    drag_area: float
    """Drag area C_d A of the hull, m²."""
    thrust_coefficients: Pair
    """Coefficients (a, b) of a rotor's thrust a ω² + b ω, N, at a speed of ω rad/s."""
    torque_coefficients: Pair
    """Coefficients (a, b) of a rotor's torque a ω² + b ω, N m, at a speed of ω rad/s."""
    speed_line: Pair
    """Slope, rad/s per unit of command, and offset, rad/s, of a rotor's speed in the command."""
    full_command: float
    """The full command."""
    rotor_lags: Pair
    """Time constants of the rotor speed when it rises and when it falls, s."""
    rotor_drag: float
    """Drag of one rotor against air that moves along its disc, N per (rad/s · m/s)."""
    inflow: float
    """Thrust that one rotor loses to air that moves down through its disc, N per (rad/s · m/s)."""
    thrust_expo: float | None = None
    """Quadratic fraction f of the thrust curve (1 − f) s + f s², at the fraction s of the motors' range.

    None: the rotor speed is linear in the command, by ``speed_line``.
    """
    spin_range: Pair = (0.0, 1.0)
    """Fractions of the full command at which the thrust curve begins and ends; used with ``thrust_expo`` only."""
    damping: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Damping of the three body rates besides that by inflow, 1/s."""
    rotors: int = 4
    """Number of rotors."""

    def rotor_speed(self, command: float) -> float:
        """Returns the speed that a rotor settles at when its motor's command is held.

        Without a thrust curve the speed is a straight line in the command. With one, the command gives a thrust,
        T = T_full ((1 − f) s + f s²) at the fraction s of the motors' range, and the speed is that which has this
        thrust. Below the range the rotor stands still.

        Args:
            command: Motor command in the vehicle's own unit, 0 to ``full_command``.

        Returns:
            Rotor speed, rad/s.
        """
        slope, offset = self.speed_line
        if self.thrust_expo is None:
            return slope * command + offset
        f = self.thrust_expo
        range_start, range_end = self.spin_range
        above_start = max(command / self.full_command - range_start, 0.0)
        s = above_start / (range_end - range_start)
        thrust = self._full_thrust * ((1 - f) * s + f * s * s)
        return self.speed_for(thrust)

    def command_for(self, speed: float) -> float:
        """Returns the command at which a rotor settles at a speed: the inverse of ``rotor_speed``.

        Args:
            speed: Rotor speed, rad/s.

        Returns:
            Motor command in the vehicle's own unit, 0 to ``full_command`` within the rotor's reach.
        """
        slope, offset = self.speed_line
        if self.thrust_expo is None:
            return (speed - offset) / slope
        f = self.thrust_expo
        range_start, range_end = self.spin_range
        thrust_fraction = self.thrust_at(speed) / self._full_thrust
        # The positive root s of f s² + (1 − f) s = T/T_full, in the form that also holds for f = 0.
        root = sqrt((1 - f) ** 2 + 4 * f * thrust_fraction)
        range_fraction = 2 * thrust_fraction / (1 - f + root)
        return self.full_command * (range_start + (range_end - range_start) * range_fraction)

    def speed_slope(self, command: float) -> float:
        """Returns the derivative of a rotor's settled speed by its command, which controllers are tuned with.

        Without a thrust curve it is the slope of ``speed_line``. With one it is, by the chain rule, dT/dc over dT/dω:
        the thrust is T = T_full ((1 − f) s + f s²) at the fraction s of the motors' range, and a ω² + b ω at a speed ω.

        Args:
            command: Motor command c in the vehicle's own unit, within the motors' range.

        Returns:
            Slope, rad/s per unit of command.
        """
        slope, _ = self.speed_line
        if self.thrust_expo is None:
            return slope
        f = self.thrust_expo
        range_start, range_end = self.spin_range
        command_range = self.full_command * (range_end - range_start)
        s = (command - self.full_command * range_start) / command_range
        curve_slope = 1 - f + 2 * f * s
        thrust_per_command = curve_slope * self._full_thrust / command_range
        a, b = self.thrust_coefficients
        thrust_per_speed = 2 * a * self.rotor_speed(command) + b
        return thrust_per_command / thrust_per_speed

    @cached_property
    def _full_thrust(self) -> float:
        """Thrust of one rotor at the full command, N."""
        slope, offset = self.speed_line
        return self.thrust_at(slope * self.full_command + offset)

    def thrust_at(self, speed: float) -> float:
        """Returns the thrust of one rotor in still air, N, at a ``speed``, rad/s."""
        quadratic, linear = self.thrust_coefficients
        return (quadratic * speed + linear) * speed

    def speed_for(self, thrust: float) -> float:
        """Returns the speed of a rotor, rad/s, whose thrust in still air is ``thrust`` N ≥ 0."""
        quadratic, linear = self.thrust_coefficients
        # The positive root of quadratic · ω² + linear · ω = thrust.
        root = sqrt(linear * linear + 4 * quadratic * thrust)
        return (root - linear) / (2 * quadratic)

    @property
    def hover_speed(self) -> float:
        """Speed of each rotor when they carry the weight in still air, rad/s."""
        return self.speed_for(self.mass * GRAVITY / self.rotors)


AIRFRAMES = TypeAdapter(dict[str, Airframe]).validate_python(
    load_adjacent_toml(__file__, "airframes.toml")
)
"""Published airframes by the name that a scenario's ``vehicle.model`` gives."""


def airframe(vehicle: VehicleSpec) -> Airframe:
    """Selects the airframe of a scenario's vehicle, a published one or its own, with the scenario's changes.

    Args:
        vehicle: Vehicle of a scenario. Its ``body``, when there is one, replaces the published airframe of its
            ``model``. Rotor lags that the scenario leaves out are the airframe's; the thrust curve is always the
            scenario's, and the moments of inertia are multiplied by ``inertia_scale``.

    Returns:
        The airframe.
    """
    base = AIRFRAMES[vehicle.model]
    if vehicle.body is not None:
        base = _own_airframe(vehicle.body, vehicle.quadratic_thrust)
    rotors = rotor_count(vehicle.frame)
    if rotors != base.rotors:
        base = _scaled_to_rotors(base, vehicle.frame, rotors)
    rise_lag, fall_lag = base.rotor_lags
    if vehicle.lag_up is not None:
        rise_lag = vehicle.lag_up
    if vehicle.lag_down is not None:
        fall_lag = vehicle.lag_down
    ix, iy, iz = (vehicle.inertia_scale * inertia for inertia in base.inertia)
    return replace(
        base,
        inertia=(ix, iy, iz),
        rotor_lags=(rise_lag, fall_lag),
        thrust_expo=vehicle.quadratic_thrust,
    )


def _scaled_to_rotors(quadrotor: Airframe, frame: Shape, rotors: int) -> Airframe:
    """Scales a quadrotor to more rotors of the same kind, each with the same load.

    Mass and drag grow with the number of rotors, and moments of inertia with the square of the length of the arms too.

    Args:
        quadrotor: Airframe whose rotors are used.
        frame: Frame of the vehicle.
        rotors: Number of its rotors.

    Returns:
        The airframe of the larger vehicle.
    """
    scale = rotors / quadrotor.rotors
    inertia_scale = scale * CIRCLES[frame].size ** 2
    ix, iy, iz = (inertia_scale * inertia for inertia in quadrotor.inertia)
    return replace(
        quadrotor,
        mass=scale * quadrotor.mass,
        # The arms of a circle are alike: so are the moments of inertia about them.
        inertia=((ix + iy) / 2, (ix + iy) / 2, iz),
        drag_area=scale * quadrotor.drag_area,
        rotors=rotors,
    )


def _own_airframe(body: BodySpec, quadratic_thrust: float | None) -> Airframe:
    """Makes an airframe from the figures of a scenario's own body, such as one that was learned from a log.

    A log shows at which command the vehicle hovers, but has no rotor speeds. So the full thrust of a rotor is its share
    of the weight over the fraction that the thrust curve gives in hover, (1 − f) s + f s². The rotor speed is an
    arbitrary scale, ``UNKNOWN_ROTOR_SPEED`` at full command, and thrust and torque are made quadratic in it. Such a
    body has no drag, no inflow and no rotor lag unless the scenario gives them.

    Args:
        body: Mass (kg), inertia (kg m²), arm (m), hover command and motors' range (fractions of the full command),
            torque by thrust (m) and damping (1/s).
        quadratic_thrust: Quadratic fraction f of the thrust curve; None: the thrust is purely quadratic, f = 1.

    Returns:
        The airframe.
    """
    f = 1.0 if quadratic_thrust is None else quadratic_thrust
    range_start, range_end = body.spin
    # The fraction s of the motors' range in hover.
    s = (body.hover - range_start) / (range_end - range_start)
    thrust_fraction = (1 - f) * s + f * s * s
    full_thrust = body.mass * GRAVITY / 4 / thrust_fraction
    return Airframe(
        mass=body.mass,
        inertia=body.inertia,
        arm=body.arm,
        hub_height=0.0,
        drag_area=0.0,
        thrust_coefficients=(full_thrust / UNKNOWN_ROTOR_SPEED**2, 0.0),
        torque_coefficients=(body.torque * full_thrust / UNKNOWN_ROTOR_SPEED**2, 0.0),
        speed_line=(UNKNOWN_ROTOR_SPEED, 0.0),
        full_command=1.0,
        rotor_lags=(0.0, 0.0),
        rotor_drag=0.0,
        inflow=0.0,
        damping=body.damping,
        spin_range=body.spin,
    )
