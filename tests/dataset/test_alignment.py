"""Airborne and settled: a report of EXTENDED_SYS_STATE counts for the time it covers, elsewhere the motors' thrust."""

from dataclasses import replace
from math import inf

import numpy as np
from hover import (
    X_QUAD,
    Hover,
    changed,
    columns,
    only,
    pulses,
    with_demand,
    with_pulses,
)
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark, raises

from mavdem.dataset import flight_states, grounded, phases
from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dataset.resampling import (
    common_grid,
    common_step,
    low_pass_impulse_response,
    needs_low_pass,
)
from mavdem.dataset.segments import settled_segments, slow_steps
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.facts import Fact
from mavdem.facts.learnability import Caution, NotLearnableReason, Remedy, Resampling
from mavdem.ingest.telemetry import MAX_GAP_SECONDS
from mavdem.ingest.vocabulary import attitude_target, quaternion

HOVER = Hover()
LIFTED = 6.0
LANDED = HOVER.landed


def reporting(time, state, without=()):
    landed = columns(time, landed_state=np.broadcast_to(state, time.shape))
    return changed(HOVER.telemetry(without=without), "EXTENDED_SYS_STATE", **landed)


def in_air(time):
    return (time > LIFTED) & (time < LANDED)


def reported():
    """A hover whose landed state is right, twice a second."""
    return reporting(HOVER.stamps(2.0), np.where(in_air(HOVER.stamps(2.0)), 2, 1))


@mark.slow
def test_reports_that_come_late_leave_the_flight_before_them_to_the_motors():
    """The first report is of the landing, as of a stream that was asked for just then."""
    time = np.arange(HOVER.sinking, HOVER.end, 0.1)
    telemetry = reporting(time, np.where(time < LANDED, 4, 1))
    (flight,) = flight_states.airborne_intervals(Signals(telemetry), 0)
    assert flight == approx((LIFTED, LANDED), abs=1.1)
    learnability = learnability_of(Signals(telemetry))
    assert learnability.learnable and learnability.segment is not None
    assert learnability.segment.end == approx(HOVER.sinking - TRANSIENT_SECONDS, abs=1.1)


def test_taking_off_is_off_the_ground_and_a_report_counts_for_ten_seconds():
    time = HOVER.stamps(2.0)
    taking_off = reporting(time, np.where(in_air(time), 3, 1))
    for telemetry in (taking_off, reporting(HOVER.stamps(1 / 11), 1)):
        (flight,) = flight_states.airborne_intervals(Signals(telemetry), 0)
        assert flight == approx((LIFTED, LANDED), abs=1.1)
    # Without any motors it counts until another.
    time = np.array([1.0, 30.0])
    signals = Signals(reporting(time, np.array([1, 2]), without=("SERVO_OUTPUT_RAW",)))
    assert flight_states.airborne_intervals(signals, 0)[-1][0] == 30.0


def test_a_vertical_speed_that_only_sinks_has_run_away():
    telemetry = HOVER.telemetry()
    signals = Signals(changed(telemetry, "LOCAL_POSITION_NED", vz=5.0))
    ((start, end),) = phases.settled_intervals(signals, 0)
    assert (start, end) == approx((LIFTED + TRANSIENT_SECONDS, LANDED - TRANSIENT_SECONDS), abs=1.5)


def eight_and_twelve(phase):
    """Stamps of a 100 Hz stream out of a loop of 4 ms."""
    steps = np.resize([0.008, 0.012], round(HOVER.end * 100))
    return np.round(phase * 0.004 + np.cumsum(steps), 3)


@mark.slow
def test_signals_of_another_axis_share_results_and_those_of_another_flight_do_not():
    signals = Signals(HOVER.telemetry())
    segments = settled_segments(signals)
    assert settled_segments(signals.for_axis("roll")) is segments
    assert aligned_flight(signals, segments[0], dt=0.02).dt == approx(0.02)
    other = replace(signals, telemetry=HOVER.telemetry(without=("ATTITUDE",)))
    assert settled_segments(other) != segments


@mark.slow
def test_each_of_two_boots_whose_clocks_overlap_has_its_segment():
    """The log has the same hover twice, as boots 0 and 1. The second lacks 3 s, so that it has two segments."""
    telemetry = HOVER.telemetry()
    interrupted = only(telemetry, lambda time: (time < 30.0) | (time > 33.0))
    both_boots = {}
    for name, table in telemetry.messages.items():
        later = interrupted.messages[name]
        both_boots[name] = {field: np.append(table[field], later[field]) for field in table}
        both_boots[name]["boot"] = np.repeat([0, 1], [len(table["time"]), len(later["time"])])
    parts = [replace(part, boot=1) for part in settled_segments(Signals(interrupted))]
    segments = settled_segments(Signals(replace(telemetry, messages=both_boots)))
    assert segments == (*settled_segments(Signals(telemetry)), *parts)


@mark.slow
def test_the_segment_is_the_hover_between_a_climb_and_a_sinking_however_slow():
    slow = HOVER.telemetry()
    slow = changed(slow, "LOCAL_POSITION_NED", vz=0.56 * slow.messages["LOCAL_POSITION_NED"]["vz"])
    (segment,) = settled_segments(Signals(slow))
    assert segment.boot == 0
    assert segment.start == approx(HOVER.level, abs=1.0)
    assert segment.end == approx(HOVER.sinking, abs=1.0)
    # A log cut out of a hover is used whole.
    cut_out = only(HOVER.telemetry(), lambda time: (time >= 15) & (time < 45))
    (segment,) = settled_segments(Signals(cut_out))
    assert (segment.start, segment.end) == approx((15, 44.99))


GROUNDED = Hover(hovering=40.0)
ON_GROUND = GROUNDED.landed + 1.0  # The motors run on for 30 s, as if nobody disarmed them.


def landed(motors, rate=None):
    """A hover that lands, without any report of that: on the ground ``motors`` (4,) µs, and a roll ``rate`` of it."""
    time = np.arange(0.0, ON_GROUND + 30.0, 0.02)
    ground = time > GROUNDED.landed
    telemetry = GROUNDED.telemetry(time, time, without=("LOCAL_POSITION_NED",))
    outputs = np.where(ground[:, None], motors, GROUNDED.motors(time))
    outputs += 3.0 * default_rng(1).standard_normal(outputs.shape)
    telemetry = with_pulses(telemetry, outputs.T)
    turning = np.where(
        ground, 1e-3 * np.sin(90 * time) if rate is None else rate(time), GROUNDED.roll_rate(time)
    )
    beat = telemetry.messages["HEARTBEAT"]
    armed = np.where(beat["time"] >= 5.0, beat["base_mode"] | 128, beat["base_mode"])
    telemetry = changed(telemetry, "HEARTBEAT", base_mode=armed)
    roll = np.where(ground, 0.1, GROUNDED.roll(time))
    return changed(telemetry, "ATTITUDE", roll=roll, rollspeed=turning)


FLOWN = landed([1600.0] * 4, GROUNDED.roll_rate)
"""It flies on where the others are on the ground."""
TIME = FLOWN.messages["SERVO_OUTPUT_RAW"]["time"]


def in_landing_mode():
    beat = FLOWN.messages["HEARTBEAT"]
    mode = np.where(beat["time"] < GROUNDED.sinking, 5, 9)
    return changed(FLOWN, "HEARTBEAT", custom_mode=mode, base_mode=beat["base_mode"] | 1)


def chopped_after_calm():
    wild = np.where(TIME < 30, 2e-3, 0.5) * np.sin(3 * TIME)
    chopped = np.where(abs(TIME - 35) < 0.5, 1100.0, pulses(FLOWN))
    return changed(with_pulses(FLOWN, chopped), "ATTITUDE", rollspeed=wild)


HELD = np.where((TIME > 6) & (TIME < 9.7), 1300.0, 1600.0)
FAST = np.where(TIME < 6, 1000.0, np.where(TIME < 25, 1500.0, 1690.0))
FLIGHTS = {
    "idles at half of what it takes to hover": (landed([1320.0] * 4), LIFTED, GROUNDED.landed),
    "idles while a hand turns it": (
        landed([1320.0] * 4, lambda time: 0.7 * np.sin(1.1 * time)),
        LIFTED,
        GROUNDED.landed,
    ),
    "fights what holds it, with as much thrust as in hover": (
        landed([1930.0, 1270.0, 1930.0, 1270.0]),
        LIFTED,
        GROUNDED.landed,
    ),
    "motors far apart while it turns a little": (
        landed([1930.0, 1270.0, 1930.0, 1270.0], lambda time: 0.025 * np.sin(9 * time)),
        LIFTED,
        inf,
    ),
    "held in the hand at half the thrust": (with_pulses(FLOWN, [HELD] * 4), 9.7, inf),
    "a mode that lands": (in_landing_mode(), LIFTED, GROUNDED.sinking),
    "a moment without throttle, calm before manoeuvres": (chopped_after_calm(), LIFTED, inf),
    "a hover before a fast flight": (with_pulses(FLOWN, [FAST] * 4), LIFTED, inf),
}
"""Telemetry, and the seconds of take-off and landing; inf: the flight goes on until the log ends."""


@mark.parametrize("name", FLIGHTS)
def test_the_ground_shows_without_any_report_and_nothing_else_is_ground(name):
    telemetry, lifted, down = FLIGHTS[name]
    ((start, end),) = phases.settled_intervals(Signals(telemetry), 0)
    assert start == approx(lifted + TRANSIENT_SECONDS, abs=1.5)
    assert end > ON_GROUND if down == inf else end == approx(down - TRANSIENT_SECONDS, abs=1.5)


def test_a_climb_in_the_midst_of_a_flight_is_not_settled():
    telemetry = HOVER.telemetry()
    position = telemetry.messages["LOCAL_POSITION_NED"]
    climbs = np.where((position["time"] > 25) & (position["time"] < 35), -1.2, position["vz"])
    segments = phases.settled_intervals(
        Signals(changed(telemetry, "LOCAL_POSITION_NED", vz=climbs)), 0
    )
    assert [round(edge) for span in segments for edge in span[:2]][1:3] == [26, 34]


@mark.slow
def test_what_never_rose_was_never_in_the_air_whatever_is_reported():
    telemetry = reported()
    still = 0.01 * np.sin(telemetry.messages["LOCAL_POSITION_NED"]["time"])
    assert (
        phases.settled_intervals(Signals(changed(telemetry, "LOCAL_POSITION_NED", vz=still)), 0)
        == []
    )
    # What is always 0 is no measurement.
    for climb in (0.0, 0.11):
        assert phases.settled_intervals(
            Signals(changed(telemetry, "LOCAL_POSITION_NED", vz=climb)), 0
        )


def test_a_vehicle_that_hovers_below_any_threshold_flies_by_its_land_detector():
    telemetry = reported()
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    pulses = np.where(in_air(time), 1120, 1050) + np.zeros((4, 1))
    ((start, end),) = grounded.without_grounded(
        flight_states.airborne_intervals(signals := Signals(with_pulses(telemetry, pulses)), 0),
        signals,
        0,
    )
    assert (start, end) == approx((LIFTED, LANDED), abs=1.0)


def test_gaps_and_tumbles_end_a_segment():
    """Motor outputs are missing for a while after 20 s, and the vehicle tumbles at 30 s and at 40 s."""
    gap = 20, 20 + 2 * MAX_GAP_SECONDS
    telemetry = only(
        HOVER.telemetry(), lambda time: (time <= gap[0]) | (time >= gap[1]), "SERVO_OUTPUT_RAW"
    )
    roll = telemetry.messages["ATTITUDE"]["roll"].copy()
    time = telemetry.messages["ATTITUDE"]["time"]
    roll[abs(time - 40) < 0.5] = 2.5
    tumbling = changed(telemetry, "ATTITUDE", roll=roll, pitch=1.2 * (abs(time - 30) < 0.5))
    segments = settled_segments(Signals(tumbling))
    assert [round(segment.duration) for segment in segments] == sorted(
        (round(segment.duration) for segment in segments), reverse=True
    )
    ends = sorted((round(s.start, 1), round(s.end, 1)) for s in segments)
    # The tumbles of 1 s about 30 and 40 s are left out with a second around them; on its back, at 40 s, the vehicle has
    # crashed, and the seconds before that are those before a touch-down.
    assert ends[1:3] == [(20.2, 28.5), (31.5, 34.5)]


def test_a_hover_before_a_tumble_is_flown_and_not_held():
    """A tumble rotates so fast, by motors so far apart, that a hover beside it would seem to be held by the ground."""
    telemetry = HOVER.telemetry()
    tumble_start = HOVER.level + 15.0
    attitude = telemetry.messages["ATTITUDE"]
    time = attitude["time"]
    tumbling = (time > tumble_start) & (time < tumble_start + 6.0)
    roll = np.where(tumbling, np.sin(8.0 * time) * 3.0, attitude["roll"])
    roll_rate = np.where(tumbling, 24.0 * np.cos(8.0 * time), attitude["rollspeed"])
    telemetry = changed(telemetry, "ATTITUDE", roll=roll, rollspeed=roll_rate)
    outputs = pulses(telemetry)
    motor_time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    outputs[0, motor_time > tumble_start] = 2000.0
    outputs[1, motor_time > tumble_start] = 1000.0
    record = only(with_pulses(telemetry, outputs), lambda time: time < tumble_start + 6.0)
    ((start, end),) = phases.settled_intervals(Signals(record), 0)
    assert (start, end) == approx((HOVER.level, tumble_start - TRANSIENT_SECONDS), abs=1.5)


@mark.parametrize("silence, segment_count", [(0.09, 1), (0.11, 2)])
def test_a_silence_of_at_most_a_tenth_of_a_second_is_bridged(silence, segment_count):
    stamps = HOVER.stamps(100.0)
    silent = (stamps > 30.001) & (stamps < 30.0 + silence - 0.001)
    telemetry = HOVER.telemetry(motor_time=stamps[~silent])
    assert len(settled_segments(Signals(telemetry))) == segment_count


@mark.slow
def test_a_uniform_source_keeps_its_samples():
    telemetry = HOVER.telemetry(motor_time=HOVER.stamps(100.0) + 0.0004)
    flight = aligned_flight(Signals(telemetry), settled_segments(Signals(telemetry))[0])
    assert flight.dt == 0.01 and flight.effect_directions is None
    assert flight.provenance["resampling"] == {"attitude": "samples kept", "motors": "samples kept"}
    assert_allclose(flight.outputs[:, 1], HOVER.roll_rate(flight.time), atol=1e-12)
    assert_allclose(flight.inputs @ X_QUAD / 4, HOVER.roll_command(flight.time + 0.0004), atol=1e-9)


@mark.slow
@mark.parametrize("offset", [0.002, 0.005, 0.008])
@mark.parametrize(
    "stamps", [HOVER.stamps(100.0), eight_and_twelve(0)], ids=["uniform", "alternating"]
)
def test_neither_motors_nor_attitude_get_a_lag(stamps, offset):
    """The delay of the truth that best explains a column is far below half a step, wherever the stamps lie."""
    telemetry = HOVER.telemetry(motor_time=stamps + offset)
    flight = aligned_flight(Signals(telemetry), settled_segments(Signals(telemetry))[0])
    delays = np.linspace(-0.01, 0.01, 201)
    for column, truth in (
        (flight.inputs @ X_QUAD / 4, HOVER.roll_command),
        (flight.outputs[:, 0], HOVER.roll),
        (flight.outputs[:, 1], HOVER.roll_rate),
    ):
        errors = [np.var(column - truth(flight.time - delay)) for delay in delays]
        assert abs(delays[np.argmin(errors)]) <= 0.0002


@mark.slow
def test_a_vibration_faster_than_the_grid_is_not_folded_into_it():
    """49 Hz, seen well at 400 Hz, would be 1 Hz on the 50 Hz of the motors; at the ends of the segment too."""
    telemetry = HOVER.telemetry(attitude_time=400.0, motor_time=50.0)
    table = telemetry.messages["ATTITUDE"]
    shaking = table["rollspeed"] + 0.2 * np.sin(2 * np.pi * 49 * table["time"])
    shaken = Signals(changed(telemetry, "ATTITUDE", rollspeed=shaking))
    flight = aligned_flight(shaken, settled_segments(shaken)[0])
    assert flight.dt == 0.02
    assert abs(flight.outputs[:, 1] - HOVER.roll_rate(flight.time)).max() < 0.01 * 0.2
    # The filter is flat where the dynamics are.
    assert_allclose(flight.outputs[:, 0], HOVER.roll(flight.time), atol=1e-4 * HOVER.sway)
    assert flight.provenance["resampling"]["attitude"] == str(
        Fact(Resampling.LOW_PASSED, rate=20.0)
    )


@mark.parametrize(
    "steps, expected",
    [
        ((4, 8, 8, 12, 8, 8, 4), 0.008),
        ((8, 12), 0.01),
        ((8, 8, 8, 8, 12), 0.0088),
        ((12, 16, 16, 20, 16, 16, 12), 0.0154),  # Four cycles.
        (([8] * 6 + [4, 12]) * 5 + [6, 2], 0.0078),  # 2 % of no whole cycles
    ],
)
def test_the_step_is_the_mean_or_the_cycles_of_a_scheduler_that_jitters(steps, expected):
    assert common_step([np.cumsum(np.resize(steps, 1000)) / 1000]) == expected


def test_steps_are_usually_slow_by_the_median_of_a_second():
    slow = [
        slow_steps(np.repeat([0.01, late, 0.01], [60, count, 60])).any()
        for count, late in ((20, 0.05), (21, 0.05), (60, 1.09 / 40), (60, 1.11 / 40))
    ]
    assert slow == [False, True, False, True]


def test_a_grid_has_the_last_sample_and_begins_where_the_low_pass_has_settled():
    time = np.arange(101) / 100
    assert_allclose(common_grid(time, time, 0.01), time)
    assert needs_low_pass(np.arange(100) / 85, 0.02)
    grid = common_grid(np.arange(4000) / 400, np.arange(500) / 50, 0.02)
    assert grid[[0, -1]] == approx([0.1, 9.88])
    response = low_pass_impulse_response(400.0, 0.02)
    gains = [response @ np.cos(np.pi * hz / 200 * np.arange(-40, 41)) for hz in (10, 20, 40)]
    assert gains == approx([256 / 257, 1 / 2, 1 / 257], abs=0.005)


@mark.slow
def test_lost_messages_and_jitter_part_nothing():
    random = default_rng(5)
    lossy = np.sort(random.permutation(HOVER.stamps(50.0))[: round(HOVER.end * 40)])
    shaky = HOVER.stamps(MIN_STREAM_RATE) + random.uniform(
        -0.004, 0.004, round(HOVER.end * MIN_STREAM_RATE)
    )
    for stamps in (lossy, shaky):
        segments = settled_segments(Signals(HOVER.telemetry(stamps, HOVER.stamps(50.0))))
        assert sum(segment.duration for segment in segments) > 39
        assert len(segments) <= 1 + np.count_nonzero(np.diff(stamps) > MAX_GAP_SECONDS)


def with_roll_demand(motor_rate, demand_rate):
    return with_demand(Hover().telemetry(motor_time=motor_rate), demand_rate, pace=3.0)


@mark.slow
@mark.parametrize(
    "motor_rate, demand_rate, taken", [(100.0, 100.0, "motors"), (10.0, 100.0, "demand")]
)
def test_the_demand_is_taken_only_where_motors_come_too_slowly(motor_rate, demand_rate, taken):
    """The demand of the controller replaces motor outputs that are recorded at 10 Hz, but not those at 100 Hz."""
    demanded = with_roll_demand(motor_rate, demand_rate)
    learnability = learnability_of(Signals(demanded))
    assert learnability.learnable
    flight = aligned_flight(Signals(demanded), learnability.segment)
    if taken == "demand":
        assert learnability.reason.figures["demand"]
    else:
        assert not learnability.reason.figures["demand"]
    if taken == "motors":
        assert len(flight.input_names) == 4
    else:
        assert flight.input_names == ("roll demand",)
        caution = next(
            each for each in learnability.cautions if each.code is Caution.DEMAND_IS_INPUT
        )
        assert caution.figures["motor_rate"] == approx(10.0)
        assert_allclose(flight.inputs[:, 0], 0.1 * np.sin(3 * flight.time), atol=2e-3)


@mark.slow
def test_the_inputs_that_are_asked_for_are_taken():
    """The user chooses the demand or the motors as inputs; inputs that are too slow or missing are refused."""
    with_motors_and_demand = with_roll_demand(100.0, 50.0)
    learnability = learnability_of(Signals(with_motors_and_demand, inputs="demand"))
    flight = aligned_flight(Signals(with_motors_and_demand, inputs="demand"), learnability.segment)
    assert learnability.learnable and learnability.cautions[0].code is Caution.DEMAND_IS_INPUT
    assert flight.input_names == ("roll demand",) and flight.dt == approx(0.02)
    slow_motors = learnability_of(Signals(with_roll_demand(10.0, 100.0), inputs="motors"))
    assert slow_motors.reason.figures["remedy"].code is Remedy.LEAVE_OUT_MOTORS
    neither = learnability_of(Signals(with_roll_demand(10.0, 10.0), inputs="motors"))
    assert neither.reason.figures["remedy"].code is Remedy.ARDUPILOT_STREAMS
    without = learnability_of(Signals(Hover().telemetry(), inputs="demand"))
    assert without.reason.code is NotLearnableReason.NO_DEMAND and without.remedy
    with raises(ValueError, match="'torque'"):
        learnability_of(Signals(with_motors_and_demand, inputs="torque"))


@mark.parametrize(
    "height, asked, leaned, rocked, stands",
    [
        (0.9, 1.05, 0.95, 0.0, True),
        (0.9, 1.05, 0.0, 2.0, True),  # It leans as much as it is asked, but at other times.
        (1.1, 1.05, 0.95, 0.0, False),  # It rose.
        (0.9, 0.95, 0.85, 0.0, False),  # The setpoint was small.
        (0.9, 1.05, 1.1, 0.0, False),  # It followed.
    ],
)
def test_what_neither_rises_nor_leans_as_it_is_asked_is_held(height, asked, leaned, rocked, stands):
    """In shares of what is asked at least, and of what hardly leans; it rocks on its own too."""
    hover = Hover(sway=0.0)
    telemetry = hover.telemetry(20.0, 20.0)
    time = telemetry.messages["ATTITUDE"]["time"]
    wave = np.where(np.sin(3 * time) > 0, 1.0, -1.0) * asked * np.radians(10.0)
    asks = attitude_target(quaternion(wave, 0 * time, 0 * time))
    telemetry = changed(telemetry, "ATTITUDE_TARGET", **columns(time, **asks))
    leans = wave / asked * leaned / 3 + rocked * np.radians(5.0) * np.sin(time)
    telemetry = changed(telemetry, "ATTITUDE", roll=leans, pitch=0.0)
    height_time = telemetry.messages["LOCAL_POSITION_NED"]["time"]
    up = np.where((height_time > 20.0) & (height_time < 40.0), -height, 0.0)
    signals = Signals(changed(telemetry, "LOCAL_POSITION_NED", z=up))
    flights = flight_states.airborne_intervals(signals, 0)
    assert flights
    if stands:
        assert grounded.without_grounded(flights, signals, 0) == []
    else:
        assert grounded.without_grounded(flights, signals, 0) != []
