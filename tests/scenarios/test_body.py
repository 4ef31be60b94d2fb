"""The integrator is of second order, and right where there is a formula for what it should give."""

import numpy as np
from pytest import approx, mark
from scipy.integrate import solve_ivp

from sitl_scenarios.damage import Damage
from sitl_scenarios.dynamics import (
    MAX_STEP_SECONDS,
    AirState,
    Body,
    State,
    disturbance_of_states,
    vehicle_dynamics,
)
from sitl_scenarios.scenario import VehicleSpec
from sitl_scenarios.vehicles import AIRFRAMES

IRIS = AIRFRAMES["iris"]
CYCLE = 0.004
CYCLES = 100
GUSTY = AirState(north=2.0, east=-3.0, down=0.5, p=0.3, q=-0.2, roll=0.02, pitch=-0.01, yaw=0.001)


def targets(cycle):
    """Commands that change from cycle to cycle, some up, some down."""
    swing = 30.0 * np.array(
        [np.sin(0.7 * cycle), np.sin(0.5 * cycle + 1), np.cos(0.6 * cycle), np.sin(0.9 * cycle)]
    )
    return tuple((IRIS.hover_speed + swing).tolist())


def begun():
    hover = (IRIS.hover_speed,) * 4
    return State(
        (0.0, 0.0, -5.0), (1.0, 0.5, -0.3), (0.96, 0.2, 0.12, 0.15), (0.8, -0.6, 0.5), hover
    )


def normed(state):
    q = np.array(state.attitude)
    return state._replace(attitude=tuple((q / np.linalg.norm(q)).tolist()))


def flown(steps):
    """The state as one row after ``CYCLES``, in steps of CYCLE/steps."""
    body = Body(VehicleSpec(model="iris"), CYCLE)
    state = normed(begun())
    for cycle in range(CYCLES):
        state = body.advanced(state, targets(cycle), GUSTY, steps)
    return np.concatenate(state[:5])


def reference():
    """Returns the state of the body after some cycles by scipy's integrator DOP853 with tight tolerances."""
    change, up, down = vehicle_dynamics(VehicleSpec(model="iris")), *IRIS.rotor_lags
    row = np.concatenate(normed(begun())[:5])

    def derivative(_, row, wanted):
        position, velocity, attitude, rates, rotors = np.split(row, [3, 6, 10, 13])
        w, x, y, z = attitude
        p, q, r = rates
        acting = change(tuple(attitude), tuple(velocity), tuple(rates), tuple(rotors), GUSTY)
        turned = 0.5 * np.array(
            [
                -x * p - y * q - z * r,
                w * p + y * r - z * q,
                w * q + z * p - x * r,
                w * r + x * q - y * p,
            ]
        )
        lag = np.where(rotors < wanted, up, down)
        return np.concatenate(
            [velocity, acting.linear, turned, acting.angular, (wanted - rotors) / lag]
        )

    for cycle in range(CYCLES):
        wanted = np.array(targets(cycle))
        row = solve_ivp(
            derivative, (0, CYCLE), row, "DOP853", rtol=1e-12, atol=1e-12, args=(wanted,)
        ).y[:, -1]
    return row


@mark.slow
def test_the_error_falls_with_the_square_of_the_step():
    truth = reference()
    errors = [np.linalg.norm(flown(steps) - truth) for steps in (2, 4, 8, 16)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(abs(orders - 2) < 0.15), orders
    # Two steps in a cycle are those of flights. With the rotors' speeds at the middle of a step in the place of their
    # means, and first-order attitudes there, four steps erred by 6.5e-6 after 0.4 s of tumbling.
    assert CYCLE / 2 == MAX_STEP_SECONDS and errors[0] < 6e-6


def test_wind_acts_where_the_hull_is_and_so_turns_a_vehicle_whose_load_has_shifted():
    body = AIRFRAMES["ardrone2"]
    condition = Damage(centre_of_mass=(0.02, -0.03))
    change = vehicle_dynamics(VehicleSpec(model="ardrone2"), condition)
    air = AirState(north=2.0, east=5.0)
    acting = change((1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, (body.hover_speed,) * 4, air)
    force = acting.disturbance_force
    hubs = [-0.02, 0.03, -body.hub_height]
    assert (
        acting.disturbance_moment == approx(np.cross(hubs, force))
        and abs(acting.disturbance_moment[2]) > 1e-3
    )


def test_the_disturbance_of_many_states_is_that_of_each():
    """Forces and moments on a damaged vehicle in wind, computed at once and one by one."""
    vehicle = VehicleSpec(model="iris")
    condition = Damage(thrust=(1.0, 0.8, 1.0, 1.0), centre_of_mass=(0.02, -0.03))
    body = Body(vehicle, CYCLE)
    body.apply_damage(condition)
    states = [normed(begun())]
    for cycle in range(20):
        states.append(body.advanced(states[-1], targets(cycle), GUSTY, 4))
    columns = [np.array([getattr(state, name) for state in states]) for name in State._fields[1:5]]
    velocity, attitude, rates, rotors = columns
    air = np.tile(GUSTY, (len(states), 1))
    disturbance = disturbance_of_states(vehicle, condition, attitude, velocity, rates, rotors, air)
    change = vehicle_dynamics(vehicle, condition)
    for row, state in enumerate(states):
        acting = change(state.attitude, state.velocity, state.rates, state.rotors, GUSTY)
        assert tuple(disturbance.force[row]) == acting.disturbance_force
        assert tuple(disturbance.moment[row]) == acting.disturbance_moment
