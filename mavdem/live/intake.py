"""Intake of a live session: it receives and records what comes over a link, and opens a lost link again."""

from collections.abc import Callable
from typing import NamedTuple

from mavdem.errors import failure_fact
from mavdem.facts import Fact
from mavdem.facts.session import LinkFact
from mavdem.live import clock
from mavdem.live.frames import Frame, FrameReader
from mavdem.live.link import MAX_PIECES, Link, LinkLost
from mavdem.live.raw_recording import RawRecording

LOST_LINK_SLEEP_SECONDS = 0.1
"""Longest time to wait between two looks at a link that is lost, s: a choice."""


class FrameBatch(NamedTuple):
    """The frames that one piece of the link completed."""

    arrival_time: float
    """When the piece arrived, s of the monotonic clock."""

    stamp: float
    """When it arrived, UNIX s."""

    frames: list[Frame]
    """The frames."""


class LinkIntake:
    """Receives from a link, records what comes, and sends.

    Attributes:
        recording: of the raw stream; None for none, and after it has failed.
        is_lost: whether the link is lost and not open again yet.
    """

    def __init__(
        self,
        link: Link,
        frame_reader: FrameReader,
        recording: RawRecording | None,
        log: Callable[[Fact], None],
    ) -> None:
        """Begins with an open link.

        Args:
            link: the link.
            frame_reader: finds the frames in its bytes.
            recording: what records them.
            log: is called with each fact about link and recording.
        """
        self.recording = recording
        self.is_lost = False
        self._link = link
        self._frame_reader = frame_reader
        self._log = log
        # Everything that arrived before this time has been read, s of the monotonic clock.
        self._emptied_time = clock.monotonic()

    def receive(self, timeout: float) -> list[FrameBatch]:
        """Receives and records what waits, or waits for something; opens a lost link again.

        Args:
            timeout: longest time to wait, s.
        """
        start_time = clock.monotonic()
        try:
            if self.is_lost and not self._reopen(timeout):
                return []
            pieces = self._link.receive(timeout)
        except LinkLost as error:
            self.is_lost = True
            self._log(error.fact.but(reopening=True))
            return []
        stamped_frames = [(stamp, self._frame_reader.feed(data)) for stamp, data in pieces]
        self._record(stamped_frames)
        now = clock.monotonic()
        wall_time = clock.unix_time()
        emptied_time = self._emptied_time
        if len(pieces) < MAX_PIECES:
            self._emptied_time = start_time
        batches = []
        for stamp, frames in stamped_frames:
            # The wall clock may be set meanwhile. Nothing arrived before everything had been read, nor later than now.
            arrival_time = min(max(now - wall_time + stamp, emptied_time), now)
            batches.append(FrameBatch(arrival_time, stamp, frames))
        return batches

    def _reopen(self, timeout: float) -> bool:
        """Opens the lost link where that is due, else waits at most ``timeout`` s; returns whether it is open."""
        if not self._link.reopen():
            clock.sleep(min(timeout, LOST_LINK_SLEEP_SECONDS))
            return False
        self.is_lost = False
        self._log(Fact(LinkFact.LINK_OPEN_AGAIN))
        return True

    def _record(self, stamped_frames: list[tuple[float, list[Frame]]]) -> None:
        """Records frames with their stamps, UNIX s; a recording that fails ends."""
        if self.recording is None:
            return
        try:
            for stamp, frames in stamped_frames:
                self.recording.add(stamp, frames)
        except OSError as error:
            self.recording = None
            self._log(failure_fact(LinkFact.STREAM_RECORDING_ENDED, error))

    def send(self, frames: list[bytes]) -> None:
        """Sends frames; a link that is lost is reported, and nothing more is sent."""
        try:
            for frame in frames:
                self._link.send(frame)
        except LinkLost as error:
            self._log(error.fact)

    def end_recording(self) -> None:
        """Completes the recording, and reports where that fails."""
        if self.recording is None:
            return
        try:
            self.recording.close()
        except OSError as error:
            self.recording = None
            fact = failure_fact(LinkFact.STREAM_RECORDING_ENDED, error, finishing=True)
            self._log(fact)
