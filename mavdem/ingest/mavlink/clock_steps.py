"""Steps of an autopilot's clock backward while its messages go on, which are undone.

A clock that falls is that of a restarted autopilot, of another sender under the same ids, or was set back. The last
shows in the sequence numbers of the frames: they go on over the fall, as those of no other sender do. The clock of an
autopilot that restarted cannot read more than the time that has passed since.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.ingest.mavlink.clock_readings import (
    MAX_STAMP_DEVIATION,
    MessageStamps,
    ReceiveTimes,
    StreamPositions,
    outlier_stamps,
    stamped_messages,
)
from mavdem.ingest.mavlink.framing import Frames
from mavdem.ingest.mavlink.reference_clock import (
    MAX_LATE_SECONDS,
    MIN_RESET_STAMPS,
    reference_type_of,
)
from mavdem.ingest.mavlink.sequence_counters import SEQUENCE_NUMBERS

MAX_PAUSE = 2.0
"""Time, s, without a stamped message over which the messages still go on: a choice, a few of the slowest streams."""

MAX_LOST_FRAMES = 4
"""Number of frames that may be lost where the clock falls, by the sequence numbers, if they are of one sender: a
choice. Those of another sender are as near by chance once in 50 times."""


class ClockStep(NamedTuple):
    """A step of the clock backward."""

    position: int
    """Position in the stream of the first message after it."""
    time_before: float
    """The clock just before, s."""
    seconds: float
    """By how much it was set back, s."""


def backward_clock_steps(
    message_types: Sequence[MessageStamps], frames: Frames, receive_times: ReceiveTimes
) -> list[ClockStep]:
    """Finds the steps of a component's clock backward while its messages went on.

    A step is larger than ``MAX_LATE_SECONDS``, since messages of a slower link come late, and the clock stays below for
    ``MIN_RESET_STAMPS``.

    Args:
        message_types: The component's messages by type, with their stamps.
        frames: The frames of the stream.
        receive_times: Returns when the messages at some positions were received, s; NaN where that is not known.

    Returns:
        The steps in the order of the stream; none where reception times are not known.
    """
    reference = reference_type_of(message_types)
    if reference is None:
        return []
    positions, seconds = stamped_messages(reference)
    is_sound = ~outlier_stamps(seconds)
    positions, seconds = positions[is_sound], seconds[is_sound]
    steps = []
    for row in np.flatnonzero(np.diff(seconds) < -MAX_LATE_SECONDS).tolist():
        pair = positions[row : row + 2]
        stamps_after = seconds[row + 1 : row + 1 + MIN_RESET_STAMPS]
        stays_below = stamps_after.max() < seconds[row] - MAX_LATE_SECONDS
        received_before, received_after = receive_times(pair)
        pause = float(received_after - received_before)
        # Comparisons with NaN are false.
        goes_on = 0.0 <= pause <= MAX_PAUSE and _are_numbered_in_turn(frames, pair)
        time_before, time_after = float(seconds[row]), float(seconds[row + 1])
        may_have_restarted = time_after <= pause + MAX_STAMP_DEVIATION
        if stays_below and goes_on and not may_have_restarted:
            steps.append(ClockStep(int(pair[1]), time_before, time_before + pause - time_after))
    return steps


def _are_numbered_in_turn(frames: Frames, pair: StreamPositions) -> bool:
    """Returns whether two frames of a sender are numbered in turn, with its frames between them.

    Args:
        frames: The frames of the stream.
        pair: Positions of both (2,).
    """
    first, second = np.searchsorted(frames.start, pair).tolist()
    following = frames[slice(first + 1, second + 1)]
    is_of_sender = following.system == frames.system[first]
    is_of_sender &= following.component == frames.component[first]
    step = int(frames.sequence[second]) - int(frames.sequence[first])
    lost_frames = (step - int(np.count_nonzero(is_of_sender))) % SEQUENCE_NUMBERS
    return lost_frames <= MAX_LOST_FRAMES


def with_steps_undone(message_type: MessageStamps, steps: Sequence[ClockStep]) -> MessageStamps:
    """Returns the messages of a type with stamps whose clock goes on over some steps backward.

    A type keeps its stamps if they do not fall at a step: they may count from 1970, or be of another computer.

    Args:
        message_type: The messages, with their stamps.
        steps: The steps of the component's clock, in the order of the stream.
    """
    stamps = message_type.stamps
    if not steps or stamps is None:
        return message_type
    if callable(stamps):
        stamps = stamps()
    continued = np.array(stamps, dtype=np.float64)
    for step in steps:
        first_row = int(np.searchsorted(message_type.positions, step.position))
        if first_row == len(stamps):
            continue
        time_before = stamps[first_row - 1] if first_row else step.time_before
        if time_before - stamps[first_row] > step.seconds / 2:
            # A stamp of 0 was not set.
            continued[first_row:] += step.seconds * (stamps[first_row:] > 0)
    return message_type._replace(stamps=continued)
