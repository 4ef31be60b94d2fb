"""Intake of a live session: it receives and records what comes over a link, and opens a lost link again."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from mavdem.errors import failure_fact
from mavdem.facts import Fact
from mavdem.facts.session import LinkFact
from mavdem.ingest.mavlink.frame_reader import Frame, FrameReader
from mavdem.live import clock
from mavdem.live.link import MAX_PIECES, Link, LinkLost, ReceivedPiece
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


class _StampedFrames(NamedTuple):
    """Frames that arrived at the same time."""

    arrival_time: float
    """Time of arrival, UNIX s."""

    frames: list[Frame]
    """The frames; none if a piece of a stream completed none."""


class LinkIntake:
    """Receives bytes from a link, records the frames in them, and sends frames; it opens a lost link again.

    Attributes:
        recording: recording of the raw stream; None for none, and after it has failed.
        is_recording_cut: whether it has failed, as on a full disk, so that it ends before the session.
        is_lost: whether the link is lost and not open again yet.
        read_until: everything that arrived before this time has been received, s of the monotonic clock.
        is_link_empty: whether the last :meth:`receive` took all that waited in the link; it takes ``MAX_PIECES`` at
            most.
    """

    def __init__(
        self,
        link: Link,
        frame_reader: FrameReader,
        recording: RawRecording | None,
        log: Callable[[Fact], None],
        first_pieces: Sequence[ReceivedPiece] = (),
    ) -> None:
        """Makes the intake of an open link, which receives and records its frames.

        Args:
            link: the link.
            frame_reader: finds the frames in its bytes.
            recording: recording of the raw stream; None for none.
            log: is called with each fact about link and recording.
            first_pieces: frames that the link delivered before this session, which the recording has already.
        """
        self.recording = recording
        self.is_recording_cut = False
        self.is_lost = False
        self._link = link
        self._frame_reader = frame_reader
        self._log = log
        self._first_pieces = list(first_pieces)
        # When the link was known to be empty last, s of the monotonic clock.
        self._emptied_time = clock.monotonic()
        self.read_until = self._emptied_time
        self.is_link_empty = True
        # When the user ended the session, or the last message after that came, UNIX s; None before.
        self._end_time: float | None = None

    def receive(self, timeout: float) -> list[FrameBatch]:
        """Receives and records what has arrived, or waits until something arrives; opens a lost link again.

        Args:
            timeout: longest time to wait, s.

        Returns:
            One batch for each received piece, in the order of arrival; none after a timeout, or while the link is lost.
        """
        start_time = clock.monotonic()
        try:
            if self.is_lost and not self._reopen(timeout):
                # Nothing arrives over a lost link.
                self.read_until = start_time
                return []
            pieces = self._link.receive(timeout)
        except LinkLost as error:
            self.read_until = start_time
            self.is_link_empty = True
            self.is_lost = True
            self._log(error.fact.replace(reopening=True))
            return []
        stamped_frames = self._frames_of_first_pieces() + self._record(pieces)
        batches = self._with_monotonic_times(stamped_frames)
        # Fewer pieces than a call can return mean that the link is empty: later ones arrive after this call began.
        self.is_link_empty = len(pieces) < MAX_PIECES
        if self.is_link_empty:
            self._emptied_time = start_time
            self.read_until = start_time
        elif batches:
            self.read_until = batches[-1].arrival_time
        return batches

    def _with_monotonic_times(self, stamped_frames: Sequence[_StampedFrames]) -> list[FrameBatch]:
        """Converts times of arrival from the wall clock, which recordings have, to the monotonic clock of the analysis.

        If the wall clock is set at this moment, the conversion is wrong. So the result is limited to the possible
        times: after the link was last empty (``_emptied_time``), and not in the future.

        Args:
            stamped_frames: frames with their arrival, UNIX s.
        """
        now = clock.monotonic()
        wall_time = clock.unix_time()
        batches = []
        for stamp, frames in stamped_frames:
            seconds_since_arrival = wall_time - stamp
            arrival_time = now - seconds_since_arrival
            arrival_time = min(max(arrival_time, self._emptied_time), now)
            batches.append(FrameBatch(arrival_time, stamp, frames))
        return batches

    def _frames_of_first_pieces(self) -> list[_StampedFrames]:
        """Returns the frames that the link delivered before this session; none after the first call.

        They are in the recording already. So another frame reader than the link's finds them: a frame that it
        keeps back, since its end has not come yet, is not recorded a second time when the rest of it comes.
        """
        reader = FrameReader()
        stamped_frames = [
            _StampedFrames(piece.arrival_time, reader.feed(piece.data))
            for piece in self._first_pieces
        ]
        self._first_pieces = []
        return stamped_frames

    def _reopen(self, timeout: float) -> bool:
        """Tries to open the lost link again.

        If the link stays lost, this sleeps for a while, so that the session's loop does not spin.

        Args:
            timeout: longest time to sleep, s; it is never more than ``LOST_LINK_SLEEP_SECONDS``.

        Returns:
            Whether the link is open.
        """
        if not self._link.reopen():
            clock.sleep(min(timeout, LOST_LINK_SLEEP_SECONDS))
            return False
        self.is_lost = False
        self._log(Fact(LinkFact.LINK_OPEN_AGAIN))
        return True

    def record_rest(self) -> None:
        """Receives and records what still waits at the end of a session, without analysing it.

        The recording goes on until ``end_recording``, since replies to the last requests come later.
        """
        # This is not called in a session that fails. A busy computer may need seconds for what follows, in which the
        # vehicle would seem to have been silent.
        self._end_time = clock.unix_time()
        if not self.is_lost:
            self._record(self._link.receive_rest())

    def _record(self, pieces: list[ReceivedPiece]) -> list[_StampedFrames]:
        """Finds the frames in received bytes, and records them before anything else is done with them.

        So no error of the analysis loses a frame. A recording that fails, for example on a full disk, is reported and
        ends; the session goes on.

        Args:
            pieces: what the link has received.

        Returns:
            The frames that were completed by each piece.
        """
        stamped_frames = []
        for piece in pieces:
            completed_frames = self._frame_reader.feed(piece.data)
            stamped_frames.append(_StampedFrames(piece.arrival_time, completed_frames))
            if self._end_time is not None:
                self._end_time = max(self._end_time, piece.arrival_time)
        if self.recording is None:
            return stamped_frames
        try:
            for stamp, frames in stamped_frames:
                self.recording.add(stamp, frames)
        except OSError as error:
            self.stop_recording(error)
        return stamped_frames

    def stop_recording(self, error: Exception) -> None:
        """Ends the recording before the session, and reports that; the file stays as it is.

        Args:
            error: why it ends, such as a full disk.
        """
        self.recording = None
        self.is_recording_cut = True
        self._log(failure_fact(LinkFact.STREAM_RECORDING_ENDED, error))

    def send(self, frames: list[bytes]) -> None:
        """Sends encoded MAVLink frames; if the link is lost meanwhile, that is reported, and the rest is not sent."""
        try:
            for frame in frames:
                self._link.send(frame)
        except LinkLost as error:
            self._log(error.fact)

    def end_recording(self) -> None:
        """Completes the recording at the end of the session; a failure is reported, and ends nothing else.

        The recording of a session that did not fail is marked as ended on purpose.
        """
        if self.recording is None:
            return
        try:
            if self._end_time is not None:
                self.recording.mark_end(self._end_time)
            self.recording.close()
        except OSError as error:
            self.recording = None
            self.is_recording_cut = True
            fact = failure_fact(LinkFact.STREAM_RECORDING_ENDED, error, finishing=True)
            self._log(fact)
