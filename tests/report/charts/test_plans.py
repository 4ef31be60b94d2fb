"""Drawings: the motors have the colour of their light, and the path is one of pieces by height and mode."""

import re

import numpy as np
from numpy.testing import assert_allclose

from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending
from mavdem.facts.event import Event
from mavdem.facts.motors import MotorsLight
from mavdem.report.charts.chart import Span
from mavdem.report.charts.flown_path import MapWind, flown_path
from mavdem.report.charts.plans import motor_levels, rose_of_flights
from mavdem.report.charts.timeline import Timeline

EVEN = np.zeros(4)
TWISTED = np.array([12.0, 12.0, -12.0, -12.0])
CODE = next(iter(MotorsLight))


def test_the_motor_that_the_light_names_has_its_level():
    light = Fact(CODE, Level.BAD, subject="motor 2 (rear left)")
    assert motor_levels(light, EVEN) == [Level.GOOD, Level.BAD, Level.GOOD, Level.GOOD]


def test_a_light_that_names_no_motor_colours_those_that_deviate_or_all():
    light = Fact(CODE, Level.WATCH)
    one_deviates = np.array([12.0, 0.0, 0.0, -1.0])
    assert motor_levels(light, one_deviates) == [Level.WATCH, *[Level.GOOD] * 3]
    assert motor_levels(light, EVEN) == [Level.WATCH] * 4


def test_no_motor_is_coloured_under_a_light_that_does_not_warn():
    for level in (Level.GOOD, Level.UNKNOWN):
        assert motor_levels(Fact(CODE, level), TWISTED) == [level] * 4


def test_a_path_changes_its_colours_with_height_and_mode():
    """A flight north climbs at 5 s, and changes its mode at 8 s."""
    time = np.linspace(0.0, 10.0, 101)
    north, east, down = 5 * time, 0 * time, -np.where(time < 4.95, 1.0, 20.0)
    position = TimeSeries(time, np.zeros(101, int), np.column_stack([north, east, down]))
    modes = (Span(0.0, 8.0, "Loiter"), Span(8.0, 10.0, "Land"))
    plan = flown_path(Timeline((), (0.0, 10.0), modes=modes, position=position))
    styles = re.findall(r'style="--height: (\S+); --mode: (\S+)"', str(plan.svg))
    heights, colours_of_modes = zip(*styles, strict=True)
    assert len(styles) == 3
    assert heights[0] != heights[1] == heights[2]
    assert colours_of_modes[0] == colours_of_modes[1] != colours_of_modes[2]
    # North is up: the path begins at the bottom of the drawing.
    low, step = plan.track["y"]["low"], plan.track["y"]["step"]
    assert_allclose([low, low + 65534 * step], [-100.0, 100.0], atol=0.1)


def test_a_vehicle_in_flight_is_drawn_with_heading_take_off_and_wind():
    """The map of a live flight, 1200 m to the north with the take-off halfway."""
    time = np.arange(1201.0)
    position = TimeSeries(time, np.zeros(1201, int), np.column_stack([time, 0 * time, -time]))
    timeline = Timeline(
        (), (0.0, 1200.0), position=position, takeoff=(600.0, 0.0, 0.0), heading=90.0
    )
    svg = str(flown_path(timeline, MapWind(270.0, (5.52, 8.6))).svg)
    # The latest place is at the top, 90° is to the right, and the take-off is in the middle.
    assert 'transform="translate(0.0 -100.0) rotate(90.0)"' in svg
    assert re.search(r'class="good" cx="-?0.0" cy="-?0.0"', svg)
    assert "take-off, rings every 400 m</span>" in svg and "vehicle</span>" in svg
    assert (
        'rotate(270.0)"><path class="arrow"' in svg
        and "5.5 to 8.6 m/s from W (270°)\N{NO-BREAK SPACE}→" in svg
    )
    logged = str(flown_path(timeline._replace(takeoff=None, heading=None)).svg)
    assert "start</span>" in logged and "end</span>" in logged
    loss = Event(900.0, Fact(Ending.CONTROL_LOST, Level.BAD, time=900.0))
    lost = str(flown_path(timeline._replace(events=(loss,))).svg)
    # Three quarters of the way north are a quarter of the drawing above its middle.
    assert 'class="loss"' not in logged and 'transform="translate(0.0 -50.0)"/>' in lost
    assert "lost at 900.0 s</span>" in lost


def test_without_a_position_there_is_no_path():
    assert flown_path(Timeline((), (0.0, 1.0))) is None
    still = TimeSeries(np.arange(4.0), np.zeros(4, np.int64), np.zeros((4, 3)))
    timeline = Timeline((), (0.0, 3.0), position=still)
    # A position that never changes was not measured; a vehicle that is received may stand on the ground.
    assert flown_path(timeline) is None
    assert flown_path(timeline._replace(heading=90.0)) is not None


def test_a_hover_fills_the_map_by_more_than_a_third_and_noise_on_the_ground_does_not():
    time = np.linspace(0.0, 10.0, 101)
    widths = []
    for size in (0.4, 0.02):
        north = size / 2 * np.sin(time)
        values = np.column_stack([north, 0 * time, 0 * time - 5.0])
        position = TimeSeries(time, np.zeros(101, int), values)
        plan = flown_path(Timeline((), (0.0, 10.0), position=position))
        widths.append(65534 * plan.track["y"]["step"])
    # The drawing is 300 wide.
    assert widths[0] > 100.0
    assert widths[1] < 10.0


def test_no_petal_of_a_wind_rose_passes_its_outer_ring():
    """Three flights have wind from the east: the outer ring, at 4, is the next even number."""
    winds = np.array([[np.pi / 2, 3.0]] * 3 + [[0.0, 3.0]])
    svg = rose_of_flights(winds).svg
    radii = [float(radius) for radius in re.findall(r'class="ring" r="([\d.]+)"', svg)]
    labels = re.findall(r'class="small"[^>]*>([^<]*)<', svg)
    petals = re.findall(r'class="petal" r="([\d.]+)" stroke-width="([\d.]+)"', svg)
    longest = max(float(middle) + float(width) / 2 for middle, width in petals)
    assert labels == ["2", "4"] and radii == [radii[1] / 2, radii[1]]
    assert_allclose(longest, radii[1] * 3 / 4, atol=0.2)
