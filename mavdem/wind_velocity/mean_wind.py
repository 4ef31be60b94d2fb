"""Means of the wind velocity by time and height, and its largest gust, with intervals from posterior samples."""

from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array, Indices
from mavdem.confidence import CONFIDENCE_LEVEL, INTERVAL_QUANTILES, Interval, coverage_factor
from mavdem.wind_velocity.compass import (
    HEADING_SD,
    meteorological_direction,
)

CALM_SPEED = 0.5
"""Lower end of the speed's interval, m/s, below which still air counts as likely."""

INDEPENDENT_SECONDS = 10.0
"""Time after which the error of the wind by noise is independent, s: a choice."""

PART_SECONDS = 60.0
"""Longest part of a flight whose mean wind is given, s: wind is reported by the minute."""

PART_TOLERANCE = 0.05
"""Number of parts by which a flight may be longer than its parts: an odd second makes no further part."""

LAYER_HEIGHT = 10.0
"""Height of a layer of the wind profile, m."""

MIN_LAYER_DISTANCE = LAYER_HEIGHT / 2
"""Least distance of the mean heights of two layers, m: nearer ones are one, as of a hover at the border of two."""

MAX_DIRECTION_OF_WIND = 90.0
"""Half width of the direction's interval by drag, lean and noise, degrees, beyond which still air counts as likely.

Less than 90 % of the likely wind velocities are then on one side of still air, which is among them.
"""

DIRECTION_DRAWS = 50
"""Number of random errors of the mean wind for each of its posterior samples: a choice."""

NOISE_SEED = 2
"""Seed of these random errors, so that a flight always has the same intervals."""

MIN_SPEED = 1e-9
"""Least speed in a denominator, m/s: it only avoids a division by 0."""


def lower_speed_bound(low: float, high: float) -> float:
    """Returns the lower end of a speed's interval, m/s, or 0 if still air is likely as well."""
    if low < min(CALM_SPEED, high / 3):
        return 0.0
    return low


class MeanWind(NamedTuple):
    """Mean wind over some steps, with its uncertainty."""

    speed: float
    """Speed of the mean wind vector, m/s."""

    low: float
    """Lower end of its 90 % interval, m/s."""

    high: float
    """Upper end of its 90 % interval, m/s."""

    direction: float
    """Direction that it comes from, degrees."""

    direction_half_width: float
    """Half width of the direction's 90 % interval, degrees."""

    noise_sd: float
    """Standard deviation by noise alone, along one direction, m/s."""

    @property
    def reported_values(self) -> dict[str, float]:
        """What is reported of a part of a flight: ``speed``, ``low`` and ``high``, m/s, and ``direction``, degrees.

        ``low`` is 0 where still air is likely as well, as it is in the interval of the whole flight.
        """
        return {
            "speed": self.speed,
            "low": lower_speed_bound(self.low, self.high),
            "high": self.high,
            "direction": self.direction,
        }


def running_means(values: Array, steps: int) -> Array:
    """Returns the running means of each column of values.

    Args:
        values: (T, N) values.
        steps: number of successive rows that are averaged.

    Returns:
        (T − steps + 1, N) means, of the first ``steps`` rows first.
    """
    # The sum of some rows is the difference of two cumulative sums.
    cumulative_sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return (cumulative_sums[steps:] - cumulative_sums[:-steps]) / steps


def speed_interval(speeds: Array, noise_variance: float | Array, speed: float) -> Interval:
    """Returns the 90 % interval of a speed, such as of the largest gust, by samples of its posterior distribution.

    Each posterior sample of drag and lean has another wind, and so another speed. The noise of the wind is added to
    each ``DIRECTION_DRAWS`` times at random.

    Args:
        speeds: the speed in each of N posterior samples (N,), m/s.
        noise_variance: variance of the error by noise along one direction, (m/s)²: one, or one for each sample (N,).
        speed: the reported value, m/s.

    Returns:
        Lower and upper end, m/s, widened if they do not contain the reported value.
    """
    noise = default_rng(NOISE_SEED).standard_normal((DIRECTION_DRAWS, len(speeds)))
    samples = speeds + noise * np.sqrt(noise_variance)
    low, high = np.quantile(samples, INTERVAL_QUANTILES).tolist()
    return max(min(low, speed), 0.0), max(high, speed)


def independent_count(steps: int, step: float) -> float:
    """Returns the number of independent errors by noise in a mean over some steps of ``step`` seconds, at least 1."""
    return max(steps * step / INDEPENDENT_SECONDS, 1.0)


def mean_wind_by_minute(
    winds: Array, variances: Array, time: Array, step: float
) -> list[dict[str, float]]:
    """Returns the mean wind of each minute of a flight.

    The flight is cut into equal parts of at most ``PART_SECONDS``, one minute; an odd second more makes no other part.

    Args:
        winds: N posterior samples of the wind velocity, north and east (T, N, 2), m/s.
        variances: variance (T, N, 2) of the error of each component by noise, (m/s)².
        time: middle of each step (T,), s.
        step: time step, s.

    Returns:
        A dictionary for each part: mean ``speed`` with the ends ``low`` and ``high`` of its interval, m/s; the
        ``direction`` that the wind comes from, degrees; and ``start`` and ``end``, the times of its first and last
        step, s.
    """
    minutes = len(winds) * step / PART_SECONDS
    # The number is rounded up, so that a flight of more than a minute has two parts, which show a wind that rose.
    part_count = max(ceil(minutes - PART_TOLERANCE), 1)
    parts = []
    for steps_of_part in np.array_split(np.arange(len(winds)), part_count):
        mean_wind = mean_wind_of_steps(winds[steps_of_part], variances[steps_of_part], step)
        times_of_part = time[steps_of_part]
        start_and_end = {"start": float(times_of_part[0]), "end": float(times_of_part[-1])}
        parts.append({**mean_wind.reported_values, **start_and_end})
    return parts


def wind_profile(
    winds: Array, variances: Array, heights: Array, step: float
) -> list[dict[str, float]]:
    """Returns the mean wind by height, in layers of about equal height (:func:`_layer_rows`).

    Layers in which the vehicle was for less than ``INDEPENDENT_SECONDS`` are left out, since a single gust would
    determine their mean.

    Args:
        winds: N posterior samples of the wind velocity, north and east (T, N, 2), m/s.
        variances: variance (T, N, 2) of the error of each component by noise, (m/s)².
        heights: heights of the vehicle (T,), m.
        step: time step, s.

    Returns:
        A dictionary for each layer, the lowest first: mean ``height`` of the vehicle in it, m; mean ``speed`` with the
        ends ``low`` and ``high`` of its interval, m/s; and the ``direction`` that the wind comes from, degrees. Empty
        for a flight within one layer.
    """
    layers = []
    for rows in _layer_rows(heights):
        if len(rows) * step < INDEPENDENT_SECONDS:
            continue
        mean_wind = mean_wind_of_steps(winds[rows], variances[rows], step)
        layers.append(
            {
                "height": float(heights[rows].mean()),
                **mean_wind.reported_values,
            }
        )
    if len(layers) < 2:
        return []
    return layers


def _layer_rows(heights: Array) -> list[Indices]:
    """Divides the steps of a flight among layers of height.

    Layers begin at multiples of ``LAYER_HEIGHT``. A hover at such a border is partly above and partly below it, at one
    height nevertheless. So a layer is joined to the one below if their mean heights differ by less than
    ``MIN_LAYER_DISTANCE``.

    Args:
        heights: heights of the vehicle (T,), m.

    Returns:
        Indices of the steps of each layer, ascending, the lowest layer first.
    """
    layer_of_step = np.floor(heights / LAYER_HEIGHT)
    layers: list[Indices] = []
    for layer in np.unique(layer_of_step):
        rows = np.flatnonzero(layer_of_step == layer)
        if layers and heights[rows].mean() - heights[layers[-1]].mean() < MIN_LAYER_DISTANCE:
            rows = np.sort(np.concatenate([layers.pop(), rows]))
        layers.append(rows)
    return layers


def mean_wind_of_steps(winds: Array, variances: Array, step: float) -> MeanWind:
    """Returns the mean wind over some steps, with intervals from samples of its posterior.

    Errors of drag and lean are the same in all steps: they show as the spread of the means of the posterior samples.
    Errors by noise are independent after ``INDEPENDENT_SECONDS``, so that they average out partly. The rest of them is
    drawn at random and added.

    Args:
        winds: N posterior samples of the wind velocity, north and east (T, N, 2), m/s.
        variances: variance (T, N, 2) of the error of each component by noise, (m/s)².
        step: time step, s.

    Returns:
        Speed with its interval, m/s, and direction with the half width of its interval, degrees.
    """
    means = winds.mean(axis=0)
    # The error by noise of a mean over independent values. Normal draws of it are added to the N means.
    noise_sd = np.sqrt(variances.mean(axis=0) / independent_count(len(winds), step))
    noise = default_rng(NOISE_SEED).standard_normal((DIRECTION_DRAWS, len(means), 2))
    samples = (means + noise * noise_sd).reshape(-1, 2)
    low, high = np.quantile(np.hypot(*samples.T), INTERVAL_QUANTILES).tolist()
    mean_wind = means.mean(axis=0)
    angle_by_samples = np.degrees(_angle_from_mean(samples, mean_wind))
    if angle_by_samples > MAX_DIRECTION_OF_WIND:
        # Speeds of scattered velocities are above 0 even if their mean is still air.
        low = 0.0
    speed = _speed_along_mean(means, mean_wind)
    north, east = mean_wind
    return MeanWind(
        speed,
        low=min(low, speed),
        high=high,
        direction=meteorological_direction(north, east),
        # The heading of the vehicle, by which the wind is turned to north, has an error of its own.
        direction_half_width=np.hypot(angle_by_samples, coverage_factor() * HEADING_SD),
        noise_sd=float(np.sqrt((noise_sd**2).mean())),
    )


def _speed_along_mean(winds: Array, mean_wind: Array) -> float:
    """Returns the median of the components of some winds along their mean direction, m/s, at least 0.

    A mean of their magnitudes would be too large in calm air.

    Args:
        winds: wind velocities, north and east (N, 2), m/s.
        mean_wind: their mean (2,), m/s.
    """
    median_product = np.median(winds @ mean_wind)
    speed = median_product / max(np.hypot(*mean_wind), MIN_SPEED)
    return max(speed, 0.0)


def _angle_from_mean(winds: Array, mean_wind: Array) -> float:
    """Returns the angle, rad, within which 90 % of some winds deviate in direction from the mean wind.

    Args:
        winds: wind velocities, north and east (N, 2), m/s.
        mean_wind: mean wind velocity (2,), m/s.
    """
    # The angle between two winds is that of the quotient of two complex numbers, north + j east.
    north_and_east = [1, 1j]
    complex_mean = complex(mean_wind @ north_and_east)
    if complex_mean == 0:
        # Still air has no direction. Any number other than 0 will do as divisor.
        complex_mean = 1.0
    angles = np.angle(winds @ north_and_east / complex_mean)
    return float(np.quantile(abs(angles), CONFIDENCE_LEVEL))
