"""Estimation of the wind velocity of one flight: its mean, course and gusts, and how well each is identified."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, nan
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array, Indices
from mavdem.confidence import INTERVAL_QUANTILES, Interval, coverage_factor, half_width
from mavdem.dataset.axes import DOWN, HORIZONTAL
from mavdem.dem.engine.linalg import one_thread
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.identifiability import Status
from mavdem.facts.online import DragSource
from mavdem.facts.wind import WindDoubt
from mavdem.immutable import ImmutableResult
from mavdem.wind_velocity.advised_flight import WindErrors, advised_flight
from mavdem.wind_velocity.airflow_filter import TOTAL_WIND_MATRIX
from mavdem.wind_velocity.beaufort import LIGHT_BREEZE
from mavdem.wind_velocity.compass import (
    HEADING_SD,
    PolarWind,
    meteorological_direction,
    speed_and_direction,
)
from mavdem.wind_velocity.drag_identification import (
    GUST_SECONDS,
    identify_drag,
    sampled_parameters,
    sampled_winds,
)
from mavdem.wind_velocity.motion_grid import MAX_STEPS, flight_grid, validated_motion
from mavdem.wind_velocity.vehicle_drag import DRAG_PARAMETERS, LEAN, LOG_COEFFICIENTS, Drag

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

CALM_SPEED = 0.5
"""Lower end of the speed's interval, m/s, below which still air counts as likely."""

REPORTED_SPEED_ERROR = 0.7
"""Half width of the speed's interval, m/s, up to which the speed is reported."""

REPORTED_RELATIVE_ERROR = 0.12
"""Half width of the speed's interval, relative to the speed, up to which the speed is reported."""

BIASED_SPEED_RATIO = 8.0
"""Ratio of the ends of the speed's interval up to which the speed is reported as biased."""

MIN_RATIO_SPEED = 0.3
"""Least lower end of the interval, m/s, in that ratio."""

REPORTED_DIRECTION_ERROR = 10.0
"""Half width of the direction's interval, degrees, up to which the direction is reported."""

MAX_DIRECTION_INTERVAL = 60.0
"""Half width of the direction's interval, degrees, up to which the direction is reported as biased."""

MAX_DIRECTION_OF_WIND = 90.0
"""Half width of the direction's interval by drag, lean and noise, degrees, beyond which still air counts as likely.

Less than 90 % of the likely wind velocities are then on one side of still air, which is among them.
"""

REPORTED_DRAG_SD = 0.18
"""Relative standard deviation of the drag up to which it is reported."""

MAX_REMAINING_DRAG_SD = 0.8
"""Standard deviation of the drag, relative to the prior's, beyond which the flight has not identified it."""

DIRECTION_DRAWS = 50
"""Number of random errors of the mean wind for each of its posterior samples: a choice."""

NOISE_SEED = 2
"""Seed of these random errors, so that a flight always has the same intervals."""

MIN_SPEED = 1e-9
"""Least speed, m/s, or square of a speed, in a denominator: it only avoids a division by 0."""

COURSE_FIELDS = ("time", "velocity", "band", "minutes", "profile")
"""Fields of ``WindVelocity`` with courses, which are empty if the speed is not identifiable."""


class WindTurn(NamedTuple):
    """How the wind turned in a flight."""

    start_direction: float
    """Direction that the wind of the first minute came from, degrees clockwise from north."""
    end_direction: float
    """Direction that the wind of the last minute came from, degrees."""
    speed: float
    """Mean of the speeds of the minutes, m/s."""


@dataclass(frozen=True, eq=False, repr=False)
class WindVelocity(ImmutableResult):
    """The horizontal wind of one flight over T time steps, with its mean, gusts and intervals.

    Attributes:
        speed: speed of the mean wind vector, m/s.
        speed_interval: ends of its 90 % interval, m/s; the lower one is 0 if still air is likely as well.
        direction: that the wind comes from, degrees clockwise from the yaw's north, 0 to 360.
        direction_interval: half width of its 90 % interval, degrees.
        gust: largest mean speed over ``gust_seconds``, m/s.
        gust_interval: ends of its 90 % interval, m/s; the lower one is 0 if still air is likely as well.
        gust_seconds: 3 s, or one step where steps are longer.
        turbulence_intensity: standard deviation of the wind along its mean direction, over its speed.
        time: (T,) s, on the clock that was given.
        velocity: (T, 2) velocity of the air, north and east, m/s.
        band: (T, 2) half widths of its band, which holds the truth with probability 90 %, m/s.
        minutes: mean of each minute: ``start`` and ``end`` (s), ``speed``, ``low``, ``high`` (m/s), ``direction``.
        profile: mean by height in layers of about 10 m: mean ``height`` in the layer, m, and ``speed``, ``low``,
            ``high`` and ``direction`` as of a minute; empty within one layer.
        along: (T, 2) velocity of the vehicle relative to the mean wind, along body x and y, m/s.
        air_velocity: (T, 2) velocity of the vehicle relative to the wind of each step, along body x and y, m/s.
        drag: drag of the vehicle, by its prior and this flight.
        status: status of "speed", "direction" and "drag", by name.
        reasons: reason why any of these is not reported, by name.
        advice: what to fly so that speed or direction are known much better, with the errors that are then to be
            expected; None if both are reported, or no such flight is known.
        boot: number of the log's boot on whose clock ``time`` is; 0 if arrays were given.
    """

    speed: float
    speed_interval: Interval
    direction: float
    direction_interval: float
    gust: float
    gust_interval: Interval
    gust_seconds: float
    turbulence_intensity: float
    time: Array
    velocity: Array
    band: Array
    along: Array
    air_velocity: Array
    minutes: tuple[dict[str, float], ...]
    profile: tuple[dict[str, float], ...]
    drag: Drag
    status: Mapping[str, Status]
    reasons: NamedFacts
    advice: Fact | None = None
    boot: int = 0

    @property
    def speed_identifiable(self) -> bool:
        """Whether the speed is identifiable, if only as biased."""
        return self.status["speed"] != Status.NOT_IDENTIFIABLE

    @property
    def direction_identifiable(self) -> bool:
        """Whether the direction means something: it is identifiable, and the air is not likely to be still."""
        still_air_likely = not self.speed_interval[0]
        return not still_air_likely and self.status["direction"] != Status.NOT_IDENTIFIABLE

    @property
    def calm(self) -> bool:
        """Whether still air is likely as well: the wind is then reported as below the interval's upper end."""
        return self.speed_identifiable and not self.speed_interval[0]

    @property
    def may_be_lean(self) -> bool:
        """Whether the vehicle may lean because of a load or a misaligned autopilot instead of the wind.

        The speed of the wind follows from the lean, and may then be biased.
        """
        doubt = self.reasons.get("speed")
        if doubt is None or self.calm:
            return False
        # The other doubt about a speed is that the drag is uncertain; whatever the drag, the vehicle then leans against
        # the wind.
        is_only_by_drag: bool = doubt.figures["by_drag"]
        return not is_only_by_drag

    @property
    def gust_time(self) -> float:
        """Middle of the strongest gust, s, on the clock of ``time``; NaN if the speed is not identifiable."""
        if not len(self.time):
            return nan
        start = int(self._means_over_gusts.argmax())
        return float(self.time[start : start + self._gust_steps].mean())

    @property
    def lull(self) -> float:
        """Smallest mean speed over ``gust_seconds``, m/s; NaN if the speed is not identifiable."""
        if not len(self.time):
            return nan
        return float(self._means_over_gusts.min())

    @property
    def turn(self) -> WindTurn | None:
        """How the wind turned, if it turned so far that its mean vector misleads; None if it did not.

        Where the direction changes, the length of the mean wind vector is less than the mean of the speeds. If it is
        less than the speed of every minute, no wind of that speed ever blew, and a report must say so. None also if
        direction or speed are not identifiable.
        """
        minutes = self.identified_figures.minutes
        if not self.direction_identifiable or len(minutes) < 2:
            return None
        speeds = [minute["speed"] for minute in minutes]
        # Both are shown with one decimal place.
        if round(self.speed, 1) >= round(min(speeds), 1):
            return None
        return WindTurn(minutes[0]["direction"], minutes[-1]["direction"], float(np.mean(speeds)))

    @property
    def _gust_steps(self) -> int:
        """Number of time steps in ``gust_seconds``."""
        return max(round(self.gust_seconds / np.median(np.diff(self.time))), 1)

    @property
    def _means_over_gusts(self) -> Array:
        """Means of the speed over ``gust_seconds`` from each step on, m/s; those that would end later are left out."""
        speeds = np.hypot(*self.velocity.T)
        return _running_means(speeds[:, np.newaxis], self._gust_steps)[:, 0]

    @property
    def polar(self) -> PolarWind:
        """The course of the wind as speed and direction, each (T,), with half widths of their bands."""
        return self.as_polar(self.velocity, self.band)

    def as_polar(self, velocity: Array, band: Array) -> PolarWind:
        """Converts the velocity of the air over time to speed and direction, to be drawn together with this wind.

        Directions are within half a turn of the mean direction of this wind, or of north if that is not identifiable,
        so that their line does not jump at north.

        Args:
            velocity: (N, 2) velocity of the air, north and east, m/s.
            band: (N, 2) half widths of its band, m/s.

        Returns:
            Speed, m/s, and direction (N,) with half widths of their bands.
        """
        mean_direction = self.direction if self.direction_identifiable else 0.0
        return speed_and_direction(velocity, band, mean_direction)

    @property
    def identified_figures(self) -> Self:
        """This wind without speeds that the flight does not identify: they are NaN, and time series are empty."""
        if self.speed_identifiable:
            return self
        empty_courses: Any = dict.fromkeys(COURSE_FIELDS, ())
        return replace(
            self,
            speed=nan,
            speed_interval=(nan, nan),
            gust=nan,
            gust_interval=(nan, nan),
            **empty_courses,
        )


class _MeanWind(NamedTuple):
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


class _Doubt(NamedTuple):
    """A figure of the wind that is not reported, and why."""

    figure: str
    """"drag", "speed" or "direction"."""

    status: Status
    """BIASED or NOT_IDENTIFIABLE."""

    reason: Fact
    """Reason why it is not reported."""


def lower_speed_bound(low: float, high: float) -> float:
    """Returns the lower end of a speed's interval, m/s, or 0 if still air is likely as well."""
    if low < min(CALM_SPEED, high / 3):
        return 0.0
    return low


def speed_status(speed: float, low: float, high: float) -> Status:
    """Returns whether a speed with an interval from low to high, m/s, is reported, biased or not identifiable."""
    if (high - low) / 2 <= max(REPORTED_SPEED_ERROR, REPORTED_RELATIVE_ERROR * speed):
        return Status.REPORTED
    if high <= BIASED_SPEED_RATIO * max(low, MIN_RATIO_SPEED):
        return Status.BIASED
    # Still air has no ratio. It is reported as below the upper end.
    may_be_calm = not lower_speed_bound(low, high)
    if may_be_calm and high <= LIGHT_BREEZE:
        return Status.BIASED
    return Status.NOT_IDENTIFIABLE


def estimate_wind(
    time: Array,
    attitude: Array,
    velocity: Array,
    drag: Drag | None = None,
    height: Array | None = None,
) -> WindVelocity:
    """Estimates the wind of one flight from attitude and velocity, at 1 Hz and faster.

    Wind pushes a multirotor, which tilts against it; its drag relates the tilt to the air speed. The steps:

    1. The motion is resampled to two even grids of time. The drag is identified on the coarse one, with its prior.
    2. On the fine one the wind is smoothed for each of N samples of drag and lean from their posterior. The lean is
       specific force that no wind causes. The spread of the N winds is the error by uncertain drag and lean, and the
       smoother's variance is the error by noise.
    3. From these follow the mean wind with its intervals, gusts, the wind by minute and by height.
    4. Figures that the flight does not determine well are marked as biased or not identifiable, with the reason, and
       with what to fly to know them better.

    Args:
        time: stamps (T,), s, ascending; there may be gaps.
        attitude: roll, pitch and yaw (T, 3), rad, Z-Y-X; rows that are not finite are left out.
        velocity: velocity over ground, north, east and down (T, 3), m/s.
        drag: drag of the vehicle, from another flight or :func:`mavdem.estimate_drag`; None for the population's.
        height: height (T,), m, for the wind by height; None if it is not known.

    Returns:
        The wind with its intervals, gusts, course over time, and the drag.

    Raises:
        ValueError: an array has another shape, the time does not ascend, or the drag is not a ``Drag``.
        NotLearnable: the flight is too short, the vehicle was held or carried, or the velocity is not the vehicle's.
    """
    samples = validated_motion(time, attitude, velocity)
    heights = np.zeros(len(time)) if height is None else np.asarray(height, np.float64)
    if heights.shape != (len(time),):
        raise ValueError(f"height must have shape ({len(time)},), not {heights.shape}")
    prior = Drag.validated_or_population(drag)
    with one_thread():
        coarse = flight_grid(samples, max_steps=MAX_STEPS // 2)
        fine = flight_grid(samples, max_steps=MAX_STEPS)
        posterior = identify_drag(coarse, prior)
        parameter_samples = sampled_parameters(posterior)
        wind_samples = sampled_winds(fine, parameter_samples)
    # The states are gust and mean wind, whose sum is the wind: N samples of it (T, N, 2), with variances by noise.
    # Letters of einsum: time t, sample n, axis a of the wind, states i and j.
    winds = wind_samples.states @ TOTAL_WIND_MATRIX.T
    variances = np.einsum(
        "ai,tnij,aj->tna", TOTAL_WIND_MATRIX, wind_samples.covariances, TOTAL_WIND_MATRIX
    )
    whole_flight = _mean_wind(winds, variances, fine.step)
    wind_velocity = winds.mean(axis=1)
    mean_wind_velocity = wind_velocity.mean(axis=0)
    step_heights = np.interp(fine.time, samples.time, heights[samples.usable])

    relative_velocity = fine.velocity[:, HORIZONTAL] - wind_velocity
    air_speed = np.nanmean(np.hypot(*relative_velocity.T))
    flight_drag = Drag(
        posterior.mean[:DRAG_PARAMETERS], posterior.covariance[:DRAG_PARAMETERS, :DRAG_PARAMETERS]
    )
    # Standard deviation of the drag at this air speed, relative to the drag and to the deviation before the flight.
    drag_sd = flight_drag.relative_sd(air_speed)
    remaining_sd = drag_sd / prior.relative_sd(air_speed)
    # If the flight hardly reduces it, the source of the drag is still the prior's source.
    source = prior.source if remaining_sd > MAX_REMAINING_DRAG_SD else DragSource.FLIGHT
    flight_drag = replace(flight_drag, source=source)
    is_lean_worse = _is_lean_worse(winds.mean(axis=0), parameter_samples)
    doubts = _doubts_on_wind(
        whole_flight, drag_sd, remaining_sd, is_lean_worse, posterior.steered_share, prior.source
    )
    status = dict.fromkeys(("speed", "direction", "drag"), Status.REPORTED)
    for doubt in doubts:
        status[doubt.figure] = doubt.status
    lowest_speed = lower_speed_bound(whole_flight.low, whole_flight.high)
    advice = None
    if status["speed"] is not Status.REPORTED or status["direction"] is not Status.REPORTED:
        has_uncertain_direction = lowest_speed > 0 and status["direction"] is not Status.REPORTED
        direction_error = np.radians(whole_flight.direction_half_width)
        errors = WindErrors(
            whole_flight.speed,
            speed_error=(whole_flight.high - lowest_speed) / 2,
            direction_error=direction_error if has_uncertain_direction else None,
            noise_sd=whole_flight.noise_sd,
            drag_sd=drag_sd,
        )
        advice = advised_flight(errors, flight_drag)

    gust_steps = max(round(GUST_SECONDS / fine.step), 1)
    gust = float(_running_means(np.hypot(*wind_velocity.T)[:, np.newaxis], gust_steps).max())
    gust_low, gust_high = _gust_interval(winds, variances, gust_steps, gust)
    if not lowest_speed:
        # Still air has no gusts. The samples have, since the speed of a scattered velocity is above 0.
        gust_low = 0.0
    mean_speed_square = max(mean_wind_velocity @ mean_wind_velocity, MIN_SPEED)
    return WindVelocity(
        speed=whole_flight.speed,
        speed_interval=(lowest_speed, whole_flight.high),
        direction=whole_flight.direction,
        direction_interval=whole_flight.direction_half_width,
        gust=gust,
        gust_interval=(gust_low, gust_high),
        gust_seconds=gust_steps * fine.step,
        turbulence_intensity=(wind_velocity @ mean_wind_velocity).std() / mean_speed_square,
        time=fine.time,
        velocity=wind_velocity,
        band=half_width(variances.mean(axis=1) + winds.var(axis=1)),
        # The wind is taken to be horizontal.
        along=fine.along_body_axes(fine.velocity - [*mean_wind_velocity, 0.0]),
        air_velocity=fine.along_body_axes(
            np.column_stack([relative_velocity, fine.velocity[:, DOWN]])
        ),
        minutes=tuple(_mean_wind_by_minute(winds, variances, fine.time, fine.step)),
        profile=tuple(_wind_profile(winds, variances, step_heights, fine.step)),
        drag=flight_drag,
        status=status,
        reasons={doubt.figure: doubt.reason for doubt in doubts},
        advice=advice,
    )


def _running_means(values: Array, steps: int) -> Array:
    """Returns the means of each column of values (T, N) over successive ``steps``, as (T − steps + 1, N)."""
    sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return (sums[steps:] - sums[:-steps]) / steps


def _gust_interval(winds: Array, variances: Array, steps: int, gust: float) -> Interval:
    """Returns the 90 % interval of the speed of the largest gust, by samples of its posterior distribution.

    Each posterior sample of drag and lean has another wind, and so another largest gust. The noise of the wind is added
    to each ``DIRECTION_DRAWS`` times at random, since a gust is too short for the noise to average out.

    Args:
        winds: N posterior samples of the wind velocity, north and east (T, N, 2), m/s.
        variances: variance (T, N, 2) of the error of each component by noise, (m/s)².
        steps: steps over which a gust is averaged.
        gust: the largest gust of the mean of all samples, m/s, which is the reported value.

    Returns:
        Lower and upper end, m/s, widened if they do not contain the reported value.
    """
    speeds = np.hypot(winds[..., 0], winds[..., 1])
    gusts = _running_means(speeds, steps).max(axis=0)
    # The standard deviation of the noise of each posterior sample (N,), averaged over time and both components.
    noise_sd = np.sqrt(variances.mean(axis=(0, 2)))
    noise = default_rng(NOISE_SEED).standard_normal((DIRECTION_DRAWS, len(gusts)))
    low, high = np.quantile(gusts + noise * noise_sd, INTERVAL_QUANTILES).tolist()
    return max(min(low, gust), 0.0), max(high, gust)


def _mean_wind_by_minute(
    winds: Array, variances: Array, time: Array, step: float
) -> list[dict[str, float]]:
    """Returns the mean wind of each minute of a flight.

    The flight is cut into equal parts of half a minute to a minute.

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
    # A flight of more than a minute has two parts, so that a wind that rose is seen.
    part_count = max(ceil(len(winds) * step / PART_SECONDS - PART_TOLERANCE), 1)
    parts = []
    for rows in np.array_split(np.arange(len(winds)), part_count):
        mean = _mean_wind(winds[rows], variances[rows], step)
        parts.append(
            {
                "speed": mean.speed,
                "low": mean.low,
                "high": mean.high,
                "direction": mean.direction,
                "start": float(time[rows[0]]),
                "end": float(time[rows[-1]]),
            }
        )
    return parts


def _wind_profile(
    winds: Array, variances: Array, heights: Array, step: float
) -> list[dict[str, float]]:
    """Returns the mean wind by height, in layers of about ``LAYER_HEIGHT``.

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
        mean = _mean_wind(winds[rows], variances[rows], step)
        layers.append(
            {
                "height": float(heights[rows].mean()),
                "speed": mean.speed,
                "low": mean.low,
                "high": mean.high,
                "direction": mean.direction,
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


def _mean_wind(winds: Array, variances: Array, step: float) -> _MeanWind:
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
    independent_steps = max(len(winds) * step / INDEPENDENT_SECONDS, 1.0)
    # The error by noise of a mean over that many independent values. Normal draws of it are added to the N means.
    noise_sd = np.sqrt(variances.mean(axis=0) / independent_steps)
    noise = default_rng(NOISE_SEED).standard_normal((DIRECTION_DRAWS, len(means), 2))
    samples = (means + noise * noise_sd).reshape(-1, 2)
    speeds = np.hypot(*samples.T)
    low, high = np.quantile(speeds, INTERVAL_QUANTILES).tolist()

    # The speed is the median component along the mean direction: a mean of magnitudes would be too large in calm air.
    north, east = means.mean(axis=0)
    projected = np.median(means @ [north, east])
    speed = projected / max(np.hypot(north, east), MIN_SPEED)
    speed = max(speed, 0.0)

    # The quotient of two winds as complex numbers has the angle between them.
    mean_wind = north + 1j * east
    if mean_wind == 0:
        mean_wind = 1.0
    angles = np.angle((samples @ [1, 1j]) / mean_wind)
    half_width_by_samples = np.degrees(np.quantile(abs(angles), 0.9))
    direction_half_width = np.hypot(half_width_by_samples, coverage_factor() * HEADING_SD)
    if half_width_by_samples > MAX_DIRECTION_OF_WIND:
        # Speeds of scattered velocities are above 0 even if their mean is still air.
        low = 0.0
    return _MeanWind(
        speed,
        low=min(low, speed),
        high=high,
        direction=meteorological_direction(north, east),
        direction_half_width=direction_half_width,
        noise_sd=float(np.sqrt((noise_sd**2).mean())),
    )


def _is_lean_worse(mean_winds: Array, parameter_samples: Array) -> bool:
    """Returns whether the uncertain lean makes the speed of the mean wind more uncertain than the uncertain drag does.

    The speed is the component along the mean direction. Its variance over the samples is compared with the part that a
    linear regression on the lean explains, and with the part that one on the drag explains.

    Args:
        mean_winds: mean wind velocity by each of N posterior samples, north and east (N, 2), m/s.
        parameter_samples: the samples (N, 10) of the scaled parameters.
    """
    along_mean = mean_winds @ mean_winds.mean(axis=0)
    by_lean = _explained_variance(along_mean, parameter_samples[:, LEAN])
    by_drag = _explained_variance(along_mean, parameter_samples[:, LOG_COEFFICIENTS])
    return by_lean > by_drag


def _explained_variance(values: Array, regressors: Array) -> float:
    """Returns the variance of values (N,) that a linear regression on k regressors (N, k) explains."""
    centred = regressors - regressors.mean(axis=0)
    coefficients = np.linalg.lstsq(centred, values - values.mean(), rcond=None)[0]
    return float(np.var(centred @ coefficients))


def _doubts_on_wind(
    mean: _MeanWind,
    drag_sd: float,
    remaining_sd: float,
    is_lean_worse: bool,
    steered_share: float,
    prior_source: DragSource,
) -> list[_Doubt]:
    """Returns the reasons why drag, speed or direction are not reported.

    A figure is reported if its interval is narrow enough. Otherwise its status is biased, which means that it is given
    with a warning, or not identifiable, which means that the flight hardly determines it.

    Args:
        mean: mean wind of the flight.
        drag_sd: relative standard deviation of the drag force at the air speed of the flight.
        remaining_sd: standard deviation after the flight, relative to the one before it (the prior's).
        is_lean_worse: whether the speed is more uncertain by the lean than by the drag.
        steered_share: fraction of the force's variance that manoeuvres explain, 0 to 1; only they determine the drag.
        prior_source: source of the prior of the drag.

    Returns:
        The figures that are not reported, each with its status and reason.
    """
    doubts = []
    drag_uncertain = drag_sd > REPORTED_DRAG_SD
    if drag_uncertain:
        status = Status.BIASED
        if remaining_sd > MAX_REMAINING_DRAG_SD:
            status = Status.NOT_IDENTIFIABLE
        reason = Fact(
            WindDoubt.DRAG_UNSURE,
            status=status,
            relative_sd=drag_sd,
            source=prior_source,
            steered=steered_share,
        )
        doubts.append(_Doubt("drag", status, reason))

    status = speed_status(mean.speed, mean.low, mean.high)
    if status is not Status.REPORTED:
        reason = Fact(
            WindDoubt.SPEED_UNSURE,
            status=status,
            low=lower_speed_bound(mean.low, mean.high),
            high=mean.high,
            by_drag=drag_uncertain and not is_lean_worse,
        )
        doubts.append(_Doubt("speed", status, reason))

    if mean.direction_half_width > REPORTED_DIRECTION_ERROR:
        status = Status.NOT_IDENTIFIABLE
        if mean.direction_half_width <= MAX_DIRECTION_INTERVAL:
            status = Status.BIASED
        interval = np.radians(mean.direction_half_width)
        reason = Fact(WindDoubt.DIRECTION_UNSURE, direction_interval=interval)
        if not lower_speed_bound(mean.low, mean.high):
            # If the wind may be calm, that is the reason, and not how the autopilot is mounted.
            reason = reason.replace(calm=True)
        doubts.append(_Doubt("direction", status, reason))
    return doubts
