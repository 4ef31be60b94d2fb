"""The history of a live flight: errors as they are by hand, lines with their gaps, and bounded memory."""

import numpy as np
from live_rows import DT, REPORTED_HORIZON, add_flight
from numpy.testing import assert_allclose
from pytest import approx, mark

from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.live import history as live_history
from mavdem.live.history import MAX_EVENTS, TIME_COLUMN, LiveHistory
from mavdem.report.charts.timeline import live_timeline


@mark.slow
def test_errors_count_learned_samples_whose_time_has_come():
    add_flight(history := LiveHistory(), 1.0, learnt=False)
    assert history.errors() == [] and history.learned_intervals == []
    assert np.isfinite(history.table[:, 2]).sum() == 100
    history = LiveHistory()
    _, motion = add_flight(history, 5.0)
    short, long = history.errors()
    assert (short.seconds, long.seconds) == REPORTED_HORIZON
    assert (short.samples, long.samples) == (499, 475)
    assert_allclose(long.mse, [0.01, 0.04])
    assert_allclose(long.baseline_mse, np.mean((motion[25:] - motion[:-25]) ** 2, axis=0))
    assert_allclose(long.coverage, [0, 1])


@mark.slow
def test_nothing_is_compared_across_a_gap_and_lines_break_there():
    """Predictions from before a gap of 1 s are not compared with samples after it.

    The predictions of the made-up flight are all 0.1 too large.
    """
    history = LiveHistory()
    add_flight(history, 1.0)
    add_flight(history, 2.0, segment=1, start=103.0)
    assert [error.samples for error in history.errors()] == [298, 250]
    _, _, measured, predicted, *_ = history.table.T
    has_prediction = np.isfinite(predicted)
    assert_allclose(predicted[has_prediction], measured[has_prediction] + 0.1)
    assert history.learned_intervals == [approx((100.0, 100.99)), approx((103.0, 104.99))]


@mark.slow
def test_what_is_withdrawn_from_the_model_leaves_no_errors_of_predictions():
    sound = LiveHistory()
    add_flight(sound, 5.0)
    lost = LiveHistory()
    add_flight(lost, 5.0)
    for time in np.arange(105.0, 107.0, DT):
        lost.add_row(0, time, np.array([3.0, 9.0]), None)
    assert lost.errors()[1].mse[0] > sound.errors()[1].mse[0]
    lost.forget_learned_since(105.0)
    for after_withdrawal, expected in zip(lost.errors(), sound.errors(), strict=True):
        assert after_withdrawal.samples == expected.samples
        assert_allclose(after_withdrawal.mse, expected.mse)


@mark.slow
def test_slow_samples_after_rows_are_drawn():
    """While a vehicle lands there are no rows, only samples that are ten times as far apart."""
    history = LiveHistory()
    add_flight(history, 5.0)
    for time in np.arange(105.0, 108.0, live_history.SAMPLE_PERIOD):
        history.add_row(0, time, np.array([0.5, 0.0]), None)
    chart = live_timeline(history, "roll").flight_charts[0]
    [measured] = [line for line in chart.thinned(2000).lines if line.name == "measured"]
    assert np.isfinite(measured.y[measured.x < 107.8]).all() and measured.x[-1] > 107.8


@mark.slow
def test_rows_of_a_time_that_samples_have_shown_are_not_drawn_again():
    history = LiveHistory()
    add_flight(history, 2.0, learnt=False)
    # The first rows come together, a second later than the samples that stood for them.
    add_flight(history, 3.0, segment=1, start=101.0)
    times = history.table[:, TIME_COLUMN]
    assert np.all(np.diff(times) >= 0)
    assert times[-1] == approx(104.0, abs=2 * DT)
    # What was learned from does not depend on what is drawn.
    assert history.learned_intervals[0][0] == approx(101.0)


@mark.slow
def test_the_timeline_goes_on_after_a_reboot():
    history = LiveHistory()
    add_flight(history, 3.0)
    add_flight(history, 3.0, segment=1, start=5.0, boot=1)
    assert history.learned_intervals == [approx((100.0, 102.99)), approx((103.99, 106.98))]
    assert [error.samples for error in history.errors()] == [598, 550]
    assert history.now == approx(106.98) and history.timeline_offset == approx(98.99)
    # What was withdrawn from the model is no longer shaded as learned from.
    history.forget_learned_since(6.0)
    assert history.learned_intervals == [approx((100.0, 102.99)), approx((103.99, 104.99))]


@mark.slow
def test_plots_show_the_latest_flight_from_its_takeoff_on_the_clock_of_its_boot():
    """Nothing of an earlier flight, of the ground before the take-off or long after the landing is shown."""
    history = LiveHistory()
    add_flight(history, 3.0)
    history.note_flight(1, 100.0)
    history.advance(0.5, 1)
    add_flight(history, 3.0, segment=1, start=4.0, boot=1)
    history.note_flight(2, 5.0)
    assert (history.flight.number, history.flight.boot) == (2, 1)
    # Seconds on the ground, of which only the first are shown.
    add_flight(history, 12.0, segment=2, start=7.0, boot=1, learnt=False)
    timeline = live_timeline(history, "roll")
    last_shown = 7.0 + live_history.SECONDS_AFTER_LANDING
    assert timeline.span == (approx(5.0, abs=2 * DT), approx(last_shown, abs=2 * DT))
    assert timeline.grey_intervals[0] == approx((5.0, 6.99), abs=2 * DT)
    assert len(timeline.grey_intervals) == 1
    chart, *_ = timeline.overview
    assert chart.x.label == "time since boot 2 (s)"


def test_no_line_is_drawn_over_the_time_without_messages_of_a_restart():
    history = LiveHistory()
    add_flight(history, 1.0, learnt=False)
    history.advance(0.5, 1, restart_seconds=20.0)
    # Before rows begin again, the samples may be of the same segment.
    add_flight(history, 1.0, start=1.0, boot=1, learnt=False)
    chart, *_ = live_timeline(history, "roll").overview
    thinned = chart.thinned(2000)
    during_restart = (thinned.lines[0].x > 102.0) & (thinned.lines[0].x < 120.0)
    assert during_restart.any() and np.isnan(thinned.lines[0].y[during_restart]).all()


def test_a_restart_that_takes_long_is_as_long_on_the_timeline():
    history = LiveHistory()
    history.advance(100.0, 0)
    history.advance(0.5, 1, restart_seconds=28.0)
    assert history.now == approx(128.0) and history.boot_start == approx(128.0)
    history.advance(1.5, 1, restart_seconds=28.0)
    assert history.now == approx(129.0)


@mark.slow
def test_a_long_flight_keeps_its_shape_in_bounded_memory(monkeypatch):
    """A flight of 1000 rows is thinned out to 100. Its ends and the gaps between its segments stay."""
    monkeypatch.setattr(live_history, "MAX_ROWS", 100)
    history = LiveHistory()
    add_flight(history, 10.0)
    time = history.table[:, 1]
    assert len(time) <= 100
    assert time[0] == approx(100.0, abs=0.2) and time[-1] == approx(110.0, abs=0.2)
    for segment in (1, 2, 3):
        add_flight(history, 2.0, segment, 110.0 + 5 * segment)
    roll_chart = live_timeline(history, "roll").flight_charts[0]
    (measured,) = (line for line in roll_chart.lines if line.name == "measured")
    assert np.isnan(measured.y).sum() == 3
    # No line is drawn across a gap.
    assert np.diff(measured.x)[~np.isnan(measured.y[1:])].max() < 1.0


def test_the_torque_of_a_motor_is_no_wind():
    history = LiveHistory()
    add_flight(history, 1.0)
    history.clear_wind_torque(100.5)
    torque = history.table[:, 5]
    assert np.isnan(torque[history.table[:, 1] >= 100.5]).all() and (torque[:50] == 1.0).all()


def test_a_flood_of_alarms_is_thinned_out_and_counted_and_hides_no_takeoff():
    history = LiveHistory()
    takeoff = Event(0.0, Fact(ReportedEvent.OFF_GROUND, time=0.0))
    history.add_event(takeoff)
    for number in range(3 * MAX_EVENTS):
        alarm = Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD, time=float(number))
        history.add_event(Event(float(number), alarm))
    assert len(history.events) <= MAX_EVENTS and history.alarm_count == 3 * MAX_EVENTS
    assert history.events[0] is takeoff
    # The latest are all there.
    latest_times = [event.seconds for event in history.events[-MAX_EVENTS // 4 :]]
    assert_allclose(np.diff(latest_times), 1.0)
