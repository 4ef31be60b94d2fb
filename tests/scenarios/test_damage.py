"""What breaks in flight does what theory says."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark

from sitl_scenarios.damage import Damage, damage_history
from sitl_scenarios.rotors import SPIN_DIRECTIONS, rotor_frame
from sitl_scenarios.scenario import Load, Propeller, Scenario, Sensors, VehicleSpec
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth
from sitl_scenarios.vehicles import AIRFRAMES, GRAVITY

pytestmark = [mark.slow, mark.usefixtures("coarse_physics")]
IRIS = AIRFRAMES["iris"]
SLOW_CONTROLLER = {"IMU_GYRO_RATEMAX": 100.0}
QUIET = Sensors(rate_sd=0.0, attitude_sd=0.0, position_sd=0.0, velocity_sd=0.0)
BREAKS = {
    "weak": {"vehicle": {"weak_motor": 1, "weak_from": 13.0, "weak_thrust": 0.8}},
    "chipped": {"propeller": Propeller(motor=3, start=13.0, thrust=0.85, torque=0.7)},
    "shifted": {"load": Load(start=13.0, forward=5.0, right=-15.0)},
}


def balanced(condition):
    """Returns the commands, µs, with which the damaged Iris hovers in still air.

    Thrust and three torques are linear in the squares of the rotor speeds.
    """
    places = rotor_frame("x", IRIS.arm)
    (lift, _) = IRIS.thrust_coefficients
    (drag, _) = IRIS.torque_coefficients
    thrust = lift * np.array(condition.thrust)
    torque = drag * np.array(condition.torque)
    forward, right = (
        np.subtract(rotor_position, shift)
        for rotor_position, shift in zip(places[:2], condition.centre_of_mass, strict=True)
    )
    sums = np.array([thrust, thrust * right, thrust * forward, torque * SPIN_DIRECTIONS])
    speeds = np.sqrt(np.linalg.solve(sums, [IRIS.mass * GRAVITY, 0.0, 0.0, 0.0]))
    slope, offset = IRIS.speed_line
    return 1000 + 1000 * (speeds / condition.speed - offset) / slope


@fixture(scope="module", params=["weak", "chipped", "shifted"])
def broken(request, coarse_physics):
    sections = dict(BREAKS[request.param])
    vehicle = VehicleSpec(parameters=SLOW_CONTROLLER, **sections.pop("vehicle", {}))
    scenario = Scenario(duration=35.0, sensors=QUIET, vehicle=vehicle, **sections)
    return request.param, scenario, fly(scenario)


def hovering(motion, begin, end):
    return motion.outputs[(motion.time > begin) & (motion.time < end)].mean(0)


def test_hover_balances_again(broken):
    _, scenario, motion = broken
    [(start, condition)] = damage_history(scenario)
    assert start == 13.0
    assert_allclose(hovering(motion, 10.0, 14.9), balanced(Damage()), atol=1.0)
    assert_allclose(hovering(motion, 23.0, 29.0), balanced(condition), atol=1.5)


def test_the_truth_says_since_when_it_is_broken_and_what_motors_do_from_then_on(broken):
    _, scenario, motion = broken
    [(_, condition)] = damage_history(scenario)
    known = truth(scenario, motion)
    begin = np.flatnonzero(known["weak"])[0]
    assert motion.time[begin] == approx(15.0, abs=0.01) and known["weak"][begin:].all()
    # The effect of a motor about roll: its thrust by its arm.
    arms = abs(np.array(rotor_frame("x", IRIS.arm).right) - condition.centre_of_mass[1])
    left = np.multiply(condition.thrust, condition.speed)
    speeds = motion.rotor_speeds[motion.time > 23.0][:200].mean(0) / IRIS.hover_speed
    effects = known["roll_effect_weak"] / known["roll_effect"]
    assert_allclose(effects, left * arms / IRIS.arm[1] * speeds, rtol=0.02)
