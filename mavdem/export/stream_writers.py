"""Writers of streams of MAVLink frames, by the ending of the file: telemetry logs and MCAP recordings."""

from typing import BinaryIO

from mavdem.ingest.mavlink.frame_stream import FrameStream
from mavdem.ingest.tlog import write_tlog


def write_mcap(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame of a stream as an MCAP recording.

    Args:
        file: the file, open for writing.
        stream: the frames of MAVLink, with their receive times.

    Returns:
        Number of frames that were written.
    """
    # The libraries of MCAP are an extra, checked where the file is named.
    from mavdem.ingest.mcap.records import write_mcap as write

    return write(file, stream)


STREAM_WRITERS = {".tlog": write_tlog, ".mcap": write_mcap}
"""Writers of streams of MAVLink frames, by the ending of the file."""
