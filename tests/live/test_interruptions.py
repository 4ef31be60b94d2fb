"""What interrupts a link: gaps, reboots, jumps, other rates, landings, bursts, copies, messages out of order."""

import random
from dataclasses import replace

import numpy as np
from hover import Hover
from live_hover import Flight, differences, offline, replay, settled_uniform
from mavlink_streams import message
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, mark, param

from mavdem.facts.session import RowsFact, VehicleFact

pytestmark = [mark.slow, mark.usefixtures("without_alarms")]

FLIGHT = Flight(hover=Hover(hovering=30.0), attitude=50.0, motors=50.0)
"""A replay takes as long as it has messages, and rows of a model need 40 Hz."""


@fixture(scope="module")
def undisturbed(without_alarms):
    """The flight up to 14 s, without any interruption of the link."""
    return replay(FLIGHT.frames(end=14.0))


def same_as_offline(replayed, frames):
    telemetry = offline([data for _, data in frames])
    for number in replayed.segments():
        assert max(differences(replayed, number, telemetry)) < 1e-9


@mark.parametrize("silence", [param(0.15, marks=mark.in_full), 300.0])
def test_a_gap_begins_a_new_segment_with_the_same_step(silence):
    """No message arrives for 0.15 s, or for 300 s, while the vehicle flies on."""
    frames = FLIGHT.frames(end=18.0)
    # The vehicle flew on meanwhile.
    later_frames = replace(FLIGHT, hover=Hover(hovering=30.0 + silence)).frames(
        start=18.0 + silence, end=22.0 + silence
    )
    replayed = replay(frames + later_frames)
    assert replayed.segments().keys() == {0, 1}
    assert replayed.setups[0].dt == replayed.setups[1].dt == 0.02
    # A review, which goes on with the messages, decides anew what rows are made of.
    assert replayed.segments()[1][0].time == approx(18.0 + silence, abs=0.4)
    assert all(row.is_settled for row in replayed.segments()[1])
    assert (VehicleFact.CLOCK_JUMPED if silence > 5 else RowsFact.MESSAGE_GAP) in replayed.codes
    if silence >= 1.0:
        assert replayed.stream.status().gap_seconds == approx(silence, abs=0.1)
    settled_uniform(replayed)
    same_as_offline(replayed, frames + later_frames)


def test_a_message_that_is_lost_is_bridged():
    """One message is lost, then a fifth of all messages at random: the rows go on in one segment."""
    frames = FLIGHT.frames(end=16.0)
    del frames[1200 + 7]
    replayed = replay(frames)
    assert replayed.segments().keys() == {0} and replayed.stream.status().lost_messages == 1
    settled_uniform(replayed)
    random_generator = random.Random(3)
    replayed = replay(
        [entry for entry in FLIGHT.frames(end=18.0) if random_generator.random() > 0.2]
    )
    assert replayed.segments().keys() == {0}, "nor does a fifth that is lost begin another segment"
    settled_uniform(replayed)


def test_another_rate_in_flight_decides_the_step_anew():
    """Messages come at 50 Hz, and at 100 Hz from 18 s on, so that a segment with half the step begins."""
    fast = replace(FLIGHT, attitude=100.0, motors=100.0)
    replayed = replay(FLIGHT.frames(end=18.0) + fast.frames(start=18.0, end=26.0))
    assert [setup.dt for setup in replayed.setups.values()] == [0.02, 0.01]
    changed = [fact for fact in replayed.facts if fact.code is RowsFact.RATE_CHANGED]
    assert changed and changed[0].figures["former_rate"] == approx(50.0)
    assert replayed.segments()[1][0].time < 21.0 and all(
        row.is_settled for row in replayed.segments()[1]
    )
    settled_uniform(replayed)


@mark.in_full
def test_jitter_of_a_scheduler_changes_the_grid_neither_live_nor_offline():
    """200 Hz asked of a loop of 4 ms: steps of 4, 8 and 12 ms come, of 8.5 ms in the mean."""
    steps = default_rng(0).choice((1, 2, 3), 2500, p=(0.13, 0.62, 0.25))
    fast = replace(FLIGHT, attitude=250.0, motors=250.0).frames(end=15.0)
    sent = set(np.cumsum(steps).tolist())
    frames = [
        (time, data)
        for time, data in fast
        if data[7] not in (30, 36) or int(250 * time + 0.01) in sent
    ]
    replayed = replay(frames)
    assert [setup.dt for setup in replayed.setups.values()] == [0.008]
    same_as_offline(replayed, frames)


def test_a_slow_stream_is_reported_with_its_remedy_and_gives_no_rows():
    """Motor outputs at 4 Hz are too slow, until they come at 50 Hz.

    The remedy is to request a higher rate, unless the session does that already.
    """
    slow = replace(FLIGHT, motors=4.0).frames(end=18.0)
    replayed = replay(slow)
    assert not replayed.rows
    (fact,) = (fact for fact in replayed.facts if fact.code is RowsFact.LIVE_RATES_TOO_LOW)
    assert fact.figures["can_ask"] and "SERVO_OUTPUT_RAW" in str(fact)
    assert replayed.stream.status().rates["SERVO_OUTPUT_RAW"] == approx(4.0, abs=0.1)
    cured = replay(FLIGHT.frames(start=18.0, end=24.0), replayed.stream)
    assert RowsFact.LIVE_RATES_ENOUGH in cured.codes
    assert cured.rows[0].time < 20.6 and all(row.is_settled for row in cured.rows)
    obstacle = replay(slow[: len(slow) // 2], rates_requested=True).stream.status().no_model_reason
    assert obstacle.code is RowsFact.LIVE_RATES_TOO_LOW and not obstacle.figures["can_ask"]
    assert not obstacle.remedy, "who asks for rates is not advised to"
    frames_without_motors = [
        (time, data) for time, data in FLIGHT.frames(end=10.0) if data[7] != 36
    ]
    assert RowsFact.NO_LIVE_MOTORS in replay(frames_without_motors).codes


@mark.in_full
def test_copies_change_nothing(undisturbed):
    frames = FLIGHT.frames(end=14.0)
    twice = [entry for entry in frames for _ in range(2)]
    assert_array_equal(replay(twice).table(), undisturbed.table())


def test_messages_out_of_order_are_put_in_order_or_counted(undisturbed):
    """Every 40th message is swapped with the next one or the one after it."""
    frames = FLIGHT.frames(end=14.0)
    swapped = list(frames)
    for row in range(0, len(swapped) - 3, 40):
        next_row = row + 1 + row // 40 % 2
        swapped[row], swapped[next_row] = swapped[next_row], swapped[row]
    replayed = replay(swapped)
    settled_uniform(replayed)
    assert replayed.segments().keys() == {0}
    status = replayed.stream.status()
    assert status.late_samples < 100 and status.lost_messages == 0, (
        "one that is overtaken is not lost"
    )
    count = min(len(replayed.rows), len(undisturbed.rows))
    assert_allclose(replayed.table()[-count:, 5], undisturbed.table()[-count:, 5], atol=0.01)


def octo():
    """Eight motors, four on each of two ports, the second sent a millisecond after the first."""
    flight = Flight(kind="OCTOROTOR", attitude=50.0, motors=50.0)
    frames = []
    for time, data in flight.frames(end=15.0):
        frames.append((time, data))
        if data[7] == 36:
            (outputs,) = np.rint(flight.hover.motors(np.array([time + 0.001])))
            stamp = {"time_usec": round((time + 0.001) * 1e6), "port": 1, "sequence": data[4]}
            fields = {f"servo{n + 1}_raw": int(outputs[n]) + 10 * n for n in range(4)}
            frames.append((time, message("SERVO_OUTPUT_RAW", **stamp, **fields)))
    return frames


def test_motors_on_two_ports_are_reported_together():
    """An octorotor sends the outputs of motors 1 to 4 and of 5 to 8 in separate messages."""
    frames = octo()
    replayed = replay(frames)
    # ArduPilot fills sixteen fields, so the second port begins with output 17.
    assert replayed.setups[0].geometry.channels == (1, 2, 3, 4, 17, 18, 19, 20)
    times, outputs, inputs = differences(replayed, 0, offline([data for _, data in frames]))
    assert times < 1e-6
    assert outputs == 0.0
    # Offline the second port is read off the line at the first one's stamps, live at the grid: 0.2 ms of their motion.
    assert inputs < 1.0


def test_pitch_is_read_from_pitch():
    frames = FLIGHT.frames(end=14.0)
    replayed = replay(frames, axis="pitch")
    times, outputs, inputs = differences(
        replayed, 0, offline([data for _, data in frames]), "pitch"
    )
    assert max(times, outputs, inputs) == 0.0
    assert_allclose(replayed.rows[-1].outputs, [0.01, 0.1], rtol=1e-6)


def test_a_second_link_that_is_late_changes_nothing(undisturbed):
    """A second link brings the same messages 2 s later."""
    frames = FLIGHT.frames(end=14.0)
    late = [(time + 2.0, data) for time, data in frames]
    replayed = replay(sorted(frames + late, key=lambda entry: entry[0]))
    assert_array_equal(replayed.table(), undisturbed.table())
    status = replayed.stream.status()
    assert status.lost_messages == 0 and status.late_samples == 0
    assert VehicleFact.VEHICLE_REBOOTED not in replayed.codes
