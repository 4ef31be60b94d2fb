"""Motor signatures against a vehicle whose trim is solved for, motor by motor."""

from __future__ import annotations

import numpy as np
import pytest

from mavdem.health.balance import motor_signatures
from mavdem.ingest.motors import motor_geometry


def frame(vehicle: str, frame_class: int, frame_type: int, motors: int):
    functions = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, motors + 1)}
    parameters = {"FRAME_CLASS": float(frame_class), "FRAME_TYPE": float(frame_type)} | functions
    layout = motor_geometry(vehicle, "ARDUPILOTMEGA", parameters, range(1, motors + 1), 8)
    assert layout is not None and not layout.positions_assumed
    return layout


LAYOUTS = {
    "quad X": frame("QUADROTOR", 1, 1, 4),
    "quad +": frame("QUADROTOR", 1, 0, 4),
    "hexa X": frame("HEXAROTOR", 2, 1, 6),
    "octa +": frame("OCTOROTOR", 3, 0, 8),
}


@pytest.fixture(params=LAYOUTS)
def layout(request):
    return LAYOUTS[request.param]


def trimmed(layout, thrusts: np.ndarray) -> np.ndarray:
    """Commands by which a mixer holds the forces of a hover where motor i gives ``thrusts[i]`` for a command of 1."""
    forward, right = np.array(layout.positions).T
    forces = np.array([np.ones(len(right)), -right, forward, np.array(layout.spins, dtype=float)])
    wanted = forces @ np.ones(len(right))
    mixer = np.linalg.pinv(forces)
    return mixer @ np.linalg.solve(forces * thrusts @ mixer, wanted)


def test_a_weak_motor_changes_the_trim_as_its_signature_says(layout):
    count = len(layout.motors)
    signatures = motor_signatures(count, layout.positions, layout.spins)
    for motor in range(count):
        thrusts = np.ones(count)
        thrusts[motor] = 1 - 1e-5
        change = (trimmed(layout, thrusts) - trimmed(layout, np.ones(count))) / 1e-5
        np.testing.assert_allclose(change, signatures.weak_motor_commands[motor], atol=1e-4)
        np.testing.assert_allclose(signatures.balance(change), signatures.weak_motor[motor], atol=1e-4)


def test_of_four_motors_only_the_weak_one_works_harder():
    layout = LAYOUTS["quad X"]
    signatures = motor_signatures(4, layout.positions, layout.spins)
    np.testing.assert_allclose(signatures.weak_motor_commands, np.eye(4), atol=1e-12)
    # Front right, counterclockwise: right side up, front up, and the counterclockwise pair up.
    np.testing.assert_allclose(signatures.weak_motor[0], [0.25, -0.25, 0.25, 0.25])


def test_axes_are_those_of_the_layout(layout):
    signatures = motor_signatures(len(layout.motors), layout.positions, layout.spins)
    assert signatures.axes == ("thrust", "roll", "pitch", "yaw")
    for axis, row in zip(signatures.axes[1:], signatures.weights[1:], strict=True):
        np.testing.assert_allclose(row, layout.effect(axis))


def test_commands_make_the_balance_asked_for(layout):
    signatures = motor_signatures(len(layout.motors), layout.positions, layout.spins)
    wanted = np.random.default_rng(4).normal(size=(5, 4))
    np.testing.assert_allclose(signatures.balance(signatures.commands(wanted)), wanted)


def test_a_shifted_load_has_no_thrust_and_no_yaw(layout):
    signatures = motor_signatures(len(layout.motors), layout.positions, layout.spins)
    np.testing.assert_array_equal(signatures.shifted_load, [[0, 1, 0, 0], [0, 0, 1, 0]])


def test_a_motor_can_be_named_where_places_and_spins_are_known_and_differ(layout):
    count = len(layout.motors)
    assert motor_signatures(count, layout.positions, layout.spins).names_a_motor
    assert not motor_signatures(count, layout.positions).names_a_motor
    assert not motor_signatures(count, (), layout.spins).names_a_motor
    assert not motor_signatures(count, layout.positions, [0] * count).names_a_motor
    coaxial = [*layout.positions, *layout.positions], [*layout.spins, *layout.spins]
    assert not motor_signatures(2 * count, *coaxial).names_a_motor


def test_what_is_not_known_has_no_axis():
    assert motor_signatures(4).axes == ("thrust",)
    assert motor_signatures(4).shifted_load.shape == (0, 1)


@pytest.mark.parametrize("given", [(0,), (4, [(1, 0)] * 3), (4, (), [1, -1])])
def test_other_numbers_of_motors_are_refused(given):
    with pytest.raises(ValueError, match="must"):
        motor_signatures(*given)
