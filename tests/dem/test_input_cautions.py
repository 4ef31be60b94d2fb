"""Cautions about recorded inputs: each thing that is wrong is found, and sound inputs are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, Settings, learn
from mavdem.dem.closed_loop.inputs import input_cautions
from mavdem.dem.record import Record


def record(inputs: np.ndarray, outputs: np.ndarray | None = None, names: tuple[str, ...] = ()) -> Record:
    outputs = FLIGHT.outputs if outputs is None else outputs
    return Record(inputs, outputs, FLIGHT.dt, (len(inputs),), input_names=names)


def controlled(gain: float, samples: int = 700, seed: int = 0) -> Flight:
    """A roll axis in wind that motors hold by the angle and ``gain`` times the rate, as measured."""
    rng = np.random.default_rng(seed)
    wind, roll, rate, torque = 0.0, 0.0, 0.0, 0.0
    inputs, outputs = np.empty((samples, 4)), np.empty((samples, 2))
    for i in range(samples):
        measured = np.array([roll, rate]) + [0.0, 0.01 * rng.standard_normal()]
        demand = -20 * measured[0] - gain * measured[1]
        inputs[i] = 1500 + 10 * demand * np.array([1, -1, -1, 1]) + rng.standard_normal(4)
        outputs[i] = measured
        wind += 0.01 * (-5 * wind + 20 * rng.standard_normal())
        torque += 0.2 * (demand - torque)
        rate += 0.01 * (torque + wind)
        roll += 0.01 * rate
    return Flight(0.01 * np.arange(samples), inputs, outputs)


FLIGHT = controlled(4.0)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("gain", [4.0, 8.0])
def test_sound_inputs_are_left_alone(seed, gain):
    flight = controlled(gain, seed=seed)
    assert input_cautions(Record.of(flight)) == ()
    assert input_cautions(record(np.round(flight.inputs), flight.outputs)) == ()
    assert input_cautions(Record.of(simulated(seed=seed, wind=1.0)[:700])) == ()


def test_a_motor_that_hardly_moves_is_named():
    inputs = FLIGHT.inputs.copy()
    inputs[:, 2] = 1500 + 0.001 * (inputs[:, 2] - 1500)
    (caution,) = input_cautions(record(inputs, names=("M1", "M2", "M3", "M4")))
    assert caution.startswith("M3 hardly moves")


@pytest.mark.parametrize("side", ["highest", "lowest"])
@pytest.mark.parametrize("quantised", [False, True])
def test_saturation_is_found_with_its_share_and_side(side, quantised):
    inputs = 1500 + 5 * (FLIGHT.inputs - 1500)
    limit = np.quantile(inputs[:, 1], 0.85 if side == "highest" else 0.15)
    inputs[:, 1] = np.minimum(inputs[:, 1], limit) if side == "highest" else np.maximum(inputs[:, 1], limit)
    found = input_cautions(record(np.round(inputs) if quantised else inputs))
    saturated = [caution for caution in found if "saturated" in caution]
    assert len(saturated) == 1
    assert saturated[0].startswith("input 2 is saturated: in 1") and side in saturated[0]


def test_a_sine_is_not_saturated():
    time = np.arange(700)[:, None] * 0.01
    inputs = 1500 + 100 * np.sin(2 * np.pi * time * [0.5, 0.7, 1.1, 1.3])
    assert not any("saturated" in caution for caution in input_cautions(record(inputs)))


def test_demands_are_not_motors():
    inputs = FLIGHT.inputs - 1500
    assert any("has both signs" in caution for caution in input_cautions(record(inputs)))
    assert input_cautions(record(inputs[:, :1], names=("roll demand",))) == ()


def test_the_ground_is_found():
    inputs, outputs = FLIGHT.inputs.copy(), FLIGHT.outputs.copy()
    inputs[600:] -= 400
    found = [caution for caution in input_cautions(record(inputs, outputs)) if "usual level" in caution]
    assert len(found) == 1 and found[0].startswith("About 6.6 s")


@pytest.mark.parametrize("seed", range(3))
def test_a_change_of_the_controller_is_found_and_dated(seed):
    before, after = controlled(4.0, seed=seed), controlled(4.0, seed=seed + 10)
    swapped = after.inputs[:, [1, 0, 3, 2]]  # the motors now answer with the other sign
    inputs, outputs = before.inputs.copy(), before.outputs.copy()
    inputs[350:], outputs[350:] = swapped[350:], after.outputs[350:]
    found = [caution for caution in input_cautions(record(inputs, outputs)) if "another way" in caution]
    assert len(found) == 1 and found[0].startswith("About 3.5 s")


@pytest.mark.slow
def test_learning_says_so():
    inputs = np.minimum(FLIGHT.inputs, np.quantile(FLIGHT.inputs, 0.8, axis=0))
    flight = Flight(FLIGHT.time, inputs, FLIGHT.outputs)
    assert any("saturated" in caution for caution in learn(flight).cautions)
    assert not any("saturated" in caution for caution in learn(flight, Settings.paper()).cautions)


def test_motors_that_never_move_are_refused_with_what_to_do():
    inputs = FLIGHT.inputs.copy()
    inputs[:, 2] = 1500
    with pytest.raises(ValueError, match="^inputs column 2 must vary: .* Leave out a motor that is missing"):
        learn(replace(record(inputs)))
    with pytest.raises(ValueError, match="^inputs column 0 must vary: constant samples determine no model$"):
        learn(record(np.full_like(inputs, 1500.0)))
