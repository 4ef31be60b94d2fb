"""Closed-loop response as flown: the dominant poles of the vehicle with its autopilot holding the attitude.

Neither DEM's A nor the joint autoregressions have them: A is of the vehicle with motors as inputs, and the
autoregressions' poles contain the wind's colour. Here the plant of the physical parameters is closed by the feedback
law that the autopilot was seen to follow (:mod:`mavdem.dem.closed_loop.feedback`); the poles are the eigenvalues of
that loop. The attitude setpoint is an input of it, so what makes the setpoint (position hold, a pilot) is outside.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig
from scipy.stats import norm

from mavdem.dem.closed_loop.feedback import HIGH_PASS_HZ, FeedbackLaw, feedback_law, setpoint_column
from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.engine.model import discretize
from mavdem.dem.graybox.parameters import Physical
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record
from mavdem.dem.validation import LEVEL

Complex = NDArray[np.complex128]

DRAWS = 200  # of plant and feedback law, for the intervals
MAX_HZ, MAX_RATE_SHARE = 10.0, 0.2  # of frequencies that are reported: Hz, and in shares of the sampling rate
"""Slower ones than ``HIGH_PASS_HZ`` are not: they are of integrators and, in flight, of what makes the setpoint."""
LEAST_WEIGHT = 0.3  # of a pole that is reported, relative to the dominant one
FREQUENCY_ERROR, DAMPING_ERROR = 0.03, 0.03
"""Standard deviations of what sampling and nonlinear effects do: relative, of frequencies and time constants; and of
damping ratios."""
MAX_HALF = 0.5  # half width of a frequency, relative to it, beyond which a pole is not reported
NO_POLE = 1e-6  # magnitude of an eigenvalue, up to which it is of what is only held for some samples
SLOWEST = 1e-3  # 1/s: the response of an integrator has no finite energy
MAX_UNSTABLE = 0.05  # share of the drawn loops
MAX_WITHOUT_POLE = 0.05  # likewise, without a pole at the frequencies that are reported
MAX_UNEXPLAINED = 0.5  # of the command by the feedback law, in standard deviations


class LoopPole(NamedTuple):
    """A pole of the closed loop, or a pair of conjugate ones; half widths are of 90 % intervals.

    Attributes:
        frequency: natural frequency |s| / 2π, Hz.
        damping_ratio: −Re s / |s|: 1 for a real pole.
        time_constant: −1/s of a real pole, s; ``None`` for a pair.
        frequency_half: Hz.
        damping_ratio_half: of the damping ratio.
        time_constant_half: s; ``None`` for a pair.
        weight: root of the energy of its part in the angle's response to an impulse of torque, 1 for the dominant one.
    """

    frequency: float
    damping_ratio: float
    time_constant: float | None
    frequency_half: float
    damping_ratio_half: float
    time_constant_half: float | None
    weight: float


class ClosedLoopResponse(NamedTuple):
    """Dominant poles, the most dominant first; none where they are not identifiable, for the ``reason``."""

    poles: tuple[LoopPole, ...]
    reason: str


def attitude_loop(record: Record, physical: Physical | None) -> ClosedLoopResponse:
    """The dominant poles of the attitude loop in a ``record`` with the ``physical`` parameters of its vehicle.

    The attitude setpoint must be in the log, and the motors' effect identifiable; ``physical`` is ``None`` where no
    parameters can be fitted.
    """
    if physical is None:
        return ClosedLoopResponse((), "There are no physical parameters of this flight to close the loop with.")
    if physical.caution is not None:
        return ClosedLoopResponse((), physical.caution)
    pairs, setpoint = derivative_pairs(record), setpoint_column(record)
    if not pairs:
        return ClosedLoopResponse((), "It needs an angle and its rate: no output is the derivative of another.")
    if setpoint is None:
        return ClosedLoopResponse(
            (),
            "The log has no attitude setpoint, without which the autopilot's answer to the motion cannot be told from "
            "what it was asked for: record ATTITUDE_TARGET as fast as the attitude.",
        )
    assert record.setpoints is not None
    angle, rate, wanted = *record.outputs[:, pairs[0]].T, record.setpoints[:, setpoint]
    command = (record.inputs - record.inputs.mean(axis=0)) @ physical.effect
    with one_thread():
        try:
            law = feedback_law(command, angle, rate, wanted, record)
        except (ValueError, np.linalg.LinAlgError) as error:
            return ClosedLoopResponse((), f"The autopilot's feedback law cannot be estimated: {error}.")
        if law.unexplained > MAX_UNEXPLAINED:
            return ClosedLoopResponse(
                (),
                f"Attitude, rate and setpoint leave {law.unexplained:.0%} of the commands' standard deviation "
                "unexplained, so the autopilot's feedback law is not known.",
            )
        return _response(physical, law, record.dt)


class _DrawnPlant(NamedTuple):
    """Damping 1/s, lag s and delay s; and the motors' effect, relative to the estimate."""

    effect: float
    damping: float
    lag: float
    delay: float


def _response(physical: Physical, law: FeedbackLaw, dt: float) -> ClosedLoopResponse:
    estimate = _DrawnPlant(1.0, physical.damping, physical.lag, physical.delay)
    draws = list(_draws(physical, law))
    held = int(np.ceil(max(plant.delay for plant, _ in [(estimate, None), *draws]) / dt)) + 1
    fastest = min(MAX_HZ, MAX_RATE_SHARE / dt)
    poles, weights = _modes(_loop(estimate, law.gains, dt, held), dt, fastest)
    if not len(poles):
        return ClosedLoopResponse((), f"No pole is between {HIGH_PASS_HZ:g} and {fastest:g} Hz.")
    drawn = [_modes(_loop(plant, gains, dt, held), dt, fastest) for plant, gains in draws]
    if poles.real.max() > 0 or np.mean([np.any(others.real > 0) for others, _ in drawn]) > MAX_UNSTABLE:
        return ClosedLoopResponse(
            (),
            "The feedback law found would make the vehicle unstable, which it was not: the log is too slow, or the "
            "stamps of attitude and motor outputs do not fit together. Record faster, on board.",
        )
    if np.mean([not len(others) for others, _ in drawn]) > MAX_WITHOUT_POLE:
        return ClosedLoopResponse(
            (), f"It is uncertain whether any pole is between {HIGH_PASS_HZ:g} and {fastest:g} Hz: fly longer."
        )
    # Light poles come and go with the draw: the one that is followed must be dominant there as well.
    heavy = [others[shares >= LEAST_WEIGHT] for others, shares in drawn if len(others)]
    found = []
    for pole, weight in zip(poles, weights, strict=True):
        if weight >= LEAST_WEIGHT:
            near = np.array([others[np.argmin(np.abs(others - pole))] for others in heavy])
            found.append(_interval(pole, float(weight), near))
    first = found[0]
    if first.frequency_half > MAX_HALF * first.frequency:
        return ClosedLoopResponse(
            (),
            f"The dominant pole is at {first.frequency:.2g} ± {first.frequency_half:.2g} Hz, which is too uncertain: "
            "fly longer, or steer more.",
        )
    # Poles near each other make up for each other's errors, in damping above all.
    for other in found[1:]:
        reach = first.frequency_half + min(other.frequency_half, MAX_HALF * other.frequency)
        if abs(other.frequency - first.frequency) < reach:
            return ClosedLoopResponse(
                (),
                f"Poles at {first.frequency:.2g} ± {first.frequency_half:.2g} Hz and {other.frequency:.2g} ± "
                f"{other.frequency_half:.2g} Hz cannot be told apart: fly longer, or steer quicker inputs.",
            )
    return ClosedLoopResponse(tuple(pole for pole in found if pole.frequency_half <= MAX_HALF * pole.frequency), "")


def _draws(physical: Physical, law: FeedbackLaw) -> Iterator[tuple[_DrawnPlant, Array]]:
    """Plants and gains as likely as the estimate: normal, with the covariance of each."""
    r, rng = len(physical.effect), np.random.default_rng(0)
    mean = float(np.abs(physical.effect).mean())
    into = np.zeros((4, r + 3))
    into[0, :r] = np.sign(physical.effect) / (r * mean)
    into[1:, r:] = np.eye(3)
    covariance = into @ physical.covariance @ into.T
    covariance[0, 0] += physical.bias**2
    values = [1.0, physical.damping, physical.lag, physical.delay]
    least = [0.2, 0.0, 0.2 * physical.lag, 0.0]
    for plant in np.maximum(rng.multivariate_normal(values, covariance, DRAWS), least).tolist():
        yield _DrawnPlant(*plant), law.gains + rng.standard_normal(len(law.deviations)) @ law.deviations


def _loop(plant: _DrawnPlant, gains: Array, dt: float, held: int) -> Array:
    """(n, n) transition of the closed loop; the states are [angle, rate, torque, past rates, integral, past commands].

    ``held`` commands are kept, as many as the delay needs.
    """
    lags = len(gains) - 3
    of_integral, n = 3 + lags, 4 + lags + held
    A = np.array([[0.0, 1.0, 0.0], [0.0, -plant.damping, 1.0], [0.0, 0.0, -1 / plant.lag]])
    step = discretize(A, np.array([[0.0], [0.0], [1 / plant.lag]]), dt)
    states = np.eye(n)
    integral = states[of_integral] + dt * states[0]
    # The gains are of the commanded torque by the estimated effect.
    command = gains[0] * states[0] + gains[1] * states[1] + gains[2:-1] @ states[3:of_integral] + gains[-1] * integral
    commands = np.vstack([plant.effect * command, plant.effect * states[of_integral + 1 :]])
    loop = np.zeros((n, n))
    loop[:3, :3] = step.state
    # As the plant's fit has it: within a step the last command holds, none acts before it is given.
    for push, late in ((step.input_now, plant.delay / dt), (step.input_next, max(plant.delay / dt - 1, 0.0))):
        whole = int(late)
        acting = (1 - late + whole) * commands[whole] + (late - whole) * commands[min(whole + 1, held)]
        loop[:3] += push * acting
    loop[3] = states[1]
    loop[4:of_integral] = states[3 : of_integral - 1]
    loop[of_integral] = integral
    loop[of_integral + 1] = command
    loop[of_integral + 2 :] = states[of_integral + 1 : -1]
    return loop


def _modes(loop: Array, dt: float, fastest: float) -> tuple[Complex, Array]:
    """Poles (k,), 1/s, one of each pair, from ``HIGH_PASS_HZ`` to ``fastest`` Hz; and their weights, largest first.

    Weights are of the angle's response to an impulse of torque, and relative to the largest.
    """
    # By left eigenvectors: commands that are only held leave several eigenvalues of 0, which have no inverse.
    steps, left, right = cast(tuple[Complex, Complex, Complex], eig(loop, left=True))
    kept = (np.abs(steps) > NO_POLE) & (steps.imag >= 0)
    steps, left, right = steps[kept], left[:, kept].conj(), right[:, kept]
    poles = np.log(steps.astype(complex)) / dt
    size = np.abs(poles) / (2 * np.pi)
    residues = np.abs(left[1] * right[0] / np.sum(left * right, axis=0))
    twice = np.where(steps.imag > 0, 2.0, 1.0)
    weights = residues * np.sqrt(twice / np.maximum(np.abs(2 * poles.real), SLOWEST))
    inside = np.flatnonzero((size > HIGH_PASS_HZ) & (size < fastest))
    order = inside[np.argsort(-weights[inside])]
    return poles[order], weights[order] / weights[order].max(initial=0.0)


def _interval(pole: complex, weight: float, others: Complex) -> LoopPole:
    """A pole with the half widths that hold as many of ``others``, the same pole of drawn loops, as the level says."""
    z = float(norm.ppf(0.5 + LEVEL / 2))
    size = abs(pole)
    frequency, ratio = size / (2 * np.pi), -pole.real / size
    of_frequency = float(np.quantile(np.abs(np.abs(others) - size), LEVEL)) / size
    of_ratio = float(np.quantile(np.abs(-others.real / np.abs(others) - ratio), LEVEL))
    relative = float(np.hypot(of_frequency, z * FREQUENCY_ERROR))
    real = pole.imag == 0
    time = -1 / pole.real
    return LoopPole(
        float(frequency),
        float(ratio),
        float(time) if real else None,
        float(relative * frequency),
        float(np.hypot(of_ratio, z * DAMPING_ERROR)),
        float(relative * abs(time)) if real else None,
        float(weight),
    )
