"""Vehicles hover where sources say, rotors are where autopilots count them, linear systems are the paper's."""

from math import hypot

import numpy as np
from pytest import approx, mark

from sitl_scenarios.dynamics import AirState, vehicle_dynamics
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.mavlink.autopilots import ARDUPILOT, PX4
from sitl_scenarios.mavlink.messages import parameters
from sitl_scenarios.parameter_controller import controller_for
from sitl_scenarios.scenario import Scenario, VehicleSpec
from sitl_scenarios.truth import linearised_model
from sitl_scenarios.vehicles import AIRFRAMES, airframe

PUBLISHED = [
    # D. Benders, MSc thesis, TU Delft 2020: speed of 1.451 rad/s per PWM and 130.9 rad/s at none.
    ("ardrone2", 0.481, (3.4e-3, 4.0e-3, 6.9e-3), 0.178, 500.0, 2.20065, 0.05505),
    # PX4's iris.sdf: motorConstant 5.84e-06, momentConstant 0.06; hull 1.5 kg, four rotors 0.005 kg.
    ("iris", 1.52, (0.029125, 0.029125, 0.055225), 0.255539, 800.0, 3.7376, 0.224256),
    # RotorPy's crazyflie_params.py: k_eta 2.3e-08; Förster 2015: torque 0.005964552 of thrust.
    ("crazyflie", 0.030, (1.43e-5, 1.43e-5, 2.89e-5), 0.043, 1800.0, 0.07452, 4.44478e-4),
]
"""Of each vehicle mass, kg, inertia, kg m², distance of a rotor from the middle, m, and at a speed in rad/s its thrust,
N, and torque, N m, worked out by hand from the sources' figures."""


@mark.parametrize("name, mass, inertia, arm, speed, thrust, torque", PUBLISHED)
def test_a_vehicle_has_the_published_figures(name, mass, inertia, arm, speed, thrust, torque):
    body = AIRFRAMES[name]
    assert (body.mass, body.inertia) == (mass, inertia)
    assert hypot(*body.arm) == approx(arm, rel=1e-5)
    assert body.thrust_at(speed) == approx(thrust, rel=1e-5)
    a, b = body.torque_coefficients
    assert a * speed**2 + b * speed == approx(torque, rel=1e-5)


def told(autopilot, **vehicle):
    sent = parameters(Scenario(vehicle=VehicleSpec(**vehicle)), autopilot)
    return {one.name: one.value for one in sent}


@mark.parametrize("kind", ["x", "plus"])
def test_px4_is_told_the_turning_of_each_rotor_as_it_turns(kind):
    """PX4's CA_ROTORn_KM: "Use a positive value for a rotor with CCW rotation"; in both frames 1 and 2 do.

    What the rotor does to the air, the air does to the body: a faster one that turns counter-clockwise seen from above
    yaws the vehicle clockwise, to the right.
    """
    values = told(PX4, frame=kind)
    assert [values[f"CA_ROTOR{n}_KM"] for n in range(4)] == [0.05, 0.05, -0.05, -0.05]


ROLL = (0.1, 0.0, 0.0, 0.5)  # A demand of roll, with thrust.


def test_an_autopilot_may_take_the_frame_for_another():
    taken = {"frame": "x", "mixer": "plus"}
    assert told(ARDUPILOT, **taken)["FRAME_TYPE"] == 0
    assert told(PX4, **taken) == approx(told(PX4, frame="plus"))
    stream = {"autopilot": "ardupilot"}
    mixed = []
    for kind in (taken, {"frame": "plus"}):
        vehicle = {**kind, "parameters": {"ATC_RAT_RLL_P": 0.1}}
        flown = controller_for(scenario_from_table({"vehicle": vehicle, "stream": stream}))
        mixed.append(flown.motor_commands(ROLL))
    assert mixed[0] == mixed[1]


def test_drag_is_linear_and_quadratic_along_each_axis():
    spec = VehicleSpec(drag_linear=(0.3, 0.2), drag_quadratic=(0.02, 0.04))
    hover = (airframe(spec).hover_speed,) * 4
    acceleration = vehicle_dynamics(spec)(
        (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, hover, AirState(north=4.0, east=-3.0)
    )
    assert acceleration.linear[:2] == approx(((0.3 + 0.02 * 5) * 4, (0.2 + 0.04 * 5) * -3))


@mark.parametrize("share", [0.0, 0.3, 1.0])
@mark.parametrize("name", AIRFRAMES)
def test_a_thrust_curve_is_as_quadratic_as_asked_and_undone_exactly(name, share):
    """The thrust is a mixture of a linear and a quadratic function of the command, with a share of the latter."""
    body = airframe(VehicleSpec(model=name, quadratic_thrust=share))

    def speed(command):
        return body.rotor_speed(command * body.full_command)

    published = AIRFRAMES[name]
    full_thrust = published.thrust_at(published.rotor_speed(body.full_command))
    for command in (0.25, 0.5, 1.0):
        expected = full_thrust * ((1 - share) * command + share * command**2)
        assert body.thrust_at(speed(command)) == approx(expected)
    for command in (0.1, 0.6, 1.0):
        assert body.command_for(speed(command)) == approx(command * body.full_command)
        rise = speed(command + 1e-6) - speed(command - 1e-6)
        assert body.speed_slope(command * body.full_command) == approx(
            rise / (2e-6 * body.full_command)
        )


PAPER_ORDER = (2, 0, 3, 1)
"""Which motor of an X frame, from 0 in our order, is the paper's first, second, third and fourth. The AR.Drone counts
clockwise from the front left, hence [1 −1 −1 1] in roll: front left, front right, rear right, rear left."""
K = 0.3748
ROW = [K, -K, -K, K]
A = [[0, 1, 0, 0], [0, 0, -9.81, 0], [0, 0, 0, 1], [0, 0, 0, 0]]
B = [[0] * 4] * 3 + [ROW]
"""The system of order 4; those of lower order are its last states."""


@mark.parametrize("order", [1, 2, 3, 4])
def test_the_papers_table_of_systems(order):
    """AR.Drone 2.0, without rotor drag and lag, PWM of 0 to 255; its y points to the left."""
    east = ("east", "east speed", "roll", "roll rate")[4 - order :]
    model = linearised_model(VehicleSpec(model="ardrone2", rotor_drag=False)).subsystem(east)
    mirror = np.diag([-1.0 if state.startswith("east") else 1.0 for state in east])
    states = slice(4 - order, None)
    assert np.allclose(mirror @ model.A @ mirror, np.array(A)[states, states], atol=2e-6)
    # At 169.06, the published pwm of hover, it is 0.3748 to four digits; that of the weight is 169.00.
    assert np.allclose(mirror @ model.B[:, PAPER_ORDER], B[states], atol=1e-4)
