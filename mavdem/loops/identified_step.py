"""Step response of the identified rate loop, for loops that are too fast for deconvolution of their messages.

Deconvolution uses setpoint and rate only at the stamps of their messages, so it blurs a loop that rises within a few
of them. Identification models the sampling and the controller's cycle, and shows such a loop better.
"""

from functools import lru_cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array
from mavdem.confidence import IntervalEstimate
from mavdem.loops.axis_loops import Loop
from mavdem.loops.margins import Complex, OpenLoop
from mavdem.loops.step_characteristics import response_times, rise_times, with_interval

FREQUENCY_STEP = 0.05
"""Step of the integral over a predicted frequency response, Hz."""
MAX_UNEXPLAINED_OUTPUT = 0.05
"""Largest share of the output that the controller does not explain, with which its response to setpoints is used.

A wrong controller shows there. Of the flights 0 to 15 of ``tools/validation/step_response.py`` at 100 Hz, seven fly the
controller of their parameters and have 0.010 to 0.034. Nine fly another, of which eight have 0.097 to 0.22.
"""
GAIN_DEVIATION = 0.02
"""Standard deviation of the error of the identified loop's gain that its posterior lacks, relative to the gain.

Below 1 Hz drag and position control act too, which identification leaves out.
"""
STEP_SECONDS = {"rate": 0.5, "attitude": 2.0}
"""Duration of step responses, measured and predicted, s, by loop: a choice, in which usual loops settle."""
PREDICTED_POINTS = 250
"""Points of a predicted step from which overshoot and rise time are computed: every 2 ms of 0.5 s."""
GAIN_SEED = 37
"""Seed of the draws of that error, so that the same flight has the same step response."""


def identified_steps(loop: Loop, time: Array, count: int) -> Array | None:
    """Returns step responses of an identified rate loop: of the estimate, then of draws from its posterior.

    The controller's response to the setpoint does not affect the open loop that was identified, and is only known from
    its parameters. So the controller must explain the logged output, and the closed loop must not contradict the
    measured rate. The draws also get a random gain, since the posterior lacks one error: identification leaves out drag
    and position control, which change the gain at low frequencies (``GAIN_DEVIATION``).

    Args:
        loop: rate and attitude loop of the axis, with the plant that was identified in flight.
        time: times after the step (K,), s.
        count: number n of draws from the posterior of the plant.

    Returns:
        Step responses (n + 1, K). None if the controller does not explain the output, or the loop is unstable.
    """
    # The share is NaN for a plant that was identified without its controller, and this comparison then false.
    is_output_explained = loop.plant.unexplained_output <= MAX_UNEXPLAINED_OUTPUT
    if not is_output_explained:
        return None
    rate_loop = loop.rate
    # ``agrees`` is None where the loop could not be compared with the measured response of the rate.
    contradicts_measurement = loop.agrees is False
    if contradicts_measurement or not rate_loop.is_stable:
        return None
    # The first response is that of the estimate, the others are those of draws.
    stable_responses = rate_loop.closed_loop_response[rate_loop.stable][: count + 1]
    stable_steps = steps_from_frequency_responses(rate_loop.frequency, stable_responses, time)
    # If fewer than n draws are stable, ``resize`` repeats the steps to the requested number.
    steps = np.resize(stable_steps, (count + 1, len(time)))
    gain_factors = 1 + GAIN_DEVIATION * default_rng(GAIN_SEED).standard_normal(count)
    # The estimate keeps its gain; the step of each draw is multiplied by a random one.
    steps[1:] *= gain_factors[:, None]
    return steps


def step_from_frequency_response(
    frequency: Array, closed_loop_response: Complex, time: Array
) -> Array:
    """Returns the response of one closed loop to a step of 1 of its setpoint.

    Args:
        frequency: frequencies (F,), Hz, ascending.
        closed_loop_response: frequency response T from the setpoint to the rate or angle (F,).
        time: times after the step (K,), s.

    Returns:
        Step response (K,).
    """
    steps = steps_from_frequency_responses(frequency, closed_loop_response[None], time)
    return np.asarray(steps[0])


class PredictedStep(NamedTuple):
    """Characteristics of the step response that an identified loop predicts, with their 90 % intervals."""

    overshoot: IntervalEstimate
    """Largest value of the step less 1; 0 or more."""
    rise_time: IntervalEstimate
    """Time from 10 to 90 % of the step, s."""
    response_time: IntervalEstimate
    """Time to 63 % of the step, delay included, s."""


_predicted_steps: WeakKeyDictionary[OpenLoop, dict[float, PredictedStep | None]] = (
    WeakKeyDictionary()
)
"""Results of :func:`predicted_step` by loop and duration, s, as long as the loop exists."""


def predicted_step(loop: OpenLoop, duration: float) -> PredictedStep | None:
    """Returns overshoot and times of the step response that an identified loop predicts, with 90 % intervals.

    They are computed with the estimated plant and with each draw from its posterior. The intervals follow from the
    draws; those with an unstable loop, whose step response grows without limit, are left out. Each result is kept, as
    tables and sentences of a report need it several times.

    Args:
        loop: the rate or attitude loop, with the estimated plant first, then with draws.
        duration: duration of the step response, s.

    Returns:
        Overshoot, rise time (10 to 90 %) and response time (to 63 %); None if the loop with the estimated plant is
        unstable.
    """
    steps_by_duration = _predicted_steps.setdefault(loop, {})
    if duration not in steps_by_duration:
        steps_by_duration[duration] = _computed_step(loop, duration)
    return steps_by_duration[duration]


def _computed_step(loop: OpenLoop, duration: float) -> PredictedStep | None:
    """Computes overshoot and times of the predicted step, which :func:`predicted_step` keeps for the next call.

    Args:
        loop: the rate or attitude loop, with the estimated plant first, then with draws.
        duration: duration of the step response, s.

    Returns:
        Each with its 90 % interval; None if the loop with the estimated plant is unstable.
    """
    if not loop.is_stable:
        return None
    time = np.linspace(0.0, duration, PREDICTED_POINTS)
    stable_responses = loop.closed_loop_response[loop.stable]
    # Step responses (N, K) of the N stable loops: the first one is still that with the estimated plant.
    steps = steps_from_frequency_responses(loop.frequency, stable_responses, time)
    overshoots = np.maximum(steps.max(axis=1) - 1, 0.0)
    return PredictedStep(
        overshoot=with_interval(overshoots),
        rise_time=with_interval(rise_times(time, steps)),
        response_time=with_interval(response_times(time, steps)),
    )


def steps_from_frequency_responses(
    frequency: Array, closed_loop_responses: Complex, time: Array
) -> Array:
    """Returns the responses of N closed loops to a step of 1 of their setpoint: 2/π ∫ Re(T) sin(ωt) / ω dω.

    The inverse Fourier transform of a causal, stable response needs only its real part. The integral is approximated by
    the midpoint rule with steps of ``FREQUENCY_STEP``, up to the highest frequency.

    Args:
        frequency: frequencies (F,), Hz, ascending.
        closed_loop_responses: frequency responses T from the setpoint to the rate or angle (N, F).
        time: times after the step (K,), s.

    Returns:
        Step responses (N, K).
    """
    midpoints = _midpoints(frequency[-1])
    # (N, M) real parts of the responses at the M midpoints.
    real_parts = np.array(
        [np.interp(midpoints, frequency, response.real) for response in closed_loop_responses]
    )
    kernel = _sine_kernel(frequency[-1], tuple(time.tolist()))
    return np.asarray(real_parts @ kernel * FREQUENCY_STEP * 2 / np.pi)


def _midpoints(highest: float) -> Array:
    """Returns the midpoints (M,) of even steps of ``FREQUENCY_STEP`` up to the highest frequency, Hz."""
    return np.arange(FREQUENCY_STEP / 2, highest, FREQUENCY_STEP)


@lru_cache(maxsize=8)
def _sine_kernel(highest: float, time: tuple[float, ...]) -> Array:
    """Computes the kernel sin(2πft) / f of the integral that gives a step response from a frequency response.

    The step response at time t is 2/π ∫ Re T(f) sin(2πft) / f df with the closed loop's frequency response T. The
    integral is a sum over frequencies f in the middle of equal steps. The kernel is cached: the loops of a flight have
    the same frequencies and times, and computing the sines takes most of the time of a response.

    Args:
        highest: highest frequency, Hz.
        time: times after the step (K,), s.

    Returns:
        (M, K) kernel at M frequencies and K times, s.
    """
    midpoints = _midpoints(highest)
    phases = 2 * np.pi * np.outer(midpoints, time)
    return np.asarray(np.sin(phases) / midpoints[:, None])
