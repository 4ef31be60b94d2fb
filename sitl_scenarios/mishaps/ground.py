"""Contact with the ground that ends a flight: a vehicle that hits it, or tips over on it, and then lies there.

A vehicle that tips over is an inverted pendulum about the feet of one side; one that hits the ground comes to lie on
its side or on its back. The vehicle does not slide, and its parts do not break off.
"""

from dataclasses import dataclass
from math import acos, cos, exp, radians, sin, sqrt

from sitl_scenarios.dynamics import State
from sitl_scenarios.vectors import Quaternion, Vector3, normalised, rotation_matrix

MAX_LANDING_LEAN = radians(30)
"""Lean, rad, up to which a vehicle that touches the ground stays on its feet; a choice."""

MAX_LANDING_SINK = 2.5
"""Speed downwards, m/s, up to which feet hold a landing; a choice."""

MAX_UPRIGHT_SINK = 4.0
"""Speed downwards, m/s, up to which a vehicle that hits the ground upright stays so; a choice."""

SIDE_ANGLE = radians(95)
"""Lean, rad, of a vehicle that lies on its side, on motors and hull."""

BACK_ANGLE = radians(175)
"""Lean, rad, of a vehicle that lies on its back."""

MIN_BACK_LEAN = radians(125)
"""Lean, rad, at the impact from which on a vehicle comes to lie on its back; a choice."""

TOPPLE_FREQUENCY = 4.0
"""Growth rate, 1/s, of the lean of a vehicle that tips over: √(g / l) of feet 0.3 m from the centre of mass, less the
rotors' help."""

TOPPLE_START = (radians(2), radians(15))
"""Lean, rad, and its rate, rad/s, with which a vehicle begins to tip over; a choice."""

SETTLING_SECONDS = 0.15
"""Time constant with which a vehicle that hit the ground comes to lie, s; a choice."""

STOPPING_SECONDS = 0.015
"""Time in which the ground stops a vehicle, s: a centimetre or two of what bends."""

IMPACT_SECONDS = 0.03
"""Time constant with which the acceleration of an impact dies away in what bends, s; a choice."""

MAX_IMPACT = 150.0
"""Greatest acceleration of an impact that accelerometers feel, m/s²: their range is 16 g."""

TOPPLE_IMPACT = 35.0
"""Acceleration by the impact of rotors and hull on the ground of a vehicle that tips over, m/s²; a choice."""


@dataclass
class GroundContact:
    """A vehicle that tips over or lies on the ground: its lean over time about a horizontal axis."""

    heading: Quaternion
    """Attitude of the vehicle without its lean."""
    axis: tuple[float, float]
    """North and east of the unit vector about which it leans."""
    lean: float
    """Lean, rad."""
    rest_lean: float
    """Lean at which it comes to lie, rad."""
    rate: float = 0.0
    """Rate of the lean, rad/s."""
    is_toppling: bool = False
    """Whether it tips over from its feet, rather than having hit the ground."""
    impact: float = 0.0
    """Acceleration by the impact on the ground, which accelerometers measure besides, m/s²."""

    @property
    def has_settled(self) -> bool:
        """Whether it lies still."""
        return abs(self.rest_lean - self.lean) < radians(1)

    def advance(self, seconds: float) -> None:
        """Moves the vehicle on the ground by one time step: its lean, the rate of that, and the shock of the impact.

        A vehicle that hit the ground comes to rest with the time constant ``SETTLING_SECONDS``. One that tips over is
        an inverted pendulum: its lean λ follows λ̈ = f² sin λ, with f = ``TOPPLE_FREQUENCY``, until rotors and hull hit
        the ground.

        Args:
            seconds: Time step, s.
        """
        self.impact *= exp(-seconds / IMPACT_SECONDS)
        if not self.is_toppling:
            settled_fraction = 1.0 - exp(-seconds / SETTLING_SECONDS)
            lean_change = (self.rest_lean - self.lean) * settled_fraction
            self.lean += lean_change
            self.rate = lean_change / seconds
            return
        acceleration = TOPPLE_FREQUENCY**2 * sin(min(self.lean, radians(90)))
        self.rate += acceleration * seconds
        self.lean += self.rate * seconds
        if self.lean >= self.rest_lean:
            self.lean = self.rest_lean
            self.rate = 0.0
            self.is_toppling = False
            self.impact = TOPPLE_IMPACT

    def state_on_ground(self, former_state: State) -> State:
        """Computes the state of a vehicle that tips over or lies on the ground, from its present lean and lean rate.

        Args:
            former_state: State in the cycle before, of which the horizontal position and the rotor speeds are kept.

        Returns:
            The state, at height 0 and with the velocity 0.
        """
        axis_north, axis_east = self.axis
        # The quaternion of the lean, a rotation about a horizontal axis of the world, after that of the heading.
        half_angle = self.lean / 2
        lean_rotation = (
            cos(half_angle),
            sin(half_angle) * axis_north,
            sin(half_angle) * axis_east,
            0.0,
        )
        attitude = normalised(quaternion_product(lean_rotation, self.heading))
        # The rate about the same axis, projected on the body axes, which are the columns of the matrix.
        body_axes_north, body_axes_east, _ = rotation_matrix(attitude)
        rates = tuple(
            self.rate * (axis_north * north + axis_east * east)
            for north, east in zip(body_axes_north, body_axes_east, strict=True)
        )
        position = (former_state.position[0], former_state.position[1], 0.0)
        return State(position, attitude=attitude, rates=rates, rotors=former_state.rotors)


def quaternion_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Multiplies two quaternions: the rotation ``b``, followed by ``a`` about the axes of the world.

    Args:
        a: The second rotation, (w, x, y, z).
        b: The first rotation, (w, x, y, z).

    Returns:
        The combined rotation, (w, x, y, z).
    """
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def lean_angle(attitude: Quaternion) -> float:
    """Returns the angle between the vehicle's down axis and the vertical, rad."""
    down = rotation_matrix(attitude)[2][2]
    return acos(min(max(down, -1.0), 1.0))


def impact(state: State) -> GroundContact:
    """Begins the motion of a vehicle that hits the ground: it comes to rest on its side, its back, or its feet.

    The more it leans at the impact, the further it turns over; a fast impact on its feet breaks them. The acceleration
    of the impact is the speed divided by the time in which the ground stops the vehicle, up to the range of
    accelerometers.

    Args:
        state: True state at the impact.

    Returns:
        The contact, at the beginning of its motion.
    """
    # North and east components of the body's down axis, the third column of the matrix.
    (_, _, down_north), (_, _, down_east), _ = rotation_matrix(state.attitude)
    length = sqrt(down_north * down_north + down_east * down_east)
    # The vehicle leans about the horizontal axis at right angles to that; an upright one, about any.
    axis_north, axis_east = 1.0, 0.0
    if length > 0:
        axis_north, axis_east = -down_east / length, down_north / length
    lean = lean_angle(state.attitude)
    # The quaternion of the opposite rotation, which takes the lean off and leaves the heading.
    half_angle = -lean / 2
    to_upright = (cos(half_angle), sin(half_angle) * axis_north, sin(half_angle) * axis_east, 0.0)
    heading = normalised(quaternion_product(to_upright, state.attitude))

    north_speed, east_speed, sink_speed = state.velocity
    rest_lean = 0.0
    if lean > MIN_BACK_LEAN:
        rest_lean = BACK_ANGLE
    elif lean > MAX_LANDING_LEAN or sink_speed > MAX_UPRIGHT_SINK:
        rest_lean = SIDE_ANGLE
    speed = sqrt(north_speed * north_speed + east_speed * east_speed + sink_speed * sink_speed)
    acceleration = min(speed / STOPPING_SECONDS, MAX_IMPACT)
    return GroundContact(heading, (axis_north, axis_east), lean, rest_lean, impact=acceleration)


def topple(state: State, bearing: float) -> GroundContact:
    """Begins the motion of a vehicle that tips over from its feet about a horizontal axis.

    Args:
        state: A vehicle that stands on the ground.
        bearing: Side to which it tips, degrees clockwise from the nose.

    Returns:
        The contact, with a small first lean and rate of the lean.
    """
    w, _, _, z = state.attitude
    heading = normalised((w, 0.0, 0.0, z))
    # The axis of the rotation, in body axes: to tip to the right is to rotate about the forward axis, and to tip
    # forward is to rotate about the axis to the left.
    angle = radians(bearing)
    axis_forward, axis_right = sin(angle), -cos(angle)
    # North and east components of the forward and right body axes.
    (forward_north, right_north, _), (forward_east, right_east, _), _ = rotation_matrix(heading)
    axis = (
        forward_north * axis_forward + right_north * axis_right,
        forward_east * axis_forward + right_east * axis_right,
    )
    lean, rate = TOPPLE_START
    return GroundContact(
        heading, axis=axis, lean=lean, rest_lean=SIDE_ANGLE, rate=rate, is_toppling=True
    )


def lands_on_feet(velocity: Vector3, attitude: Quaternion) -> bool:
    """Returns whether a vehicle that touches the ground stays on its feet."""
    return velocity[2] <= MAX_LANDING_SINK and lean_angle(attitude) <= MAX_LANDING_LEAN
