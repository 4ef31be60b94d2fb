"""Dynamics: forces and moments on a quadrotor, and its accelerations.

North-east-down (NED), body axes forward, right, down (FRD). On the body act its weight, the rotors' thrust along −z and
torque about z, and air that moves past it:

- the hull's drag, ½ρ C_d A |a| a, for air that moves with a relative to the body;
- each rotor's drag, k ω a along its disc: the H-force, linear in rotor speed and in the air's (Ph. Martin and
  E. Salaün, ICRA 2010; R. Mahony, V. Kumar and P. Corke, "Multirotor aerial vehicles", IEEE RAM 2012);
- each rotor's loss of thrust to air that moves down through its disc, k_z ω a_z, with a_z at its own hub. So a body
  that rolls is damped, and air that turns about its x axis rolls it (J. Svacha et al., ICUAS 2017).

Both drags act at the height of the hubs, above the centre of mass, and so tilt the body. Left out as small: gyroscopic
moments of the rotors, flapping moments, ground effect, and what inflow does to torque.

Damage changes what a rotor gives at its speed, and where the centre of mass is: the body turns about the new one, and
hull and hubs are where they were. Left out as small: what a shifted load changes of the moments of inertia, and what a
chipped propeller loses of its drag.
"""

from __future__ import annotations

from collections.abc import Callable
from math import asin, atan2, sqrt
from typing import NamedTuple

from sitl_scenarios.mixer import SPINS, Four, frame
from sitl_scenarios.scenario import Scenario, VehicleSpec
from sitl_scenarios.vehicles import AIR_DENSITY, GRAVITY, airframe

Three = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Air(NamedTuple):
    """The air about the vehicle, and what else pushes it."""

    north: float = 0.0  # with east, down: m/s, where it moves to
    east: float = 0.0
    down: float = 0.0
    p: float = 0.0  # with q: its rotation about the body's forward and right axes, rad/s
    q: float = 0.0
    roll: float = 0.0  # with pitch, yaw: a moment on the body, N m, whatever the air does
    pitch: float = 0.0
    yaw: float = 0.0


class Wear(NamedTuple):
    """Damage of a vehicle: shares that are left of what its four rotors do, and where its centre of mass is."""

    speed: Four = (1.0,) * 4  # of each rotor, at the same command
    thrust: Four = (1.0,) * 4  # with torque: of each rotor, at the same speed
    torque: Four = (1.0,) * 4
    centre: tuple[float, float] = (0.0, 0.0)  # of mass: how far forward and right of the published one, m


SOUND = Wear()


def damages(scenario: Scenario) -> list[tuple[float, Wear]]:
    """Seconds after the first arming, and the condition from then on, of all damage in order; none of a sound one."""
    vehicle, propeller, load = scenario.vehicle, scenario.propeller, scenario.load
    begins = [vehicle.weak_from] * bool(vehicle.weak_motor) + [propeller.start] * bool(propeller.motor)
    begins += [load.start] * bool(load.forward or load.right)

    def at(time: float) -> Wear:
        weak = vehicle.weak_motor if time >= vehicle.weak_from else 0
        chipped = propeller.motor if time >= propeller.start else 0
        shifted = time >= load.start
        return Wear(
            # Thrust goes with the square of the speed.
            speed=_all_but(weak, sqrt(vehicle.weak_thrust)),
            thrust=_all_but(chipped, propeller.thrust),
            torque=_all_but(chipped, propeller.torque),
            centre=(1e-3 * load.forward * shifted, 1e-3 * load.right * shifted),
        )

    return [(begin, at(begin)) for begin in sorted(set(begins))]


def _all_but(motor: int, share: float) -> Four:
    """1, but ``share`` for a motor, from 1; 0: none."""
    a, b, c, d = (share if motor == number else 1.0 for number in (1, 2, 3, 4))
    return a, b, c, d


Change = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
"""Acceleration NED (m/s²), angular acceleration in body axes (rad/s²), and of that the disturbance: force NED (N) and
moment in body axes (N m) of everything but weight and the rotors' thrust and torque in still air."""
Dynamics = Callable[[Quaternion, Three, Three, Four, Air], Change]
"""Of attitude (body to NED), velocity (NED, m/s), body rates (rad/s), rotor speeds (rad/s) and the air."""


def dynamics(vehicle: VehicleSpec, condition: Wear = SOUND) -> Dynamics:
    """Accelerations of a vehicle in the air as a function of its state; flown, and linearised, by this one function."""
    body = airframe(vehicle)
    places = frame(vehicle.frame, body.arm)
    ahead, aside = condition.centre
    x1, x2, x3, x4 = (forward - ahead for forward in places.forward)
    y1, y2, y3, y4 = (right - aside for right in places.right)
    k1, k2, k3, k4 = condition.thrust
    s1, s2, s3, s4 = (spin * share for spin, share in zip(SPINS, condition.torque, strict=True))
    mass, height = body.mass, body.hub_height
    ix, iy, iz = body.inertia
    thrust2, thrust1 = body.thrust
    torque2, torque1 = body.torque
    half_rho_area = AIR_DENSITY * body.drag_area / 2
    along = body.rotor_drag if vehicle.rotor_drag else 0.0
    through = body.inflow if vehicle.rotor_drag else 0.0

    def change(attitude: Quaternion, velocity: Three, rates: Three, rotors: Four, air: Air) -> Change:
        # Unrolled into floats: numpy's calls on arrays of three would take ten times as long.
        w, x, y, z = attitude
        vn, ve, vd = velocity
        p, q, r = rates
        o1, o2, o3, o4 = rotors
        north, east, down, air_p, air_q, roll, pitch, yaw = air

        # Rotation from body to NED.
        xx, yy, zz = x + x, y + y, z + z
        wx, wy, wz = w * xx, w * yy, w * zz
        xy, xz, yz = x * yy, x * zz, y * zz
        xx, yy, zz = x * xx, y * yy, z * zz
        r11, r12, r13 = 1.0 - yy - zz, xy - wz, xz + wy
        r21, r22, r23 = xy + wz, 1.0 - xx - zz, yz - wx
        r31, r32, r33 = xz - wy, yz + wx, 1.0 - xx - yy

        # The air relative to the body, in its axes.
        an, ae, ad = north - vn, east - ve, down - vd
        ax = r11 * an + r21 * ae + r31 * ad
        ay = r12 * an + r22 * ae + r32 * ad
        az = r13 * an + r23 * ae + r33 * ad
        hull = half_rho_area * sqrt(an * an + ae * ae + ad * ad)
        planar = hull + along * (o1 + o2 + o3 + o4)
        fx, fy = planar * ax, planar * ay

        # Air through each disc; a hub at (x, y) moves down with the body's p y − q x.
        tp, tq = through * (air_p - p), through * (air_q - q)
        tz = through * az
        l1 = o1 * (tz + tp * y1 - tq * x1)
        l2 = o2 * (tz + tp * y2 - tq * x2)
        l3 = o3 * (tz + tp * y3 - tq * x3)
        l4 = o4 * (tz + tp * y4 - tq * x4)
        push = hull * az
        fz = push + l1 + l2 + l3 + l4
        mx = roll + height * fy - aside * push + y1 * l1 + y2 * l2 + y3 * l3 + y4 * l4
        my = pitch - height * fx + ahead * push - x1 * l1 - x2 * l2 - x3 * l3 - x4 * l4
        mz = yaw + aside * fx - ahead * fy

        # Thrust and torque in still air.
        t1 = k1 * (thrust2 * o1 + thrust1) * o1
        t2 = k2 * (thrust2 * o2 + thrust1) * o2
        t3 = k3 * (thrust2 * o3 + thrust1) * o3
        t4 = k4 * (thrust2 * o4 + thrust1) * o4
        lift = t1 + t2 + t3 + t4
        turn = (
            s1 * (torque2 * o1 + torque1) * o1
            + s2 * (torque2 * o2 + torque1) * o2
            + s3 * (torque2 * o3 + torque1) * o3
            + s4 * (torque2 * o4 + torque1) * o4
        )

        fn = r11 * fx + r12 * fy + r13 * fz
        fe = r21 * fx + r22 * fy + r23 * fz
        fd = r31 * fx + r32 * fy + r33 * fz
        return (
            (fn - r13 * lift) / mass,
            (fe - r23 * lift) / mass,
            (fd - r33 * lift) / mass + GRAVITY,
            (mx - y1 * t1 - y2 * t2 - y3 * t3 - y4 * t4 + (iy - iz) * q * r) / ix,
            (my + x1 * t1 + x2 * t2 + x3 * t3 + x4 * t4 + (iz - ix) * r * p) / iy,
            (mz + turn + (ix - iy) * p * q) / iz,
            fn,
            fe,
            fd,
            mx,
            my,
            mz,
        )

    return change


def turned(attitude: Quaternion, half: Three) -> Quaternion:
    """An attitude after a small rotation about the body's axes by half angles, rad; not quite of unit length."""
    (a, b, c, d), (x, y, z) = attitude, half
    return (
        a - b * x - c * y - d * z,
        b + a * x + c * z - d * y,
        c + a * y + d * x - b * z,
        d + a * z + b * y - c * x,
    )


def euler(attitude: Quaternion) -> tuple[float, float, float]:
    """Roll, pitch and yaw, rad, Z-Y-X, of a unit quaternion from body to NED."""
    w, x, y, z = attitude
    return (
        atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
