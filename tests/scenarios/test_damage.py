"""What breaks in flight does what theory says: four rotors balance weight, roll, pitch and yaw again."""

import numpy as np
import pytest

from sitl_scenarios.dynamics import SPINS, Damage, damages, frame
from sitl_scenarios.scenario import Load, Propeller, Scenario, Sensors, VehicleSpec
from sitl_scenarios.sensors import vibration
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth
from sitl_scenarios.vehicles import AIRFRAMES, GRAVITY

pytestmark = pytest.mark.slow
IRIS = AIRFRAMES["iris"]
QUIET = Sensors(rate_sd=0.0, attitude_sd=0.0, position_sd=0.0, velocity_sd=0.0)
BREAKS = {
    "weak": {"vehicle": VehicleSpec(weak_motor=1, weak_from=18.0, weak_thrust=0.8)},
    "chipped": {"propeller": Propeller(motor=3, start=18.0, thrust=0.85, torque=0.7, unbalance=0.0)},
    "shifted": {"load": Load(start=18.0, forward=5.0, right=-15.0)},
}


def balanced(condition):
    """Commands, µs, of the Iris in still air by its four balances, which are linear in the squares of the speeds."""
    places, (lift, _), (drag, _) = frame("x", IRIS.arm), IRIS.thrust, IRIS.torque
    thrust, torque = lift * np.array(condition.thrust), drag * np.array(condition.torque)
    forward, right = (np.subtract(one, moved) for one, moved in zip(places[:2], condition.centre, strict=True))
    sums = np.array([thrust, thrust * right, thrust * forward, torque * SPINS])
    speeds = np.sqrt(np.linalg.solve(sums, [IRIS.mass * GRAVITY, 0.0, 0.0, 0.0]))
    slope, offset = IRIS.speed
    return 1000 + 1000 * (speeds / condition.speed - offset) / slope


@pytest.fixture(scope="module", params=["weak", "chipped", "shifted"])
def broken(request):
    scenario = Scenario(duration=40.0, sensors=QUIET, **BREAKS[request.param])
    return request.param, scenario, fly(scenario)


def hovering(motion, begin, end):
    return motion.outputs[(motion.time > begin) & (motion.time < end)].mean(0)


def test_hover_balances_again(broken):
    _, scenario, motion = broken
    [(start, condition)] = damages(scenario)
    assert start == 18.0
    np.testing.assert_allclose(hovering(motion, 14.0, 19.9), balanced(Damage()), atol=1.0)
    np.testing.assert_allclose(hovering(motion, 28.0, 34.0), balanced(condition), atol=1.5)


def test_the_truth_says_what_is_left_and_since_when(broken):
    kind, scenario, motion = broken
    known = truth(scenario, motion)
    begin = np.flatnonzero(known["weak"])[0]
    assert motion.time[begin] == pytest.approx(20.0, abs=0.01) and known["weak"][begin:].all()
    sound = {"speed_left": [1.0] * 4, "thrust_left": [1.0] * 4, "torque_left": [1.0] * 4, "centre": [0.0, 0.0]}
    after = {name: known[name][-1].tolist() for name in sound}
    changed = {
        "weak": {"speed_left": pytest.approx([0.8**0.5, 1, 1, 1])},
        "chipped": {"thrust_left": [1.0, 1.0, 0.85, 1.0], "torque_left": [1.0, 1.0, 0.7, 1.0]},
        "shifted": {"centre": pytest.approx([0.005, -0.015])},
    }[kind]
    assert after == sound | changed
    # The effect of a motor about roll: its thrust by its arm.
    arms = np.abs(np.array(frame("x", IRIS.arm).right) - after["centre"][1])
    expected = np.array(after["thrust_left"]) * np.array(after["speed_left"]) * arms / IRIS.arm[1]
    speeds = motion.rotor_speeds[motion.time > 28.0][:500].mean(0) / IRIS.hover_speed
    np.testing.assert_allclose(known["roll_effect_weak"] / known["roll_effect"], expected * speeds, rtol=0.02)


def test_an_unbalanced_propeller_shakes_gyro_and_accelerometer():
    propeller = Propeller(motor=2, start=18.0, thrust=0.9, torque=0.88, unbalance=20.0)
    scenario = Scenario(duration=40.0, sensors=QUIET, propeller=propeller)
    motion = fly(scenario)
    felt = vibration(scenario, motion)
    before, after = (motion.time > 10) & (motion.time < 19.9), (motion.time > 28.0) & (motion.time < 34.0)
    assert not felt[before].any()
    speed = motion.rotor_speeds[after, 1].mean()
    force = 20e-6 * speed**2
    assert felt[after].mean(0) == pytest.approx([*[force / IRIS.mass / 2**0.5] * 2, 0.0], rel=0.01)
    # About the heading: by the arm, and through the gyro's low-pass of 20 Hz.
    amplitude = force * np.hypot(*IRIS.arm) / (IRIS.inertia[2] * speed) / np.hypot(1, speed / (2 * np.pi * 20))
    turning = motion.known_rates[after, 2] - motion.rates[after, 2]
    assert turning.std() == pytest.approx(amplitude / 2**0.5, rel=0.05)
    # At the rotor's own frequency, as sampled.
    spectrum = np.abs(np.fft.rfft(turning * np.hanning(len(turning))))
    peak = np.fft.rfftfreq(len(turning), motion.time[1])[np.argmax(spectrum)]
    alias = abs((speed / (2 * np.pi) + 125) % 250 - 125)
    assert peak == pytest.approx(alias, abs=1.0)
