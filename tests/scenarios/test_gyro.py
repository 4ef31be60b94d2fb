"""The simulated gyro has the filters of the loops; the autopilots' mixers keep the thrust that is asked for."""

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark

from mavdem.loops.filters import gyro_response
from sitl_scenarios import mixers
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.gyro import Gyro
from sitl_scenarios.parameter_controller import ParameterController
from sitl_scenarios.rotors import rotor_frame

STEP = 1e-3
AT = 30.0  # Hz
GYROS = {
    "ardupilot": {
        "INS_GYRO_FILTER": 20.0,
        "INS_HNTCH_ENABLE": 1.0,
        "INS_HNTCH_FREQ": 80.0,
        "INS_HNTCH_BW": 40.0,
        "INS_HNTCH_ATT": 30.0,
    },
    "px4": {"IMU_GYRO_CUTOFF": 40.0, "IMU_GYRO_NF0_FRQ": 60.0, "IMU_GYRO_NF0_BW": 20.0},
}
X = rotor_frame("x", (0.1, 0.1))
WHOLE = np.array(X[2:])
HALVES = WHOLE / 2


def sensed(gyro, *rates):
    """The rates of a gyro, after a sample of these."""
    gyro.measure(rates, ())
    return gyro.filtered_rates


def of(autopilot, **parameters):
    table = {"stream": {"autopilot": autopilot}, "vehicle": {"parameters": parameters}}
    return scenario_from_table(table)


@mark.parametrize("autopilot", GYROS)
def test_the_gyro_passes_what_its_filters_do(autopilot):
    """A sine passes through the simulated gyro: its gain and phase are those of the autopilot's filters."""
    scenario = of(autopilot, **GYROS[autopilot])
    controller = ParameterController(scenario).axis_controllers[0]
    gyro = Gyro(controller, STEP)
    sine = np.exp(2j * np.pi * AT * STEP * np.arange(2000))
    felt = [sensed(gyro, one.real, one.imag, 0.0) for one in sine.tolist()]
    passed = complex(*felt[-1][:2]) / sine[-1]
    expected = gyro_response(controller, np.array([AT]))[0]
    assert passed == approx(gyro.response(np.array([AT]))[0], abs=1e-6)
    # PX4's own gyro is faster than the physics
    assert passed == approx(expected, abs=1e-6 if autopilot == "ardupilot" else 0.01)
    assert abs(passed) < 0.9


def test_a_filter_above_what_the_physics_show_is_off():
    scenario = of("px4", IMU_GYRO_CUTOFF=490.0)
    gyro = Gyro(ParameterController(scenario).axis_controllers[0], STEP)
    assert sensed(gyro, 1.0, 2.0, 3.0) == (1.0, 2.0, 3.0)


each_mixer = mark.parametrize("mix", [mixers.ardupilot_thrusts, mixers.px4_thrusts])


@each_mixer
def test_the_mixers_leave_demands_alone_that_fit(mix):
    demands = 0.2, -0.1, 0.1, 0.4
    thrusts = np.array(mix(HALVES, demands))
    assert [2 * thrusts @ column / 2 for column in HALVES] == approx(demands[:3])
    assert thrusts.mean() == approx(0.4)


@each_mixer
def test_the_mixers_do_not_climb_to_turn(mix):
    rng = default_rng(0)
    for demands in rng.uniform((-1, -1, -1, 0.1), 1, (200, 4)).tolist():
        thrusts = np.array(mix(HALVES, tuple(demands)))
        assert thrusts.min() > -1e-9 and thrusts.max() < 1 + 1e-9
        assert thrusts.mean() < demands[3] + 0.13  # PX4 clips what yaw leaves


def test_ardupilots_roll_and_pitch_go_down_to_a_motor_that_stands_still():
    assert mixers.ardupilot_thrusts(HALVES, (0.8, 0.8, 0.0, 0.4)) == approx((0.4, 0.4, 0.8, 0.0))


def test_ardupilots_yaw_gives_way_first_but_for_its_headroom():
    wide = np.array(mixers.ardupilot_thrusts(HALVES, (0.6, 0.0, 1.0, 0.5)))
    assert wide @ HALVES[0] == approx(0.6) and wide @ HALVES[2] == approx(0.4)
    narrow = np.array(mixers.ardupilot_thrusts(HALVES, (1.0, 0.0, 1.0, 0.5)))
    assert narrow @ HALVES[2] / (narrow @ HALVES[0]) == approx(0.2)


def test_px4s_roll_pitch_and_yaw_give_way_one_after_another():
    thrusts = np.array(mixers.px4_thrusts(WHOLE, (0.5, 0.1, 0.0, 0.3)))
    assert thrusts.min() == approx(0.0) and thrusts.mean() == approx(0.3)
    assert thrusts @ WHOLE[1] / 4 == approx(0.1) and thrusts @ WHOLE[0] / 4 < 0.25
    full = np.array(mixers.px4_thrusts(WHOLE, (0.0, 0.0, 0.5, 1.0)))
    assert full.max() == approx(1.0) and full @ WHOLE[2] / 4 == approx(0.15 / 2, abs=0.08)
