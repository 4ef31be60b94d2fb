"""Directions of the wind: meteorological convention, points of the compass, and bands of speed and direction."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array

COMPASS_POINTS = (
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
)
"""Points of the compass, clockwise from north."""

POINT_WIDTH = 360 / len(COMPASS_POINTS)
"""Angle, degrees, between two points of the compass."""

COMPASS_WORDS = {"N": "north", "E": "east", "S": "south", "W": "west"}
"""The cardinal directions in words, by their letters."""

FLOW_ARROWS = "↓↙←↖↑↗→↘"
"""Arrows along the flow of wind from north, north-east and so on, 45° apart."""

HEADING_SD = 2.5
"""Standard error of the heading, degrees: as a calibrated compass has."""

ANY_DIRECTION = 180.0
"""Half width of the direction, degrees, if the wind may come from any direction."""

MIN_DIVISOR = 1e-9
"""Speed, m/s, by which a velocity is divided at least: it only avoids a division by zero in still air."""


class PolarWind(NamedTuple):
    """Wind over time as speed and direction, with half widths of their bands."""

    speed: Array
    """Speed (T,), m/s."""

    direction: Array
    """Direction that the wind comes from (T,), degrees clockwise from north; not limited to 0 to 360."""

    speed_half_width: Array
    """Half width of the speed's band (T,), m/s."""

    direction_half_width: Array
    """Half width of the direction's band (T,), degrees; 180 if the wind may come from anywhere."""


def meteorological_direction(north: float, east: float) -> float:
    """Returns the direction that air moving with velocities north and east comes from, degrees from north, 0 to 360."""
    return np.degrees(np.arctan2(-east, -north)) % 360


def compass_point(direction: float) -> str:
    """Returns the nearest of 16 points of the compass to a direction, degrees clockwise from north, such as "WSW"."""
    return _nearest_point(direction, COMPASS_POINTS)


def compass_text(direction: float) -> str:
    """Returns a direction that wind comes from as text, with an arrow along its flow, such as "WSW (248°) ↗".

    The direction is rounded to the nearest of 16 points of the compass, 22.5° apart, and of 8 arrows, 45° apart.

    Args:
        direction: where the wind comes from, degrees clockwise from north.
    """
    point = compass_point(direction)
    arrow = _nearest_point(direction, FLOW_ARROWS)
    return f"{point} ({direction % 360:.0f}°) {arrow}"


def compass_words(direction: float, half_width: float | None = None) -> str:
    """Returns a direction that wind comes from in words, such as "the west-south-west (248° ± 9°)".

    The direction is rounded to the nearest of 16 points of the compass, as by :func:`compass_text`.

    Args:
        direction: where the wind comes from, degrees clockwise from north.
        half_width: half width of its interval, degrees; None if it is not to be shown. No line is broken within it.
    """
    point = compass_point(direction)
    words = "-".join(COMPASS_WORDS[letter] for letter in point)
    interval = (
        "" if half_width is None else f"\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}{half_width:.0f}°"
    )
    return f"the {words} ({direction % 360:.0f}°{interval})"


def speed_and_direction(
    velocity: Array, half_width: Array, middle_direction: float = 180.0
) -> PolarWind:
    """Converts the velocity of the wind over time to speed and direction.

    Args:
        velocity: (T, 2) velocity of the air, north and east, m/s.
        half_width: (T, 2) half widths of its band of uncertainty, north and east, m/s.
        middle_direction: middle of the range of the returned directions, degrees. They are at most 180° from it, so
            that a plotted line does not jump from 360° to 0° if the wind comes from about north. By default the range
            is 0 to 360°.

    Returns:
        (T,) speed, m/s, and direction, degrees, with their half widths. North and east components are taken as
        independent. The half width along the wind is the speed's. The arctangent of the half width across the wind
        over the speed is the half width of the direction.
    """
    speed = np.hypot(*velocity.T)
    unit_along_wind = velocity / np.maximum(speed, MIN_DIVISOR)[:, None]
    # Along a unit vector u, the half width of u_north · north + u_east · east is the root of the sum of squares.
    half_width_along = np.hypot(*(unit_along_wind * half_width).T)
    # The unit vector across the wind has the components swapped. The sign of one of them would be changed, which makes
    # no difference to the squares.
    unit_across_wind = unit_along_wind[:, ::-1]
    half_width_across = np.hypot(*(unit_across_wind * half_width).T)
    angle_of_half_width = np.degrees(np.arctan2(half_width_across, speed))
    # If the half width across is at least the speed, the speed may be 0: then any direction is possible.
    direction_half_width = np.where(half_width_across < speed, angle_of_half_width, ANY_DIRECTION)
    # The direction from which the wind comes is opposite to the velocity: atan2(−east, −north), clockwise from north.
    north, east = velocity.T
    origin = np.degrees(np.arctan2(-east, -north))
    # The remainder converts the difference to −180 … 180°.
    direction = middle_direction + (origin - middle_direction + 180) % 360 - 180
    return PolarWind(speed, direction, half_width_along, direction_half_width)


def _nearest_point(direction: float, points: Sequence[str]) -> str:
    """Returns the point that is nearest to a direction.

    Args:
        direction: degrees clockwise from north.
        points: names of points at equal angles over the whole circle, clockwise from north.

    Returns:
        One of the names.
    """
    angle_between_points = 360 / len(points)
    # Directions just below 360° are rounded to the first point, which is north.
    return points[round(direction / angle_between_points) % len(points)]
