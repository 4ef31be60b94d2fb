"""MotorWatch says what the test finds, in words, of settled flight only."""

import json

import numpy as np
import pytest

from mavdem.health.in_flight import MotorAlarm, MotorWatch, alarm_figures
from mavdem.ingest.motors import motor_geometry

NAMES = tuple(f"motor {n} ({place})" for n, place in enumerate(("front right", "rear left"), 1)) + (
    "motor 3",
    "motor 4",
)
X, SPINS = [(1, 1), (-1, -1), (1, -1), (-1, 1)], (1, 1, -1, -1)


def watched(watch, time, commands, settled=lambda at: True):
    for at, row in zip(time.tolist(), commands, strict=True):
        watch.take(at, row, settled(at))
    return watch.alarms


def broken(rise, seconds=45.0, rate=10.0, breaks=25.0):
    time = np.arange(0.0, seconds, 1 / rate)
    noise = np.random.default_rng(2).normal(scale=0.004, size=(len(time), 4))
    return time, 0.5 + noise + 0.5 * np.outer(time > breaks, rise)


def test_it_names_the_motor_in_a_sentence():
    watch = MotorWatch(NAMES, (1, 2, 3, 4), X, SPINS)
    [alarm] = watched(watch, *broken([0.0, 0.3, 0.0, 0.0]))
    assert (alarm.motor, alarm.name) == (2, "motor 2 (rear left)")
    assert (
        alarm.sentence.startswith("Alarm: motor 2 (rear left) lost about 36% of its thrust")
        and "since 25 s" in alarm.sentence
    )
    assert "assumed" not in alarm.sentence
    assert json.loads(json.dumps(alarm.as_dict()))["motor"] == 2


def test_it_says_when_the_name_rests_on_an_assumption():
    layout = motor_geometry("QUADROTOR", "PX4", {}, (1, 2, 3, 4), 16)
    given = layout.names, layout.motors, layout.positions, layout.spins, layout.positions_assumed
    [alarm] = watched(MotorWatch(*given), *broken([0.3, 0.0, 0.0, 0.0]))
    assert alarm.sentence.endswith("Where the motors are is assumed, and so is the name.")


def test_a_shifted_load_blames_no_motor():
    [alarm] = watched(MotorWatch(NAMES, (1, 2, 3, 4), X, SPINS), *broken([0.08, -0.08, 0.0, 0.0]))
    assert alarm.motor is None and "no motor is named" in alarm.sentence and "Alarm" not in alarm.sentence


def test_slow_streams_show_nothing_and_why_is_said_until_they_are_fast():
    watch = MotorWatch(NAMES, (1, 2, 3, 4), X, SPINS)
    time, commands = broken([0.3, 0.0, 0.0, 0.0], rate=4.0)
    assert not watched(watch, time, commands) and "6 times a second" in watch.obstacle
    time, commands = broken([0.0, 0.0, 0.0, 0.0])
    assert not watched(watch, 100.0 + time, commands) and watch.obstacle == ""


def test_json_keeps_alarms_apart_from_changes_that_name_no_motor():
    named, torque = MotorAlarm(30.0, 28.5, 2, "motor 2", 0.25, 0.98), MotorAlarm(40.0, 30.0, None, "", 0.1, 0.97)
    found = json.loads(json.dumps(alarm_figures([torque, named])))
    assert [one["motor"] for one in found["alarms"]] == [2]
    assert [one["time"] for one in found["torque_changes"]] == [40.0]
    assert found["false_alarms_per_hour"]["at_most"] == pytest.approx(-np.log(0.05) / 5.55, abs=0.01)


def test_what_is_not_settled_is_no_reference_and_no_change():
    time, commands = broken([0.3, 0.0, 0.0, 0.0])
    # Landed, and off again with another load: what comes after is compared with itself.
    assert not watched(MotorWatch(NAMES, (1, 2, 3, 4), X, SPINS), time, commands, lambda at: not 20 < at < 30)
    assert not watched(MotorWatch(NAMES, (1, 2, 3, 4), X, SPINS), time, commands, lambda at: at < 25)


def test_without_spins_it_says_why_it_is_silent():
    watch = MotorWatch(NAMES, (1, 2, 3, 4), X, ())
    assert not watched(watch, *broken([0.3, 0.0, 0.0, 0.0])) and "not known" in watch.obstacle
