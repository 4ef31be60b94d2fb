"""Vehicles: rigid bodies and rotors of quadrotors, published ones or a scenario's own.

Figures and sources of the published vehicles are in ``airframes.toml``.
"""

from dataclasses import dataclass, replace
from math import sqrt

from pydantic import TypeAdapter

from mavdem.files import load_adjacent_toml
from sitl_scenarios.motion import Pair
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
    """Rigid body and rotors of a quadrotor, in SI units.

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

    def rotor_speed(self, command: float) -> float:
        """Returns the speed that a rotor settles at, rad/s, at a ``command`` from 0 to the full one."""
        slope, offset = self.speed_line
        if self.thrust_expo is None:
            return slope * command + offset
        range_start, range_end = self.spin_range
        range_fraction = max(command / self.full_command - range_start, 0.0) / (
            range_end - range_start
        )
        return self.speed_for(
            self._full_thrust
            * (
                (1 - self.thrust_expo) * range_fraction
                + self.thrust_expo * range_fraction * range_fraction
            )
        )

    def command_for(self, speed: float) -> float:
        """Returns the command at which a rotor settles at a ``speed``, rad/s: the inverse of ``rotor_speed``."""
        slope, offset = self.speed_line
        if self.thrust_expo is None:
            return (speed - offset) / slope
        f = self.thrust_expo
        range_start, range_end = self.spin_range
        thrust_fraction = self.thrust_at(speed) / self._full_thrust
        # The positive root s of f s² + (1 − f) s = thrust, in the form that also holds for f = 0.
        root = sqrt((1 - f) ** 2 + 4 * f * thrust_fraction)
        range_fraction = 2 * thrust_fraction / (1 - f + root)
        return self.full_command * (range_start + (range_end - range_start) * range_fraction)

    def speed_slope(self, command: float) -> float:
        """Returns the slope of ``rotor_speed`` at a ``command``, rad/s per unit of command.

        With a thrust curve, it is the slope of thrust by command over the slope of thrust by speed.
        """
        if self.thrust_expo is None:
            return self.speed_line[0]
        range_start, range_end = self.spin_range
        command_range = self.full_command * (range_end - range_start)
        range_fraction = (command - self.full_command * range_start) / command_range
        curve_slope = 1 - self.thrust_expo + 2 * self.thrust_expo * range_fraction
        thrust_per_command = curve_slope * self._full_thrust / command_range
        thrust_per_speed = (
            2 * self.thrust_coefficients[0] * self.rotor_speed(command)
            + self.thrust_coefficients[1]
        )
        return thrust_per_command / thrust_per_speed

    @property
    def _full_thrust(self) -> float:
        """Thrust of one rotor at the full command, N."""
        slope, offset = self.speed_line
        return self.thrust_at(slope * self.full_command + offset)

    def thrust_at(self, speed: float) -> float:
        """Returns the thrust of one rotor in still air, N, at a ``speed``, rad/s."""
        a, b = self.thrust_coefficients
        return (a * speed + b) * speed

    def speed_for(self, thrust: float) -> float:
        """Returns the speed of a rotor, rad/s, whose thrust in still air is ``thrust`` N ≥ 0."""
        a, b = self.thrust_coefficients
        # The positive root of a ω² + b ω = thrust.
        root = sqrt(b * b + 4 * a * thrust)
        return (root - b) / (2 * a)

    @property
    def hover_speed(self) -> float:
        """Speed of each rotor when the four carry the weight in still air, rad/s."""
        return self.speed_for(self.mass * GRAVITY / 4)


AIRFRAMES = TypeAdapter(dict[str, Airframe]).validate_python(
    load_adjacent_toml(__file__, "airframes.toml")
)
"""Published airframes by the name that a scenario's ``vehicle.model`` gives."""


def airframe(vehicle: VehicleSpec) -> Airframe:
    """Returns the airframe of a scenario's vehicle: the published or its own one, with the changes that it asks for."""
    base = AIRFRAMES[vehicle.model]
    if vehicle.body is not None:
        base = _own_airframe(vehicle.body, vehicle.quadratic_thrust)
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


def _own_airframe(body: BodySpec, quadratic_thrust: float | None) -> Airframe:
    """Returns an airframe by the figures of a scenario's own body, such as one that was learned from a log.

    The rotors' full thrust follows from the command in hover, where the four rotors carry the weight. A body of one's
    own has no drag, no inflow and no rotor lag unless the scenario gives them.

    Args:
        body: Mass, inertia, arm, hover command, torque, motors' range and damping.
        quadratic_thrust: Quadratic fraction of the thrust curve; None: the thrust is quadratic alone.
    """
    f = 1.0 if quadratic_thrust is None else quadratic_thrust
    range_start, range_end = body.spin
    range_fraction = (body.hover - range_start) / (range_end - range_start)
    thrust_fraction = (1 - f) * range_fraction + f * range_fraction * range_fraction
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
