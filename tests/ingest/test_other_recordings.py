"""Parts of another recording inside a log or a stream are left out and counted; a second boot is kept."""

import struct

import mavlink_streams
import numpy as np
from dataflash_logs import formats, message
from pytest import approx, mark, param

from mavdem.facts.sources import Repair
from mavdem.ingest.dataflash.log import read_dataflash
from mavdem.ingest.other_recordings import END_OF_FILE, LeftOutBlock, outside_blocks

STEP = 0.02


def attitudes(start, end, roll=100):
    """ATT at 50 Hz from one time of the boot clock to another, s."""
    count = round((end - start) / STEP)
    return b"".join(
        message("ATT", round((start + STEP * row) * 1e6), 0, roll + row % 3) for row in range(count)
    )


def vehicle_of(folder, content):
    path = folder / "log.bin"
    path.write_bytes(formats() + content)
    return read_dataflash(path).vehicles[0]


def duration_and_boots(vehicle):
    columns = next(columns for columns in vehicle.messages.values() if len(columns["time"]) > 1000)
    return columns["time"].max() - columns["time"].min(), len({*columns["boot"].tolist()})


@mark.slow
@mark.parametrize("old_start", [5.0, 70.0, 400.0])
def test_blocks_of_an_older_log_are_left_out_and_counted(old_start, tmp_path):
    content = attitudes(20.0, 50.0)
    for number in range(5):
        old = old_start + 40.0 * number
        content += attitudes(old, old + 6.0, roll=300)
        content += attitudes(50.0 + 10.0 * number, 60.0 + 10.0 * number)
    vehicle = vehicle_of(tmp_path, content)
    assert duration_and_boots(vehicle) == (approx(80.0, abs=0.1), 1)
    (repair,) = [fact for fact in vehicle.repairs if fact.code is Repair.OLD_BLOCKS_LEFT_OUT]
    assert repair.figures["count"] == 5
    assert repair.figures["duration"] == approx(30.0, abs=0.2)


def test_of_swapped_blocks_the_one_in_the_wrong_place_is_left_out(tmp_path):
    content = attitudes(20.0, 50.0) + attitudes(54.0, 58.0) + attitudes(50.0, 54.0)
    vehicle = vehicle_of(tmp_path, content + attitudes(58.0, 90.0))
    assert duration_and_boots(vehicle) == (approx(70.0, abs=0.1), 1)
    codes = [fact.code for fact in vehicle.repairs]
    assert codes == [Repair.OLD_BLOCKS_LEFT_OUT]


@mark.slow
@mark.parametrize("start", [200, 3000])
def test_a_block_that_is_repeated_later_is_left_out(start, tmp_path):
    """300 messages of a DataFlash log are there twice, one block after the other."""
    flight = attitudes(20.0, 150.0)
    message_bytes = len(message("ATT"))
    block = flight[start * message_bytes : (start + 300) * message_bytes]
    end = (start + 300) * message_bytes
    vehicle = vehicle_of(tmp_path, flight[:end] + block + flight[end:])
    assert duration_and_boots(vehicle) == (approx(130.0, abs=0.1), 1)
    assert len(vehicle.messages["ATTITUDE_TARGET"]["time"]) == round(130.0 / STEP)


@mark.slow
@mark.parametrize("pause", [0.0, 300.0])
def test_a_second_boot_is_kept(pause, tmp_path):
    content = attitudes(20.0, 80.0) + attitudes(80.0 + pause, 100.0 + pause)
    vehicle = vehicle_of(tmp_path, content + attitudes(4.0, 70.0))
    assert [fact.code for fact in vehicle.repairs] == [Repair.LOG_OF_SEVERAL_BOOTS]
    assert duration_and_boots(vehicle)[1] == 2


def test_a_log_that_is_there_twice_is_read_once(tmp_path):
    flight = attitudes(20.0, 80.0)
    vehicle = vehicle_of(tmp_path, flight + formats() + flight)
    assert duration_and_boots(vehicle) == (approx(60.0, abs=0.1), 1)
    assert [fact.code for fact in vehicle.repairs] == [Repair.OLD_BLOCKS_LEFT_OUT]


@mark.slow
def test_a_block_near_the_beginning_that_is_repeated_is_no_boot(tmp_path):
    """A block of 3321 bytes, which begins in the midst of a message, is there twice."""
    flight = attitudes(20.0, 90.0)
    message_bytes = len(message("ATT"))
    end = 125 * message_bytes
    vehicle = vehicle_of(tmp_path, flight[:end] + flight[end - 3321 : end] + flight[end:])
    assert duration_and_boots(vehicle) == (approx(70.0, abs=0.1), 1)
    (repair,) = [fact for fact in vehicle.repairs if fact.code is Repair.OLD_BLOCKS_LEFT_OUT]
    assert repair.figures["size"] == approx(3321, abs=2 * message_bytes)


@mark.slow
def test_a_second_log_that_begins_late_on_its_clock_is_kept(tmp_path):
    content = attitudes(120.0, 180.0) + formats() + attitudes(90.0, 170.0)
    vehicle = vehicle_of(tmp_path, content)
    assert [fact.code for fact in vehicle.repairs] == [Repair.LOG_OF_SEVERAL_BOOTS]


WEEK = 2300


def satellite_times(start, end, utc_at_boot):
    """GPS once a second with a fix, of a boot clock that read 0 at a time of the week, s."""
    return b"".join(
        message("GPS", round(1e6 * second), 0, 3, round(1e3 * (utc_at_boot + second)), WEEK)
        for second in range(round(start), round(end))
    )


def with_satellites(start, end, utc_at_boot):
    """Attitudes, with a satellite time after each second of them."""
    return b"".join(
        attitudes(second, second + 1.0) + satellite_times(second, second + 1.0, utc_at_boot)
        for second in range(round(start), round(end))
    )


@mark.slow
@mark.parametrize("old_start", [5, 400])
def test_a_tail_of_an_older_flight_is_left_out_by_its_satellite_time(old_start, tmp_path):
    content = with_satellites(20, 80, utc_at_boot=90_000)
    content += with_satellites(old_start, old_start + 15, utc_at_boot=7_000)
    vehicle = vehicle_of(tmp_path, content)
    assert duration_and_boots(vehicle) == (approx(60.0, abs=0.1), 1)
    (repair,) = [fact for fact in vehicle.repairs if fact.code is Repair.OLD_BLOCKS_LEFT_OUT]
    assert repair.figures["count"] == 1
    assert repair.figures["duration"] == approx(15.0, abs=0.2)


@mark.slow
def test_a_second_boot_and_a_pause_fit_the_satellite_time(tmp_path):
    content = with_satellites(20, 80, utc_at_boot=90_000)
    content += with_satellites(300, 360, utc_at_boot=90_000)
    content += with_satellites(5, 60, utc_at_boot=90_420)
    vehicle = vehicle_of(tmp_path, content)
    assert [fact.code for fact in vehicle.repairs] == [Repair.LOG_OF_SEVERAL_BOOTS]
    assert duration_and_boots(vehicle)[1] == 2


def stream_part(received, start, end, sequence=0):
    """Returns frames of a flight from start to end on the boot clock, s.

    Their stamps begin at the time of reception, s, and their sequence numbers at ``sequence``.
    """
    frames = b""
    for row in range(round((end - start) / STEP)):
        stamp = mavlink_streams.NOW + round(1e6 * (received + STEP * row))
        for content in mavlink_streams.flight([start + STEP * row], sequence=sequence):
            frames += struct.pack(">Q", stamp) + content
        sequence += 2
    return frames


def stream_vehicle(*parts):
    heartbeat = struct.pack(">Q", mavlink_streams.NOW) + mavlink_streams.heartbeat()
    return mavlink_streams.read(heartbeat + b"".join(parts)).vehicles[0]


def boots_and_codes(vehicle):
    boots = np.unique(vehicle.messages["ATTITUDE"]["boot"])
    return len(boots), [fact.code for fact in vehicle.repairs]


@mark.slow
@mark.parametrize(
    "other_start", [param(5.0, marks=mark.in_full), 250.0, param(380.0, marks=mark.in_full)]
)
def test_another_sender_for_a_while_is_left_out_of_a_stream(other_start):
    """For 15 s another vehicle with the same ids and another clock is received."""
    vehicle = stream_vehicle(
        stream_part(0.0, 400.0, 440.0),
        stream_part(40.0, other_start, other_start + 15.0),
        stream_part(55.0, 455.0, 480.0),
    )
    assert boots_and_codes(vehicle) == (1, [Repair.OTHER_CLOCK_LEFT_OUT])
    time = vehicle.messages["ATTITUDE"]["time"]
    assert (time.min(), time.max()) == (approx(400.0), approx(480.0, abs=0.1))
    (repair,) = vehicle.repairs
    assert repair.figures["count"] == 2 * round(15.0 / STEP)
    assert repair.figures["duration"] == approx(15.0, abs=0.1)


@mark.slow
def test_a_clock_that_falls_without_a_pause_and_not_to_zero_is_no_reboot():
    vehicle = stream_vehicle(stream_part(0.0, 400.0, 440.0), stream_part(40.0, 250.0, 270.0))
    assert boots_and_codes(vehicle) == (1, [Repair.OTHER_CLOCK_LEFT_OUT])


@mark.slow
@mark.parametrize("set_to", [250.0, 20.0])
def test_a_clock_that_is_set_back_while_the_sequence_numbers_go_on_is_continued(set_to):
    """The autopilot neither restarted, nor is it another sender: nothing of its flight is left out."""
    after = stream_part(4.0, set_to, set_to + 3.0, sequence=2 * round(4.0 / STEP))
    vehicle = stream_vehicle(stream_part(0.0, 400.0, 404.0), after)
    assert boots_and_codes(vehicle) == (1, [Repair.CLOCK_SET_BACK])
    time = vehicle.messages["ATTITUDE"]["time"]
    assert len(time) == round(7.0 / STEP)
    assert np.diff(time) == approx(STEP, abs=0.002)


@mark.slow
def test_a_reboot_while_nothing_was_received_is_one():
    vehicle = stream_vehicle(stream_part(0.0, 400.0, 440.0), stream_part(320.0, 250.0, 270.0))
    assert boots_and_codes(vehicle) == (2, [Repair.LOG_OF_SEVERAL_BOOTS])


@mark.slow
def test_a_reboot_to_near_zero_is_one_in_a_stream():
    vehicle = stream_vehicle(stream_part(0.0, 400.0, 440.0), stream_part(45.0, 3.0, 40.0))
    assert boots_and_codes(vehicle) == (2, [Repair.LOG_OF_SEVERAL_BOOTS])


def test_messages_outside_of_many_blocks_are_found_at_their_limits():
    blocks = [
        LeftOutBlock(10, 20, 1.0),
        LeftOutBlock(20, 30, 1.0),
        LeftOutBlock(50, END_OF_FILE, 1.0),
    ]
    positions = np.array([60, 0, 10, 19, 20, 29, 30, 49, 50])
    assert positions[outside_blocks(blocks, positions)].tolist() == [0, 30, 49]
