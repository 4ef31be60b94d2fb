"""The wind velocity of one flight: its mean, time series and gusts, with intervals and what is doubtful about them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import nan
from typing import Any, NamedTuple, Self

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.dataset.intervals import TimeInterval
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.identifiability import Status
from mavdem.immutable import ImmutableResult
from mavdem.wind_velocity.compass import (
    POINT_WIDTH,
    PolarWind,
    speed_and_direction,
)
from mavdem.wind_velocity.mean_wind import running_means
from mavdem.wind_velocity.vehicle_drag import Drag

SERIES_FIELDS = ("time", "velocity", "band", "minutes", "profile")
"""Fields of ``WindVelocity`` with the wind by time or height, which are empty if the speed is not identifiable."""


def mean_air_speed(air_velocity: Array) -> float:
    """Returns the mean air speed of a flight, m/s: the speed at which its drag is stated.

    Args:
        air_velocity: (T, 2) velocity relative to the air, along body x and y, m/s; NaN where it is not known.
    """
    return float(np.nanmean(np.hypot(*air_velocity.T)))


class WindTurn(NamedTuple):
    """How the wind turned in a flight."""

    start_direction: float
    """Direction that the wind of the first minute came from, degrees clockwise from north."""
    end_direction: float
    """Direction that the wind of the last minute came from, degrees."""
    farthest_direction: float | None
    """Direction of a minute between them, degrees, that lies farthest from the first one; None if the last one does."""


def _farthest_direction(directions: Array) -> float | None:
    """Returns the direction that lies farthest from the first one, which a wind that turns back or on to it passed.

    It is None if the last direction is the farthest, within one point of the compass: less would not show in words.

    Args:
        directions: directions (M,) that the wind of each minute came from, degrees clockwise from north.
    """
    # The angle between each direction and the first one, 0 to 180 degrees.
    angles_from_first = np.abs((directions - directions[0] + 180) % 360 - 180)
    farthest = int(np.argmax(angles_from_first))
    turned_back_by = angles_from_first[farthest] - angles_from_first[-1]
    if turned_back_by < POINT_WIDTH:
        return None
    return float(directions[farthest])


@dataclass(frozen=True, eq=False, repr=False)
class WindVelocity(ImmutableResult):
    """The horizontal wind of one flight over T time steps, with its mean, gusts and intervals.

    Attributes:
        speed: speed of the mean wind vector, m/s.
        speed_interval: ends of its 90 % interval, m/s; the lower one is 0 if still air is likely as well.
        mean_speed: mean of the speeds of all steps, m/s; where the wind turns, it is above ``speed``.
        mean_speed_interval: ends of its 90 % interval, m/s.
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
        left_out: start and end, s, of each part of the flight that was left out since the attitude did not follow its
            setpoint; empty if arrays were given.
    """

    speed: float
    speed_interval: Interval
    mean_speed: float
    mean_speed_interval: Interval
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
    left_out: tuple[TimeInterval, ...] = ()

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
        reason_against_speed = self.reasons.get("speed")
        if reason_against_speed is None or self.calm:
            # The speed is reported, or the air may be still.
            return False
        # Where the speed is missing only because the drag is poorly known, the lean itself is that in the wind.
        drag_is_only_reason: bool = reason_against_speed.figures["by_drag"]
        return not drag_is_only_reason

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
        minutes = self.without_unidentified_speeds.minutes
        if not self.direction_identifiable or len(minutes) < 2:
            return None
        speeds = [minute["speed"] for minute in minutes]
        # Both are shown with one decimal place.
        if round(self.speed, 1) >= round(min(speeds), 1):
            return None
        directions = np.array([minute["direction"] for minute in minutes])
        return WindTurn(
            start_direction=minutes[0]["direction"],
            end_direction=minutes[-1]["direction"],
            farthest_direction=_farthest_direction(directions),
        )

    @property
    def _gust_steps(self) -> int:
        """Number of time steps in ``gust_seconds``."""
        return max(round(self.gust_seconds / np.median(np.diff(self.time))), 1)

    @property
    def _means_over_gusts(self) -> Array:
        """Means of the speed over ``gust_seconds`` from each step on, m/s; those that would end later are left out."""
        speeds = np.hypot(*self.velocity.T)
        return running_means(speeds[:, np.newaxis], self._gust_steps)[:, 0]

    @property
    def polar(self) -> PolarWind:
        """The wind over time as speed and direction, each (T,), with half widths of their bands."""
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
    def without_unidentified_speeds(self) -> Self:
        """This wind without speeds that the flight does not identify: they are NaN, and time series are empty."""
        if self.speed_identifiable:
            return self
        empty_series: Any = dict.fromkeys(SERIES_FIELDS, ())
        return replace(
            self,
            speed=nan,
            speed_interval=(nan, nan),
            mean_speed=nan,
            mean_speed_interval=(nan, nan),
            gust=nan,
            gust_interval=(nan, nan),
            **empty_series,
        )
