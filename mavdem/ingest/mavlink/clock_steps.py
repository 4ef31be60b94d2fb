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
    positions, clock = stamped_messages(reference)
    is_sound = ~outlier_stamps(clock)
    positions, clock = positions[is_sound], clock[is_sound]
    steps = []
    for last_row_before in np.flatnonzero(np.diff(clock) < -MAX_LATE_SECONDS).tolist():
        first_row_after = last_row_before + 1
        time_before, time_after = float(clock[last_row_before]), float(clock[first_row_after])
        stamps_after = clock[first_row_after : first_row_after + MIN_RESET_STAMPS]
        stays_below = stamps_after.max() < time_before - MAX_LATE_SECONDS
        messages_around_fall = positions[[last_row_before, first_row_after]]
        received_before, received_after = receive_times(messages_around_fall)
        pause = float(received_after - received_before)
        # A pause that is not known is NaN, and fails both comparisons.
        messages_go_on = 0.0 <= pause <= MAX_PAUSE and _are_numbered_in_turn(
            frames, messages_around_fall
        )
        # Within the pause, an autopilot that restarted can have counted no further than this.
        may_have_restarted = time_after <= pause + MAX_STAMP_DEVIATION
        if stays_below and messages_go_on and not may_have_restarted:
            # Without the step the clock would have gone on by the pause.
            set_back_by = time_before + pause - time_after
            steps.append(
                ClockStep(
                    position=int(positions[first_row_after]),
                    time_before=time_before,
                    seconds=set_back_by,
                )
            )
    return steps


def _are_numbered_in_turn(frames: Frames, pair: StreamPositions) -> bool:
    """Returns whether the sequence numbers of two frames agree with the number of frames sent between them.

    A component numbers its frames 0 to 255 in turn, over and over. The difference of the two numbers is compared with
    the number of frames of this component from the first, exclusive, to the second, inclusive. Up to
    ``MAX_LOST_FRAMES`` may be missing.

    Args:
        frames: The frames of the stream.
        pair: Positions in the stream of the two frames (2,), of one component.
    """
    first, second = np.searchsorted(frames.start, pair).tolist()
    frames_after_first = frames[first + 1 : second + 1]
    is_of_component = (frames_after_first.system == frames.system[first]) & (
        frames_after_first.component == frames.component[first]
    )
    received_frames = int(np.count_nonzero(is_of_component))
    sent_frames = int(frames.sequence[second]) - int(frames.sequence[first])
    lost_frames = (sent_frames - received_frames) % SEQUENCE_NUMBERS
    return lost_frames <= MAX_LOST_FRAMES


def with_steps_undone(message_type: MessageStamps, steps: Sequence[ClockStep]) -> MessageStamps:
    """Adds to the stamps after each step of the clock by how much it was set back, so that the clock seems to go on.

    Stamps of this type that do not fall at a step are of another clock: they may count from 1970, or be those of
    another computer. These are not changed.

    Args:
        message_type: Messages of one type in the order of the stream, with their stamps, s, and stream positions.
        steps: The steps backward of the component's clock, in the order of the stream.

    Returns:
        The messages with the changed stamps.
    """
    if not steps:
        # Without a step the stamps need not be decoded yet.
        return message_type
    stamps = message_type.decoded_stamps()
    if stamps is None:
        return message_type
    continued = np.array(stamps, dtype=np.float64)
    for step in steps:
        first_row_after = int(np.searchsorted(message_type.positions, step.position))
        if first_row_after == len(stamps):
            # All messages of this type came before the step.
            continue
        time_before = stamps[first_row_after - 1] if first_row_after else step.time_before
        fall = time_before - stamps[first_row_after]
        # Messages of this type are rarer than those that showed the step, so that their stamps fall by less. Those of
        # another clock rise.
        falls_at_step = fall > step.seconds / 2
        if falls_at_step:
            # A stamp of 0 means that the sender knew no time.
            is_set = stamps[first_row_after:] > 0
            continued[first_row_after:][is_set] += step.seconds
    return message_type._replace(stamps=continued)
