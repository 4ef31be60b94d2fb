"""Simulation: what commanded motors would do, by the physical parameters: the plant alone, no autopilot answers."""

from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_discrete_lyapunov

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.model import linear_recursion
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record
from mavdem.dem.validation import require_finite_and_bounded
from mavdem.plant.parameters import Physical, parameter_vector, slopes_of
from mavdem.plant.sampled_plant import Plant, plant
from mavdem.plant.wind_torque import steady


def simulated(physical: Physical, record: Record, inputs: ArrayLike) -> Forecast:
    """Returns the forecast of an angle and its rate under commanded ``inputs`` (H, r), after the training data.

    Its mean and variance are (H, m). It begins with the last measured sample, and with the torque that the last
    commands left in the motors. The steady disturbance of the training data stays: it balances the mean inputs. The
    variance is that of the wind, of which nothing else is known, and of motors' effect, damping and lag, to first
    order.

    ``ValueError`` for outputs that are not an angle and its rate, and for inputs larger than may be learned from.
    """
    commanded = record.validated_inputs(inputs)
    require_finite_and_bounded(commanded, "inputs")
    pairs = derivative_pairs(record)
    if record.outputs.shape[1] != 2 or not pairs:
        raise ValueError(
            "a simulation needs two outputs, an angle and its rate: the plant has no others"
        )
    columns = list(pairs[0])
    theta = parameter_vector(physical)[:-1]
    mean_of = partial(_mean, delay=physical.delay, record=record, columns=columns, inputs=commanded)
    mean = mean_of(theta)
    slopes = slopes_of(mean_of, theta, mean)
    variance = np.einsum("iht,ij,jht->ht", slopes, physical.covariance[:-1, :-1], slopes)
    variance += _of_wind(physical, record.dt, len(commanded))
    back = np.argsort(columns)
    return Forecast(mean[:, back], variance[:, back])


def _mean(
    theta: Array,
    delay: float,
    record: Record,
    columns: list[int],
    inputs: Array,
) -> Array:
    """(H, 2) angle and rate of the plant with motors, damping and lag ``theta`` (r + 2,), without wind."""
    dt = record.dt
    damping, lag = theta[-2:]
    axis = plant(damping, lag, (), dt)
    trim = record.inputs.mean(axis=0)
    constants = []
    for before, outputs in record.segments:
        commanded = (before - trim) @ theta[:-2]
        pushes = axis.pushes(commanded, delay / dt)
        driven = linear_recursion(axis.step.Phi[1:, 1:], pushes[:, 1:], commanded[:1])
        torque = np.append(commanded[0], driven)
        constants.append(steady(outputs[:, columns[1]], torque, damping, dt))
    # A steady disturbance acts like a steady command.
    constant = np.average(constants, weights=record.lengths)
    whole = np.append(commanded, (inputs - trim) @ theta[:-2]) + constant
    ahead = axis.pushes(whole, delay / dt)[len(commanded) - 1 :]
    first = np.append(outputs[-1, columns], torque[-1] + constant)
    step, turned = _with_angle(axis, dt)
    return linear_recursion(step, ahead @ turned.T, first)[:, :2]


def _of_wind(physical: Physical, dt: float, steps: int) -> Array:
    """(H, 2) variance that the wind gives angle and rate from a known beginning."""
    axis = plant(physical.damping, physical.lag, physical.components, dt)
    step, turned = _with_angle(axis, dt)
    process = turned @ axis.process @ turned.T
    P = np.zeros_like(process)
    P[3:, 3:] = solve_discrete_lyapunov(step[3:, 3:], process[3:, 3:])
    variance = np.empty((steps, 2))
    for row in variance:
        P = step @ P @ step.T + process
        row[:] = P.diagonal()[:2]
    return variance


def _with_angle(axis: Plant, dt: float) -> ArrayPair:
    """The plant's step with the angle before its states, and what a push on these, (n,), does to all of them."""
    n = len(axis.wind)
    half = np.eye(1, n) * dt / 2  # of the rate before and after each step
    turned = np.vstack([half, np.eye(n)])
    step = np.eye(n + 1)
    step[:, 1:] = turned @ axis.step.Phi
    step[:1, 1:] += half
    return step, turned
