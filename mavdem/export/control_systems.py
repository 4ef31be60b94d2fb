"""Learnt models as systems of python-control."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavdem.dem import Learned
from mavdem.export.tables import column_name
from mavdem.report.names import Labels, state_names, states_are_outputs

if TYPE_CHECKING:
    import control


def to_control(learned: Learned) -> control.StateSpace:
    """The learnt ẋ = A x + B u, y = C x, in continuous time and in the units of the data: radians and s.

    Inputs and outputs are deviations from the trim: from ``learned.model.input_trim`` and ``output_trim``. Signals are
    named as columns of ``flight.csv`` are: "motor_1_us", "roll_rad". The process and measurement noise and the offset
    are not in it.
    """
    import control

    labels, model = Labels.of(learned), learned.model
    inputs, outputs = (
        [column_name(*pair) for pair in zip(names, units, strict=True)]
        for names, units in (
            (labels.input_names, labels.input_units),
            (labels.output_names, labels.output_units),
        )
    )
    states = [column_name(name, "") for name in state_names(labels, learned)]
    if states_are_outputs(learned):
        states = [*outputs, *states[len(outputs) :]][: len(states)]
    feedthrough = np.zeros((len(outputs), len(inputs)))
    return control.StateSpace(
        model.A, model.B, model.C, feedthrough, inputs=inputs, outputs=outputs, states=states, name="mavdem"
    )
