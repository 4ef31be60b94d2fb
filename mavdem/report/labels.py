"""Labels: names and units of a model's channels and states, and one command for all motors.

States that are outputs have the outputs' names. ``AxisCommand`` is one number for all motors: by how much those that
turn the vehicle one way run above those that turn it back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mavdem.arrays import Array
from mavdem.assessment.axis.residuals import command_weights, input_directions
from mavdem.containers import Names
from mavdem.dem import Learned


class Labels(NamedTuple):
    """Names and units of channels; a unit that is not known is empty."""

    input_names: Names
    output_names: Names
    input_units: Names
    output_units: Names

    @classmethod
    def of(cls, learned: Learned) -> Labels:
        """Returns those of the training data of ``learned``; numbers where it has no names."""
        record = learned.record
        inputs = record.inputs.shape[1]
        outputs = record.outputs.shape[1]
        return cls(
            record.input_names or tuple(f"input {i + 1}" for i in range(inputs)),
            record.output_names or tuple(f"output {i + 1}" for i in range(outputs)),
            record.input_units or ("",) * inputs,
            record.output_units or ("",) * outputs,
        )


def states_are_outputs(learned: Learned) -> bool:
    """Returns whether the first states of ``learned`` are the outputs: C is fixed to [I 0], not free."""
    return bool(learned.known[-learned.model.C.size :].all())


def state_names(outputs: Sequence[str], learned: Learned) -> list[str]:
    """Returns names of the n states: those of the ``outputs``, then the hidden ones; or numbers."""
    order = learned.model.A.shape[0]
    if not states_are_outputs(learned):
        return [f"state {i + 1}" for i in range(order)]
    return [*outputs, *(f"hidden {i + 1}" for i in range(order - len(outputs)))][:order]


class AxisCommand(NamedTuple):
    """One number for r inputs: c = ``weights`` · (u − trim), in the ``unit`` of the inputs.

    The ``weights`` (r,) of motors that turn the vehicle up the axis sum to 1, of the others to -1; ``motors`` (r,) is
    what the motors do for a command of 1 and for nothing else.
    """

    name: str
    unit: str
    weights: Array
    motors: Array

    @classmethod
    def of(cls, learned: Learned) -> AxisCommand:
        """Returns that of the axis of ``learned``, by the mixer geometry or else by each motor's effectiveness."""
        labels = Labels.of(learned)
        turning = input_directions(learned)
        motors = turning / (command_weights(turning) @ turning)
        return cls(
            f"{labels.output_names[0]} command",
            labels.input_units[0],
            command_weights(turning),
            motors,
        )

    def series(self, inputs: Array) -> Array:
        """Returns the command (T,) over ``inputs`` (T, r), about its mean."""
        command = inputs @ self.weights
        return command - command.mean()
