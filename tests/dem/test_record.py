"""The training data: cautions about inputs that are no motors."""

import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight, learn
from mavdem.dem.record import Record, folds

FLIGHT = simulated(wind=1.0)[:700]


def cautions(inputs, names=()):
    return Record(inputs, FLIGHT.outputs, FLIGHT.dt, (len(inputs),), input_names=names).input_cautions


def test_sound_inputs_are_left_alone():
    assert cautions(FLIGHT.inputs) == cautions(np.round(FLIGHT.inputs)) == ()
    demand = FLIGHT.inputs[:, :1] - FLIGHT.inputs[:, :1].mean()
    assert cautions(demand, ("roll demand",)) == ()


def test_a_motor_that_hardly_moves_is_named():
    inputs = FLIGHT.inputs.copy()
    inputs[:, 2] = 1500 + 0.001 * (inputs[:, 2] - 1500)
    (caution,) = cautions(inputs, ("M1", "M2", "M3", "M4"))
    assert caution.startswith("M3 hardly moves")


def test_demands_are_not_motors_and_learning_says_so():
    inputs = FLIGHT.inputs - FLIGHT.inputs.mean(axis=0)
    (caution,) = cautions(inputs)
    assert caution.startswith("input 1 has both signs")
    assert any("has both signs" in caution for caution in learn(Flight(FLIGHT.time, inputs, FLIGHT.outputs)).cautions)


def test_motors_that_never_move_are_refused_with_what_to_do():
    inputs = FLIGHT.inputs.copy()
    inputs[:, 2] = 1500
    with pytest.raises(ValueError, match="^inputs column 2 must vary: .* Leave out a motor that is missing"):
        learn(Record(inputs, FLIGHT.outputs, FLIGHT.dt, (700,)))
    with pytest.raises(ValueError, match="^inputs column 0 must vary: constant samples determine no model$"):
        learn(Record(np.full_like(inputs, 1500.0), FLIGHT.outputs, FLIGHT.dt, (700,)))


def test_folds_are_parts_of_equal_length_in_pieces_of_one_segment():
    parts = folds([100, 7, 60], 4)
    assert [sum(stop - start for _, start, stop in part) for part in parts] == [41, 42, 42, 42]
    assert parts[2] == [(0, 83, 100), (1, 0, 7), (2, 0, 18)]
