"""Frames of a sender that are taken in runs give what they give one by one."""

from functools import cache

import numpy as np
from pytest import mark, param

from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES, frame_content
from mavdem.ingest.mavlink.sender_links import SenderLinks
from mavdem.ingest.mavlink.sender_streams import sender_stream_of
from tests.ingest.mavlink_streams import frames_in, message

pytestmark = mark.slow


def vehicle_frames(random, count, start, heading, first_sequence):
    """Returns frames of a vehicle whose heading turns and whose position is sent now and then.

    One in twenty is lost.
    """
    frames = []
    for row in range(count):
        clock = round(1e3 * start) + 20 * row
        fields = {
            "time_boot_ms": clock,
            "yaw": heading + 0.2 * np.sin(row / 40),
            "roll": 0.1 * heading,
        }
        name = "ATTITUDE"
        if row % 5 == 0:
            name = "HEARTBEAT"
            fields = {"type": 2}
        elif row % 7 == 0:
            name = "GLOBAL_POSITION_INT"
            fields = {"time_boot_ms": clock, "lat": 470000000 + row, "lon": 80000000}
        frames.append(message(name, sequence=(first_sequence + row) % 256, **fields))
    return [frame for frame in frames if random.random() > 0.05]


def with_copies(random, frames, share, delay):
    """A stream in which some frames come again, some frames later."""
    arrivals = [(float(row), frame) for row, frame in enumerate(frames)]
    arrivals += [(row + delay, frame) for row, frame in arrivals if random.random() < share]
    return [frame for _, frame in sorted(arrivals, key=lambda arrival: arrival[0])]


@cache
def streams(seed):
    """Returns the frames of one link, two links, two vehicles, a restart, and a recording that is repeated."""
    random = np.random.default_rng(seed)
    single = vehicle_frames(random, 1500, 10.0, 0.3, 0)
    other = vehicle_frames(random, 1500, 10.0, 1.5, 90)
    return [
        with_copies(random, single, 0.02, 40.5),
        single[:400] + with_copies(random, single[400:800], 0.5, 3.5) + single[800:],
        [frame for pair in zip(single, other, strict=False) for frame in pair],
        single + vehicle_frames(random, 800, 1.0, -0.4, 17),
        single + single,
    ]


@mark.parametrize("seed", [0, param(1, marks=mark.in_full)])
@mark.parametrize("kind", range(5))
def test_runs_of_frames_give_what_single_frames_give(seed, kind):
    """The reader of files processes many frames at once, the live reader one by one: both must agree."""
    content = b"".join(streams(seed)[kind])
    frames = frames_in(content)
    data = np.frombuffer(content, dtype=np.uint8)
    stream = sender_stream_of(data, frames, np.arange(len(frames)))
    links = SenderLinks()
    is_no_copy = []
    for row in range(len(frames)):
        is_readable = bool(frames.checksum[row] == CHECKSUM_MATCHES)
        message_id = int(frames.message_id[row])
        bytes_of_frame = frame_content(data, frames, row)
        is_no_copy.append(
            links.process_frame(bytes_of_frame, message_id, int(frames.sequence[row]), is_readable)
        )
    assert stream.is_no_copy.tolist() == is_no_copy
    assert stream.lost == max(links.missing, 0)
    assert stream.copies == links.copies
    assert stream.longest_delay == links.longest_delay
    assert stream.has_two_senders == links.has_found_two_vehicles
