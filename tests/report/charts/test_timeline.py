"""The timeline: the wind's speed and direction, each where it is identifiable, with the autopilot's own estimate."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark

from mavdem.assessment.time_history import (
    AxisHistory,
    FollowedSetpoint,
    TimeHistory,
    wind_history,
)
from mavdem.dataset.segments import Segment
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact
from mavdem.facts.event import Event
from mavdem.facts.identifiability import Status
from mavdem.facts.session import VehicleFact
from mavdem.report.charts.chart import over_time
from mavdem.report.charts.timeline import (
    Timeline,
    axis_history_charts,
    height_chart,
    history_timeline,
    wind_speed_and_direction_charts,
)
from mavdem.wind_velocity.from_log import WindEvidence
from mavdem.wind_velocity.velocity import WindVelocity

TIME = np.arange(0.0, 10.0)
SPEED = 5.0
DIRECTION = 270.0  # Degrees; the wind comes from the west, so that the air moves east.
AUTOPILOT_SPEED = 4.0


def wind(speed=Status.REPORTED, direction=Status.REPORTED):
    """A steady wind of ``SPEED`` from ``DIRECTION``, with the status of its speed and direction."""
    velocity = np.tile([0.0, SPEED], (len(TIME), 1))
    return WindVelocity(
        speed=SPEED,
        speed_interval=(4.0, 6.0),
        mean_speed=5.0,
        mean_speed_interval=(4.0, 6.0),
        direction=DIRECTION,
        direction_interval=10.0,
        gust=SPEED,
        gust_interval=(SPEED, SPEED),
        gust_seconds=3.0,
        turbulence_intensity=0.0,
        time=TIME,
        velocity=velocity,
        band=np.ones_like(velocity),
        along=np.zeros_like(velocity),
        air_velocity=-velocity,
        minutes=(),
        profile=(),
        drag=None,
        status={"speed": speed, "direction": direction, "drag": Status.REPORTED},
        reasons={},
    )


def charts(estimate):
    """The charts of a wind, beside which the autopilot estimated ``AUTOPILOT_SPEED`` from the same direction."""
    values = np.tile([0.0, AUTOPILOT_SPEED], (len(TIME), 1))
    autopilot = TimeSeries(TIME, np.zeros(len(TIME), int), values)
    segment = Segment(0, TIME[0], TIME[-1])
    history = wind_history(WindEvidence(estimate, autopilot, None), segment)
    return [*wind_speed_and_direction_charts(history)]


def test_a_direction_about_north_is_one_line_on_an_axis_of_compass_points():
    velocity = np.column_stack([np.full(10, -5.0), np.where(TIME < 5, -0.5, 0.5)])
    north = replace(wind(), velocity=velocity, direction=0.0)
    _, direction = charts(north)
    line = direction.lines[0]
    assert np.isfinite(line.y).all() and abs(np.diff(line.y)).max() < 20
    assert [(tick.value, tick.name) for tick in direction.y.ticks] == [
        (-90, "W"),
        (-45, "NW"),
        (0, "N"),
        (45, "NE"),
    ]
    low, high = direction.y.limits
    for line in direction.lines:
        assert low <= np.nanmin(line.y) and np.nanmax(line.y) <= high


def test_a_direction_breaks_opposite_to_the_mean():
    """The wind is from west in the mean, and turns past east."""
    velocity = np.column_stack([np.where(TIME < 5, -0.5, 0.5), np.full(10, -5.0)])
    _, direction = charts(replace(wind(), velocity=velocity))
    line = direction.lines[0]
    assert line.y.size == 11 and np.isnan(line.y[5]) and line.x[5] == 4.5


def test_speed_is_drawn_in_metres_per_second_and_direction_in_degrees():
    speed, direction = charts(wind())
    assert speed.y.label == "Wind, m/s" and direction.y.label == "direction (°)"
    assert_allclose([line.y[0] for line in speed.lines], [SPEED, AUTOPILOT_SPEED])
    assert_allclose([line.y[0] for line in direction.lines], DIRECTION)


def test_of_a_speed_that_is_not_identifiable_only_the_band_is_drawn():
    speed, direction = charts(wind(speed=Status.NOT_IDENTIFIABLE))
    assert np.isnan(speed.lines[0].y).all() and "only its 90 % band" in speed.title
    assert_allclose(speed.lines[0].lower_edge, SPEED - 1.0)
    assert "Wind from W" in direction.title and direction.y.label == "direction (°)"
    assert [line.name for line in direction.lines] == ["wind", "autopilot's own"]
    assert_allclose([line.y[0] for line in direction.lines], DIRECTION)


@mark.parametrize("lowest_speed", [0.0, 4.0])
def test_without_a_direction_only_the_speed_is_drawn(lowest_speed):
    estimate = replace(wind(direction=Status.NOT_IDENTIFIABLE), speed_interval=(lowest_speed, 6.0))
    (speed,) = charts(estimate)
    assert_allclose([line.y[0] for line in speed.lines], [SPEED, AUTOPILOT_SPEED])
    assert_allclose(speed.lines[0].lower_edge, SPEED - 1.0)


def angle_charts(axis):
    """The charts of an angle that turns by more than two turns in 10 s, with its setpoint 2° ahead."""
    angle = np.radians(np.linspace(0.0, 800.0, len(TIME)))
    measured = TimeSeries(TIME, np.zeros(len(TIME), int), angle)
    followed = FollowedSetpoint(measured, angle + np.radians(2.0), "rad")
    return axis_history_charts(axis, AxisHistory(angle=followed, rate=None))


def test_yaw_is_drawn_within_half_a_turn_to_both_sides():
    (chart,) = angle_charts("yaw")
    for line in chart.lines:
        finite = line.y[np.isfinite(line.y)]
        assert len(finite) == len(TIME)
        assert (abs(finite) <= 180).all()
        assert abs(np.diff(line.y))[np.isfinite(np.diff(line.y))].max() <= 180
        assert np.isnan(line.y).sum() == 2
    (roll,) = angle_charts("roll")
    assert roll.lines[1].y.max() == approx(800)


def test_the_first_plots_of_a_page_are_roll_and_pitch_with_their_setpoints():
    axis_charts = {axis: angle_charts(axis) for axis in ("roll", "pitch", "yaw")}
    timeline = Timeline((), (TIME[0], TIME[-1]), axis_charts)
    (group,) = timeline.overview_groups
    assert [chart.title for chart in group.columns[0]] == ["Roll", "Pitch"]
    assert not timeline.overview


def test_a_page_has_four_plots_over_time_at_full_width_and_the_others_beside_each_other():
    (line,) = angle_charts("roll")[0].lines[:1]
    charts = tuple(over_time(f"plot {number}", "m", [line]) for number in range(9))
    marked = Event(TIME[0], Fact(VehicleFact.NO_VEHICLE_YET))
    timeline = Timeline(charts, (TIME[0], TIME[-1]), events=(marked,))
    first, other_groups = timeline.overview_groups
    assert [len(column) for column in first.columns] == [4] and not first.is_flat
    assert [len(column) for column in other_groups.columns] == [2, 2, 1] and other_groups.is_flat
    assert all(len(chart.marks) == 1 for column in other_groups.columns for chart in column)
    # A fifth plot alone stays with the first four.
    (group,) = timeline._replace(flight_charts=charts[:5]).overview_groups
    assert [len(column) for column in group.columns] == [5]


def test_a_lost_height_leaves_the_plot_and_a_battery_has_the_limit_that_it_crossed():
    boot = np.zeros(len(TIME), int)
    measured = TimeSeries(TIME, boot, 10 * np.sin(TIME))
    lost = TimeSeries(TIME, boot, -500 * TIME)
    history = TimeHistory(
        segment=Segment(0, TIME[0], TIME[-1]),
        height=lost,
        barometer_height=measured,
        satellite_height=None,
        motors=None,
        voltages={"battery": TimeSeries(TIME, boot, 12 - 0.3 * TIME)},
        voltage_limits={"critical": 10.5},
        axes={},
        wind=None,
        modes=(),
        events=(),
        position=None,
    )
    height, battery = history_timeline(history).flight_charts
    lowest, highest = height.y.limits
    assert lost.values.min() < lowest < measured.values.min()
    assert measured.values.max() < highest < 2 * measured.values.max()
    assert [line.name for line in battery.lines] == ["battery", "critical"]
    assert_allclose(battery.lines[1].y, 10.5)
    # An estimate that is wrong by little determines the axis with the measured height.
    near = history_timeline(replace(history, height=replace(lost, values=2 * measured.values)))
    assert near.flight_charts[0].y.limits is None
    # The page of the wind has the height by satellites alone too, whatever its title.
    satellites = replace(history, height=None, barometer_height=None, satellite_height=measured)
    assert [line.name for line in height_chart(satellites).lines] == ["satellites"]
