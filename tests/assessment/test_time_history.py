"""The time history: one boot of a log, from shortly before arming to shortly after disarming, without short signals."""

from dataclasses import replace

import numpy as np
from hover import Hover, asking, changed, columns
from instrumented import instrumented
from numpy.testing import assert_allclose
from partial_records import partial_record
from pytest import approx, mark

from mavdem.assessment.shown_time import SECONDS_BETWEEN_BOOTS
from mavdem.assessment.time_history import SECONDS_AROUND_FLIGHT, time_history
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Unjudged
from mavdem.wind_velocity.from_log import WindEvidence
from mavdem.wind_velocity.velocity import WindVelocity

HOVER = Hover()
ARMED, DISARMED = 5.0, HOVER.landed + 1.0
HEARTBEAT_PERIOD = 1.0
NO_WIND = WindEvidence(None, None, Fact(Unjudged.NOT_JUDGED, reason=None))


def history_of(telemetry, *events):
    """The time history of a vehicle whose wind is not known."""
    signals = Signals(telemetry)
    return time_history(signals, learnability_of(signals).segments, NO_WIND, events)


def armed_from_20_to_40_s():
    """The vehicle, which is disarmed before 20 s and from 40 s on."""
    beats = HOVER.stamps(1.0)
    base_mode = np.where((beats >= 20.0) & (beats < 40.0), 129, 1)
    return changed(HOVER.telemetry(), "HEARTBEAT", base_mode=base_mode)


@mark.slow
def test_a_time_history_lasts_from_before_arming_to_after_disarming():
    history = history_of(armed_from_20_to_40_s())
    assert history.segment.start == approx(20.0 - SECONDS_AROUND_FLIGHT, abs=HEARTBEAT_PERIOD)
    assert history.segment.end == approx(40.0 + SECONDS_AROUND_FLIGHT, abs=HEARTBEAT_PERIOD)
    angle = history.axes["roll"].angle.measured
    assert angle.time[0] >= history.segment.start and angle.time[-1] <= history.segment.end
    assert_allclose(angle.values, HOVER.roll(angle.time))


@mark.slow
def test_setpoints_are_held_at_the_times_of_the_measured_signal():
    time = HOVER.stamps(10.0)
    setpoints = asking(HOVER.telemetry(), time, 0, HOVER.roll_rate(time), HOVER.roll(time))
    rate = history_of(setpoints).axes["roll"].rate
    age = rate.measured.time - np.floor(rate.measured.time * 10.0 + 1e-6) / 10.0
    assert rate.setpoint.shape == rate.measured.values.shape and rate.unit == "rad/s"
    assert_allclose(rate.setpoint, HOVER.roll_rate(rate.measured.time - age))
    assert history_of(HOVER.telemetry()).axes["roll"].rate.setpoint is None


@mark.slow
def test_motors_are_in_percent_of_their_range_and_of_their_mean():
    motors = history_of(HOVER.telemetry()).motors
    hovering = (motors.outputs.time > 20.0) & (motors.outputs.time < 40.0)
    assert motors.outputs.values[hovering].mean() == approx(60.0, abs=5.0)
    assert_allclose(motors.deviations.values.mean(axis=1), 0.0, atol=1e-9)
    assert_allclose(np.diff(motors.deviations.values), np.diff(motors.outputs.values), atol=1e-9)


@mark.slow
def test_the_barometer_begins_at_the_height_and_shows_where_that_diverged():
    telemetry = instrumented()
    position = telemetry.messages["LOCAL_POSITION_NED"]
    runaway = np.where(position["time"] > 30.0, 3.0 * (position["time"] - 30.0), 0.0)
    history = history_of(changed(telemetry, "LOCAL_POSITION_NED", z=position["z"] + runaway))
    height, barometer = history.height, history.barometer_height
    assert barometer.values[0] == approx(height.values[0], abs=0.5)
    assert barometer.value_at(29.0) == approx(height.value_at(29.0), abs=0.5)
    # The estimate dives, and the barometer does not.
    assert barometer.value_at(36.0) - height.value_at(36.0) == approx(18.0, abs=1.0)
    without = changed(telemetry, "SCALED_PRESSURE", altitude=120.0)
    assert history_of(without).barometer_height is None


@mark.slow
def test_the_flights_of_all_boots_are_drawn_one_after_the_other():
    """The same flight is recorded in two boots.

    The first one is drawn before the second, with a gap, and its events are shifted with it.
    """
    # The same flight in two boots; the second is analysed.
    telemetry = armed_from_20_to_40_s()
    messages = {}
    for name, table in telemetry.messages.items():
        messages[name] = {
            field: np.concatenate([values, values]) for field, values in table.items()
        }
        messages[name]["boot"] = np.repeat([0, 1], len(table["time"]))
    signals = Signals(replace(telemetry, messages=messages))
    settled = [Segment(1, 25.0, 35.0)]
    events = [
        Fact(ReportedEvent.MOTORS_ARMED, time=20.0, boot=0),
        # Before the part of its boot that is shown: at its place is the end of the first flight.
        Fact(ReportedEvent.MODE_CHANGED, time=10.0, boot=1),
    ]
    one_flight = time_history(signals, settled, NO_WIND, events)
    history = time_history(signals, settled, NO_WIND, events, has_all_flights=True)
    segment = history.segment
    assert (segment.boot, segment.end) == (1, one_flight.segment.end)
    period = one_flight.segment.duration + SECONDS_BETWEEN_BOOTS
    assert segment.start == approx(one_flight.segment.start - period)
    angle = history.axes["roll"].angle.measured
    assert set(angle.boot) == {1} and (np.diff(angle.time) > 0).all()
    earlier = angle.select(angle.time < one_flight.segment.start - 1.0)
    assert_allclose(earlier.values, HOVER.roll(earlier.time + period), atol=1e-6)
    assert [event.seconds for event in history.events] == [approx(20.0 - period)]


@mark.slow
def test_a_signal_with_a_single_sample_in_flight_is_left_out():
    telemetry = armed_from_20_to_40_s()
    for time, is_shown in (([0.0, 1.0, 30.0], False), ([0.0, 30.0, 31.0], True)):
        heights = columns(time, altitude_relative=np.array([1.0, 2.0, 3.0]))
        height = history_of(changed(telemetry, "ALTITUDE", **heights)).height
        assert (height is not None) is is_shown


@mark.slow
def test_a_receiver_gives_path_and_height_where_nothing_else_does():
    """The vehicle moves 0.001° north, 111.2 m, and climbs 5 m; without a fix the position is no place."""
    time = [10.0, 20.0, 30.0, 31.0]
    fixes = columns(
        time,
        fix_type=np.array([0, 3, 3, 3]),
        satellites_visible=12,
        lat=np.array([1, 500_000_000, 500_010_000, 500_010_000]),
        lon=np.array([1, 80_000_000, 80_000_000, 80_000_000]),
        alt=np.array([0, 600_000, 605_000, 605_000]),
    )
    history = history_of(changed(HOVER.telemetry(), "GPS_RAW_INT", **fixes))
    assert_allclose(history.satellite_height.values, [0.0, 5.0, 5.0], atol=1e-6)
    assert_allclose(history.position.values[:2], [[0, 0, 0], [111.2, 0, -5.0]], atol=0.1)


@mark.slow
def test_voltages_are_named_by_their_battery():
    time = HOVER.stamps(1.0)
    telemetry = changed(HOVER.telemetry(), "SYS_STATUS", **columns(time, voltage_battery=16000))
    (voltage,) = history_of(telemetry).voltages.values()
    assert list(history_of(telemetry).voltages) == ["battery"]
    assert_allclose(voltage.values, 16.0)
    assert not history_of(HOVER.telemetry()).voltages


@mark.slow
def test_events_of_another_boot_or_of_no_time_are_left_out():
    here = Fact(ReportedEvent.BATTERY_WARNED, time=20.0, boot=0)
    of_no_boot = Fact(ReportedEvent.BATTERY_WARNED, time=30.0)
    elsewhere = Fact(ReportedEvent.BATTERY_WARNED, time=20.0, boot=1)
    timeless = Fact(ReportedEvent.BATTERY_WARNED, boot=0)
    history = history_of(HOVER.telemetry(), here, of_no_boot, elsewhere, timeless)
    assert [event.fact for event in history.events] == [here, of_no_boot]


def test_without_an_attitude_there_is_no_time_history():
    assert history_of(HOVER.telemetry(without=("ATTITUDE",))) is None


def test_a_wind_of_another_boot_is_left_out():
    signals = Signals(HOVER.telemetry())
    wind = partial_record(WindVelocity, boot=0)
    of_other_boot = partial_record(WindVelocity, boot=1)
    history = time_history(signals, (), WindEvidence(wind, None, None), ())
    assert history.wind.estimate is wind
    assert time_history(signals, (), WindEvidence(of_other_boot, None, None), ()).wind is None
