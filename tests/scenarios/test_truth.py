"""The truth of a flight is what moved it, and its file is the same for the same flight."""

import numpy as np
import pytest

from sitl_scenarios.files import load
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth, write_truth


@pytest.fixture(scope="module")
def flown():
    scenario = load("system_2").model_copy(update={"duration": 25.0})
    return scenario, fly(scenario)


def test_the_linear_system_with_lag_and_disturbance_moves_as_the_vehicle_did(flown):
    scenario, motion = flown
    known = truth(scenario, motion)
    hover = (motion.landed_state == 2) & (motion.time > 9) & (motion.time < 17)
    A, B = known["roll_lag_A"], known["roll_lag_B"]
    outputs, dt = motion.outputs[hover], 0.004
    trim = outputs.mean(axis=0)
    rate, drive, rates = motion.rates[hover][0, 0], 0.0, []
    keeps = np.exp(A[2, 2] * dt)
    for row, disturbance in zip(outputs - trim, known["roll_disturbance"][hover], strict=True):
        rates.append(rate)
        settled = -(B[2] @ row) / A[2, 2]
        rate += dt * (A[1, 1] * rate + drive + disturbance)
        drive = settled + keeps * (drive - settled)
    true = motion.rates[hover, 0]
    # An integral of eight seconds: what is left of the unknown beginning drifts.
    drift = np.polynomial.Polynomial.fit(motion.time[hover], true - rates, 1)
    left = true - rates - drift(motion.time[hover])
    assert left.std() < 0.05 * true.std()


def test_the_system_is_the_papers(flown):
    known = truth(*flown)
    assert np.allclose(known["roll_A"], [[0, 1], [0, 0]], atol=1e-9)
    # 255 pwm are 1000 µs; the paper's motors are front left, front right, rear right, rear left.
    assert known["roll_B"][1, [2, 0, 3, 1]] == pytest.approx(0.255 * 0.3748 * np.array([1, -1, -1, 1]), rel=1e-3)
    assert known["lag"] == pytest.approx([0.02, 0.02, 0.02])


def test_the_disturbance_is_the_moment_that_the_scenario_asks_for(flown):
    scenario, motion = flown
    known = truth(scenario, motion)
    hover = motion.landed_state == 2
    # The hull's drag adds a little to 0.0034 N m on 0.0034 kg m²; 15 s hold about 100 independent values.
    assert known["roll_disturbance"][hover].std() == pytest.approx(1.0, rel=0.3)


def test_the_file_is_the_same_for_the_same_flight(tmp_path, flown):
    scenario, motion = flown
    write_truth(tmp_path / "a.npz", scenario, motion)
    write_truth(tmp_path / "b.npz", scenario, fly(scenario))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as read:
        assert Scenario.model_validate_json(str(read["scenario"])) == scenario
        assert np.array_equal(read["wind"], motion.wind)
        assert set(read.files) == set(truth(scenario, motion))
