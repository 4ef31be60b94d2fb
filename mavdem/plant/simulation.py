"""Simulation of one axis by its physical parameters under commanded motors, with no autopilot in the loop."""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.engine.model import linear_recursion
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record
from mavdem.dem.validation import require_finite_and_bounded
from mavdem.plant.parameters import Physical, parameter_gradient, parameter_vector
from mavdem.plant.sampled_plant import SampledPlant, sampled_plant
from mavdem.plant.wind_torque import mean_external_torque

WIND_STATES = 3
"""Index of the wind torque's first state, after the angle, the rate and the motors' torque."""


def simulate_response(physical: Physical, record: Record, inputs: ArrayLike) -> Forecast:
    """Simulates an angle and its rate under commanded inputs, from the end of the training data on.

    The simulation begins with the last measured sample, and with the torque of the motors by the last commands. The
    mean disturbance of the training data is assumed to persist, because it balances the mean inputs.

    Args:
        physical: control effectiveness, damping, motor time constant and delay of the axis.
        record: the training data, with two outputs: an angle and its rate.
        inputs: commanded inputs (H, r) after it.

    Returns:
        Mean and variance (H, 2) in the order of the record's outputs. The variance is caused by the future wind torque,
        and by the errors of effect, damping and lag, to first order.

    Raises:
        ValueError: the outputs are not an angle and its rate, or the inputs are larger than may be learned from.
    """
    commanded_inputs = record.validated_inputs(inputs)
    require_finite_and_bounded(commanded_inputs, "inputs")
    pairs = derivative_pairs(record)
    if record.outputs.shape[1] != 2 or not pairs:
        raise ValueError(
            "a simulation needs two outputs, an angle and its rate: the plant has no others"
        )
    angle_and_rate = list(pairs[0])
    # The delay, the last parameter, is fixed at its estimate: its uncertainty is not in the variance.
    theta = parameter_vector(physical)[:-1]
    mean_at = partial(
        _simulated_mean,
        delay=physical.delay,
        record=record,
        angle_and_rate=angle_and_rate,
        inputs=commanded_inputs,
    )
    mean = mean_at(theta)
    # To first order, parameters with covariance P cause the variance g P gᵀ, with the gradient g of each sample.
    # Letters of einsum: parameters i and j, sample h, output t.
    gradient = parameter_gradient(mean_at, theta, mean)
    variance = np.einsum("iht,ij,jht->ht", gradient, physical.covariance[:-1, :-1], gradient)
    variance += _wind_variance(physical, record.dt, len(commanded_inputs))
    # The simulation has the angle first; the record may have the rate first.
    output_order = np.argsort(angle_and_rate)
    return Forecast(mean[:, output_order], variance[:, output_order])


def _simulated_mean(
    theta: Array,
    delay: float,
    record: Record,
    angle_and_rate: list[int],
    inputs: Array,
) -> Array:
    """Simulates the axis under commanded inputs, with the steady wind torque only.

    First the motors' torque over the training data is computed. From it follow the steady external torque, and the
    motors' torque at the end of the data. From that state on, the axis is simulated.

    Args:
        theta: effect of each input, damping and lag (r + 2,).
        delay: delay of the commands, s.
        record: the training data: T samples of r inputs and m outputs, in one or several segments.
        angle_and_rate: columns of the angle and of its rate in the record's outputs.
        inputs: commanded inputs (H, r).

    Returns:
        Angle and rate (H, 2), rad and rad/s.
    """
    dt = record.dt
    effect = theta[:-2]
    damping, lag = theta[-2:]
    plant = sampled_plant(damping, lag, (), dt)
    trim = record.inputs.mean(axis=0)

    # The steady external torque of each segment follows from the motors' torque. After the loop, the variables are
    # those of the last segment.
    constants = []
    for segment_inputs, outputs in record.segments:
        commanded_torque = (segment_inputs - trim) @ effect
        contributions = plant.input_contributions(commanded_torque, delay / dt)
        motor_transition = plant.transition.Phi[1:, 1:]
        later_torque = linear_recursion(
            motor_transition, contributions[:, 1:], commanded_torque[:1]
        )
        torque = np.append(commanded_torque[0], later_torque)
        rate = outputs[:, angle_and_rate[1]]
        constants.append(mean_external_torque(rate, torque, damping, dt))
    constant = np.average(constants, weights=record.lengths)

    # A steady disturbance acts like a steady command. Because of the delay, the last commands of the training data act
    # on the first simulated samples.
    all_commands = np.append(commanded_torque, (inputs - trim) @ effect) + constant
    contributions = plant.input_contributions(all_commands, delay / dt)[len(commanded_torque) - 1 :]
    initial_state = np.append(outputs[-1, angle_and_rate], torque[-1] + constant)
    plant_with_angle = _with_angle(plant, dt)
    states = linear_recursion(
        plant_with_angle.transition, contributions @ plant_with_angle.input_map.T, initial_state
    )
    return states[:, :2]


def _wind_variance(physical: Physical, dt: float, steps: int) -> Array:
    """Returns the variance that the wind torque causes in angle and rate, both known at the beginning.

    The covariance P of the states follows P⁺ = A P Aᵀ + Q, step by step.

    Args:
        physical: physical parameters of the axis, with the components of the wind torque.
        dt: time step, s.
        steps: number H of steps.

    Returns:
        Variances of angle, rad², and rate, (rad/s)² (H, 2).
    """
    plant = sampled_plant(physical.damping, physical.lag, physical.components, dt)
    plant_with_angle = _with_angle(plant, dt)
    transition = plant_with_angle.transition
    Q = plant_with_angle.input_map @ plant.Q @ plant_with_angle.input_map.T
    # The states of the wind torque begin with their stationary covariance, since they are not known. Angle, rate and
    # motors' torque are known at the beginning, with variance 0.
    P = np.zeros_like(Q)
    wind = slice(WIND_STATES, None)
    P[wind, wind] = scipy.linalg.solve_discrete_lyapunov(transition[wind, wind], Q[wind, wind])
    variance = np.empty((steps, 2))
    for step in range(steps):
        P = transition @ P @ transition.T + Q
        variance[step] = P.diagonal()[:2]
    return variance


class _AngleAugmented(NamedTuple):
    """A sampled plant whose state begins with the angle."""

    transition: Array
    """Transition matrix (n + 1, n + 1)."""

    input_map: Array
    """Map (n + 1, n) from what is added to the plant's states to what is added to all states."""


def _with_angle(plant: SampledPlant, dt: float) -> _AngleAugmented:
    """Adds the angle as the first state of a sampled plant, by integrating the rate with the trapezoidal rule.

    In one step the angle grows by (dt/2) (p + p⁺), with the rate p at the sample and p⁺ at the next. So whatever inputs
    or noise add to the states of the plant at the next sample, dt/2 times what they add to p⁺ is added to the angle.
    The input map does that: it maps such additions to the states with the angle.

    Args:
        plant: the sampled axis with n states, of which the rate (rad/s) is the first.
        dt: time step, s.

    Returns:
        Transition (n + 1, n + 1), and input map (n + 1, n).
    """
    n = len(plant.wind_output)
    # Row that gives dt/2 times the rate, the first of the plant's states.
    half_step_of_rate = np.eye(1, n) * dt / 2
    input_map = np.vstack([half_step_of_rate, np.eye(n)])
    transition = np.eye(n + 1)
    transition[:, 1:] = input_map @ plant.transition.Phi
    transition[:1, 1:] += half_step_of_rate
    return _AngleAugmented(transition, input_map)
