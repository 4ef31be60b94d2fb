"""The truth of a flight is what moved it, and its file is the same for the same flight."""

import numpy as np
from pytest import approx, fixture, mark

from sitl_scenarios.files import load
from sitl_scenarios.scenario import Moment, Multisine, Scenario, Sensors, VehicleSpec
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import margins, truth, write_truth


@fixture(scope="module")
def flown():
    scenario = load("system_2").model_copy(update={"duration": 15.0})
    return scenario, fly(scenario)


def accelerations(scenario, motion, axis="roll"):
    """Returns two angular accelerations of the settled flight, rad/s².

    The first is the simulated one, the second that of A, B and the disturbance.
    """
    known = truth(scenario, motion)
    rates = motion.rates[:, ("roll", "pitch", "yaw").index(axis)]
    dt = motion.time[1]
    keeps = np.exp(-dt / known["lag"][0])
    drive = 0.0
    drives = []
    for settled in (motion.outputs - known["trim"]) @ known[f"{axis}_B"][-1]:
        drives.append(drive)
        drive = settled + keeps * (drive - settled)
    predicted = known[f"{axis}_A"][-1, -1] * rates + drives + known[f"{axis}_disturbance"]
    hover = ((motion.landed_state == 2) & (motion.time > 10))[1:]
    return (np.diff(rates) / dt)[hover], ((predicted[1:] + predicted[:-1]) / 2)[hover]


@mark.in_full
def test_the_linear_system_moves_about_every_axis_as_the_vehicle_did():
    """The linearised model with the stored disturbance explains the simulated acceleration of each axis."""
    excitation = Multisine(
        kind="multisine", axis="all", sd=2.0, lowest=0.3, highest=4.0, period=10.0
    )
    inertias = {"roll": 3.4e-3, "pitch": 4.0e-3, "yaw": 6.9e-3}
    moments = tuple(Moment(axis=axis, sd=sd / 2, s=0.1) for axis, sd in inertias.items())
    vehicle = VehicleSpec(model="ardrone2")
    scenario = Scenario(
        duration=20.0, vehicle=vehicle, excitation=excitation, moments=moments, seed=4
    )
    motion = fly(scenario)
    known = truth(scenario, motion)
    for axis in inertias:
        true, predicted = accelerations(scenario, motion, axis)
        assert np.polyfit(predicted, true, 1)[0] == approx(1, abs=0.03)
        assert (true - predicted).std() < 0.05 * true.std()
        # 0.5 rad/s²; 12 s hold about 34 independent values.
        assert known[f"{axis}_disturbance"][motion.landed_state == 2].std() == approx(0.5, rel=0.4)


def test_margins_are_those_about_the_crossover_where_drag_turns_a_light_vehicle_back():
    """Drag turns a tilted vehicle back, so that the gain rises through 1 at a low frequency."""
    frequency = np.geomspace(0.05, 100.0, 4000)
    s = 2j * np.pi * frequency
    drag_stiffness = 1.5
    without_drag = 15.0 / s / (0.03 * s + 1) * np.exp(-0.01 * s)
    with_drag = without_drag * s**3 / (s**3 + drag_stiffness)
    expected = margins(frequency, without_drag)
    assert margins(frequency, with_drag) == approx(expected, rel=0.02)


@mark.in_full
@mark.usefixtures("coarse_physics")
def test_the_rate_loop_oscillates_above_its_gain_margin_and_not_below():
    def swing(gain):
        scenario = Scenario(
            duration=15.0, vehicle=VehicleSpec(rate_gain=gain), sensors=Sensors(rate_sd=1e-4)
        )
        motion = fly(scenario)
        return truth(scenario, motion)["pitch_rate_margins"][2], motion.rates[2000:2500, 1].std()

    limit = 10 ** (swing(1.0)[0] / 20)
    assert swing(0.93 * limit)[1] < 0.03 < 0.08 < swing(1.07 * limit)[1]


@mark.slow
@mark.usefixtures("coarse_physics")
def test_effects_follow_from_voltage_inertia_and_thrust_curve():
    plain = VehicleSpec()
    base = abs(effect(plain))
    assert abs(effect(VehicleSpec(inertia_scale=2.0))) == approx(base / 2, rel=0.01)
    # Thrust 5.84e-6 ω², 1100 rad/s at 2000 µs: linear, every µs is a thousandth of it, at 0.22 m.
    linear = 5.84e-6 * 1100**2 / 1000 * 0.22 / 0.029125
    assert abs(effect(VehicleSpec(quadratic_thrust=0.0))) == approx(4 * [linear], rel=0.01)


def effect(vehicle):
    scenario = Scenario(duration=15.0, height=2.0, vehicle=vehicle)
    return truth(scenario, fly(scenario))["roll_effect"]


@mark.slow
def test_the_file_is_the_same_for_the_same_flight(tmp_path, flown):
    scenario, motion = flown
    for name in ("a.npz", "b.npz"):
        write_truth(tmp_path / name, scenario, motion)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as read:
        assert Scenario.model_validate_json(str(read["scenario"])) == scenario
