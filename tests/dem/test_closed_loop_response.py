"""The dominant poles of the closed loop, compared with theory on a small linear loop."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mavdem.dem import Learned
from mavdem.dem.closed_loop import response
from mavdem.dem.closed_loop.feedback import feedback_law
from mavdem.dem.closed_loop.response import attitude_loop
from mavdem.dem.engine.model import discretize
from mavdem.dem.graybox.parameters import Physical, WindowTable
from mavdem.dem.record import Record

DT, SAMPLES = 0.01, 3000
DAMPING, LAG, EFFECT = 1.0, 0.03, np.array([0.5, -0.5, -0.5, 0.5])
STIFF, RESIST = 90.0, 14.0  # command = STIFF · (setpoint − angle) − RESIST · rate, rad/s²
PLANT = discretize(
    np.array([[0.0, 1.0, 0.0], [0.0, -DAMPING, 1.0], [0.0, 0.0, -1 / LAG]]), np.array([[0.0], [0.0], [1 / LAG]]), DT
)


def flown(seed: int) -> Record:
    """Thirty seconds in turbulence, with a setpoint that is steered, as four motors, angle, rate and setpoint."""
    rng = np.random.default_rng(seed)
    hold = PLANT.input_now[:, 0] + PLANT.input_next[:, 0]
    asked = 0.05 * np.convolve(rng.standard_normal(SAMPLES + 50), np.hanning(50), "same")[:SAMPLES]
    x, gust = np.zeros(3), 0.0
    motors, outputs = np.empty((SAMPLES, 4)), np.empty((SAMPLES, 2))
    for t in range(SAMPLES):
        outputs[t] = x[:2] + rng.standard_normal(2) * [1e-4, 2e-3]
        command = STIFF * (asked[t] - outputs[t, 0]) - RESIST * outputs[t, 1]
        motors[t] = 1500 + EFFECT / (EFFECT @ EFFECT) * command + 0.01 * rng.standard_normal(4)
        gust += -DT * 2.0 * gust + 2.0 * np.sqrt(DT) * rng.standard_normal()
        x = PLANT.state @ x + hold * command + [0.0, DT * gust, 0.0]
    # A setpoint is logged with the sample it belongs to.
    return Record(motors, outputs, DT, (SAMPLES,), None, (), asked[:, None], ("roll setpoint",))


def physical(sd: float = 0.01, effect: np.ndarray = EFFECT, status: str = "reported") -> Physical:
    """The plant, with a relative standard deviation of all its parameters."""
    values = np.array([*effect, DAMPING, LAG, 0.0])
    statuses = {"effect": status, "damping": "reported", "lag": "reported"}
    table = WindowTable(*np.zeros((8, 1)))
    return Physical(
        effect, DAMPING, LAG, 0.0, np.diag((sd * values) ** 2), statuses, {"effect": "Too much wind."},
        0.0, 1.0, 0.1, (), 0.002, {}, table,
    )  # fmt: skip


def true_poles() -> tuple[complex, float]:
    """The pair and the real pole of the sampled loop."""
    gains = np.array([-STIFF, -RESIST, 0.0])
    step = PLANT.state + np.outer(PLANT.input_now[:, 0] + PLANT.input_next[:, 0], gains)
    poles = np.log(np.linalg.eigvals(step).astype(complex)) / DT
    return complex(poles[np.argmax(poles.imag)]), float(poles[np.argmin(np.abs(poles.imag))].real)


def test_the_dominant_poles_are_those_of_theory_and_inside_their_intervals():
    truth, real = true_poles()
    frequency, ratio = abs(truth) / (2 * np.pi), -truth.real / abs(truth)
    assert 1.2 < frequency < 2.5
    assert 0.2 < ratio < 0.8
    inside = []
    for seed in range(4):
        found = attitude_loop(flown(seed), physical())
        assert not found.reason
        pole, slow = found.poles
        assert pole.time_constant is None
        assert pole.weight == 1
        assert pole.frequency == pytest.approx(frequency, rel=0.04)
        assert pole.damping_ratio == pytest.approx(ratio, abs=0.04)
        assert pole.frequency_half < 0.15 * frequency
        assert slow.damping_ratio == 1
        assert slow.time_constant == pytest.approx(-1 / real, rel=0.1)
        inside.append(abs(slow.time_constant + 1 / real) < slow.time_constant_half)
        inside.append(abs(pole.frequency - frequency) < pole.frequency_half)
    assert sum(inside) >= 6


def test_intervals_grow_with_those_of_the_plant():
    record = flown(0)
    sharp, vague = (attitude_loop(record, physical(sd)).poles[0] for sd in (0.01, 0.04))
    assert vague.frequency == sharp.frequency
    assert vague.frequency_half > 1.1 * sharp.frequency_half


def test_the_feedback_law_is_found_in_turbulence():
    record = flown(1)
    command = (record.inputs - record.inputs.mean(axis=0)) @ EFFECT
    assert record.setpoints is not None
    law = feedback_law(command, *record.outputs.T, record.setpoints[:, 0], record)
    assert law.gains[0] == pytest.approx(-STIFF, rel=0.1)
    assert law.gains[1:-1].sum() == pytest.approx(-RESIST, rel=0.1)
    assert law.unexplained < 0.1


@pytest.mark.parametrize(
    ("change", "plant", "reason"),
    [
        ({}, None, "no physical parameters"),
        ({}, physical(status="not identifiable"), "Too much wind"),
        ({"setpoints": None, "setpoint_names": ()}, physical(), "no attitude setpoint"),
        ({"setpoint_names": ("roll rate setpoint",)}, physical(), "no attitude setpoint"),
        ({}, physical(effect=-EFFECT), "unstable"),
    ],
    ids=["no plant", "no effect", "no setpoint", "rate setpoint", "wrong sign"],
)
def test_what_cannot_be_known_has_a_reason(change, plant, reason):
    found = attitude_loop(replace(flown(0), **change), plant)
    assert found.poles == ()
    assert reason in found.reason


def test_commands_that_follow_something_else_are_refused():
    record = flown(0)
    other = 1500 + np.outer(np.random.default_rng(1).standard_normal(SAMPLES), EFFECT)
    assert "unexplained" in attitude_loop(replace(record, inputs=other), physical()).reason


def test_of_a_learnt_model_it_is_that_of_its_training_data():
    learned = SimpleNamespace(record=flown(1), physical=physical())
    assert Learned.closed_loop.func(learned) == attitude_loop(flown(1), physical())


def test_samples_without_a_setpoint_are_left_out():
    record = flown(0)
    assert record.setpoints is not None
    setpoints = record.setpoints.copy()
    setpoints[:300] = np.nan
    late, whole = (attitude_loop(each, physical()).poles[0] for each in (replace(record, setpoints=setpoints), record))
    assert late.frequency == pytest.approx(whole.frequency, rel=0.02)
    assert late != whole


def test_poles_near_each_other_are_not_told_apart(monkeypatch):
    poles, weights = np.array([-6 + 9j, -30 + 0j]), np.array([1.0, 0.8])
    monkeypatch.setattr(response, "_modes", lambda *_: (poles, weights))
    assert len(attitude_loop(flown(0), physical()).poles) == 2
    monkeypatch.setattr(response, "FREQUENCY_ERROR", 0.29)
    found = attitude_loop(flown(0), physical())
    assert found.poles == ()
    assert "cannot be told apart" in found.reason


def test_a_short_flight_is_refused():
    record = flown(0)
    part = Record(
        record.inputs[:500], record.outputs[:500], DT, (500,), None, (), record.setpoints[:500], record.setpoint_names
    )
    assert "samples" in attitude_loop(part, physical()).reason
