"""The wind in metres a second: mean, course and gusts, and what of it a flight identifies."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import nan
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array
from mavdem.confidence import (
    INTERVAL_QUANTILES,
    MIN_SAMPLES_FOR_STATISTICS,
    Interval,
    coverage_factor,
    half_width,
)
from mavdem.dem.engine.linalg import one_thread
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.identifiability import Status
from mavdem.facts.online import DragSource
from mavdem.facts.wind import WindDoubt, WindShare
from mavdem.immutable import ImmutableResult
from mavdem.wind_velocity.airflow import TOTAL_WIND_MATRIX, Drag
from mavdem.wind_velocity.drag import (
    GUST_SECONDS,
    STEPS,
    courses,
    gridded,
    identified,
    validated_motion,
)

# after which noise is new
INDEPENDENT_SECONDS = 10.0
# m of height of which a mean is shown; m/s
LAYER = 10.0
CALM = 0.5
# m/s or share of half width reported; ratio of ends biased
SPEED_ERROR = 0.7
SPEED_SHARE = 0.12
SPEED_FACTOR = 8.0
# degrees of half width; of the heading, a compass's
DIRECTION_ERROR = 10.0
MAX_DIRECTION_INTERVAL = 60.0
HEADING_SD = 2.5
# m/s, standard deviation of the motion through the air that tells the mean wind's torque apart
CHANGED = 1.0
# relative sd of the drag that is reported; share of the prior's that is biased
DRAG_ERROR = 0.18
DRAG_LEFT = 0.8
COURSES = ("time", "velocity", "band", "minutes", "profile")
POINTS = [
    "N",
    "NNE",
    "NE",
    "ENE",
    "E",
    "ESE",
    "SE",
    "SSE",
    "S",
    "SSW",
    "SW",
    "WSW",
    "W",
    "WNW",
    "NW",
    "NNW",
]


@dataclass(frozen=True, eq=False, repr=False)
class WindVelocity(ImmutableResult):
    """The horizontal wind of one flight.

    Attributes:
        speed: of the mean wind vector, m/s.
        speed_interval: ends of its 90 % interval, the lower one 0 where still air is likely, too.
        direction: where it comes from, degrees from the north of the yaw, 0 to 360.
        direction_interval: half width of its 90 % interval, degrees.
        gust: the strongest mean of ``gust_seconds``, m/s: of 3 s, or of a step where steps are longer.
        turbulence_intensity: standard deviation of the wind along its mean direction, over its speed.
        time: (T,) s, on the clock that was given.
        velocity, band: (T, 2) north and east of where the air moves to, m/s, and half widths that hold it with 90 %.
        minutes: mean of each minute: ``start`` and ``end`` (s), ``speed``, ``low``, ``high`` (m/s), ``direction``.
        profile: mean by height in layers of 10 m: ``height``, ``speed``, ``direction``; empty within one layer.
        along: (T, 2) velocity through air that moves as the mean wind does, along body x and y, m/s.
        drag: of the vehicle, as the flight leaves it.
        status: by "speed", "direction" and "drag".
        reasons: of what is not reported.
        boot: of the log, on whose clock ``time`` is; 0 where arrays were given.
    """

    speed: float
    speed_interval: Interval
    direction: float
    direction_interval: float
    gust: float
    gust_seconds: float
    turbulence_intensity: float
    time: Array
    velocity: Array
    band: Array
    along: Array
    minutes: tuple[dict[str, float], ...]
    profile: tuple[dict[str, float], ...]
    drag: Drag
    status: Mapping[str, Status]
    reasons: NamedFacts
    boot: int = 0

    @property
    def speed_identifiable(self) -> bool:
        """Whether the speed is identifiable."""
        return self.status["speed"] != Status.NOT_IDENTIFIABLE

    @property
    def direction_identifiable(self) -> bool:
        """Whether the direction means something: it is identifiable, and the air is not still."""
        still = not self.speed_interval[0]
        return not still and self.status["direction"] != Status.NOT_IDENTIFIABLE

    @property
    def calm(self) -> bool:
        """Whether still air is likely, too: the wind is then said to be below the interval's upper end."""
        return self.speed_identifiable and not self.speed_interval[0]

    @property
    def identified_figures(self) -> Self:
        """Itself without speeds, where the flight does not identify them: NaN, and courses without a sample."""
        if self.speed_identifiable:
            return self
        nothing: Any = dict.fromkeys(COURSES, ())
        return replace(self, speed=nan, speed_interval=(nan, nan), gust=nan, **nothing)


def lower_speed_bound(low: float, high: float) -> float:
    """Returns the lower end of an interval of speed, m/s: 0 where still air is likely, too."""
    if low < min(CALM, high / 3):
        return 0.0
    return low


def speed_status(speed: float, low: float, high: float) -> Status:
    """Returns whether a ``speed`` with this interval, m/s, is reported."""
    if (high - low) / 2 <= max(SPEED_ERROR, SPEED_SHARE * speed):
        return Status.REPORTED
    if high <= SPEED_FACTOR * max(low, 0.3):
        return Status.BIASED
    return Status.NOT_IDENTIFIABLE


def meteorological_direction(north: float, east: float) -> float:
    """Returns the direction that air moving ``north`` and ``east`` comes from, degrees, 0 to 360."""
    return np.degrees(np.arctan2(-east, -north)) % 360


def compass_text(direction: float) -> str:
    """Returns where wind from a ``direction``, °, comes from, and an arrow along it: "WSW (248°) ↗"."""
    return f"{POINTS[round(direction / 22.5) % 16]} ({direction % 360:.0f}°) {'↓↙←↖↑↗→↘'[round(direction / 45) % 8]}"


def speed_and_direction(
    velocity: Array, band: Array, near: float = 180.0
) -> tuple[Array, Array, Array, Array]:
    """Returns speed (T,), m/s, and direction it comes from, degrees, of a course (T, 2), then half widths of both.

    Those are of the ``band`` (T, 2) along and across the ``velocity``; 180° where that may come from anywhere. The
    direction is half a turn from ``near``, degrees, at most, so that a line of it does not jump at north.
    """
    speed = np.hypot(*velocity.T)
    along = velocity / np.maximum(speed, 1e-9)[:, None]
    half = np.hypot(*(along * band).T)
    across = np.hypot(*(along[:, ::-1] * band).T)
    turned = np.where(across < speed, np.degrees(np.arctan2(across, speed)), 180.0)
    return (
        speed,
        near + (np.degrees(np.arctan2(*-velocity.T[::-1])) - near + 180) % 360 - 180,
        half,
        turned,
    )


def estimate_wind(
    time: Array,
    attitude: Array,
    velocity: Array,
    drag: Drag | None = None,
    height: Array | None = None,
) -> WindVelocity:
    """Returns the wind of one flight from attitude and velocity, at 1 Hz and faster.

    Args:
        time: (T,) s, ascending; gaps may be in it.
        attitude: (T, 3) roll, pitch and yaw, rad, Z-Y-X; rows that are not finite are left out.
        velocity: (T, 3) north, east and down over ground, m/s.
        drag: of the vehicle, from another flight or :func:`mavdem.estimate_drag`; the population's unless given.
        height: (T,) m, where the wind is wanted by height.

    Raises:
        ValueError: arrays of other shapes, a time that does not ascend, or a drag that is no ``Drag``.
        NotLearnable: too short, or no free flight: held, carried, or a velocity that is not the vehicle's.
    """
    stamps, angles, speeds, usable = validated_motion(time, attitude, velocity)
    high_up = np.zeros(len(time)) if height is None else np.asarray(height, np.float64)
    if high_up.shape != (len(time),):
        raise ValueError(f"height must have shape ({len(time)},), not {high_up.shape}")
    prior = Drag.given(drag)
    with one_thread():
        coarse, fine = (gridded(stamps, angles, speeds, most=most) for most in (STEPS // 2, STEPS))
        mean, covariance, steered = identified(coarse, prior)
        states, spreads = courses(fine, mean, covariance)
    drag_in_flight = Drag(mean[:6], covariance[:6, :6])
    winds = states @ TOTAL_WIND_MATRIX.T
    variances = np.einsum("ai,tnij,aj->tna", TOTAL_WIND_MATRIX, spreads, TOTAL_WIND_MATRIX)
    whole = _mean(winds, variances, fine.step)
    air = winds.mean(axis=1)
    width = max(round(GUST_SECONDS / fine.step), 1)
    mean = air.mean(axis=0)
    minutes = []
    number = max(round(len(air) * fine.step / 60), 1)
    for rows in np.array_split(np.arange(len(air)), number):
        own = _mean(winds[rows], variances[rows], fine.step)
        minute = {name: getattr(own, name) for name in ("speed", "low", "high", "direction")}
        start, end = fine.time[rows[[0, -1]]].tolist()
        minutes.append({**minute, "start": start, "end": end})
    layers = []
    heights = np.interp(fine.time, stamps, high_up[usable])
    layer_of_sample = np.floor(heights / LAYER)
    for n in np.unique(layer_of_sample):
        sensed = air[layer_of_sample == n]
        if len(sensed) * fine.step >= INDEPENDENT_SECONDS:
            north, east = sensed.mean(axis=0).tolist()
            layers.append(
                {
                    "height": LAYER * (n + 0.5),
                    "speed": np.hypot(north, east),
                    "direction": meteorological_direction(north, east),
                }
            )
    through_air = fine.velocity[:, :2] - air
    moved = np.nanmean(np.hypot(*through_air.T))
    sd = drag_in_flight.relative_sd(moved)
    relative_sd = sd / prior.relative_sd(moved)
    drag_in_flight = replace(
        drag_in_flight, source=prior.source if relative_sd > DRAG_LEFT else DragSource.FLIGHT
    )
    doubts = list(_doubts(whole, sd, relative_sd, steered, prior.source))
    gusts = np.convolve(np.hypot(*air.T), np.ones(width) / width, mode="valid")
    mean_square = max(mean @ mean, 1e-9)
    status = dict.fromkeys(("speed", "direction", "drag"), Status.REPORTED)
    status |= {name: doubted for name, doubted, _ in doubts}
    return WindVelocity(
        speed=whole.speed,
        speed_interval=(lower_speed_bound(whole.low, whole.high), whole.high),
        direction=whole.direction,
        direction_interval=whole.turned,
        gust=gusts.max(),
        gust_seconds=width * fine.step,
        turbulence_intensity=(air @ mean).std() / mean_square,
        time=fine.time,
        velocity=air,
        band=half_width(variances.mean(axis=1) + winds.var(axis=1)),
        along=np.einsum("tij,tj->ti", fine.axes, fine.velocity - [*mean, 0.0]),
        minutes=tuple(minutes),
        profile=tuple(layers if len(layers) > 1 else ()),
        drag=drag_in_flight,
        status=status,
        reasons={name: doubt for name, _, doubt in doubts},
    )


def torque_share_of_wind(wind: WindVelocity, time: Array, torque: Array) -> Fact:
    """Returns the ``share`` of a ``torque`` (N,) at ``time`` (N,), s, that the mean ``wind`` explains.

    It is the share of the variance of means over 3 s, by what is linear in the velocity through that air along body x
    and y, fitted to every second quarter of a minute and tried on the others. None where that hardly changes.
    """
    thirds = np.floor(time / GUST_SECONDS)
    number, third = np.unique(thirds, return_inverse=True)
    finite = np.isfinite(wind.along).all(axis=1)
    air = (
        np.interp(time, wind.time[finite], part, np.nan, np.nan) for part in wind.along[finite].T
    )
    sums = np.array([np.bincount(third, values) for values in (torque, *air)])
    means = sums / np.bincount(third)
    kept = np.isfinite(means).all(axis=0)
    slow, *along = means[:, kept]
    if len(slow) < MIN_SAMPLES_FOR_STATISTICS or np.std(along, axis=1).max() < CHANGED:
        return Fact(WindShare.SHARE_UNKNOWN, share=None)
    table = np.column_stack([np.ones(len(slow)), *along])
    is_even = number[kept] // 5 % 2 == 0
    left = slow.copy()
    for tried in (is_even, ~is_even):
        fitted = np.linalg.lstsq(table[~tried], slow[~tried])[0]
        left[tried] -= table[tried] @ fitted
    unexplained = left.var() / slow.var()
    share = max(1 - unexplained, 0.0)
    return Fact(WindShare.SHARE_KNOWN, share=share, span=GUST_SECONDS)


class _Mean(NamedTuple):
    """Of the wind over steps: its speed with both ends of its interval, where it comes from, and that half width."""

    speed: float
    low: float
    high: float
    direction: float
    turned: float


def _mean(winds: Array, variances: Array, step: float) -> _Mean:
    """That of draws (T, N, 2) with these variances."""
    means = winds.mean(axis=0)
    # By the draws of drag and lean, which are common to all steps; what noise does averages out.
    count = max(len(winds) * step / INDEPENDENT_SECONDS, 1.0)
    noise = default_rng(2).standard_normal((50, len(means), 2))
    spread = np.sqrt(variances.mean(axis=0) / count)
    samples = (means + noise * spread).reshape(-1, 2)
    speeds = np.hypot(*samples.T)
    low, high = np.quantile(speeds, INTERVAL_QUANTILES).tolist()
    north, east = means.mean(axis=0)
    along = np.median(means @ [north, east])
    speed = along / max(np.hypot(north, east), 1e-9)
    speed = max(speed, 0.0)
    apart = np.angle((samples @ [1, 1j]) / (north + 1j * east or 1.0))
    turned = np.degrees(np.quantile(abs(apart), 0.9))
    turned = np.hypot(turned, coverage_factor() * HEADING_SD)
    return _Mean(speed, min(low, speed), high, meteorological_direction(north, east), turned)


def _doubts(
    mean: _Mean, sd: float, relative_sd: float, steered: float, source: DragSource
) -> Iterator[tuple[str, Status, Fact]]:
    """Status and reason of drag, speed and direction where they are not reported."""
    if sd > DRAG_ERROR:
        status = Status.NOT_IDENTIFIABLE if relative_sd > DRAG_LEFT else Status.BIASED
        doubt = Fact(
            WindDoubt.DRAG_UNSURE,
            status=status,
            relative_sd=sd,
            source=source,
            steered=steered,
        )
        yield "drag", status, doubt
    status = speed_status(mean.speed, mean.low, mean.high)
    if status is not Status.REPORTED:
        low = lower_speed_bound(mean.low, mean.high)
        doubt = Fact(
            WindDoubt.SPEED_UNSURE,
            status=status,
            low=low,
            high=mean.high,
            by_drag=sd > DRAG_ERROR,
        )
        yield "speed", status, doubt
    if mean.turned > DIRECTION_ERROR:
        roughly = mean.turned <= MAX_DIRECTION_INTERVAL
        half = np.radians(mean.turned)
        doubt = Fact(WindDoubt.DIRECTION_UNSURE, direction_interval=half)
        yield "direction", Status.BIASED if roughly else Status.NOT_IDENTIFIABLE, doubt
