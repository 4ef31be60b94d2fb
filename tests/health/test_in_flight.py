"""Motors in flight: one that works harder is found, named and measured, and so is its recovery; nothing else is."""

import numpy as np
from frames import FRAMES, geometry
from hover import overtake
from numpy.random import default_rng
from pytest import approx, mark
from scipy.signal import lfilter

from mavdem.facts import Level
from mavdem.facts.motors import InFlight
from mavdem.health.balance import motor_signatures
from mavdem.health.in_flight import (
    HOURS_TO_FALSE_ALARM,
    LONGEST_GAP,
    MotorAlarm,
    MotorWatch,
    alarm_figures,
)
from mavdem.ingest.motors import motor_geometry

# Hz, s
RATE = 10.0
BREAKS = 20.0
SIGNATURES = {motors: motor_signatures(geometry(motors)) for motors in FRAMES}
MIXERS = {motors: np.linalg.pinv(signatures.weights) for motors, signatures in SIGNATURES.items()}


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


def changes(time, commands, heading=lambda at: 0.0):
    watch = MotorWatch(geometry(commands.shape[1]))
    found = []
    for at, row in zip(time.tolist(), commands, strict=True):
        latest = watch.take(at, row, heading(at))
        assert all(one.since < one.time <= at for one in latest)
        found += latest
    return found


def after(time, rise):
    """(N, 4) commands that rise (4,) from the break on."""
    return np.outer(time >= 100.0 + BREAKS, rise)


@mark.slow
@mark.parametrize("seed", range(3))
@mark.parametrize("motor", range(4))
def test_a_motor_that_works_an_eighth_harder_is_named_within_five_seconds(motor, seed):
    time, commands = flight(seed)
    rise = 0.125 * 0.6 * np.eye(4)[motor]
    [first, *rest] = changes(time, commands + after(time, rise))
    assert first.motor == motor + 1 and not rest
    assert BREAKS < first.time - 100.0 <= BREAKS + 5.0
    assert first.since == approx(100.0 + BREAKS, abs=2.0)
    assert first.size == approx(0.125, abs=0.04) and first.loss[0] < 1 - 1.125**-1.5 < first.loss[1]
    assert 0.95 < first.probability <= 1
    share, band = first.sound_share
    assert abs(share - 1 / 1.125) < 2 * band < 0.1


@mark.parametrize("motors", [6, 8])
def test_the_size_is_that_of_the_motor_s_own_command_also_where_its_neighbours_help(motors):
    time, commands = flight(5, sd=0.003, motors=motors)
    pattern = SIGNATURES[motors].weak_motor_commands[0]
    rise = 0.15 * pattern / pattern[0]
    [first, *_] = changes(time, commands + after(time, 0.6 * rise))
    assert first.motor == 1
    assert first.size == approx(0.15, abs=0.03)
    # Neighbours make up for the rest of what was lost.
    assert first.loss[0] < (1 - 1 / 1.15) / pattern[0] < first.loss[1] < 1.5 * first.loss[0] + 0.25


LATER = {  # s, what the motors then have to give in place of 1
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


@mark.parametrize("faults", LATER.values(), ids=LATER)
def test_every_fault_is_found_and_its_end(faults):
    time, commands = flight(6, 110.0, 0.005)
    rises = np.ones_like(commands)
    for begin, rise in faults.items():
        rises[time >= 100.0 + begin] = rise
    found = changes(time, commands * rises)
    before = [1.0] * 4
    for begin, rise in faults.items():
        for motor in np.flatnonzero(np.subtract(rise, before)):
            one = found.pop(0)
            assert one.motor == motor + 1 and begin < one.time - 100.0 < begin + 2.5
            assert one.weak == (rise[motor] > 1) and one.size == approx(rise[motor] - 1, abs=0.05)
            code = InFlight.MOTOR_LOST_THRUST if one.weak else InFlight.MOTOR_RECOVERED
            assert one.fact.code is code
        before = rise
    assert not found


@mark.parametrize("shift", [(0.05, 0.0), (0.0, -0.06), (-0.05, 0.05), (0.03, 0.06)])
def test_a_shifted_load_is_called_that_once_it_has_lasted(shift):
    time, commands = flight(7)
    rise = 0.6 * quad(0.0, *shift, 0.0)
    [first, *rest] = changes(time, commands + after(time, rise))
    assert first.motor is None and not rest
    assert BREAKS + 8.0 <= first.time - 100.0 < BREAKS + 15.0
    assert first.size == approx(np.hypot(*shift), abs=0.015)
    assert first.fact.code is InFlight.STEADY_TORQUE_CHANGED


def turned(*turns):
    """The heading at a time: so much, rad, is turned evenly from a beginning to an end, s, for each of the turns."""
    return lambda at: sum(angle * np.clip((at - a) / (b - a), 0, 1) for a, b, angle in turns)


def test_what_changes_with_the_heading_names_no_motor():
    """The nose turns from 18 to 22 s, in which a motor begins to work harder."""
    time, commands = flight(1, 60.0, 0.005)
    harder = 0.12 * np.eye(4)[0]
    weak = commands + after(time, harder)
    turn = (118.0, 122.0, 2.0)
    assert not changes(time, weak, turned(turn))
    # Still so after the next turn: the heading is not why. Nor is it at the heading of before.
    [alarm] = changes(time, weak, turned(turn, (128.0, 130.0, 2.0)))
    assert alarm.motor == 1 and 130.0 < alarm.time < 133.0
    [alarm] = changes(time, weak, turned(turn, (128.0, 130.0, -2.0)))
    assert alarm.motor == 1 and 130.0 < alarm.time < 133.0
    [alarm] = changes(time, weak, turned((118.0, 122.0, np.pi / 6 - 0.01)))
    assert alarm.motor == 1 and alarm.time < 123.0
    # A turn back to what was before is no recovery of a motor.
    there = commands + np.outer((time >= 120) & (time < 129), harder)
    assert not changes(time, there, turned(turn, (128.0, 130.0, -2.0)))


def test_no_motor_is_named_before_ten_seconds_were_steady():
    time, commands = flight(1, 60.0, 0.005)
    weak = commands + after(time, 0.12 * np.eye(4)[0])
    for until in (112.0, 115.0):
        [alarm] = changes(time, weak, turned((100.0, until, 1.2 * (until - 100.0))))
        assert alarm.time == approx(max(until + 10.0, 122.0), abs=0.6)
        [alarm] = changes(time, weak, lambda at, until=until: np.nan if at < until else 0.0)
        assert alarm.time == approx(max(until + 10.0, 122.0), abs=0.6)


@mark.parametrize("change", [(0.0, 0.0, 0.0, 0.05), (0.15, 0.0, 0.0, 0.0)])
def test_yaw_alone_and_thrust_alone_are_no_motor(change):
    time, commands = flight(8)
    assert not changes(time, commands + after(time, 0.6 * quad(*change)))


def test_what_no_cause_explains_and_lasts_does_not_hide_the_next_fault():
    time, commands = flight(1, 70.0, 0.005)
    turned = commands + 0.6 * np.outer(time >= 125.0, quad(0.0, 0.0, 0.0, 0.05))
    [alarm] = changes(time, turned * np.where(time[:, np.newaxis] >= 160.0, [1, 1.12, 1, 1], 1))
    assert alarm.motor == 2 and 160.0 < alarm.time < 163.0


@mark.slow
@mark.parametrize("sd, seconds", [(0.01, 0.1), (0.02, 3.0)])
def test_coloured_noise_gives_no_alarm(sd, seconds):
    """Over five minutes each; what is slow is more than the test was told of at first, and it must learn that."""
    time, commands = flight(3, 300.0, sd, seconds)
    assert HOURS_TO_FALSE_ALARM > 2 * 300 / 3600
    assert not [one for one in changes(time, commands) if one.motor is not None]
    # Nor a gust that passes.
    time, commands = flight(4, 60.0, 0.005)
    gust = np.exp(-((time - 130.0) ** 2) / 2 / 1.5**2)
    assert not changes(time, commands + 0.6 * np.outer(gust, quad(0.0, 0.06, 0.04, 0.01)))


def test_manoeuvres_that_begin_make_it_wait():
    """Steps to the side after calm hover: to one side and the other, harder than a weak motor."""
    time, commands = flight(5, 60.0, 0.003)
    steps = np.where(time > 120.0, np.sin(2 * np.pi * (time - 120.0) / 1.5), 0.0)
    wild = commands + 0.6 * np.outer(steps, quad(0.0, 0.15, 0.0, 0.04))
    assert not changes(time, wild)


def watched(rise, rate=10.0, watch=None, begins=0.0, **known):
    """The watch of a flight in which motors' commands rise (4,) at 25 s."""
    watch = watch or MotorWatch(geometry(**known))
    time = np.arange(0.0, 45.0, 1 / rate)
    noise = default_rng(2).normal(scale=0.004, size=(len(time), 4))
    for at, row in zip(time.tolist(), 0.5 + noise + 0.5 * np.outer(time > 25.0, rise), strict=True):
        watch.take(begins + at, row)
    return watch


def test_it_names_the_motor_and_says_when_that_rests_on_an_assumption():
    [alarm] = watched([0.0, 0.3, 0.0, 0.0]).alarms
    fact = alarm.fact
    assert (fact.subject, fact.level) == ("motor 2 (rear left)", Level.BAD)
    assert not fact.figures["assumed"]
    layout = motor_geometry("QUADROTOR", "PX4", {}, (1, 2, 3, 4), 16)
    [alarm] = watched([0.3, 0.0, 0.0, 0.0], watch=MotorWatch(layout)).alarms
    assert alarm.fact.figures["assumed"]


def test_a_bad_link_hides_no_fault_and_no_recovery():
    """A fifth is lost, a tenth doubled or overtaken, and every 25 s it is silent for 2.5 s."""
    draw = default_rng(8)
    time, commands = flight(6, 70.0, 0.005)
    commands[(time >= 120.0) & (time < 145.0)] *= [1.2, 1.0, 1.0, 1.0]
    kept = np.flatnonzero((draw.random(len(time)) > 0.2) & ((time - 100.0) % 27.5 < 25.0))
    kept = np.repeat(kept, 1 + (draw.random(len(kept)) < 0.05))
    overtake(draw, kept)
    weak, sound = changes(time[kept], commands[kept])
    assert (weak.motor, sound.motor) == (1, 1) and weak.weak and not sound.weak
    assert 120.0 < weak.time < 125.0 and 145.0 < sound.time < 150.0


@mark.parametrize("silent", [LONGEST_GAP - 0.2, LONGEST_GAP + 0.2])
def test_after_a_long_silence_what_was_before_is_no_reference(silent):
    time, commands = flight(6, 40.0, 0.005)
    commands[time > 120.0] *= [1.2, 1.0, 1.0, 1.0]
    heard = abs(time - 120.0) > silent / 2
    assert len(changes(time[heard], commands[heard])) == (silent < LONGEST_GAP)


def test_where_nothing_can_be_found_it_says_why():
    slow = watched([0.3, 0.0, 0.0, 0.0], rate=4.0)
    assert not slow.alarms and slow.obstacle.code is InFlight.MOTOR_OUTPUTS_TOO_SLOW
    assert watched([0.0] * 4, watch=slow, begins=100.0).obstacle is None
    silent = watched([0.3, 0.0, 0.0, 0.0], spins=())
    assert not silent.alarms and silent.obstacle.code is InFlight.MOTOR_PLACES_UNKNOWN


def test_json_keeps_alarms_apart_from_changes_that_name_no_motor():
    named = MotorAlarm(30.0, 28.5, 2, "motor 2", 0.25, 0.98, loss=(0.2, 0.4))
    torque = MotorAlarm(40.0, 30.0, None, "", 0.1, 0.97)
    sound = MotorAlarm(50.0, 49.0, 2, "motor 2", 0.0, 0.99)
    found = alarm_figures([torque, named, sound])
    assert (found["alarms"], found["recoveries"]) == ([named], [sound])
    assert found["torque_changes"] == [torque]
    at_most, basis = found["false_alarms_per_hour"].values()
    assert at_most == approx(-np.log(0.05) / 5.55, abs=0.01)
    assert basis.figures["duration"] == 5.55 * 3600
