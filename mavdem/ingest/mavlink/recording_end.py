"""The mark at the end of a recording that its user ended, which distinguishes it from a recording that a failure ended.

The mark is an ordinary STATUSTEXT of a logger, so that every program reads the file as before.
"""

import numpy as np

from mavdem.ingest.mavlink.dialect import definitions_by_name, mavlink_constant
from mavdem.ingest.mavlink.frame_stream import FrameStream
from mavdem.ingest.mavlink.framing import frame_content
from mavdem.ingest.mavlink.payloads import FrameSender, encode_frame, filled_payloads
from mavdem.ingest.telemetry import MICROSECONDS

RECORDER = FrameSender(255, mavlink_constant("MAV_COMP_ID_LOG"))
"""Sender of the mark: the logger of a ground station."""

END_TEXT = b"mavdem: recording ended by its user"
"""Text of the mark; it names the program, since others show it among the texts of the vehicle."""

MAX_SILENCE_BEFORE_END = 3.0
"""Longest time between the last frame of the vehicle and the mark, s, with which the mark ended its record.

A choice: as long as a live session waits until it reports silence. A vehicle that was silent for longer was lost before
somebody ended the recording. It bounds the other direction too: a mark stamped longer before the last frame belongs
to another recording, or to a clock that was set in between.
"""


def end_mark() -> bytes:
    """Returns the frame that marks the end of a recording; it is always the same."""
    severity = mavlink_constant("MAV_SEVERITY_INFO")
    payload = filled_payloads("STATUSTEXT", severity=severity, text=END_TEXT).tobytes()
    return encode_frame(payload, definitions_by_name()["STATUSTEXT"], RECORDER, sequence=0)


def is_ended_on_purpose(stream: FrameStream, sender: FrameSender) -> bool:
    """Returns whether the record of a vehicle ends because the user ended the recording, and not with the vehicle.

    That is so if the last frame of the recording is the mark, received shortly after the vehicle's last frame.

    Args:
        stream: frames of the recording, with their receive times.
        sender: ids of the vehicle, which sent at least one frame.
    """
    frames = stream.frames
    last_row = len(frames) - 1
    if frame_content(stream.data, frames, last_row) != end_mark():
        return False
    is_of_vehicle = (frames.system == sender.system) & (frames.component == sender.component)
    rows = np.array([np.flatnonzero(is_of_vehicle)[-1], last_row])
    last_receive_time, end_time = (stream.receive_stamps(rows) / MICROSECONDS).tolist()
    return bool(abs(end_time - last_receive_time) <= MAX_SILENCE_BEFORE_END)
