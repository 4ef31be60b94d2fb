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
"""Points of the compass, clockwise from north, 22.5° apart."""

COMPASS_WORDS = {"N": "north", "E": "east", "S": "south", "W": "west"}
"""The cardinal directions in words, by their letters."""

FLOW_ARROWS = "↓↙←↖↑↗→↘"
"""Arrows along the flow of wind from north, north-east and so on, 45° apart."""

ANY_DIRECTION = 180.0
"""Half width of the direction, degrees, if the wind may come from any direction."""

MIN_DIVISOR = 1e-9
"""Speed, m/s, by which a velocity is divided at least: it only avoids a division by zero in still air."""


class PolarWind(NamedTuple):
    """A course of wind as speed and direction, with half widths of their bands."""

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


def compass_text(direction: float) -> str:
    """Returns a direction that wind comes from as text, with an arrow along its flow, such as "WSW (248°) ↗".

    The direction is rounded to the nearest of 16 points of the compass, 22.5° apart, and of 8 arrows, 45° apart.

    Args:
        direction: degrees clockwise from north.
    """
    point = _nearest_point(direction, COMPASS_POINTS)
    arrow = _nearest_point(direction, FLOW_ARROWS)
    return f"{point} ({direction % 360:.0f}°) {arrow}"


def compass_words(direction: float) -> str:
    """Returns a direction that wind comes from in words, such as "the west-south-west (248°)".

    The direction is rounded to the nearest of 16 points of the compass, as by :func:`compass_text`.

    Args:
        direction: degrees clockwise from north.
    """
    point = _nearest_point(direction, COMPASS_POINTS)
    words = "-".join(COMPASS_WORDS[letter] for letter in point)
    return f"the {words} ({direction % 360:.0f}°)"


def speed_and_direction(velocity: Array, band: Array, near_direction: float = 180.0) -> PolarWind:
    """Converts the velocity of the wind over time to speed and direction.

    Args:
        velocity: (T, 2) velocity of the air, north and east, m/s.
        band: (T, 2) half widths of its band, north and east, m/s.
        near_direction: middle of the range of the returned directions, degrees. They are at most 180° from it, so that
            a plotted line does not jump from 360° to 0° if the wind comes from about north. By default the range is 0
            to 360°.

    Returns:
        (T,) speed, m/s, and direction, degrees, with their half widths. The band of the velocity is assumed to be an
        ellipse with its axes north and east. Its half width along the wind is that of the speed. Its half width across
        the wind, seen at the distance of the speed, is the angle by which the direction is uncertain.
    """
    speed = np.hypot(*velocity.T)
    # Unit vectors along the flow.
    unit = velocity / np.maximum(speed, MIN_DIVISOR)[:, None]
    # Half widths along and across the flow, m/s. The unit vector across the flow has the components swapped; the sign
    # of one of them does not matter, since they are squared.
    band_along = np.hypot(*(unit * band).T)
    band_across = np.hypot(*(unit[:, ::-1] * band).T)
    angle = np.degrees(np.arctan2(band_across, speed))
    # If the half width across exceeds the speed, the ellipse may contain a speed of 0: then any direction is possible.
    direction_half_width = np.where(band_across < speed, angle, ANY_DIRECTION)
    # The direction from which the wind comes is opposite to the velocity: atan2(−east, −north), clockwise from north.
    north, east = velocity.T
    origin = np.degrees(np.arctan2(-east, -north))
    # The remainder converts the difference to −180 … 180°.
    direction = near_direction + (origin - near_direction + 180) % 360 - 180
    return PolarWind(speed, direction, band_along, direction_half_width)


def _nearest_point(direction: float, points: Sequence[str]) -> str:
    """Returns the point that is nearest to a direction.

    Args:
        direction: degrees clockwise from north.
        points: names of points at equal angles over the whole circle, clockwise from north.
    """
    angle_between_points = 360 / len(points)
    # Directions just below 360° are rounded to the first point, which is north.
    return points[round(direction / angle_between_points) % len(points)]
