"""Learned models as systems of python-control: the plant with its delay, and the model of DEM."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypedDict
from warnings import warn

import numpy as np

from mavdem.dem import Learned
from mavdem.errors import NotLearnable
from mavdem.export.tables import column_name
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPlant
from mavdem.loops.loop_construction import POSTERIOR_DRAWS
from mavdem.plant import Physical
from mavdem.report.labels import Labels, state_names, states_are_outputs

if TYPE_CHECKING:
    import control

PADE_ORDER = 2
"""Order of the Padé approximation of the delay. Its phase is exact to 1° up to 0.3/delay Hz."""

MAX_PLANT_OUTPUTS = 2
"""Outputs of a plant at most: the angle and the rate of its axis."""


class SignalNames(TypedDict):
    """The names of a system and of its signals, as keyword arguments of ``control.StateSpace``."""

    inputs: list[str]
    outputs: list[str]
    name: str


def to_control(learned: Learned, model: str = "physical") -> control.StateSpace:
    """Returns a model of one axis in continuous time, about its trim.

    The ``model`` "physical" is the plant: from the motors to angle and rate by their effect, motor time constant, delay
    and the rate damping. The delay is approximated by ``PADE_ORDER``. The system's ``delay`` is the delay in s, and its
    ``draws`` are plants from the posterior, for designs that must hold under its uncertainty. The plant contains no
    controller and has no closed-loop bias.

    The ``model`` "dem" is DEM's own ẋ = A x + B u, y = C x of the flight in closed loop, without noise and offset.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
        model: "physical" or "dem".

    Returns:
        A system in the units of the data, rad and s. Its ``name`` identifies the model; its signals are named as the
        columns of ``flight.csv``: "motor_1_us", "roll_rad".

    Raises:
        NotLearnable: the physical parameters are not identifiable. A ``UserWarning`` is issued where they are biased.
        ValueError: ``model`` is neither "physical" nor "dem".
    """
    import control

    if model not in ("physical", "dem"):
        raise ValueError(f"model must be 'physical' or 'dem', not {model!r}")
    labels = Labels.of(learned)
    names = SignalNames(
        inputs=list(map(column_name, labels.input_names, labels.input_units)),
        outputs=list(map(column_name, labels.output_names, labels.output_units)),
        name=f"mavdem {model} model",
    )
    if model == "physical":
        # The first draw is the estimate itself.
        draws = identified_parameters(learned).draws(POSTERIOR_DRAWS).tolist()
        plants = [plant_system(draw, names) for draw in draws]
        estimate = plants[0]
        estimate.delay = draws[0][-1]
        estimate.draws = plants[1:]
        return estimate
    states = [column_name(name, "") for name in state_names(labels.output_names, learned)]
    if states_are_outputs(learned):
        output_states = names["outputs"][: len(states)]
        states = output_states + states[len(output_states) :]
    A, B, C = learned.model.A, learned.model.B, learned.model.C
    D = np.zeros((len(C), len(names["inputs"])))
    return control.StateSpace(A, B, C, D, states=states, **names)


def identified_parameters(learned: Learned) -> Physical:
    """Returns the physical parameters of a model, and warns if some are biased or poorly known.

    Args:
        learned: the linear model that was learned from a flight, with its training data.

    Raises:
        NotLearnable: the parameters are not identifiable, or the model has other outputs than an angle and its rate.
    """
    physical = learned.physical
    if physical is None:
        raise NotLearnable(NoPlant.NO_PLANT, reason=learned.physical_reason)
    if physical.caution is not None:
        raise NotLearnable(NoPlant.NO_PLANT, reason=physical.caution)
    output_count = len(learned.record.output_names)
    if output_count > MAX_PLANT_OUTPUTS:
        raise NotLearnable(NoPlant.TOO_MANY_OUTPUTS, count=output_count)
    _warn_of_doubtful_parameters(physical)
    return physical


def _warn_of_doubtful_parameters(physical: Physical) -> None:
    """Warns of parameters that are biased or poorly known, and says why; does nothing if there are none.

    Args:
        physical: physical parameters of a plant, with the status of each and the reasons for it.
    """
    doubtful_parameters = []
    for name, status in physical.status.items():
        if status is not Status.REPORTED:
            doubtful_parameters.append(f"{name} {status}")
    if not doubtful_parameters:
        return
    # Several parameters may have the same reason, which is stated once.
    unique_reasons = dict.fromkeys(
        reason.sentence_and_remedy for reason in physical.reasons.values() if reason is not None
    )
    warn(
        f"Poorly known of this plant: {', '.join(doubtful_parameters)}. {' '.join(unique_reasons)}",
        # The warning names the line that calls ``Learned.to_control``, which is that many calls up.
        stacklevel=5,
    )


def plant_system(parameters: Sequence[float], names: SignalNames) -> control.StateSpace:
    """Returns the plant of one set of physical parameters in continuous time.

    With the motors' torque τ, rad/s², the rate ω and the angle φ: τ̇ = (u(t − delay) − τ)/lag, ω̇ = τ − damping ω,
    φ̇ = ω, where u is the sum of the inputs, each times its effect. A delay has no finite state-space model, so it is
    replaced by its Padé approximation, a rational all-pass filter of ``PADE_ORDER``.

    Args:
        parameters: effect of each input, rad/s² per unit, then the damping, 1/s, the motor time constant, s, and the
            delay, s.
        names: names of the system and its signals; with one output the plant ends at the rate.

    Returns:
        The state-space system, with states of the delay, angle, rate and torque.
    """
    import control

    *effects, damping, lag, delay = parameters
    outputs = names["outputs"]
    # The signal passes the effects, the delay and the motion, in this order: systems in series are multiplied from the
    # right to the left.
    pade_order = PADE_ORDER if delay else 0
    delay_system = control.tf2ss(*control.pade(delay, pade_order))
    motion = _motion_system(damping, lag, output_count=len(outputs))
    sum_of_inputs = np.array([effects])
    delay_states = [f"delay_{number}" for number in range(1, pade_order + 1)]
    states = [*delay_states, *outputs, "motors_torque"]
    return control.StateSpace(motion * delay_system * sum_of_inputs, states=states, **names)


def _motion_system(damping: float, lag: float, *, output_count: int) -> control.StateSpace:
    """Returns the motion of one axis by the commanded torque: τ̇ = (u − τ)/lag, ω̇ = τ − damping ω, φ̇ = ω.

    Args:
        damping: rate damping, 1/s.
        lag: motor time constant, s.
        output_count: 2 for the outputs angle and rate, 1 for the rate alone, which needs no state of the angle.
    """
    import control

    # States: angle, rate and torque. Without the output of the angle, its state is left out.
    angle_rate_torque = np.array([[0, 1, 0], [0, -damping, 1], [0, 0, -1 / lag]])
    first_state = MAX_PLANT_OUTPUTS - output_count
    A = angle_rate_torque[first_state:, first_state:]
    B = np.zeros((output_count + 1, 1))
    B[-1] = 1 / lag
    C = np.eye(output_count, output_count + 1)
    return control.StateSpace(A, B, C, np.zeros((output_count, 1)))
