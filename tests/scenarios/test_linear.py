"""The linear systems are the paper's and the closed forms'; test_truth.py has how the vehicle really moves."""

import numpy as np
import pytest
from paper_systems import paper_system

from sitl_scenarios.scenario import VehicleSpec
from sitl_scenarios.truth import linearised
from sitl_scenarios.vehicles import AIRFRAMES, GRAVITY

K = 0.3748
ROW = [K, -K, -K, K]
TABLE = {
    1: ([[0]], [ROW]),
    2: ([[0, 1], [0, 0]], [[0] * 4, ROW]),
    3: ([[0, -9.81, 0], [0, 0, 1], [0, 0, 0]], [[0] * 4, [0] * 4, ROW]),
    4: ([[0, 1, 0, 0], [0, 0, -9.81, 0], [0, 0, 0, 1], [0, 0, 0, 0]], [[0] * 4] * 3 + [ROW]),
}


@pytest.mark.parametrize("order", TABLE)
def test_the_papers_table_of_systems(order):
    found, (A, B) = paper_system(order), TABLE[order]
    assert found.states == (("y", "ẏ", "φ", "φ̇"))[4 - order :]
    assert np.allclose(found.A, A, atol=2e-6)
    # At 169.06, the published pwm of hover, it is 0.3748 to four digits; that of the weight is 169.00.
    assert np.allclose(found.B, B, atol=1e-4)


@pytest.mark.parametrize("model", AIRFRAMES)
@pytest.mark.parametrize("kind", ["x", "plus"])
def test_closed_forms(model, kind):
    vehicle, body = VehicleSpec(model=model, frame=kind), AIRFRAMES[model]
    found, omega = linearised(vehicle).without_lag(), body.hover_speed
    aside = body.arm[1] if kind == "x" else np.hypot(*body.arm)
    pair = 4 if kind == "x" else 2  # rotors that have that arm
    at = found.states.index
    damping = pair * body.inflow * omega * aside**2 / body.inertia[0]
    drag = 4 * body.rotor_drag * omega
    assert found.A[at("roll rate"), at("roll rate")] == pytest.approx(-damping, rel=1e-6)
    assert found.A[at("east speed"), at("east speed")] == pytest.approx(-drag / body.mass, rel=1e-3)
    assert found.A[at("east speed"), at("roll")] == pytest.approx(GRAVITY, rel=1e-6)
    assert found.A[at("north speed"), at("pitch")] == pytest.approx(-GRAVITY, rel=1e-6)
    slope = (2 * body.thrust[0] * omega + body.thrust[1]) * body.speed[0]
    assert found.B[at("roll rate"), 1] == pytest.approx(slope * aside / body.inertia[0], rel=1e-6)
    assert found.B[at("down speed")] == pytest.approx(np.full(4, -slope / body.mass), rel=1e-6)
    turn = (2 * body.torque[0] * omega + body.torque[1]) * body.speed[0]
    assert found.B[at("yaw rate")] == pytest.approx(turn / body.inertia[2] * np.array([1, 1, -1, -1]), rel=1e-6)
