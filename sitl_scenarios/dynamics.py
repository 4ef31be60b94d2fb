"""Dynamics of a quadrotor: rotor frame and mixer, forces and moments, and the step from state to state.

North-east-down (NED), body axes forward, right, down (FRD). On the body act its weight, the rotors' thrust along −z and
torque about z, and air that moves past it:

- the hull's drag, ½ρ C_d A |a| a, for air that moves with a relative to the body; a scenario may set others;
- each rotor's drag, k ω a along its disc: the H-force, linear in rotor speed and in the air's (Ph. Martin and
  E. Salaün, ICRA 2010; R. Mahony, V. Kumar and P. Corke, "Multirotor aerial vehicles", IEEE RAM 2012);
- each rotor's loss of thrust to air that moves down through its disc, k_z ω a_z, with a_z at its own hub. So a body
  that rolls is damped, and air that turns about its x axis rolls it (J. Svacha et al., ICUAS 2017).

Both drags act at the height of the hubs, above the centre of mass, and so tilt the body. Damage changes what a rotor
gives at its speed, and where the centre of mass is. Left out as small: gyroscopic moments of the rotors, flapping
moments, ground effect, what inflow does to torque, what a shifted load changes of the inertia, and what a chipped
propeller loses of its drag.

ArduPilot and PX4 count an X quad alike: 1 front right, 2 rear left, 3 front left, 4 rear right. ArduPilot counts a + as
1 right, 2 left, 3 front, 4 rear; PX4, whose parameters hold the places, is given the same. In both frames, 1 and 2
turn counter-clockwise seen from above
(https://ardupilot.org/copter/docs/connect-escs-and-motors.html; PX4's airframe reference).
"""

from collections.abc import Callable
from math import asin, atan2, ceil, exp, hypot, sqrt
from operator import mul
from typing import Literal, NamedTuple

import numpy as np

from sitl_scenarios.motion import Array, Motion, Pair
from sitl_scenarios.scenario import Scenario, VehicleSpec
from sitl_scenarios.vehicles import AIR_DENSITY, GRAVITY, airframe

Four = tuple[float, ...]
"""Of the four rotors, in the autopilots' order."""

SPINS = (1.0, 1.0, -1.0, -1.0)
"""1: the rotor turns counter-clockwise seen from above, and its torque turns the body clockwise: positive yaw."""


class RotorFrame(NamedTuple):
    """Rotors in the autopilots' order."""

    forward: Four  # with right: place of each rotor from the centre of mass, m
    right: Four
    roll: Four  # with pitch, yaw: what a demand of 1 adds to the normalised command of each motor
    pitch: Four
    yaw: Four


def frame(kind: Literal["x", "plus"], arm: Pair) -> RotorFrame:
    """Returns the frame of a vehicle.

    ``arm`` is how far forward and right the rotors of the X are, m; those of the + are as far out.
    """
    forward = (1.0, -1.0, 1.0, -1.0)
    right = (1.0, -1.0, -1.0, 1.0)
    if kind == "plus":
        forward = (0.0, 0.0, 1.0, -1.0)
        right = (1.0, -1.0, 0.0, 0.0)
        arm = (hypot(*arm),) * 2
    ahead, aside = arm
    # Thrust acts upwards: a rotor on the left rolls to the right, one in front raises the nose.
    return RotorFrame(
        forward=tuple(part * ahead for part in forward),
        right=tuple(part * aside for part in right),
        roll=tuple(-part for part in right),
        pitch=forward,
        yaw=SPINS,
    )


IDLE_COMMAND = 0.1  # Of full command: what an armed motor turns at, at least


def mix(frame: RotorFrame, demands: Four) -> Four:
    """Returns normalised commands of the motors, ``IDLE_COMMAND`` to 1.

    ``demands`` are roll, pitch, yaw (−1 to 1) and thrust (0 to 1). Where a motor would saturate, thrust gives way
    first, so that the vehicle stays upright, and then all of roll, pitch and yaw alike.
    """
    roll, pitch, yaw, thrust = demands
    turning = [
        roll * r + pitch * p + yaw * s
        for r, p, s in zip(frame.roll, frame.pitch, frame.yaw, strict=True)
    ]
    lowest = min(turning)
    highest = max(turning)
    if highest - lowest > 1.0 - IDLE_COMMAND:
        scale = (1.0 - IDLE_COMMAND) / (highest - lowest)
        turning = [part * scale for part in turning]
        lowest = lowest * scale
        highest = highest * scale
    least = IDLE_COMMAND - lowest
    most = 1.0 - highest
    thrust = min(max(thrust, least), most)
    return tuple(share + thrust for share in turning)


# Of no command and of a full one
MIN_PULSE = 1000.0
MAX_PULSE = 2000.0
DISARMED_PULSE = {"px4": 900.0, "ardupilot": 1000.0}  # µs of a disarmed motor, by autopilot


def pulse(command: float) -> float:
    """Returns a normalised command as it is put out: whole µs."""
    microseconds = MIN_PULSE + (MAX_PULSE - MIN_PULSE) * command
    return float(round(microseconds))


Three = tuple[float, ...]
"""Of three axes."""
Quaternion = tuple[float, float, float, float]


class AirState(NamedTuple):
    """The air about the vehicle, and what else pushes it."""

    north: float = 0.0  # with east, down: m/s, where it moves to
    east: float = 0.0
    down: float = 0.0
    p: float = 0.0  # with q: its rotation about the body's forward and right axes, rad/s
    q: float = 0.0
    roll: float = 0.0  # with pitch, yaw: a moment on the body, N m, whatever the air does
    pitch: float = 0.0
    yaw: float = 0.0


class Damage(NamedTuple):
    """Damage of a vehicle: shares that are left of what its four rotors do, and where its centre of mass is."""

    speed: Four = (1.0,) * 4  # of each rotor, at the same command
    thrust: Four = (1.0,) * 4  # with torque: of each rotor, at the same speed
    torque: Four = (1.0,) * 4
    # of mass: how far forward and right of the published one, m
    centre: Pair = (0.0, 0.0)


UNDAMAGED = Damage()


def damages(scenario: Scenario) -> list[tuple[float, Damage]]:
    """Returns seconds after the first arming, and the condition from then on, of all damage in order.

    There are none of a sound vehicle.
    """
    vehicle = scenario.vehicle
    propeller = scenario.propeller
    load = scenario.load
    begins = [vehicle.weak_from] * bool(vehicle.weak_motor)
    begins += [propeller.start] * bool(propeller.motor)
    begins += [load.start] * bool(load.forward or load.right)

    def at(time: float) -> Damage:
        weak = vehicle.weak_motor if time >= vehicle.weak_from else 0
        chipped = propeller.motor if time >= propeller.start else 0
        shifted = time >= load.start
        return Damage(
            # Thrust goes with the square of the speed.
            speed=_all_but(weak, sqrt(vehicle.weak_thrust)),
            thrust=_all_but(chipped, propeller.thrust),
            torque=_all_but(chipped, propeller.torque),
            centre=(1e-3 * load.forward * shifted, 1e-3 * load.right * shifted),
        )

    return [(begin, at(begin)) for begin in sorted(set(begins))]


def _all_but(motor: int, share: float) -> Four:
    """1, but ``share`` for a motor, from 1; 0: none."""
    return tuple(share if motor == number else 1.0 for number in (1, 2, 3, 4))


Change = tuple[float, ...]
"""Acceleration NED (m/s²), angular acceleration in body axes (rad/s²), and of that the disturbance: force NED (N) and
moment in body axes (N m) of everything but weight and the rotors' thrust and torque in still air."""
Dynamics = Callable[[Quaternion, Three, Three, Four, AirState], Change]
"""Of attitude (body to NED), velocity (NED, m/s), body rates (rad/s), rotor speeds (rad/s) and the air."""


def dynamics(vehicle: VehicleSpec, condition: Damage = UNDAMAGED) -> Dynamics:
    """Returns accelerations of a vehicle in the air as a function of its state.

    The vehicle is flown, and linearised, by this one function.
    """
    body = airframe(vehicle)
    places = frame(vehicle.frame, body.arm)
    ahead, aside = condition.centre
    rotors_of = zip(
        places.forward, places.right, condition.thrust, condition.torque, SPINS, strict=True
    )
    # Of each rotor its place from the centre of mass, the share of its thrust, and that of its torque with its sign.
    each = [
        (forward - ahead, right - aside, thrust, spin * torque)
        for forward, right, thrust, torque, spin in rotors_of
    ]
    mass = body.mass
    height = body.hub_height
    ix, iy, iz = body.inertia
    dx, dy, dz = (
        damping * about for damping, about in zip(body.damping, body.inertia, strict=True)
    )
    thrust2, thrust1 = body.thrust
    torque2, torque1 = body.torque
    half_rho_area = AIR_DENSITY * body.drag_area / 2
    along_x = along_y = body.rotor_drag * vehicle.rotor_drag
    hull_x = hull_y = half_rho_area
    if vehicle.drag_linear is not None:
        full_speed = 4 * body.hover_speed
        along_x, along_y = (drag * mass / full_speed for drag in vehicle.drag_linear)
    if vehicle.drag_quadratic is not None:
        hull_x, hull_y = (drag * mass for drag in vehicle.drag_quadratic)
    through = body.inflow if vehicle.rotor_drag else 0.0

    def change(
        attitude: Quaternion, velocity: Three, rates: Three, rotors: Four, air: AirState
    ) -> Change:
        # Of floats: numpy's calls on arrays of three would take ten times as long.
        p, q, r = rates
        north, east, down, air_p, air_q, roll, pitch, yaw = air
        rows = rotation(attitude)
        vn, ve, vd = velocity
        past = north - vn, east - ve, down - vd
        ax, ay, az = [dot(column, past) for column in zip(*rows, strict=True)]
        speed = sqrt(dot(past, past))
        speeds = sum(rotors)
        drag_x = hull_x * speed + along_x * speeds
        fx = drag_x * ax
        drag_y = hull_y * speed + along_y * speeds
        fy = drag_y * ay

        # Air through each disc; a hub at (x, y) moves down with the body's p y − q x.
        tp = through * (air_p - p)
        tq = through * (air_q - q)
        tz = through * az
        fz = push = half_rho_area * speed * az
        mx = roll - dx * p + height * fy - aside * push
        my = pitch - dy * q - height * fx + ahead * push
        mz = yaw - dz * r + aside * fx - ahead * fy
        for rotor, (forward, right, _, _) in zip(rotors, each, strict=True):
            flow = tz + tp * right - tq * forward
            lost = rotor * flow
            fz += lost
            mx += right * lost
            my -= forward * lost

        # Thrust and torque in still air.
        lift = turn = 0.0
        rolling = mx
        pitching = my
        for rotor, (forward, right, left, spin) in zip(rotors, each, strict=True):
            thrust = left * (thrust2 * rotor + thrust1) * rotor
            lift += thrust
            turn += spin * (torque2 * rotor + torque1) * rotor
            rolling -= right * thrust
            pitching += forward * thrust

        force = [dot(row, (fx, fy, fz)) for row in rows]
        north, east, down = [
            (part - row[2] * lift) / mass for part, row in zip(force, rows, strict=True)
        ]
        about_x = (rolling + (iy - iz) * q * r) / ix
        about_y = (pitching + (iz - ix) * r * p) / iy
        about_z = (mz + turn + (ix - iy) * p * q) / iz
        return north, east, down + GRAVITY, about_x, about_y, about_z, *force, mx, my, mz

    return change


def dot(vector: Three, other: Three) -> float:
    """Returns the inner product."""
    x, y, z = vector
    u, v, w = other
    return x * u + y * v + z * w


def rotation(attitude: Quaternion) -> tuple[Three, Three, Three]:
    """Returns the rows of the matrix of an attitude, from body to NED."""
    w, x, y, z = attitude
    x2 = x + x
    y2 = y + y
    z2 = z + z
    xx = x * x2
    yy = y * y2
    zz = z * z2
    xy = x * y2
    xz = x * z2
    yz = y * z2
    wx = w * x2
    wy = w * y2
    wz = w * z2
    return (
        (1.0 - yy - zz, xy - wz, xz + wy),
        (xy + wz, 1.0 - xx - zz, yz - wx),
        (xz - wy, yz + wx, 1.0 - xx - yy),
    )


def turned(attitude: Quaternion, half: Three) -> Quaternion:
    """Turns an attitude by a small rotation about the body's axes by half angles, rad; not quite of unit length."""
    (a, b, c, d) = attitude
    (x, y, z) = half
    return (
        a - b * x - c * y - d * z,
        b + a * x + c * z - d * y,
        c + a * y + d * x - b * z,
        d + a * z + b * y - c * x,
    )


def unit(attitude: Quaternion) -> Quaternion:
    """Returns the same attitude, of unit length."""
    a, b, c, d = attitude
    squares = a * a + b * b + c * c + d * d
    size = 1.0 / sqrt(squares)
    return a * size, b * size, c * size, d * size


def euler(attitude: Quaternion) -> tuple[float, float, float]:
    """Returns roll, pitch and yaw, rad, Z-Y-X, of a unit quaternion from body to NED."""
    w, x, y, z = attitude
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    sine = 2 * (w * y - z * x)
    pitch = asin(min(max(sine, -1.0), 1.0))
    yaw = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def known_angles(motion: Motion) -> Array:
    """Returns (N, 3) roll, pitch and yaw, rad, as the autopilot estimates them."""
    return np.array([euler(attitude) for attitude in motion.known_attitude.tolist()])


class State(NamedTuple):
    """Of the vehicle."""

    position: Three = (0.0, 0.0, 0.0)  # with velocity: NED, m and m/s
    velocity: Three = (0.0, 0.0, 0.0)
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)  # unit quaternion from body to NED
    rates: Three = (0.0, 0.0, 0.0)  # in body axes, rad/s
    rotors: Four = (0.0, 0.0, 0.0, 0.0)  # speeds, rad/s
    change: Change = (0.0,) * 12  # what acted last; all of it zero on the ground


def _along(at: Three, slope: Three, step: float) -> Three:
    x, y, z = at
    u, v, w = slope
    return x + step * u, y + step * v, z + step * w


MAX_STEP_SECONDS = 1e-3  # s: the physics take whole steps in a cycle, and none is longer than this


def steps_of(cycle: float) -> int:
    """Returns how many steps of the physics there are in a control cycle, s."""
    return ceil(cycle / MAX_STEP_SECONDS - 1e-9)


class Body:
    """A vehicle's way from state to state, in steps of ``step`` seconds, by ``dynamics``, which damage changes."""

    def __init__(self, vehicle: VehicleSpec, step: float) -> None:
        self._vehicle = vehicle
        self._airframe = airframe(vehicle)
        self._step = step
        self.damage(UNDAMAGED)
        up, down = self._airframe.lag
        self._keeps = tuple(
            exp(-step / tau) if tau else 0.0 for tau in (up / 0.5, up, down / 0.5, down)
        )

    def damage(self, condition: Damage) -> None:
        """Puts the vehicle in this ``condition`` from now on."""
        self.condition = condition
        self.dynamics = dynamics(self._vehicle, condition)

    def targets(self, outputs: Four, battery: float) -> Four:
        """Returns rotor speeds that the outputs settle at, rad/s, with what is left of the battery."""
        body = self._airframe
        span = MAX_PULSE - MIN_PULSE
        share = body.full / span
        if body.quadratic is not None:
            speeds = [battery * body.rotor_speed(share * (us - MIN_PULSE)) for us in outputs]
        else:
            slope = battery * body.speed[0] * body.full / span
            offset = battery * body.speed[1]
            speeds = [slope * (us - MIN_PULSE) + offset for us in outputs]
        return tuple(map(mul, speeds, self.condition.speed))

    def moved(self, state: State, targets: Four, air: AirState) -> State:
        """Returns the state a step later in the air; ``targets``: what the rotors' commands settle at, rad/s."""
        h = self._step
        half = self._step / 2
        position, velocity, attitude, rates, rotors, last = state
        middle_rotors, rotors = self.lagged(rotors, targets)
        p, q, r = rates
        # Half a step of rotation by the rates; their own change would be of higher order.
        quarter = p * half / 2, q * half / 2, r * half / 2
        middle_attitude = turned(attitude, quarter)
        middle_velocity = _along(velocity, last[:3], half)
        middle_rates = _along(rates, last[3:6], half)
        last = self.dynamics(middle_attitude, middle_velocity, middle_rates, middle_rotors, air)
        mean_velocity = _along(velocity, last[:3], half)
        position = _along(position, mean_velocity, h)
        velocity = _along(velocity, last[:3], h)
        p, q, r = _along(rates, last[3:6], half)
        half_turn = (half * p, half * q, half * r)
        attitude = unit(turned(attitude, half_turn))
        rates = _along(rates, last[3:6], h)
        return State(position, velocity, attitude, rates, rotors, last)

    def lagged(self, rotors: Four, targets: Four) -> tuple[Four, Four]:
        """Returns rotor speeds half a step and a step later, on their way to what their commands settle at, rad/s."""
        half_up, up, half_down, down = self._keeps
        middle = []
        end = []
        for speed, target in zip(rotors, targets, strict=True):
            off = speed - target
            half, whole = (half_up, up) if off < 0.0 else (half_down, down)
            middle.append(target + off * half)
            end.append(target + off * whole)
        return tuple(middle), tuple(end)
