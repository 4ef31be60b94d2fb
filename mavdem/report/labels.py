"""Labels: names and units of a model's inputs, outputs and states, and one command for all motors of an axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mavdem.arrays import Array
from mavdem.assessment.axis.residuals import command_weights, input_directions
from mavdem.containers import Names
from mavdem.dem import Learned


class Labels(NamedTuple):
    """Names and units of the channels of a model."""

    input_names: Names
    """Names of the r inputs, such as the motors."""

    output_names: Names
    """Names of the m outputs, angle and rate."""

    input_units: Names
    """Units of the inputs; empty where not known."""

    output_units: Names
    """Units of the outputs; empty where not known."""

    @classmethod
    def of(cls, learned: Learned) -> Labels:
        """Returns the labels of a model's training data; numbered names where these have none.

        Args:
            learned: the linear model that was learned from a flight, with its training data.
        """
        record = learned.record
        input_count = record.inputs.shape[1]
        output_count = record.outputs.shape[1]
        numbered_inputs = tuple(f"input {number}" for number in range(1, input_count + 1))
        numbered_outputs = tuple(f"output {number}" for number in range(1, output_count + 1))
        return cls(
            record.input_names or numbered_inputs,
            record.output_names or numbered_outputs,
            record.input_units or ("",) * input_count,
            record.output_units or ("",) * output_count,
        )


def states_are_outputs(learned: Learned) -> bool:
    """Returns whether the first states of a model are its outputs: its C was fixed to [I 0] and not learned."""
    # The elements of C are the last ones of θ.
    is_element_of_C_fixed = learned.known[-learned.model.C.size :]
    return bool(is_element_of_C_fixed.all())


def state_names(outputs: Sequence[str], learned: Learned) -> list[str]:
    """Returns names for the n states of a learned linear model.

    If the first states are the outputs themselves, they have the names of the outputs, and the others are called
    "hidden 1", "hidden 2", …. Otherwise, when the output matrix C was learned freely, they are "state 1", "state 2", ….

    Args:
        outputs: names of the outputs.
        learned: the learned model.
    """
    order = learned.model.A.shape[0]
    if not states_are_outputs(learned):
        return [f"state {number}" for number in range(1, order + 1)]
    hidden_count = order - len(outputs)
    hidden_names = [f"hidden {number}" for number in range(1, hidden_count + 1)]
    return [*outputs, *hidden_names][:order]


class AxisCommand(NamedTuple):
    """Command of one axis: a weighted sum of r motor outputs, positive where they accelerate the positive rotation.

    It is c = w · (u − trim), with the weights w and the inputs u. A command of 0 does not turn the vehicle.
    """

    name: str
    """Name of the command, such as "roll command"."""

    unit: str
    """Unit of the command, which is that of the inputs."""

    weights: Array
    """Weights w (r,): they sum to 1 over motors that accelerate the positive rotation, and to −1 over the others."""

    motors: Array
    """Deviations m (r,) of the inputs from the trim with which the command is 1: w · m = 1."""

    @classmethod
    def of(cls, learned: Learned) -> AxisCommand:
        """Returns the command of a model's axis, which combines the outputs of all motors to one number.

        The motors are weighted by their relative effects on the axis. These are known from the mixer geometry or,
        without it, from the effectiveness that was learned.

        Args:
            learned: the linear model that was learned from a flight, with its training data.

        Returns:
            The command, with its weights and the motor outputs, in the direction of these effects, that make it 1.
        """
        labels = Labels.of(learned)
        directions = input_directions(learned)
        weights = command_weights(directions)
        return cls(
            name=f"{labels.output_names[0]} command",
            unit=labels.input_units[0],
            weights=weights,
            motors=directions / (weights @ directions),
        )

    def series(self, inputs: Array) -> Array:
        """Returns the command (T,) for inputs (T, r), minus its mean."""
        command = inputs @ self.weights
        return command - command.mean()
