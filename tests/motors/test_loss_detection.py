"""Motors in flight: one that works harder is found, named and measured, and so is its recovery; nothing else is."""

import numpy as np
from frames import FRAMES, geometry
from hover import overtake
from numpy.random import default_rng
from pytest import approx, mark, param
from scipy.signal import lfilter

from mavdem.facts import Level
from mavdem.facts.motors import MotorWatchFact
from mavdem.ingest.motor_geometry import motor_geometry
from mavdem.motors.balance import MAX_GAP
from mavdem.motors.change_statistics import (
    PRIOR_FREEDOM,
    changes_with_least_variance,
    long_run_variance,
    window_changes,
    window_means,
)
from mavdem.motors.loss_detection import HOURS_TO_FALSE_ALARM, MotorLossDetector
from mavdem.motors.motor_changes import MotorChange, alarm_figures
from mavdem.motors.signatures import motor_signatures

# Hz, s
RATE = 10.0
BREAKS = 20.0
SIGNATURES = {motors: motor_signatures(geometry(motors)) for motors in FRAMES}
MIXERS = {
    motors: np.linalg.pinv(signatures.mixer_rows) for motors, signatures in SIGNATURES.items()
}


def quad(*balance):
    """(4,) commands of a quadrotor that ask for so much thrust, roll, pitch and yaw."""
    return MIXERS[4] @ balance


def flight(seed, seconds=45.0, sd=0.01, coloured_by=0.5, motors=4):
    """Times (N,) and commands (N, k) of a sound vehicle in wind, about 0.6 of the range."""
    time = np.arange(round(seconds * RATE)) / RATE + 100.0
    keeps = np.exp(-1 / (RATE * coloured_by))
    draws = default_rng(seed).standard_normal((len(time), 4))
    noise = lfilter([np.sqrt(1 - keeps**2)], [1.0, -keeps], draws, axis=0)
    return time, 0.6 * (1 + sd * noise @ MIXERS[motors].T)


def detector_after_flight(time, commands, heading=lambda at: 0.0, detector=None, lean=(0.0, 0.0)):
    """Returns a detector that processed a flight with a constant lean, roll and pitch in degrees."""
    detector = detector or MotorLossDetector(geometry(commands.shape[1]))
    for at, row in zip(time.tolist(), commands, strict=True):
        found_changes = detector.update(at, row, heading(at), np.radians(lean))
        assert all(change.onset_time < change.time <= at for change in found_changes)
    return detector


def changes(*flown):
    return detector_after_flight(*flown).alarms


def after(time, rise):
    """(N, 4) commands that rise (4,) from the break on."""
    return np.outer(time >= 100.0 + BREAKS, rise)


def only_change(seed, rise):
    """The one change that is found in a flight whose commands rise from the break on."""
    time, commands = flight(seed)
    (change,) = changes(time, commands + after(time, rise))
    return change


@mark.slow
@mark.parametrize("motor, seed", [(0, 0), (1, 1), (2, 2), (3, 0)])
def test_a_motor_that_works_an_eighth_harder_is_named_within_five_seconds(motor, seed):
    first_change = only_change(seed, 0.125 * 0.6 * np.eye(4)[motor])
    assert first_change.motor == motor + 1
    assert BREAKS < first_change.time - 100.0 <= BREAKS + 5.0
    assert first_change.onset_time == approx(100.0 + BREAKS, abs=2.0)
    assert (
        first_change.size == approx(0.125, abs=0.04)
        and first_change.loss[0] < 1 - 1.125**-1.5 < first_change.loss[1]
    )
    assert 0.95 < first_change.probability <= 1


@mark.slow
@mark.parametrize("motors", [6, 8])
def test_the_size_is_that_of_the_motor_s_own_command_also_where_its_neighbours_help(motors):
    time, commands = flight(5, sd=0.003, motors=motors)
    pattern = SIGNATURES[motors].weak_motor_commands[0]
    rise = 0.15 * pattern / pattern[0]
    [first_change, *_] = changes(time, commands + after(time, 0.6 * rise))
    assert first_change.motor == 1
    assert first_change.size == approx(0.15, abs=0.03)
    # Neighbours make up for the rest of what was lost.
    assert (
        first_change.loss[0]
        < (1 - 1 / 1.15) / pattern[0]
        < first_change.loss[1]
        < 1.5 * first_change.loss[0] + 0.25
    )


LATER = {  # Commands after so many seconds, in the place of 1.
    "one while another lasts": {
        20: [1, 1.2, 1, 1],
        26: [1, 1.2, 1.25, 1],
        40: [1, 1, 1.25, 1],
        52: [1] * 4,
    },
    "worse, then both at once": {
        20: [1, 1, 1, 1.15],
        30: [1, 1, 1, 1.4],
        40: [1.2, 1, 1, 1.4],
        50: [1] * 4,
    },
    "in part": {20: [1.5, 1, 1, 1], 40: [1.2, 1, 1, 1], 60: [1] * 4},
}


@mark.slow
@mark.parametrize("faults", LATER.values(), ids=LATER)
def test_every_fault_is_found_and_its_end(faults):
    """Motors lose thrust and recover at given times, after 100 s: each change is found within 2.5 s."""
    time, commands = flight(6, 110.0, 0.005)
    rises = np.ones_like(commands)
    for begin, rise in faults.items():
        rises[time >= 100.0 + begin] = rise
    found_changes = changes(time, commands * rises)
    before = [1.0] * 4
    for begin, rise in faults.items():
        for motor in np.flatnonzero(np.subtract(rise, before)):
            change = found_changes.pop(0)
            assert change.motor == motor + 1 and begin < change.time - 100.0 < begin + 2.5
            assert change.onset_time == 100.0 + begin
            if rise[motor] > 1:
                assert change.is_weak
            else:
                assert not change.is_weak
            assert change.size == approx(rise[motor] - 1, abs=0.05)
            code = (
                MotorWatchFact.MOTOR_LOST_THRUST
                if change.is_weak
                else MotorWatchFact.MOTOR_RECOVERED
            )
            assert change.fact.code is code
        before = rise
    assert not found_changes


@mark.slow
@mark.parametrize("shift", [(0.05, 0.0), (0.0, -0.06), (-0.05, 0.05), (0.03, 0.06)])
def test_a_shifted_load_is_called_that_once_it_has_lasted(shift):
    """Roll and pitch change as by a load, relative to the thrust; no motor is named, and 8 s or more pass."""
    first_change = only_change(7, 0.6 * quad(0.0, *shift, 0.0))
    assert first_change.motor is None
    assert BREAKS + 8.0 <= first_change.time - 100.0 < BREAKS + 15.0
    assert first_change.size == approx(np.hypot(*shift), abs=0.015)
    assert first_change.fact.code is MotorWatchFact.STEADY_TORQUE_CHANGED


@mark.slow
@mark.parametrize("shift", [(0.05, -0.04, -0.03), (-0.02, 0.05, -0.025)])
def test_a_load_that_shifts_in_wind_is_reported_without_a_cause_once_it_has_lasted(shift):
    """The wind's drag acts off the centre of mass, so that yaw changes too, as no single motor would change it."""
    first_change = only_change(7, 0.6 * quad(0.0, *shift))
    assert first_change.motor is None
    assert BREAKS + 8.0 <= first_change.time - 100.0 < BREAKS + 17.0
    assert first_change.onset_time - 100.0 == approx(BREAKS, abs=0.6)
    assert first_change.size == approx(np.hypot(*shift[:2]), abs=0.015)
    causes = first_change.cause_probabilities
    load = causes.load
    assert 0.5 < load < 0.9 and causes.motor < 0.01
    assert first_change.suspect is None
    words = f"a shifted load can do that (probability {load:.2f}), a weak motor (< 0.01)"
    assert f"{words}, or rarely the wind" in first_change.fact.sentence


@mark.slow
@mark.parametrize("lean, motor", [((0.0, 0.0), 4), ((-12.0, 6.0), None)])
def test_a_load_that_shifts_on_a_leaning_vehicle_is_no_motor_even_where_yaw_changes_alike(
    lean, motor
):
    """A level vehicle whose roll, pitch and yaw change nearly alike has a weak motor 4.

    At the other lean a load does that, if a torque takes twice the yaw command that it takes as roll command.
    """
    time, commands = flight(3, sd=0.003)
    shift = 0.6 * quad(0.0, -0.03, -0.03, -0.02)
    [first_change, *_] = detector_after_flight(
        time, commands + after(time, shift), lean=lean
    ).alarms
    assert first_change.motor == motor


def turned(*turns):
    """The heading at a time: so much, rad, is turned evenly from a beginning to an end, s, for each of the turns."""
    return lambda at: sum(angle * np.clip((at - a) / (b - a), 0, 1) for a, b, angle in turns)


@mark.slow
def test_what_changes_with_the_heading_names_no_motor():
    """The nose turns from 18 to 22 s, in which a motor begins to work harder."""
    time, commands = flight(1, 60.0, 0.005)
    harder = 0.12 * np.eye(4)[0]
    weak = commands + after(time, harder)
    turn = (118.0, 122.0, 2.0)
    further, back = (128.0, 130.0, 2.0), (128.0, 130.0, -2.0)
    assert not changes(time, weak, turned(turn))
    # Still so after the next turn: the heading is not why. Nor is it at the heading of before, or near it.
    near = (118.0, 122.0, np.pi / 6 - 0.01)
    for turns, earliest in (((turn, further), 130.0), ((turn, back), 130.0), ((near,), 120.0)):
        [alarm] = changes(time, weak, turned(*turns))
        assert alarm.motor == 1 and earliest < alarm.time < earliest + 3.0
    # A turn back to what was before is no recovery of a motor.
    there = commands + np.outer((time >= 120) & (time < 129), harder)
    assert not changes(time, there, turned(turn, back))


@mark.slow
@mark.parametrize("earlier_share, named_motors", [(0.0, [1]), (0.6, [])])
def test_a_change_that_shows_at_an_earlier_heading_names_no_motor(earlier_share, named_motors):
    """Before the break the nose points elsewhere for 3 s, where a share of the same rise shows."""
    time, commands = flight(1, 60.0, 0.005)
    rise = 0.2 * np.eye(4)[0]
    heading = turned(
        (107.0, 108.0, 2.1), (111.0, 112.0, -2.1), (118.0, 120.0, 1.05), (130.0, 132.0, 2.1)
    )
    is_elsewhere = (time >= 107.5) & (time < 111.5)
    rises = np.outer((time >= 119.0) + earlier_share * is_elsewhere, rise)
    assert [alarm.motor for alarm in changes(time, commands + rises, heading)] == named_motors


@mark.slow
def test_no_motor_is_named_before_ten_seconds_were_steady():
    time, commands = flight(1, 60.0, 0.005)
    weak = commands + after(time, 0.12 * np.eye(4)[0])
    for end_time in (112.0, 115.0):
        unknown = np.where(time < end_time, np.nan, 0.0)
        turning = np.minimum(time, end_time)
        for heading in (dict(zip(time, change, strict=True)) for change in (unknown, turning)):
            [alarm] = changes(time, weak, heading.get)
            assert alarm.time == approx(max(end_time + 10.0, 122.0), abs=0.6)


@mark.slow
@mark.parametrize(
    "size, balance",
    [
        (lambda time: time >= BREAKS, (0.0, 0.0, 0.0, 0.05)),
        (lambda time: time >= BREAKS, (0.15, 0.0, 0.0, 0.0)),
        (lambda time: np.exp(-(((time - 30.0) / 1.5) ** 2) / 2), (0.0, 0.06, 0.04, 0.01)),
        (lambda time: (time > 20) * np.sin(2 * np.pi * time / 1.5), (0.0, 0.15, 0.0, 0.04)),
    ],
    ids=["yaw alone", "thrust alone", "a gust that passes", "manoeuvres after calm hover"],
)
def test_what_is_no_motor_gives_no_alarm(size, balance):
    """Yaw or thrust alone change, a gust passes, or the pilot begins to manoeuvre."""
    time, commands = flight(4, 60.0, 0.003)
    assert not changes(time, commands + 0.6 * np.outer(size(time - 100.0), quad(*balance)))


@mark.slow
@mark.parametrize("sd, seconds", [(0.01, 0.1), param(0.02, 3.0, marks=mark.in_full)])
def test_coloured_noise_gives_no_alarm(sd, seconds):
    """Over five minutes each; what is slow is more than the test was told of at first, and it must learn that."""
    time, commands = flight(3, 300.0, sd, seconds)
    assert HOURS_TO_FALSE_ALARM > 2 * 300 / 3600
    assert not [change for change in changes(time, commands) if change.motor is not None]


@mark.slow
def test_it_names_the_motor_and_says_when_that_rests_on_an_assumption():
    time, commands = flight(2)
    weak = commands + after(time, 0.15 * np.eye(4)[1])
    [alarm] = changes(time, weak)
    assert (alarm.fact.subject, alarm.fact.level) == ("motor 2 (rear left)", Level.BAD)
    assert not alarm.fact.figures["assumed"]
    layout = motor_geometry("QUADROTOR", "PX4", {}, (1, 2, 3, 4), 16)
    [alarm] = detector_after_flight(time, weak, detector=MotorLossDetector(layout)).alarms
    assert alarm.fact.figures["assumed"]


@mark.slow
def test_a_bad_link_hides_no_fault_and_no_recovery():
    """A fifth is lost, a tenth doubled or overtaken, and every 25 s it is silent for 2.5 s."""
    draw = default_rng(8)
    time, commands = flight(6, 70.0, 0.005)
    commands[(time >= 120.0) & (time < 145.0)] *= [1.2, 1.0, 1.0, 1.0]
    kept = np.flatnonzero((draw.random(len(time)) > 0.2) & ((time - 100.0) % 27.5 < 25.0))
    kept = np.repeat(kept, 1 + (draw.random(len(kept)) < 0.05))
    overtake(draw, kept)
    weak, sound = changes(time[kept], commands[kept])
    assert (weak.motor, sound.motor) == (1, 1) and weak.is_weak and not sound.is_weak
    assert 120.0 < weak.time < 125.0 and 145.0 < sound.time < 150.0


@mark.slow
@mark.parametrize("silent", [MAX_GAP - 0.2, MAX_GAP + 0.2])
def test_after_a_long_silence_what_was_before_is_no_reference(silent):
    time, commands = flight(6, 40.0, 0.005)
    commands[time > 120.0] *= [1.2, 1.0, 1.0, 1.0]
    heard = abs(time - 120.0) > silent / 2
    if silent < MAX_GAP:
        assert len(changes(time[heard], commands[heard])) == 1
    else:
        assert len(changes(time[heard], commands[heard])) == 0


@mark.slow
@mark.parametrize("motor", range(4))
def test_a_motor_that_loses_a_fifth_of_its_thrust_is_named_at_the_rate_of_ground_stations(motor):
    time, commands = flight(motor + 20, seconds=100.0)
    commands[time >= 150.0] += 0.15 * 0.6 * np.eye(4)[motor]
    # Of the 20 samples of 2 s, 8 arrive: 4 Hz.
    kept = np.arange(len(time)) % 5 % 3 == 0
    (change,) = changes(time[kept], commands[kept])
    assert change.motor == motor + 1 and change.is_weak
    assert 150.0 < change.time <= 155.0


@mark.slow
def test_where_nothing_can_be_found_it_says_why():
    time, commands = flight(2)
    weak = commands + after(time, 0.15 * np.eye(4)[0])
    slow = detector_after_flight(4 * time, weak)
    assert (
        not slow.alarms and slow.undetectable_reason.code is MotorWatchFact.MOTOR_OUTPUTS_TOO_SLOW
    )
    assert detector_after_flight(time + 400.0, commands, detector=slow).undetectable_reason is None
    silent = detector_after_flight(time, weak, detector=MotorLossDetector(geometry(spins=())))
    assert (
        not silent.alarms and silent.undetectable_reason.code is MotorWatchFact.MOTOR_PLACES_UNKNOWN
    )


def test_json_keeps_alarms_apart_from_changes_that_name_no_motor():
    """A torque without a motor, a weak motor, and its recovery are listed under three keys."""
    named_alarm = MotorChange(30.0, 28.5, 2, "motor 2", 0.25, 0.98, loss=(0.2, 0.4))
    torque = MotorChange(40.0, 30.0, None, "", 0.1, 0.97)
    sound = MotorChange(50.0, 49.0, 2, "motor 2", 0.0, 0.99)
    found_changes = alarm_figures([torque, named_alarm, sound])
    assert (found_changes["alarms"], found_changes["recoveries"]) == ([named_alarm], [sound])
    assert found_changes["torque_changes"] == [torque]
    at_most, basis = found_changes["false_alarms_per_hour"].values()
    assert at_most == approx(-np.log(0.05) / 5.55, abs=0.01)
    assert basis.figures["duration"] == 5.55 * 3600


def test_a_batch_as_long_as_the_run_shows_no_variance():
    found_changes = long_run_variance(
        np.ones((2, 1)), np.ones((1, 2), bool), np.zeros((1, 1)), np.zeros(1), 0.01
    )
    assert found_changes == approx(2 / 2.02)


def test_no_change_has_a_smaller_variance_than_by_the_prior():
    """So a change that is too small for any cause with the prior's variance needs no estimate of its own."""
    blocks = 0.01 * default_rng(3).standard_normal((120, 3))
    prior = np.array([0.003, 0.006, 0.012]) ** 2
    means = window_means(blocks, np.array([2, 8, 40]))
    least = changes_with_least_variance(means, prior, PRIOR_FREEDOM)
    estimated = window_changes(blocks, means, prior, PRIOR_FREEDOM)
    assert np.all(least.variance <= estimated.variance)
    assert np.any(least.variance < estimated.variance)
    assert least.change == approx(estimated.change) and least.freedom == approx(estimated.freedom)
