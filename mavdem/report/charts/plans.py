"""Drawings of a page that are no charts over an axis: the vehicle from above with its motors, and the wind rose."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import ceil, degrees, dist
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.facts import Fact, Level
from mavdem.facts.motors import motor_number
from mavdem.motors.change_hypotheses import FAULT_RISE
from mavdem.report.charts.chart import Plan
from mavdem.report.numbers import listed
from mavdem.report.pages.environment import environment
from mavdem.wind_velocity.compass import compass_text

if TYPE_CHECKING:
    from mavdem.assessment.condition import Condition
    from mavdem.assessment.motor_failure import FailureCommands
    from mavdem.dataset.motor_outputs import MotorOutputs
    from mavdem.motors.hover import HoverFigures
    from mavdem.wind_velocity.velocity import WindVelocity

RADIUS = 100.0
"""Radius of what is drawn, in units of the drawing: of the outermost motor, the largest petal, and half of the path."""

MAX_DISC_RADIUS = 43.0
"""Largest radius of the disc of a motor, in units of the drawing: a motor at ``RADIUS`` still lies within it."""

MIN_MOTOR_DISTANCE = 1.0
"""Distance in the drawing below which two motors have the same place: those of a coaxial pair."""

SPEED_CLASS_LIMITS = (0, 2, 4, 6, 8, 10, np.inf)
"""Limits of the classes of wind speed in a wind rose, m/s."""

SECTOR_COUNT = 16
"""Directions of a wind rose, those of the compass."""

SECTOR_WIDTH = 360 / SECTOR_COUNT
"""Width of each direction of a wind rose, degrees."""

LOWEST_OPACITY = 0.25
"""Opacity of the petals of the slowest class of speed: they are seen on white."""

OPACITY_PER_SPEED_CLASS = 0.14
"""How much more opaque each faster class is: the sixth and last one has 0.95."""

MIN_ROSE_FLIGHTS = 8
"""Flights from which on their winds are drawn as a rose; each of fewer is a dot. A choice: half of the directions."""

MAX_PATH_POINTS = 600
"""Points of the flown path that are drawn, at most."""

MIN_PATH_SIZE = 0.5
"""Smallest width of a drawn path, m: a vehicle on the ground does not fill the drawing with the noise of its position.

A choice: a steady hover moves by some decimetres, and fills a good part of it.
"""

MIN_LIVE_PATH_SIZE = 3.0
"""The same while the vehicle flies, m, with which the rings of distance are 1 m apart: a choice.

Without it a hover fills the map with the noise of its position.
"""


class _DrawnCommands(NamedTuple):
    """Commands of the k motors that the drawing of the vehicle shows, with the texts on it."""

    title: str
    """Title of the drawing."""

    description: str
    """Kind of the commands and of the remarks."""

    commands: Array
    """(k,) Commands as fractions of the motors' range."""

    remarks: list[str]
    """Remark on each motor, such as its headroom."""

    imbalance: Numbers
    """(k,) Trim deviation of each motor (:attr:`HoverFigures.imbalance`), %; 0 where it is not drawn."""

    @classmethod
    def of_hover(cls, hover: HoverFigures) -> _DrawnCommands:
        """Returns what the drawing of a vehicle shows of its hover: mean commands, and the headroom of each motor.

        Args:
            hover: commands and headroom of the motors in settled flight, as fractions of their range.
        """
        return cls(
            title="From above, in settled flight: commands in % of the range",
            description="Mean command, of its range, and headroom",
            commands=np.array(hover.trim_of_range),
            remarks=[f"{100 * headroom:.0f} % left" for headroom in hover.headroom],
            imbalance=hover.imbalance,
        )

    @classmethod
    def of_failure(cls, failure: FailureCommands) -> _DrawnCommands:
        """Returns what the drawing of a vehicle shows of a motor failure: the commands at that time and the usual ones.

        Args:
            failure: commands of the motors while one failed and in the flight before, as fractions of their range.
        """
        start_time, end_time = failure.interval
        return cls(
            title=f"From above, at the failure ({start_time:.1f} to {end_time:.1f} s): commands in % of the range",
            description="Median command at the failure, of its range, and in the flight before",
            commands=failure.at_failure,
            remarks=[f"usual {100 * usual_command:.0f} %" for usual_command in failure.usual],
            # The drawing shows a motor that failed, and no trim deviations, which describe the hover.
            imbalance=(0.0,) * len(failure.at_failure),
        )


def frame_plan(
    motors: MotorOutputs | None,
    condition: Condition | None,
    light: Fact,
    failure: FailureCommands | None = None,
) -> Plan | None:
    """Returns the vehicle from above: each motor at its position, with its command in the hover or at a failure.

    The commands are as flown, so that they include those for lean and manoeuvres. The light judges how unevenly the
    motors work without these.

    Args:
        motors: outputs with the geometry of the motors; None if they were not logged.
        condition: condition of the vehicle with its hover, the outputs in steady flight; None if it is not known.
        light: status light of the motors: a fact with its level.
        failure: commands when a motor failed, which are drawn instead of the commands in the hover; None if none
            failed.

    Returns:
        The drawing; None if the positions or the commands of all motors are not known.
    """
    if motors is None:
        return None
    hover = None if condition is None else condition.hover
    if failure is not None:
        drawn = _DrawnCommands.of_failure(failure)
    elif hover is not None:
        drawn = _DrawnCommands.of_hover(hover)
    else:
        return None
    motor_count = len(drawn.commands)
    if len(motors.geometry.positions) != motor_count:
        return None
    # The outermost motor lies at RADIUS from the centre. The lower limit only avoids a division by zero.
    positions = np.array(motors.geometry.positions, np.float64)
    largest_distance = max(np.hypot(*positions.T).max(), 1e-9)
    positions *= RADIUS / largest_distance
    levels = motor_levels(light, np.array(drawn.imbalance))
    drawn_motors = []
    for index, (forward, right) in enumerate(positions.tolist()):
        command = float(drawn.commands[index])
        command_within_range = min(max(command, 0.0), 1.0)
        drawn_motors.append(
            {
                "name": index + 1,
                "x": round(right, 1),
                "y": round(-forward, 1),
                # An arc of the rim is as long, in % of the turn, as the command in % of the range.
                "arc": round(100 * command_within_range, 1),
                "command": f"{100 * command:.0f} %",
                "remark": drawn.remarks[index],
                "level": levels[index],
            }
        )
    motor_texts = [
        f"motor {motor['name']} {motor['command']}, {motor['remark']}" for motor in drawn_motors
    ]
    svg = figure_as_svg("frame", motors=drawn_motors, size=_disc_radius(positions))
    return Plan(drawn.title, f"{drawn.description}: {listed(motor_texts)}.", svg)


def _disc_radius(positions: Array) -> float:
    """Returns the radius of a disc with full command, in units of the drawing: neighbouring discs do not overlap.

    Args:
        positions: (k, 2) places of the motors in the drawing. Two motors at one place, one above the other, share it.
    """
    radii = [MAX_DISC_RADIUS]
    for first, second in combinations(positions.tolist(), 2):
        distance = dist(first, second)
        if distance > MIN_MOTOR_DISTANCE:
            radii.append(distance / 2)
    return min(radii)


def motor_levels(light: Fact, imbalance: Array) -> list[Level]:
    """Returns for each motor the level in whose colour it is drawn, so that the drawing agrees with the status light.

    1. If the light does not warn, all motors have its level.
    2. If it warns of one motor, that motor has its level, and the others are good.
    3. If it warns without naming a motor, the motors whose trim deviates as much as after a fault have its level, and
       the others are good; if no motor deviates so much, all have its level.

    Args:
        light: the judgement of the motors, a coded finding with a level and, as its subject, the motor.
        imbalance: (M,) trim deviation of each motor, percent.
    """
    motor_count = len(imbalance)
    if not light.is_watch_or_bad:
        return [light.level] * motor_count
    named_motor = motor_number(light.subject)
    if named_motor is not None:
        is_warned_of = np.arange(1, motor_count + 1) == named_motor
    else:
        is_warned_of = abs(imbalance) > 100 * FAULT_RISE
    if not is_warned_of.any():
        return [light.level] * motor_count
    levels = []
    for is_bad_motor in is_warned_of:
        levels.append(light.level if is_bad_motor else Level.GOOD)
    return levels


def rose_of_wind(wind: WindVelocity) -> Plan:
    """Returns the wind rose of a flight: for each direction, how much of the time wind came from there, by speed.

    Args:
        wind: the estimated wind of the flight, with speed and direction at each sample.

    Returns:
        The drawing, in percent of the time, with an arrow for the mean direction.
    """
    polar = wind.polar
    description = (
        f"The wind came from {compass_text(wind.direction)}, {wind.mean_speed:.1f} m/s in the mean."
    )
    percent_per_sample = 100 / len(polar.speed)
    return _wind_rose(description, polar.direction, polar.speed, percent_per_sample, wind.direction)


def rose_of_flights(winds: Array) -> Plan:
    """Returns the wind rose of a fleet: the number of flights with wind from each direction, by speed.

    Args:
        winds: mean wind of each flight (N, 2): direction that it comes from, rad, and speed, m/s.
    """
    direction, speed = winds.T
    description = f"How many of {len(winds)} flights had wind from where, and how strong."
    return _wind_rose(description, np.degrees(direction), speed, 1.0)


def wind_dots_of_flights(winds: Array) -> Plan:
    """Draws the mean wind of each of a few flights as a dot, in its direction from the centre and as far as its speed.

    Args:
        winds: mean wind of each flight (N, 4): direction that it comes from, rad; speed, m/s; and both ends of the 90 %
            interval of the speed.

    Returns:
        The drawing, with two rings at round speeds, and a line along the interval of each speed.
    """
    # The outer ring is at an even number of m/s that no interval exceeds, and the inner one at half of it.
    outer_speed = 2 * max(int(np.ceil(winds[:, 1:].max() / 2)), 1)
    rings = [(RADIUS / 2, f"{outer_speed // 2} m/s"), (RADIUS, f"{outer_speed} m/s")]
    dots = []
    for direction, speed, low, high in winds.tolist():
        radii = [round(RADIUS / outer_speed * value, 1) for value in (speed, low, high)]
        dots.append((round(degrees(direction), 1), *radii))
    subject = "The dot shows" if len(winds) == 1 else "Each dot shows"
    description = (
        f"{subject} where the wind of a flight came from, and how strong it was; the line is the 90 % interval "
        "of the speed."
    )
    svg = figure_as_svg("rose", petals=(), rings=rings, arrow=None, dots=dots)
    return Plan("Wind", description, svg)


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


class _SpeedClass(NamedTuple):
    """A class of wind speed in the key of a wind rose."""

    name: str
    """Its limits, such as "2 to 4 m/s"."""

    opacity: float
    """Opacity of its petals."""


def _wind_rose(
    description: str,
    direction: Array,
    speed: Array,
    weight: float,
    mean_direction: float | None = None,
) -> Plan:
    """Draws a wind rose: a histogram of the wind over ``SECTOR_COUNT`` directions, stacked by classes of speed.

    Each direction has one petal for each class of speed, stacked outwards with the slowest class in the middle. The
    length of a petal is the count of its class, so that all petals together reach to the count of the direction.

    Args:
        description: text that describes the drawing.
        direction: (N,) directions that the wind comes from, degrees.
        speed: (N,) wind speeds, m/s.
        weight: what each of the N winds counts: 1 if they are flights, otherwise a percentage of the time.
        mean_direction: direction, degrees, from which an arrow shows the mean wind; None without an arrow.

    Returns:
        The drawing, with two rings that show the scale.
    """
    sector = np.rint(direction / SECTOR_WIDTH).astype(int) % SECTOR_COUNT
    bin_edges = (SPEED_CLASS_LIMITS, np.arange(SECTOR_COUNT + 1))
    # How often each class of speed came from each direction (classes, sectors), in the unit of the weight.
    counts = weight * np.histogram2d(speed, sector, bin_edges)[0]
    # The petals of a class begin where those of the slower class end: at the counts, summed over the classes.
    petal_edges = np.vstack([np.zeros(SECTOR_COUNT), counts.cumsum(axis=0)])
    outer_count = _count_of_outer_ring(petal_edges.max())
    # The length that is drawn for a count of 1.
    length_per_count = RADIUS / outer_count
    # The key has the classes of speed that occur.
    occurring_classes = np.flatnonzero(counts.any(axis=1)).tolist()
    svg = figure_as_svg(
        "rose",
        petals=_petals(petal_edges, length_per_count),
        rings=_rings_of_rose(outer_count, unit="" if weight == 1.0 else " %"),
        arrow=mean_direction,
        classes=[_speed_class(number) for number in occurring_classes],
    )
    return Plan("Wind rose", description, svg)


def _count_of_outer_ring(max_count: float) -> float:
    """Returns the count at the outer ring of a wind rose, which no petal exceeds.

    From 2 on it is an even number, so that the labels of both rings are whole numbers, one half the other.

    Args:
        max_count: count of the longest petal; 0 if there is none.
    """
    if max_count < 2:
        # The lower limit only avoids a division by zero where nothing is drawn.
        return max(max_count, 1e-9)
    return 2.0 * ceil(max_count / 2)


def _rings_of_rose(outer_count: float, unit: str) -> list[tuple[float, str]]:
    """Returns the two rings that show the scale of a wind rose.

    Args:
        outer_count: count at the outer ring.
        unit: unit of the counts, with a space before it; empty if they are numbers of flights.

    Returns:
        The radius of each ring, and its label: the count at that radius, such as "10 %".
    """
    decimals = 0 if outer_count >= 2 else 1
    return [
        (RADIUS / 2, f"{outer_count / 2:.{decimals}f}{unit}"),
        (RADIUS, f"{outer_count:.{decimals}f}{unit}"),
    ]


def _speed_class(number: int) -> _SpeedClass:
    """Returns a class of wind speed for the key of a wind rose, by its number, from 0 for the slowest on."""
    low, high = SPEED_CLASS_LIMITS[number], SPEED_CLASS_LIMITS[number + 1]
    name = f"{low} to {high} m/s" if np.isfinite(high) else f"above {low} m/s"
    return _SpeedClass(name, _opacity(number))


def _petals(edges: Array, scale: float) -> list[_Petal]:
    """Returns the petals of a wind rose that have a length.

    Args:
        edges: (classes + 1, sectors) counts at which the petal of each class of speed begins and ends, by direction.
        scale: length that is drawn for a count of 1.
    """
    petals = []
    for speed_class, (inner_edges, outer_edges) in enumerate(pairwise(edges)):
        opacity = _opacity(speed_class)
        for sector in range(SECTOR_COUNT):
            inner_radius = scale * inner_edges[sector]
            outer_radius = scale * outer_edges[sector]
            if outer_radius > inner_radius:
                petals.append(_Petal(sector, inner_radius, outer_radius, opacity))
    return petals


def _opacity(speed_class: int) -> float:
    """Returns the opacity of the petals of a class of speed, from 0 for the slowest on."""
    return LOWEST_OPACITY + OPACITY_PER_SPEED_CLASS * speed_class


def figure_as_svg(macro: str, **values: Any) -> Markup:
    """Returns the ``<svg>`` that a macro of ``plans.html`` makes of values."""
    macros = environment().get_template("plans.html").module
    return Markup(getattr(macros, macro)(**values))
