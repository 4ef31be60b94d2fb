"""The map of a flight: its path over ground, coloured by height or flight mode, with scale, north and wind."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil
from typing import NamedTuple, Self, TypeVar

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.containers import JsonValues
from mavdem.report.charts.chart import Plan, Span, packed
from mavdem.report.charts.plans import (
    MAX_PATH_POINTS,
    MIN_LIVE_PATH_SIZE,
    MIN_PATH_SIZE,
    RADIUS,
    figure_as_svg,
)
from mavdem.report.charts.timeline import Timeline
from mavdem.report.palette import ASCENDING, MEASURED, MODE_COLOURS
from mavdem.wind_velocity.compass import compass_text
from mavdem.wind_velocity.velocity import WindVelocity

Coordinates = TypeVar("Coordinates", float, Array)
"""One coordinate of a place, or those of many places."""

HEIGHT_COLOURS = ASCENDING
"""Colours of the path by height, from the lowest fifth of the range to the highest."""

MIN_HEIGHT_RANGE = 1.0
"""Smallest range of heights, m, that the colours are spread over: a hover does not show the noise of its height."""

MAX_RING_RADIUS = 2 * RADIUS
"""Largest ring of distance, in units of the drawing: a take-off at one side of the path reaches its other side."""

WHOLE_METRES = 4.0
"""Least range of heights of one colour, m, whose ends are shown without decimals."""


class _Key(NamedTuple):
    """An entry of the legend of the path's colours."""

    name: str
    """What the colour means."""

    colour: str
    """Colour of the palette."""


class _Place(NamedTuple):
    """A marked place of the map."""

    name: str
    """What it is, for the legend."""

    x: float
    """Coordinate to the right, in units of the drawing."""

    y: float
    """Coordinate downward, in units of the drawing."""


class _Piece(NamedTuple):
    """A part of the path with one colour for its height and one for its flight mode."""

    way: str
    """Path data of SVG."""

    height_colour: str
    """Colour for its height."""

    mode_colour: str
    """Colour for its flight mode."""


class MapWind(NamedTuple):
    """The wind as a map shows it: an arrow with a label, which follow the cursor where the wind over time is known."""

    direction: float
    """Direction that it comes from, degrees clockwise from north."""

    speed_interval: Interval | None
    """Both ends of the 90 % interval of its speed, m/s; None where it is not known."""

    time: Array | None = None
    """(T,) times of the estimates over time, s since boot; None if only the mean is known."""

    directions: Array | None = None
    """(T,) directions at these times, degrees, within half a turn of the mean, so that they can be interpolated."""

    name: str = "wind"
    """What is written before its label, such as "mean wind"."""

    @classmethod
    def of_flight(cls, wind: WindVelocity | None) -> Self | None:
        """Returns the wind of a flight for its map: its mean, and how its direction changed over time.

        Args:
            wind: the estimated wind; None without an estimate.

        Returns:
            The wind, without the speed if that is not identifiable; None if the direction is not identifiable.
        """
        if wind is None or not wind.direction_identifiable:
            return None
        return cls(
            wind.direction,
            speed_interval=wind.mean_speed_interval if wind.speed_identifiable else None,
            time=wind.time,
            directions=wind.polar.direction,
        )

    @property
    def label(self) -> str:
        """Text at the arrow of the wind, such as "3.1 to 5.2 m/s from NW"; without the speed if it is not known."""
        origin = f"from {compass_text(self.direction)}"
        if self.speed_interval is None:
            return origin
        low, high = self.speed_interval
        return f"{low:.1f} to {high:.1f} m/s {origin}"

    def interpolated_at(self, time: Array) -> dict[str, Array]:
        """Interpolates the direction at the times of the path's points, so that the arrow can follow the cursor.

        Args:
            time: (N,) times, s since boot.

        Returns:
            "direction", (N,), degrees; NaN before and after the estimate. Empty if only the mean wind is known.
        """
        if self.time is None or self.directions is None:
            return {}
        direction = np.interp(time, self.time, self.directions, left=np.nan, right=np.nan)
        return {"direction": direction}


class _MapProjection(NamedTuple):
    """How positions over ground become coordinates of the drawing, with north up."""

    scale: float
    """Units of the drawing for a metre."""

    middle_north: float
    """Position north, m, that lies at the origin of the drawing."""

    middle_east: float
    """Position east, m, that lies at the origin of the drawing."""

    @classmethod
    def of_path(cls, north: Array, east: Array, min_size: float) -> Self:
        """Returns the projection with which a path fills the drawing, with one scale for both directions.

        Args:
            north, east: (N,) positions of the path, m.
            min_size: smallest extent, m, that fills the drawing: a smaller path does not.
        """
        size = max(np.ptp(north), np.ptp(east), min_size)
        return cls(
            scale=2 * RADIUS / size,
            middle_north=(north.min() + north.max()) / 2,
            middle_east=(east.min() + east.max()) / 2,
        )

    def x(self, east: Coordinates) -> Coordinates:
        """Returns coordinates to the right for positions east, m."""
        return self.scale * (east - self.middle_east)

    def y(self, north: Coordinates) -> Coordinates:
        """Returns coordinates downward for positions north, m."""
        return -self.scale * (north - self.middle_north)

    def place(self, name: str, north: float, east: float) -> _Place:
        """Returns a marked place of the map, by its position north and east, m."""
        return _Place(name, self.x(east), self.y(north))


def flown_path(timeline: Timeline | None, wind: MapWind | None = None) -> Plan | None:
    """Returns the map of the flown path, north up, with a bar of scale and, where it is known, the wind.

    Both directions have one scale, by which the larger extent of the path fills the drawing. At most
    ``MAX_PATH_POINTS`` samples are drawn, evenly chosen. A vehicle that is received is drawn with its heading, and the
    place of its take-off where that is known; a log has the first and the last point of its path.

    Args:
        timeline: timeline of the flight, with its position and modes; None without one.
        wind: the wind of the flight; None if it is not known.

    Returns:
        The drawing, with what the page needs to show the place at a time; None if the position is not known. In a log
        that is also so if it never changes: then nothing measured it.
    """
    position = None if timeline is None else timeline.position
    if timeline is None or position is None:
        return None
    is_received = timeline.heading is not None
    has_moved = bool(np.ptp(position.values[:, :2], axis=0).any())
    if not has_moved and not is_received:
        return None
    sample_count = len(position.time)
    stride = ceil(sample_count / MAX_PATH_POINTS)
    # The first samples are skipped such that the last one is among those drawn.
    first_drawn = (sample_count - 1) % stride
    drawn = slice(first_drawn, None, stride)
    time = position.time[drawn]
    north, east, down = position.values[drawn].T
    height = -down
    min_size = MIN_LIVE_PATH_SIZE if is_received else MIN_PATH_SIZE
    projection = _MapProjection.of_path(north, east, min_size)
    x = projection.x(east)
    y = projection.y(north)
    start = _Place("start", x[0], y[0])
    loss_time = timeline.time_of_loss
    loss = None
    if loss_time is not None and time[0] <= loss_time <= time[-1]:
        name = f"lost at {loss_time:.1f} s"
        loss = _Place(name, np.interp(loss_time, time, x), np.interp(loss_time, time, y))
    if timeline.takeoff is not None:
        takeoff_north, takeoff_east, _ = timeline.takeoff
        start = projection.place("take-off", takeoff_north, takeoff_east)

    lowest_height = float(np.nanmin(height))
    height_range = max(float(np.nanmax(height)) - lowest_height, MIN_HEIGHT_RANGE)
    height_classes = _height_classes(height, lowest_height, height_range)
    mode_names = list(dict.fromkeys(mode.name for mode in timeline.modes))
    mode_numbers = _mode_numbers(time, timeline.modes, mode_names)
    lowest_text, highest_text = _height_texts(lowest_height, height_range)
    # The bar of scale is about a third of the drawing, in metres rounded to one digit.
    drawing_size = 2 * RADIUS / projection.scale
    bar_metres = float(f"{drawing_size / 3:.0e}")
    bar_length = projection.scale * bar_metres
    svg = figure_as_svg(
        "path",
        pieces=[*_path_pieces(x, y, height_classes, mode_numbers)],
        start=start,
        end=_Place("end" if timeline.heading is None else "vehicle", x[-1], y[-1]),
        loss=loss,
        heading=timeline.heading,
        scale=(bar_length, f"{bar_metres:g} m"),
        ring_radii=_ring_radii(bar_length) if is_received else [],
        lowest=lowest_text,
        highest=highest_text,
        colours=HEIGHT_COLOURS,
        modes=[_Key(name, _mode_colour(number)) for number, name in enumerate(mode_names)],
        wind=wind,
    )
    description = (
        f"Path over ground, {np.ptp(east):.0f} m wide and {np.ptp(north):.0f} m high; north is up."
    )
    # What the script of the page needs to show place, height and the wind's direction at the time under the cursor.
    track = {"time": time, "x": x, "y": y, "height": height}
    if wind is not None:
        track |= wind.interpolated_at(time)
    packed_track: JsonValues = {}
    for name, values in track.items():
        packed_track[name] = packed(values, is_logarithmic=False)
    return Plan("Flown path", description, svg, packed_track)


def _ring_radii(spacing: float) -> list[float]:
    """Returns the radii of the rings of distance around the take-off, as far as the drawing reaches.

    Args:
        spacing: distance between two rings, the length of the bar of scale, in units of the drawing.
    """
    count = int(MAX_RING_RADIUS / spacing)
    return [spacing * number for number in range(1, count + 1)]


def _height_classes(height: Array, lowest_height: float, height_range: float) -> Array:
    """Returns for each height the index of its colour: the range of heights is divided into equal classes.

    Args:
        height: (N,) heights, m; NaN where not known, which is drawn like the lowest one.
        lowest_height: lowest height of the path, m.
        height_range: difference of the highest and the lowest height, m.

    Returns:
        (N,) indices in ``HEIGHT_COLOURS``, from 0 for the lowest class.
    """
    known_height = np.nan_to_num(height, nan=lowest_height)
    relative_height = (known_height - lowest_height) / height_range
    class_count = len(HEIGHT_COLOURS)
    classes = np.floor(class_count * relative_height).astype(int)
    # The highest point has the relative height 1, and belongs to the highest class.
    return np.clip(classes, 0, class_count - 1)


def _height_texts(lowest_height: float, height_range: float) -> tuple[str, str]:
    """Returns both ends of the range of heights that the path's colours divide equally, m, as text.

    Args:
        lowest_height: lowest height of the path, m.
        height_range: difference of the highest and the lowest height, m.
    """
    # The limits of neighbouring colours differ by at least one of the last digit.
    decimals = 0 if height_range >= len(HEIGHT_COLOURS) * WHOLE_METRES else 1
    texts = []
    for height in np.round([lowest_height, lowest_height + height_range], decimals):
        # Adding 0 turns −0 into 0, which has no sign.
        texts.append(f"{height + 0.0:.{decimals}f}".replace("-", "−"))
    return texts[0], texts[1]


def _mode_numbers(time: Array, modes: Sequence[Span], names: Sequence[str]) -> Array:
    """Returns which flight mode the vehicle had at each of some times, as a number for the data of a page.

    Args:
        time: (N,) times, s.
        modes: flight modes, each with its name, and with its start and end, s.
        names: names of all modes, in the order of their numbers.

    Returns:
        (N,) index of the mode's name among the names, from 0; −1 where the mode is not known.
    """
    numbers = np.full(len(time), -1)
    for mode in modes:
        numbers[(time >= mode.start) & (time <= mode.end)] = names.index(mode.name)
    return numbers


def _mode_colour(number: int) -> str:
    """Returns the colour of a flight mode by its number; neutral where the mode is not known."""
    if number < 0:
        return MEASURED
    return MODE_COLOURS[number % len(MODE_COLOURS)]


def _path_pieces(
    x: Array, y: Array, height_classes: Array, mode_numbers: Array
) -> Iterator[_Piece]:
    """Yields the path in pieces of one colour: a new piece begins where the class of height or the flight mode changes.

    Args:
        x, y: coordinates (N,) in units of the drawing, to the right and downward.
        height_classes: (N,) index of the colour of each height.
        mode_numbers: (N,) number of the flight mode.
    """
    is_change = (np.diff(height_classes) != 0) | (np.diff(mode_numbers) != 0)
    # Indices of the points at which another colour begins; between two points a change belongs to the second one.
    first_points = (np.flatnonzero(is_change) + 1).tolist()
    for start, end in pairwise([0, *first_points, len(x)]):
        # Each piece goes on to the first point of the next one, so that the path has no gaps.
        points = zip(x[start : end + 1], y[start : end + 1], strict=True)
        svg_path = "M" + " ".join(f"{right:.1f} {downward:.1f}" for right, downward in points)
        height_colour = HEIGHT_COLOURS[height_classes[start]]
        yield _Piece(svg_path, height_colour, _mode_colour(int(mode_numbers[start])))
