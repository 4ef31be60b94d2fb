"""A session whose vehicle falls silent while another one sends, which the next session is to follow."""

from mavlink_streams import flight, heartbeat

from mavdem.ingest import read_log
from mavdem.live.vehicle_selection import Component


def record_take_over(session):
    """Lets a session record 1:1, which falls silent, and then 2:1, which another session is to follow."""
    for system in (1, 2):
        pieces = [heartbeat(system)] * 5 + flight([1.0, 1.01, 1.02], system=system)
        frames = session.stream.frame_reader.feed(b"".join(pieces))
        session.intake.recording.add(1.7e9 + system, frames)
        list(session.stream.process_frames(1.7e9 + system, frames))
    session.successor = Component(2, 1)


def systems_in(path):
    """The system ids of the vehicles in a recording."""
    return [telemetry.system for telemetry in read_log(path).vehicles]
