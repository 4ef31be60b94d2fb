"""Simulation: what commanded motors would do, by the physical parameters: the plant alone, no autopilot answers."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import discretize, recursion
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.graybox.likelihood import delayed, step_covariance, with_wind
from mavdem.dem.graybox.parameters import Physical, slopes_of
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record


def simulated(physical: Physical, record: Record, inputs: Array) -> Forecast:
    """Mean and variance (H, m) of an angle and its rate under commanded ``inputs`` (H, r), after the training data.

    It begins with the last measured sample, and with the torque that the last commands left in the motors. The steady
    disturbance of the training data stays: it balances the mean inputs. The variance is that of the wind, of which
    nothing else is known, and of motors' effect, damping and lag, to first order.

    ``ValueError`` for outputs that are not an angle and its rate.
    """
    pairs = derivative_pairs(record)
    if record.outputs.shape[1] != 2 or not pairs:
        raise ValueError(
            "a simulation needs two outputs, an angle and its rate: the plant has no others"
        )
    order = list(pairs[0])
    theta = np.array([*physical.effect, physical.damping, physical.lag])
    mean = _mean(theta, physical.delay, record, order, inputs)
    slopes = slopes_of(
        lambda theta: _mean(theta, physical.delay, record, order, inputs), theta, mean
    )
    variance = np.einsum("iht,ij,jht->ht", slopes, physical.covariance[:-1, :-1], slopes)
    variance += _of_wind(physical, record.dt, len(inputs))
    back = np.argsort(order)
    return Forecast(mean[:, back], variance[:, back])


def _mean(
    theta: Array,
    delay: float,
    record: Record,
    order: list[int],
    inputs: Array,
) -> Array:
    """(H, 2) angle and rate of the plant with motors, damping and lag ``theta`` (r + 2,), without wind."""
    motors = theta[:-2]
    damping = theta[-2]
    lag = theta[-1]
    trim = record.inputs.mean(axis=0)
    steps = delay / record.dt
    A = np.array([[0.0, 1.0, 0.0], [0.0, -damping, 1.0], [0.0, 0.0, -1 / lag]])
    state, now, later = discretize(A, np.array([[0.0], [0.0], [1 / lag]]), record.dt)

    def pushes(commands: Array) -> Array:
        """(T − 1, 3) what commands (T, r) add to angle, rate and torque in each step."""
        early, late = delayed(commands - trim, steps)
        return np.asarray(
            np.outer(early @ motors, now[:, 0]) + np.outer(late @ motors, later[:, 0])
        )

    # The disturbance is what the mean of rate' = torque − damping · rate + disturbance leaves.
    turned = 0.0
    torques = []
    for before, outputs in record.segments:
        start = (before[0] - trim) @ motors
        driven = recursion(state[2:, 2:], pushes(before)[:, 2:], np.array([start]))
        torques.append(np.append(start, driven))
        turned += outputs[-1, order[1]] - outputs[0, order[1]]
    rate = record.outputs[:, order[1]].mean()
    torque = np.concatenate(torques)
    steady = turned / (len(record) * record.dt) + damping * rate - torque.mean()
    before, outputs = record.segments[-1]
    ahead = pushes(np.vstack([before, inputs]))[len(before) - 1 :]
    # A steady disturbance acts like a steady command.
    ahead += steady * (now + later)[:, 0]
    first = np.array([*outputs[-1, order], torques[-1][-1] + steady])
    return recursion(state, ahead, first)[:, :2]


def _of_wind(physical: Physical, dt: float, steps: int) -> Array:
    """(H, 2) variance that the wind gives angle and rate from a known beginning."""
    A, drive, wind = with_wind(
        np.array([[0.0, 1.0], [0.0, -physical.damping]]), physical.components
    )
    A[1] += wind
    P = np.zeros_like(A)
    P[2:, 2:] = solve_continuous_lyapunov(A[2:, 2:], -drive[2:, 2:])
    variance = np.empty((steps, 2))
    state = expm(A * dt)
    process = step_covariance(A, drive, dt)
    for step in range(steps):
        P = state @ P @ state.T + process
        variance[step] = P.diagonal()[:2]
    return variance
