"""Charts of the flights of two logs over each other."""

from dataclasses import replace

import numpy as np
from hover import Hover, asking, only
from numpy.testing import assert_allclose
from pytest import approx, mark

from mavdem.dataset.signals import Signals
from mavdem.report.charts.chart import Group, Line, over_time
from mavdem.report.charts.comparison_charts import (
    FLIGHT_SERIES_TITLES,
    HEIGHT,
    MEAN_MOTOR_OUTPUT,
    MEAN_SECONDS,
    MOTOR_OUTPUTS,
    ROLL,
    ROLL_ERROR,
    VIBRATIONS,
    flight_series,
    flight_series_charts,
    start_on_boot_clock,
    time_in_flight,
)
from mavdem.report.pages.page import Chapter, render_document
from mavdem.serve.stored_files import SERIES_FILE
from mavdem.serve.stored_series import read_series, write_series

FLOWN = Hover(sway=0.2).telemetry(20.0, 20.0)


def test_a_flight_that_began_before_the_record_is_drawn_from_its_beginning_on():
    begun = only(FLOWN, lambda time: time > 20.0)
    series = flight_series(Signals(begun))
    # The record begins about 20 s after boot, which is where the charts begin.
    assert start_on_boot_clock(series) == approx(20.0, abs=0.5)
    assert time_in_flight(series, 25.0, boot=0) == approx(5.0, abs=0.5)
    assert time_in_flight(series, 25.0, boot=1) is None
    assert time_in_flight(series, 19.0, boot=0) is None
    for times, values in series.values():
        assert np.isfinite(values).all()
        assert 0.0 <= times[0] < 1.0


def test_heights_of_both_flights_begin_at_zero():
    """Logs have heights above different points, such as one that begins in the air 12 m above its home."""
    times = np.array([0.0, 1.0])
    flights = {
        "A": {HEIGHT: np.array([times, [12.0, 13.0]])},
        "B": {HEIGHT: np.array([times, [0.0, 2.0]])},
    }
    colours = {"A": "#1f7ad6", "B": "#dd5a2f"}
    [chart] = flight_series_charts(flights, {"A": "A", "B": "B"}, colours)
    assert [line.y.tolist() for line in chart.lines] == [[0.0, 1.0], [0.0, 2.0]]


def test_the_error_of_an_angle_is_drawn_only_where_its_setpoint_was_recorded():
    time = np.arange(25.0, 35.0, 0.1)
    signals = Signals(asking(FLOWN, time, 7, None, np.full(len(time), np.radians(3.0))))
    series = flight_series(signals)
    error_times, errors = series[ROLL_ERROR]
    roll_times, rolls = series[ROLL]
    assert_allclose(errors + 3.0, np.interp(error_times, roll_times, rolls), atol=1e-6)
    assert ROLL_ERROR not in flight_series(Signals(FLOWN))


def test_stored_series_are_drawn_as_those_of_the_log(tmp_path):
    """The series of a flight are written to a file and read again, and drawn beside the original ones."""
    vibration = np.linspace(1.0, 4.0, 50)
    time = np.linspace(1.0, 39.0, 50)
    levels = {
        f"vibration_{axis}": scale * vibration for axis, scale in zip("xyz", (1, 3, 2), strict=True)
    }
    clips = {f"clipping_{number}": np.zeros(50) for number in range(3)}
    boot = np.zeros(50, int)
    message = {"time": time, "boot": boot} | levels | clips
    vibrating = replace(FLOWN, messages={**FLOWN.messages, "VIBRATION": message})
    series = flight_series(Signals(vibrating))
    write_series(tmp_path, series)
    stored = read_series(tmp_path)
    sides = {"A": stored, "B": series}
    charts = list(flight_series_charts(sides, {"A": "a", "B": "b"}, {"A": "blue", "B": "red"}))
    titles = [chart.title for chart in charts]
    assert titles == [title for title in FLIGHT_SERIES_TITLES if title in titles]
    for chart in charts:
        line_a, line_b = chart.lines
        assert_allclose(line_a.y, line_b.y, rtol=1e-6)
    assert charts[-1].title == VIBRATIONS[0] and charts[-1].lines[0].y.max() > 9.0


def test_outputs_of_motors_are_means_over_half_a_second_on_one_scale():
    """All four charts of motors have the same range, and their mean is that of the collective."""
    signals = Signals(FLOWN)
    motors = signals.motors
    series = flight_series(signals)
    titles = [title for title in MOTOR_OUTPUTS if title in series]
    assert len(titles) == len(motors.geometry.names) == 4
    airborne = series[MEAN_MOTOR_OUTPUT]
    for title in titles:
        times, means = series[title]
        assert np.all(np.diff(times) > 0)
        assert len(times) == approx(np.ptp(airborne[0]) / MEAN_SECONDS, abs=2)
    mean_of_motors = np.mean([series[title][1].mean() for title in titles])
    assert mean_of_motors == approx(airborne[1].mean(), abs=1.0)
    charts = flight_series_charts({"A": series}, {"A": "a"}, {"A": "blue"})
    (limits,) = {chart.y.limits for chart in charts if chart.title in titles}
    level = [values[(times > 5.0) & (times < 35.0)] for times, values in map(series.get, titles)]
    assert limits[0] < np.min(level) and limits[1] > np.max(level)


def test_a_scale_leaves_out_take_off_and_landing_but_no_crash():
    """The motors run up from 10 % and down again; roll ends upright or, in a crash, at 80°."""
    times = np.arange(0.0, 61.0)
    outputs = 60.0 + np.sin(times)
    outputs[[0, -1]] = 10.0
    limits = {}
    for roll_at_end in (1.0, 80.0):
        rolls = np.append(np.cos(times[:-1]), roll_at_end)
        flight = {MEAN_MOTOR_OUTPUT: np.array([times, outputs]), ROLL: np.array([times, rolls])}
        roll, output = flight_series_charts({"A": flight}, {"A": "A"}, {"A": "#1f7ad6"})
        assert roll.y.limits is None
        limits[roll_at_end] = output.y.limits
    assert limits[1.0] == approx((58.5, 61.5), abs=0.1)
    assert limits[80.0] is None


def test_a_flight_without_stored_series_or_with_damaged_ones_has_none(tmp_path):
    assert read_series(tmp_path) is None
    write_series(tmp_path, flight_series(Signals(FLOWN)))
    file = tmp_path / SERIES_FILE
    content = file.read_bytes()
    for damaged in (b"", content[:-30], content[:200] + bytes(60) + content[260:]):
        file.write_bytes(damaged)
        assert read_series(tmp_path) is None


SPAN = """new Promise(done => {
  const ready = () => {
    const flight = document.documentElement.charts?.groups.flight;
    flight?.span ? done(flight.span) : setTimeout(ready, 20);
  };
  ready();
})"""


@mark.slow
def test_charts_of_a_group_without_limits_show_all_of_their_lines(tmp_path, browser):
    time = np.linspace(20.0, 80.0, 7)
    chart = over_time("Height", "m", [Line("height", "#1f7ad6", time, time)])
    page = render_document("a", "b", [], [Chapter("c", (), [Group.side_by_side([chart])])])
    _, span = browser.shown(page, SPAN, tmp_path)
    assert span == [20.0, 80.0]
