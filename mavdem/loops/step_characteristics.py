"""Characteristics of a step response and its frequency response, such as overshoot and rise time, with intervals."""

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import INTERVAL_QUANTILES, IntervalEstimate
from mavdem.facts.loops import SETTLING_BAND
from mavdem.plant.parameters import DRAWS, ESTIMATE

RESPONSE_LEVEL = 1 - np.exp(-1)
"""Level of a step whose time is the response time: 63 %, which a first-order lag reaches after its time constant."""


def step_characteristics(
    time: Array, steps: Array, frequency: Array, gains: Array
) -> dict[str, IntervalEstimate]:
    """Computes the characteristics of a step response, such as the rise time, each with its 90 % interval.

    Each is computed for the estimate and for each draw, and its interval follows from the draws. All of them are
    attributes of :class:`mavdem.loops.step_response.StepResponse`.

    Args:
        time: times after the step (K,), s.
        steps: responses to a step of 1 (N, K), of the estimate in the first row, then of draws.
        frequency: frequencies (F,), Hz, at which the response is known.
        gains: gains |T| (N, F), with rows in the same order.

    Returns:
        Characteristics by name; times in s, frequencies in Hz.
    """
    half_times = _first_times(time, steps, 0.5)
    # A step settles at the last time at which it is outside the band around 1.
    is_unsettled = abs(steps - 1) > SETTLING_BAND
    settling_time = np.where(is_unsettled, time, 0.0).max(axis=1, initial=time[0])
    values = {
        "overshoot": _unbiased_overshoots(steps),
        "rise_time": rise_times(time, steps),
        "settling": settling_time,
        "delay": half_times,
        "peak": gains.max(axis=1),
        "peak_frequency": frequency[gains.argmax(axis=1)],
    }
    return {name: with_interval(estimate_and_draws) for name, estimate_and_draws in values.items()}


def rise_times(time: Array, steps: Array) -> Array:
    """Returns the times in which responses to a step rise from 10 to 90 % of it.

    Args:
        time: times after the step (K,), s.
        steps: responses to a step of 1 (N, K), which are 0 at time 0.

    Returns:
        The times (N,), s; the whole duration for a response that never reaches 90 %.
    """
    tenth_times = _first_times(time, steps, 0.1)
    nine_tenth_times = _first_times(time, steps, 0.9)
    has_risen = nine_tenth_times < time[-1]
    return np.where(has_risen, nine_tenth_times - tenth_times, nine_tenth_times)


def response_times(time: Array, steps: Array) -> Array:
    """Returns the times from a step until the responses to it reach ``RESPONSE_LEVEL`` (63 %) of it.

    Unlike the rise time to 90 %, such a time does not jump if the integral term takes long for the last tenth.

    Args:
        time: times after the step (K,), s.
        steps: responses to a step of 1 (N, K), which are 0 at time 0.

    Returns:
        The times (N,), s; the whole duration for a response that never reaches that level.
    """
    return _first_times(time, steps, RESPONSE_LEVEL)


def _unbiased_overshoots(steps: Array) -> Array:
    """Returns the overshoots of the estimate and of draws, corrected for the bias of a maximum by noise.

    Noise increases the maximum of a step. The estimate contains noise once, and a draw, which is made around the
    estimate, twice. So the mean excess of the draws over the estimate is the bias of the estimate, as in a bootstrap.
    The excess of each draw is reflected about the uncorrected estimate, which gives the interval of the basic bootstrap
    (A. C. Davison and D. V. Hinkley, Bootstrap Methods and their Application, sec. 5.2).

    Args:
        steps: responses to a step of 1 (N, K), of the estimate in the first row, then of draws.

    Returns:
        Overshoots (N,), 0 or more, as fractions of the step, in the same order.
    """
    raw_overshoots = np.maximum(steps.max(axis=1) - 1, 0.0)
    raw_estimate = raw_overshoots[ESTIMATE]
    excess = raw_overshoots - raw_estimate
    # The estimate is corrected by the bias, each draw by its own excess.
    corrections = excess.copy()
    corrections[ESTIMATE] = excess[DRAWS].mean()
    return np.maximum(raw_estimate - corrections, 0.0)


def _first_times(time: Array, steps: Array, level: float) -> Array:
    """Returns the times at which responses to a step first exceed a level, linearly interpolated.

    Args:
        time: times after the step (K,), s.
        steps: responses (N, K), which are 0 at time 0.
        level: level to be exceeded, as a fraction of the step.

    Returns:
        Times (N,), s; the last of ``time`` for a response that never exceeds the level.
    """
    # The running maximum never decreases, so that it crosses the level once.
    running_maximum = np.maximum.accumulate(steps, axis=1)
    is_below = running_maximum <= level
    # The values before and after the level is exceeded; the first sample, which is 0, is below any level.
    value_before = running_maximum.max(axis=1, where=is_below, initial=0.0)
    value_after = running_maximum.min(axis=1, where=~is_below, initial=np.inf)
    last_below = is_below.sum(axis=1) - 1
    # If the level is never exceeded, the value after is infinite, the fraction 0, and the sample the last one.
    sample = last_below + (level - value_before) / (value_after - value_before)
    return np.interp(sample, np.arange(len(time)), time)


def with_interval(values: Array) -> IntervalEstimate:
    """Computes the 90 % interval of an estimate from draws of its posterior.

    Of the draws, 5 % are below the interval and 5 % above it. It is widened if it does not contain the estimate.

    Args:
        values: (N,) the estimate first, then N − 1 draws.

    Returns:
        The estimate, and the lower and upper end of its interval.
    """
    low, high = np.quantile(values[DRAWS], INTERVAL_QUANTILES).tolist()
    estimate = values[ESTIMATE]
    return IntervalEstimate(estimate, min(low, estimate), max(high, estimate))
