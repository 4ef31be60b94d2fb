"""Limit cycles are found by their line, at the frequency they have; gusts, steps and a motor at its limit are none."""

import numpy as np
from hover import X_QUAD, Hover, changed, pulses, with_pulses
from numpy.random import default_rng
from pytest import approx, mark
from scipy.signal import cont2discrete, lfilter

from mavdem.assessment.condition import measure_condition
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.loops.limit_cycles import (
    Oscillation,
    continued_limit_cycle,
    detect_starting_limit_cycle,
)

HOVER = Hover(hovering=40.0)


def found(rate, command, hertz=100.0, offset=0.0, pitch=0.0):
    """Of a hover with a roll rate (N,), deg/s, and a roll command (N,), µs, that are functions of time, s."""
    return measure_condition(hover_signals(rate, command, hertz, offset, pitch)).oscillation


def hover_signals(rate, command, hertz=100.0, offset=0.0, pitch=0.0):
    """The hover that ``found`` judges."""
    telemetry = HOVER.telemetry(attitude_time=hertz, motor_time=hertz)
    time = HOVER.stamps(hertz)
    telemetry = with_limited_outputs(telemetry, X_QUAD, command(time), offset)
    roll_rate = np.radians(rate(time))
    return Signals(
        changed(telemetry, "ATTITUDE", rollspeed=roll_rate, pitchspeed=pitch * roll_rate)
    )


def with_limited_outputs(telemetry, signs, command, offset=0.0):
    """A flight whose motors follow a command (N,), µs, with these signs, within limits; the first has an offset, µs."""
    outputs = 1500.0 + np.outer(signs, command)
    outputs[0] += offset
    limited = np.where(pulses(telemetry) > 1000, outputs.clip(1150.0, 1990.0), 1000.0)
    return with_pulses(telemetry, limited)


def swinging(hertz, size):
    return lambda time: size * np.sin(2 * np.pi * hertz * time)


def gusts(size):
    """A rate in wind: white noise through the attitude loop's resonance, at 1.5 Hz with a damping of 0.4."""

    def series(time):
        omega = 3 * np.pi
        continuous = [1, 0], [1, 0.8 * omega, omega**2]
        (numerator,), denominator, _ = cont2discrete(continuous, time[1] - time[0])
        values = lfilter(numerator, denominator, default_rng(1).standard_normal(len(time)))
        return size * values / values.std()

    return series


@mark.slow
@mark.parametrize("hertz", [1.5, 7.0, 12.0])
def test_a_limit_cycle_has_its_frequency_rate_and_time_at_a_limit(hertz):
    """Roll swings at a frequency, Hz, with an amplitude of 85 °/s, and the motors between their limits.

    Pitch swings half as much.
    """
    limit_cycle = found(
        lambda time: swinging(hertz, 85.0)(time) + gusts(10.0)(time),
        lambda time: swinging(hertz, 900.0)(time) + gusts(40.0)(time),
        pitch=0.5,
    )
    assert limit_cycle.axis == "roll" and not limit_cycle.growing
    assert limit_cycle.frequency == approx(hertz, abs=0.25)
    assert limit_cycle.rate == approx(np.hypot(85.0 / np.sqrt(2), 10.0), rel=0.05)
    assert limit_cycle.at_limit > 0.5 and limit_cycle.seconds > 30
    assert limit_cycle.was_upright
    (other,) = limit_cycle.other_axes
    assert (other.axis, other.rate) == ("pitch", approx(limit_cycle.rate / 2))


YAW_QUAD = np.array([1.0, 1.0, -1.0, -1.0])
"""Sign of the yaw torque of the same motors."""


@mark.slow
def test_yaw_oscillates_like_the_other_axes():
    time = HOVER.stamps(100.0)
    yaw_rate = np.radians(swinging(6.0, 60.0)(time))
    limited = with_limited_outputs(HOVER.telemetry(), YAW_QUAD, swinging(6.0, 900.0)(time))
    turning = changed(limited, "ATTITUDE", yawspeed=yaw_rate)
    condition = measure_condition(Signals(turning))
    assert condition.oscillation.axis == "yaw" and not condition.oscillation.other_axes
    assert condition.oscillation.frequency == approx(6.0, abs=0.25)
    assert condition.oscillation.at_limit > 0.5


@mark.slow
def test_a_yaw_that_a_rolling_vehicle_shakes_does_not_oscillate_by_itself():
    time = HOVER.stamps(100.0)
    roll_rate = np.radians(swinging(7.0, 85.0)(time))
    limited = with_limited_outputs(HOVER.telemetry(), X_QUAD, swinging(7.0, 900.0)(time))
    turning = changed(limited, "ATTITUDE", rollspeed=roll_rate, yawspeed=0.2 * roll_rate)
    condition = measure_condition(Signals(turning))
    assert (condition.oscillation.axis, condition.oscillation.other_axes) == ("roll", ())


@mark.slow
@mark.parametrize("seconds, growing", [(12.0, True), (33.0, True), (45.0, False)])
def test_one_that_grows_is_found_before_motors_reach_their_limits(seconds, growing):
    def grows(size):
        return lambda time: np.exp((time - 50.0) / seconds) * swinging(5.0, size)(time)

    limit_cycle = found(grows(60.0), grows(120.0))
    assert (limit_cycle.growing, limit_cycle.at_limit) == (growing, 0)
    assert limit_cycle.frequency == approx(5.0, abs=0.25)


@mark.slow
def test_one_that_lasts_is_found_though_it_neither_grows_nor_reaches_a_limit():
    limit_cycle = found(swinging(4.0, 30.0), swinging(4.0, 60.0))
    assert not limit_cycle.growing and limit_cycle.at_limit == 0


@mark.slow
@mark.parametrize(
    "phase", [lambda t: 0.5 * t + 0.06 * t**2, lambda t: 3.0 * t], ids=["sweep", "sine"]
)
def test_what_is_steered_to_identify_is_none(phase):
    """Sweeps from 0.5 to 5 Hz and sines of up to 3 Hz, as ArduPilot's system identification mode flies them."""

    def swept(size):
        return lambda time: size * np.sin(2 * np.pi * phase(time))

    assert found(swept(30.0), swept(60.0)) is None


@mark.slow
def test_motors_from_stop_to_stop_show_it_though_the_vehicle_sways_besides():
    limit_cycle = found(gusts(100.0), swinging(17.0, 900.0))
    assert round(limit_cycle.frequency) == 17 and limit_cycle.rate < 20.0


@mark.slow
@mark.parametrize("hertz, soonest, latest", [(17.0, 0.5, 1.5), (9.0, 1.0, 2.5), (3.0, 3.0, 6.5)])
def test_in_flight_a_small_one_from_stop_to_stop_is_found(hertz, soonest, latest):
    """One of 8 Hz or more is found within about 2 s, however little it turns; a slow one as in the review of a log."""
    start_time, end_time = 20.0, 32.0

    def swings(size):
        return lambda time: swinging(hertz, size)(time) * ((time >= start_time) & (time < end_time))

    signals = hover_signals(swings(6.0), swings(900.0))
    found_at = [
        now
        for now in np.arange(start_time - 5.0, end_time + 5.0, 0.5)
        if detect_starting_limit_cycle(
            signals.motors,
            {"roll": signals.attitudes[0]},
            {},
            int(signals.motors.boot[0]),
            12.0,
            now,
        )
    ]
    assert soonest <= found_at[0] - start_time <= latest
    assert end_time - 0.5 <= found_at[-1] <= end_time + 2.0
    assert len(found_at) == 1 + (found_at[-1] - found_at[0]) / 0.5


def test_what_is_said_of_a_limit_cycle_stays_until_it_really_changes():
    """Pitch oscillates, then roll alone, then both, by 17 and 18 Hz in turn; at last roll oscillates much more."""

    def cycle(axis, frequency, rate, *others):
        return Oscillation(axis, frequency, rate, 0.9, False, 2.0, None, others)

    pitch = cycle("pitch", 18.0, 4.0)
    roll = cycle("roll", 17.0, 5.0)
    both = continued_limit_cycle(pitch, roll)
    assert both == roll._replace(other_axes=(pitch,))
    for present in (cycle("pitch", 17.0, 6.0), roll, cycle("roll", 18.0, 3.0, pitch)):
        assert continued_limit_cycle(both, present) == both
    # Motors that swing from stop to stop are named once they do, and stay named.
    stops = continued_limit_cycle(both, roll._replace(at_both_limits=0.4))
    assert stops.is_stop_to_stop and not both.is_stop_to_stop
    assert continued_limit_cycle(stops, roll) == stops
    grown = cycle("roll", 16.0, 10.0)
    assert continued_limit_cycle(both, grown) == grown._replace(other_axes=(pitch,))


@mark.parametrize("steered_share, is_found", [(0.0, True), (1.0, False), (None, False)])
def test_in_flight_a_slow_one_is_told_from_steering_by_the_setpoint(steered_share, is_found):
    signals = hover_signals(swinging(1.5, 40.0), swinging(1.5, 900.0))
    roll = signals.attitudes[0]
    setpoints = {}
    if steered_share is not None:
        angle = roll.angle_series
        setpoints["roll"] = TimeSeries(angle.time, angle.boot, steered_share * angle.values)
    cycle = detect_starting_limit_cycle(
        signals.motors, {"roll": roll}, setpoints, int(roll.boot[0]), 12.0, 25.0
    )
    assert (cycle is not None) == is_found


@mark.slow
def test_where_messages_come_too_slowly_the_frequency_is_not_told():
    limit_cycle = found(swinging(12.0, 85.0), swinging(12.0, 900.0), 10.0)
    assert limit_cycle.frequency is None


@mark.slow
@mark.parametrize(
    "rate, command, offset", [(40.0, 300.0, 0.0), (10.0, 40.0, 600.0), (3.0, 20.0, 0.0)]
)
def test_wind_is_none_though_motors_reach_their_limits(rate, command, offset):
    assert found(gusts(rate), gusts(command), offset=offset) is None


@mark.slow
def test_steps_to_the_side_are_none():
    def square(size):
        return lambda time: size * np.sign(swinging(0.25, 1.0)(time))

    assert found(square(40.0), square(900.0)) is None


@mark.slow
def test_what_moves_only_the_rate_is_an_alias_or_a_vibration():
    assert found(swinging(7.0, 85.0), gusts(300.0)) is None
