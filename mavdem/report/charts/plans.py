"""Plans: drawings of a page with axes of their own: the vehicle from above, the wind rose, and the flown path."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from mavdem.arrays import Array
from mavdem.assessment.condition import Condition
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.facts import Level
from mavdem.motors.change_hypotheses import FAULT_RISE
from mavdem.report.charts.chart import Plan
from mavdem.report.charts.timeline import Timeline
from mavdem.report.numbers import listed
from mavdem.report.pages.page import environment
from mavdem.wind_velocity.compass import compass_text
from mavdem.wind_velocity.estimation import WindVelocity

RADIUS = 100.0
"""Radius of what is drawn, in units of the drawing: of the outermost motor, the largest petal, and half of the path."""

SPEED_CLASS_LIMITS = (0, 2, 4, 6, 8, 10, np.inf)
"""Limits of the classes of wind speed in a wind rose, m/s."""

SECTOR_COUNT = 16
"""Directions of a wind rose, those of the compass."""

SECTOR_WIDTH = 360 / SECTOR_COUNT
"""Width of each direction of a wind rose, degrees."""

MAX_PATH_POINTS = 600
"""Points of the flown path that are drawn, at most."""

MIN_PATH_SIZE = 2.0
"""Smallest width of a drawn path, m: a hover does not fill the drawing with the noise of its position."""


def frame_plan(motors: MotorOutputs | None, condition: Condition | None) -> Plan | None:
    """Returns the vehicle from above: each motor at its position, with trim deviation and headroom.

    Args:
        motors: outputs with the geometry of the motors; None where they were not logged.
        condition: condition of the vehicle with its hover, the outputs in steady flight; None where it is not known.

    Returns:
        The drawing; None where the positions or the hover of all motors are not known.
    """
    hover = None if condition is None else condition.hover
    if motors is None or condition is None or hover is None:
        return None
    count = len(hover.motors)
    if len(motors.geometry.positions) != count:
        return None
    # The outermost motor lies at RADIUS from the centre.
    positions = np.array(motors.geometry.positions, np.float64)
    positions *= RADIUS / max(np.hypot(*positions.T).max(), 1e-9)
    half_widths = condition.share_interval or (None,) * count
    drawn_motors = []
    for number, ((forward, right), half_width) in enumerate(
        zip(positions.tolist(), half_widths, strict=True)
    ):
        deviation = f"{100 * (hover.trim_share[number] - 1):+.1f} %".replace("-", "−")
        is_faulty = abs(hover.imbalance[number]) > 100 * FAULT_RISE
        drawn_motors.append(
            {
                "name": number + 1,
                "x": round(right, 1),
                "y": round(-forward, 1),
                # The disc's area, not its radius, is the motor's share of its range.
                "share": hover.trim_of_range[number] ** 0.5,
                "deviation": deviation,
                "half": "" if half_width is None else f"± {100 * half_width:.1f} %",
                "headroom": f"{100 * hover.headroom[number]:.0f} % left",
                "level": Level.WATCH if is_faulty else Level.GOOD,
            }
        )
    motor_texts = [
        f"motor {motor['name']} {motor['deviation']} {motor['half']}, {motor['headroom']}"
        for motor in drawn_motors
    ]
    svg = _svg("frame", motors=drawn_motors, size=150.0 / count**0.9)
    return Plan("From above", f"Trim deviation and headroom: {listed(motor_texts)}.", svg)


def rose_of_wind(wind: WindVelocity) -> Plan:
    """Returns the wind rose of a flight: the share of time, %, that wind came from each direction, by speed."""
    polar = wind.polar
    description = f"The wind came from {compass_text(wind.direction)}, {wind.speed:.1f} m/s."
    percent_per_sample = 100 / len(polar.speed)
    return _wind_rose(description, polar.direction, polar.speed, percent_per_sample, wind.direction)


def rose_of_flights(winds: Array) -> Plan:
    """Returns the wind rose of a fleet: the number of flights with wind from each direction, by speed.

    Args:
        winds: mean wind of each flight (N, 2): direction that it comes from, rad, and speed, m/s.
    """
    direction, speed = winds.T
    return _wind_rose(f"Wind of {len(winds)} flights.", np.degrees(direction), speed, 1.0)


class _Petal(NamedTuple):
    """A part of a wind rose: one class of speed in one direction."""

    sector: int
    """Number of the direction, clockwise from north."""

    inner_radius: float
    """In units of the drawing."""

    outer_radius: float
    """In units of the drawing."""

    opacity: float
    """The higher, the faster the wind."""


def _wind_rose(
    description: str,
    direction: Array,
    speed: Array,
    weight: float,
    mean_direction: float | None = None,
) -> Plan:
    """Returns a wind rose, a histogram of wind by direction, in which petals show the classes of speed.

    The petals of a direction lie one outside of the other, the slowest class in the middle. Their lengths are the
    counts of their classes, so that all of them together reach to the count of the direction.

    Args:
        description: the drawing in words.
        direction: directions that the wind comes from (N,), degrees.
        speed: wind speeds (N,), m/s.
        weight: how much each of the N winds counts: 1 for numbers of flights, otherwise percent of the time.
        mean_direction: direction, degrees, from which an arrow shows the mean wind; None without an arrow.
    """
    sector = np.rint(direction / SECTOR_WIDTH).astype(int) % SECTOR_COUNT
    bins = (SPEED_CLASS_LIMITS, np.arange(SECTOR_COUNT + 1))
    counts = weight * np.histogram2d(speed, sector, bins)[0]
    # Cumulative counts by class of speed are the radii at which the petals begin and end.
    edges = np.vstack([np.zeros(SECTOR_COUNT), counts.cumsum(axis=0)])
    scale = RADIUS / max(edges.max(), 1e-9)
    petals = []
    for speed_class, (inner_edges, outer_edges) in enumerate(pairwise(edges)):
        opacity = 0.25 + 0.14 * speed_class
        for number, (inner, outer) in enumerate(zip(inner_edges, outer_edges, strict=True)):
            if outer > inner:
                petals.append(_Petal(number, scale * inner, scale * outer, opacity))
    unit = " %" if weight != 1.0 else ""
    # Where the outer ring stands for more than 1, the labels are whole numbers.
    decimals = 0 if scale < RADIUS else 1
    rings = [(radius, f"{radius / scale:.{decimals}f}{unit}") for radius in (RADIUS / 2, RADIUS)]
    svg = _svg("rose", petals=petals, rings=rings, arrow=mean_direction)
    return Plan("Wind rose", description, svg)


def flown_path(timeline: Timeline | None) -> Plan | None:
    """Returns the flown path over ground, north up, with a bar of scale.

    Both directions have one scale, by which the larger extent of the path fills the drawing.

    Args:
        timeline: timeline of the flight, with its position; None without one.

    Returns:
        The drawing; None where the position is not known.
    """
    position = None if timeline is None else timeline.position
    if position is None:
        return None
    north, east = position.values[:, :2].T
    size = max(np.ptp(north), np.ptp(east), MIN_PATH_SIZE)
    # The bar is about a third of the path, rounded to one digit.
    bar_length = float(f"{size / 3:.0e}")
    scale = 2 * RADIUS / size
    # Every so many samples one is drawn (rounded up). The middle of the path is the origin, and y points down.
    stride = -(-len(north) // MAX_PATH_POINTS)
    x = scale * (east[::stride] - (east.min() + east.max()) / 2)
    y = -scale * (north[::stride] - (north.min() + north.max()) / 2)
    points = " ".join(f"{right:.1f} {down:.1f}" for right, down in zip(x, y, strict=True))
    svg = _svg(
        "path",
        way=f"M{points}",
        first=(x[0], y[0]),
        last=(x[-1], y[-1]),
        scale=(scale * bar_length, f"{bar_length:g} m"),
    )
    description = (
        f"Path over ground, {np.ptp(east):.0f} m wide and {np.ptp(north):.0f} m high; north is up."
    )
    return Plan("Flown path", description, svg)


def _svg(macro: str, **values: Any) -> Markup:
    """Returns the ``<svg>`` that a macro of ``plans.html`` makes of values."""
    macros = environment().get_template("plans.html").module
    return Markup(getattr(macros, macro)(**values))
