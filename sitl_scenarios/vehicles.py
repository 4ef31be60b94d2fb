"""Vehicles: published rigid bodies and rotors of quadrotors, with the source beside the numbers."""

from dataclasses import dataclass, replace
from math import sqrt

from pydantic import TypeAdapter

from mavdem.files import load_adjacent_toml
from sitl_scenarios.motion import Pair
from sitl_scenarios.scenario import BodySpec, VehicleSpec

GRAVITY = 9.81  # m/s², as in the paper's table of systems
CHARGED = 12.6  # V of a charged battery of three cells
AIR_DENSITY = 1.225  # kg/m³, of the standard atmosphere at sea level (ISO 2533)


@dataclass(frozen=True)
class Airframe:
    """A quadrotor, SI units."""

    mass: float  # kg
    # about forward, right and down, kg m²; the products are taken to be zero
    inertia: tuple[float, float, float]
    # how far forward and right of the centre of mass the rotors of the X frame are, m
    arm: Pair
    # of the rotors above the centre of mass, m; the drag of the hull acts there too
    hub_height: float
    drag_area: float  # of the hull, C_d A, m²
    thrust: Pair  # (a, b) of a rotor, N: aω² + bω at ω rad/s
    torque: Pair  # (a, b) of a rotor, N m, likewise
    speed: Pair  # (slope, offset) of a rotor's speed, rad/s, in the command
    full: float  # the command that is 2000 µs; 0 is 1000 µs
    lag: Pair  # time constants of the rotor speed when it rises and when it falls, s
    rotor_drag: float  # N per (rad/s · m/s) of one rotor, against the air that moves along its disc
    # N per (rad/s · m/s) of one rotor: thrust lost to air that moves down through its disc
    inflow: float
    # f: thrust by the share s of the full command is (1 − f) s + f s² of the full thrust; None: ``speed`` as published
    quadratic: float | None = None
    # shares of the full command at which the thrust of ``quadratic`` begins and ends
    spin: Pair = (0.0, 1.0)
    # of the body's rates, besides that of ``inflow``, 1/s
    damping: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def rotor_speed(self, command: float) -> float:
        """Returns the speed that a command settles at, rad/s; the command in the vehicle's own unit, 0 to ``full``."""
        slope, offset = self.speed
        if self.quadratic is None:
            return slope * command + offset
        begin, end = self.spin
        share = max(command / self.full - begin, 0.0) / (end - begin)
        return self.speed_for(
            self._full_thrust * ((1 - self.quadratic) * share + self.quadratic * share * share)
        )

    def command_for(self, speed: float) -> float:
        """Returns the command that settles at ``speed``, rad/s, in the vehicle's own unit."""
        slope, offset = self.speed
        if self.quadratic is None:
            return (speed - offset) / slope
        f = self.quadratic
        begin, end = self.spin
        thrust = self.thrust_at(speed) / self._full_thrust
        # The root that stays where f is 0.
        root = sqrt((1 - f) ** 2 + 4 * f * thrust)
        share = 2 * thrust / (1 - f + root)
        return self.full * (begin + (end - begin) * share)

    def speed_slope(self, command: float) -> float:
        """Returns the slope of ``rotor_speed`` in the command, rad/s per unit."""
        if self.quadratic is None:
            return self.speed[0]
        begin, end = self.spin
        span = self.full * (end - begin)
        share = (command - self.full * begin) / span
        steepness = 1 - self.quadratic + 2 * self.quadratic * share
        rise = steepness * self._full_thrust / span
        thrust_slope = 2 * self.thrust[0] * self.rotor_speed(command) + self.thrust[1]
        return rise / thrust_slope

    @property
    def _full_thrust(self) -> float:
        """Of one rotor at full command, N."""
        slope, offset = self.speed
        return self.thrust_at(slope * self.full + offset)

    def thrust_at(self, speed: float) -> float:
        """Returns the thrust of one rotor in still air, N, at a speed in rad/s."""
        a, b = self.thrust
        return (a * speed + b) * speed

    def speed_for(self, thrust: float) -> float:
        """Returns the speed of a rotor whose thrust in still air is ``thrust`` N ≥ 0, rad/s."""
        a, b = self.thrust
        root = sqrt(b * b + 4 * a * thrust)
        return (root - b) / (2 * a)

    @property
    def hover_speed(self) -> float:
        """Of each rotor when the four carry the weight, rad/s."""
        return self.speed_for(self.mass * GRAVITY / 4)


# By the name that a scenario gives; their figures and sources are in airframes.toml
AIRFRAMES = TypeAdapter(dict[str, Airframe]).validate_python(
    load_adjacent_toml(__file__, "airframes.toml")
)


def airframe(vehicle: VehicleSpec) -> Airframe:
    """Returns the published airframe, or the vehicle's own, with what a scenario changes of it."""
    published = AIRFRAMES[vehicle.model]
    if vehicle.body is not None:
        published = _own(vehicle.body, vehicle.quadratic_thrust)
    lags = zip(published.lag, (vehicle.lag_up, vehicle.lag_down), strict=True)
    up, down = (own if given is None else given for own, given in lags)
    ix, iy, iz = (vehicle.inertia_scale * inertia for inertia in published.inertia)
    return replace(
        published, inertia=(ix, iy, iz), lag=(up, down), quadratic=vehicle.quadratic_thrust
    )


# rad/s of a rotor at full command, where nobody knows it: thrust and torque count, not the speed
FULL_SPEED = 1000.0


def _own(body: BodySpec, quadratic: float | None) -> Airframe:
    f = 1.0 if quadratic is None else quadratic
    begin, end = body.spin
    share = (body.hover - begin) / (end - begin)
    thrust_share = (1 - f) * share + f * share * share
    full = body.mass * GRAVITY / 4 / thrust_share
    return Airframe(
        mass=body.mass,
        inertia=body.inertia,
        arm=body.arm,
        hub_height=0.0,
        drag_area=0.0,
        thrust=(full / FULL_SPEED**2, 0.0),
        torque=(body.torque * full / FULL_SPEED**2, 0.0),
        speed=(FULL_SPEED, 0.0),
        full=1.0,
        lag=(0.0, 0.0),
        rotor_drag=0.0,
        inflow=0.0,
        damping=body.damping,
        spin=body.spin,
    )
