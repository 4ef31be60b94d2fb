"""The boot clock undoes wraps, counts reboots, keeps gaps, and is not taken in by outliers."""

from typing import NamedTuple

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pytest import approx, mark

from mavdem.facts.sources import Repair
from mavdem.ingest.mavlink.clock_readings import MessageStamps
from mavdem.ingest.mavlink.clocks import boot_clock
from mavdem.ingest.mavlink.restarts import HeartbeatStates

WRAP_US = 2.0**32 / 1e6
WRAP_MS = 2.0**32 / 1e3


class Clock(NamedTuple):
    """``time`` and ``boot`` of all messages in the order they came, and the repairs."""

    time: np.ndarray
    boot: np.ndarray
    repairs: tuple


def clock(message_types, count):
    """Puts messages on the boot clock. Positions that no message type has are those of messages without stamps."""
    stamped = np.concatenate([message_type.positions for message_type in message_types])
    unstamped = MessageStamps("HEARTBEAT", np.setdiff1d(np.arange(count), stamped))
    boot_times, repairs, _ = boot_clock([*message_types, unstamped])
    time = np.empty(count)
    boot = np.empty(count, dtype=np.int64)
    for message_type in (*message_types, unstamped):
        time[message_type.positions] = boot_times[message_type.message].time
        boot[message_type.positions] = boot_times[message_type.message].boot
    return Clock(time, boot, repairs)


def clock_of(times, period=WRAP_MS):
    return clock([MessageStamps("ATTITUDE", np.arange(len(times)), times, period)], len(times))


def interleaved(times, servo):
    """ATTITUDE and SERVO_OUTPUT_RAW in turn."""
    rows = np.arange(len(times))
    stamps = [
        MessageStamps("ATTITUDE", 2 * rows, times, WRAP_MS),
        MessageStamps("SERVO_OUTPUT_RAW", 2 * rows + 1, servo, WRAP_US),
    ]
    return clock(stamps, 2 * len(times))


@mark.slow
@given(st.floats(1, 3e6), st.floats(0.01, 5), st.integers(10, 300))
def test_servo_wraps_are_put_on_the_epoch_of_attitude(start, step, count):
    """SERVO_OUTPUT_RAW has 32-bit microseconds, which wrap after 71 minutes.

    ATTITUDE has milliseconds, which do not.
    """
    times = start + step * np.arange(count)
    servo = np.maximum((times + 0.001) % WRAP_US, 1e-6)
    clock_result = interleaved(times, servo)
    assert np.allclose(clock_result.time[::2], times, atol=1e-9)
    assert np.allclose(clock_result.time[1::2], times + 0.001, atol=2e-6)
    assert not clock_result.boot.any()


def test_a_wrap_of_the_only_clock_is_undone():
    times = 4000 + 0.5 * np.arange(2000)
    clock_result = clock_of(times % WRAP_US, period=WRAP_US)
    assert np.allclose(clock_result.time, times)
    assert not clock_result.boot.any()
    (wrap,) = clock_result.repairs
    assert wrap.code is Repair.CLOCK_WRAPPED and wrap.figures["period"] == WRAP_US
    # After a minute's silence it has restarted.
    clock_result = clock_of(
        np.append(WRAP_US - 5 + np.arange(5), 65 + np.arange(9)), period=WRAP_US
    )
    assert clock_result.boot.any()
    # So are 49 days.
    times = WRAP_MS - 30 + 0.1 * np.arange(1000)
    assert np.allclose(clock_of(times % WRAP_MS).time, times)


@mark.slow
@given(st.floats(20, 4200), st.floats(0.5, 15), st.floats(0.02, 1.0))
def test_a_reboot_starts_a_new_boot(before, after, step):
    """The clock counts 100 messages, and then begins again at a time before them."""
    first = before + step * np.arange(100)
    second = after + step * np.arange(100)
    times = np.concatenate([first, second])
    clock_result = clock_of(times)
    assert np.array_equal(clock_result.time, times)
    assert clock_result.boot.tolist() == [0] * 100 + [1] * 100


def test_messages_around_a_reboot_go_to_the_boot_their_own_stamp_tells():
    times = np.concatenate([500 + 0.25 * np.arange(40), 4 + 0.25 * np.arange(40)])
    servo = times + 0.01
    servo[39] = 3.9
    clock_result = interleaved(times, servo)
    assert clock_result.boot[79] == 1 and clock_result.time[79] == approx(3.9)
    assert clock_result.boot[77] == 0 and clock_result.boot[81] == 1


def test_a_text_before_the_first_stamp_of_a_boot_is_of_that_boot():
    """ArduPilot sends why its watchdog reset it before anything with a clock."""
    positions = np.r_[0:100, 103:203]
    attitude = MessageStamps("ATTITUDE", positions, np.r_[20.0:30.0:0.1, 1.0:11.0:0.1], WRAP_MS)
    texts = MessageStamps("STATUSTEXT", np.array([50, 100, 102]))
    received = np.r_[0.0:10.0:0.1, 10.1, 14.0, 14.1, 14.2:24.2:0.1]
    boot_times, _, delays = boot_clock([attitude, texts], lambda rows: received[rows])
    # The clock of the second boot read 1.0 s at 14.2 s, and the last message of the first came at 9.9 s.
    assert delays == {1: approx(14.2 - 1.0 - 9.9)}
    assert boot_times["STATUSTEXT"].boot.tolist() == [0, 0, 1]
    assert boot_times["STATUSTEXT"].time == approx([25.0, 29.9, 1.0])
    untold, _, no_delays = boot_clock([attitude, texts])
    assert untold["STATUSTEXT"].boot.tolist() == [0, 0, 0] and not no_delays
    received[102:] -= 86400.0
    of_day_before, _, _ = boot_clock([attitude, texts], lambda rows: received[rows])
    assert of_day_before["STATUSTEXT"].boot.tolist() == [0, 0, 1]


def test_heartbeats_alone_show_a_restart_and_count_its_time():
    """After its restart the autopilot sends HEARTBEATs, and once where it started, which has a stamp."""
    attitude = MessageStamps("ATTITUDE", np.arange(100), np.arange(20.0, 30.0, 0.1), WRAP_MS)
    beats = MessageStamps("HEARTBEAT", np.array([50, 100, 101, 102, 103, 105]))
    origins = MessageStamps("GPS_GLOBAL_ORIGIN", np.array([40, 104]), np.array([20.0, 4.1]))
    texts = MessageStamps("STATUSTEXT", np.array([60, 106]))
    received = np.r_[0.0:10.0:0.1, 10.5, 11.5, 12.5, 13.5, 14.6, 15.5, 16.0]
    states = HeartbeatStates(beats.positions, np.array([4, 4, 1, 1, 3, 4], dtype=np.uint8))
    message_types = [attitude, beats, origins, texts]
    clock_result = boot_clock(message_types, lambda rows: received[rows], states)
    assert clock_result.times["HEARTBEAT"].boot.tolist() == [0, 0, 1, 1, 1, 1]
    assert clock_result.times["HEARTBEAT"].time == approx([25.0, 29.9, 0.0, 1.0, 2.0, 4.0])
    assert clock_result.times["GPS_GLOBAL_ORIGIN"].boot.tolist() == [0, 1]
    assert clock_result.times["STATUSTEXT"].boot.tolist() == [0, 1]
    assert clock_result.times["STATUSTEXT"].time == approx([26.0, 4.0])
    assert clock_result.delays == {1: approx(11.5 - 9.9)}
    (reboot,) = clock_result.repairs
    assert reboot.code is Repair.LOG_OF_SEVERAL_BOOTS and reboot.time == approx(29.9)
    # An autopilot that is not starting has not restarted, though its messages with a clock ended.
    running = states._replace(system_status=np.full(6, 4, dtype=np.uint8))
    going_on = boot_clock(message_types, lambda rows: received[rows], running)
    assert not going_on.times["HEARTBEAT"].boot.any() and not going_on.delays


def test_a_reboot_after_a_wrap_reads_its_own_time():
    first = 4200 + 0.5 * np.arange(400)
    second = 5 + 0.5 * np.arange(100)
    clock_result = clock_of(np.concatenate([first % WRAP_US, second]), period=WRAP_US)
    assert np.allclose(clock_result.time, np.concatenate([first, second]))
    assert clock_result.boot.tolist() == [0] * 400 + [1] * 100


@mark.slow
@given(st.integers(0, 199), st.floats(0.001, 4e6), st.booleans())
def test_a_stray_stamp_is_no_reboot(row, wrong, twice):
    """One anywhere; two together away from the ends, where they could as well be a boot cut short."""
    times = 1000 + 0.1 * np.arange(200)
    stray = times.copy()
    stray[row : row + 1 + (twice and 2 <= row <= 196)] = wrong
    clock_result = clock_of(stray)
    assert not clock_result.boot.any()
    assert abs(clock_result.time - times).max() < 10


def test_late_messages_are_no_reboot():
    times = 100 + 0.1 * np.arange(400)
    late = times.copy()
    late[50::2] -= 3.0
    assert not clock_of(late).boot.any()
    rows = np.arange(400)
    for count in (4, 5, 30):
        low = np.where((rows >= 50) & (rows < 50 + count), times - 3.0, times)
        assert not clock_of(low).boot.any()


def test_a_reboot_seconds_after_the_start_is_no_late_link():
    times = np.concatenate([1 + 0.1 * np.arange(90), 1 + 0.1 * np.arange(300)])
    assert clock_of(times).boot.tolist() == [0] * 90 + [1] * 300
    # A second link, 3 s late, brings every fifth message, or brings all for a while.
    rows = np.arange(400)
    regular = 1 + 0.1 * rows
    fifth = np.concatenate([regular[:90], regular[60:90:5], regular[90:]])
    burst = np.where((rows >= 90) & (rows < 120), regular - 3.0, regular)
    assert not clock_of(fifth).boot.any()
    assert not clock_of(burst).boot.any()


def test_messages_of_another_time_are_no_reboot_where_the_clock_goes_on():
    times = 400 + 0.1 * np.arange(400)
    rows = np.arange(400)
    other = np.where((rows >= 50) & (rows < 70), times - 150.0, times)
    assert not clock_of(other).boot.any()


def test_a_clock_that_never_comes_back_is_a_reboot():
    times = np.concatenate([400 + 0.1 * np.arange(200), 250 + 0.1 * np.arange(200)])
    assert clock_of(times).boot.tolist() == [0] * 200 + [1] * 200


def test_a_jump_forward_stays_a_gap():
    times = np.concatenate([10 + 0.01 * np.arange(500), 600 + 0.01 * np.arange(500)])
    clock_result = clock_of(times)
    assert np.array_equal(clock_result.time, times)
    assert not clock_result.boot.any()
    assert clock_result.repairs == ()


def test_unix_time_is_moved_to_the_boot_clock():
    """Some messages of a log are stamped by UTC or another clock.

    Their offset to the boot clock is removed and reported.
    """
    times = np.linspace(50.0, 59.9, 100)
    rows = np.arange(100)
    for epoch in (1.6e9, 11.0):
        stamps = [
            MessageStamps("ATTITUDE", 2 * rows, times, WRAP_MS),
            MessageStamps("GPS_RAW_INT", 2 * rows + 1, times + epoch, np.inf),
        ]
        clock_result = clock(stamps, 200)
        assert abs(clock_result.time[1::2] - times).max() <= 0.1 + 1e-6
        (moved,) = clock_result.repairs
        assert moved.code is Repair.CLOCK_MOVED
        assert moved.figures["offset"] == approx(epoch, abs=0.2)
    # Messages without a clock take the last before them.
    stamps = [MessageStamps("ATTITUDE", np.array([1, 3, 4]), np.array([7.0, 7.1, 7.2]), WRAP_MS)]
    assert clock(stamps, 6).time.tolist() == [7.0, 7.0, 7.0, 7.1, 7.2, 7.2]


@mark.slow
@given(st.lists(st.floats(0, 4e6), min_size=1, max_size=60), st.booleans())
def test_any_stamps_at_all_give_finite_times(times, servo):
    values = np.array(times)
    clock_result = interleaved(values, values[::-1] % WRAP_US) if servo else clock_of(values)
    if values.any():
        assert np.isfinite(clock_result.time).all()
    assert (np.diff(clock_result.boot) >= -clock_result.boot.max()).all() and (
        clock_result.boot >= 0
    ).all()


def test_a_message_whose_stamp_is_ignored_repeats_the_last_of_its_kind():
    times = 100 + 0.1 * np.arange(200)
    servo = times + 0.05
    servo[100] += 5.5
    clock_result = interleaved(times, servo)
    assert clock_result.time[201] == clock_result.time[199]
    (ignored,) = clock_result.repairs
    assert dict(ignored.figures) == {"name": "SERVO_OUTPUT_RAW", "count": 1}
