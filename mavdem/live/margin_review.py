"""Stability margins in flight: the latest messages are judged in another process, as the recording of a flight is.

The functions for logs do it. They identify the loops by the setpoints of the body rate, and withhold margins that are
too uncertain, so that margins in flight and those of the review of the recording agree.
"""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from math import inf
from time import process_time
from typing import NamedTuple

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.record import Assessment
from mavdem.dataset.axes import AXES
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.lights import Light
from mavdem.facts.loops import LoopFact
from mavdem.facts.margins import MarginsLight
from mavdem.facts.watch import WatchFact
from mavdem.ingest.mavlink.frame_reader import Frame
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.telemetry import Log, Parameters
from mavdem.ingest.tlog import tlog_from_bytes, write_stamped
from mavdem.live.latest_flight import log_of_latest_flight
from mavdem.live.margin_confirmation import MarginConfirmation
from mavdem.live.messages import message_readers
from mavdem.live.stream import LiveStream
from mavdem.live.vehicle_selection import Component
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identification import MIN_IDENTIFIED_SECONDS

FIRST_REVIEW_SECONDS = MIN_IDENTIFIED_SECONDS + TRANSIENT_SECONDS
"""Time from take-off to the first review, s: before, settled flight is too short to identify a loop."""

REVIEW_PERIOD = 15.0
"""Least time between the beginnings of two reviews, s: a choice."""

MAX_PROCESSOR_SHARE = 0.1
"""Largest share of one core that reviews may take, a choice: after a long one, the next one begins later."""

PIECE_SECONDS = 10.0
"""Duration of the pieces in which messages are kept and forgotten, s: a choice."""

MAX_BYTES = 6 << 20
"""Bytes of messages that are kept, 6 MiB: six minutes with attitude, setpoints and outputs of ArduPilot at 100 Hz.

A choice. It bounds the time of a review, and the memory of the process that does it, which needs 20 to 30 times as
many bytes. Of a longer flight the beginning is forgotten.
"""

MAX_PIECE_BYTES = MAX_BYTES // 8
"""Bytes from which on another piece begins before ``PIECE_SECONDS`` are over: a choice. So ``MAX_BYTES`` hold although
the latest piece is never forgotten, however fast messages come."""

MARGINS_AWAITED = Fact(
    WatchFact.NO_OSCILLATION, reason=Fact(WatchFact.MARGINS_AWAITED, duration=FIRST_REVIEW_SECONDS)
)
"""The light of the margins in flight until the loops are identified by setpoints of the rate, if nothing oscillates."""

UNNAMED_RECORDING = "FILE.tlog"
"""Name of the recording in advice on commands if nothing is recorded."""


@dataclass
class _Piece:
    """Messages that were received within ``PIECE_SECONDS``, or fewer where they come fast, as a telemetry log."""

    start: float
    """When the first of them was received, UNIX s."""

    boot: int
    """Number of the vehicle's boot in which they were received."""

    records: BytesIO = field(default_factory=BytesIO)
    """The frames, each after its receive stamp."""


class FlightMessages:
    """The latest messages of the followed vehicle as a telemetry log in memory, from shortly before its take-off on."""

    def __init__(self) -> None:
        """Begins without a message."""
        self._pieces = deque[_Piece]()
        self._size = 0

    def add(
        self, stamp: float, frames: Sequence[Frame], vehicle: Component | None, boot: int
    ) -> None:
        """Adds the frames whose messages a live session reads; other messages do not show the loops.

        Args:
            stamp: when they were received, UNIX s.
            frames: frames of all senders, in the order of arrival.
            vehicle: the followed vehicle, whose frames are kept; None while it is not known, when all are.
            boot: number of the vehicle's boot, that is how often its autopilot has restarted so far.
        """
        microseconds = round(stamp * 1e6)
        stamped_contents = []
        for frame in frames:
            is_intact = frame.checksum == CHECKSUM_MATCHES
            is_of_vehicle = vehicle is None or vehicle.has_sent(frame)
            is_read_live = frame.message_id in message_readers()
            if is_intact and is_of_vehicle and is_read_live:
                stamped_contents.append((microseconds, frame.content))
        if not stamped_contents:
            return
        records = self._records_at(stamp, boot)
        size_before = records.tell()
        write_stamped(records, stamped_contents)
        self._size += records.tell() - size_before
        while self._size > MAX_BYTES and len(self._pieces) > 1:
            self._forget_first_piece()

    def _records_at(self, stamp: float, boot: int) -> BytesIO:
        """Returns the buffer to which messages of a time are appended: that of the latest piece, or of a new one.

        A piece ends after ``PIECE_SECONDS``, when it is full (``MAX_PIECE_BYTES``), or when the autopilot restarts.

        Args:
            stamp: when the messages were received, UNIX s.
            boot: number of the boot in which they were received.
        """
        is_new_piece_due = True
        if self._pieces:
            latest_piece = self._pieces[-1]
            piece_age = stamp - latest_piece.start
            # The age is negative where the computer's clock was set back.
            has_other_time = piece_age < 0 or piece_age >= PIECE_SECONDS
            is_full = latest_piece.records.tell() >= MAX_PIECE_BYTES
            is_new_piece_due = has_other_time or is_full or boot != latest_piece.boot
        if is_new_piece_due:
            self._pieces.append(_Piece(stamp, boot))
        return self._pieces[-1].records

    def forget_earlier_flights(self) -> None:
        """Forgets all but the last two pieces, which contain the take-off that has just been noticed.

        Pieces of an earlier boot are forgotten too: another autopilot, with other messages, may have sent them under
        the same ids.
        """
        while len(self._pieces) > 2 or self._begins_in_earlier_boot:
            self._forget_first_piece()

    @property
    def _begins_in_earlier_boot(self) -> bool:
        """Whether the oldest messages are of another boot than the latest."""
        return bool(self._pieces) and self._pieces[0].boot != self._pieces[-1].boot

    def _forget_first_piece(self) -> None:
        """Forgets the oldest messages."""
        self._size -= self._pieces.popleft().records.tell()

    @property
    def records(self) -> bytes:
        """The content of a telemetry log with all messages that are kept."""
        return b"".join(piece.records.getbuffer() for piece in self._pieces)


class ReviewedMargins(NamedTuple):
    """What a review of a flight so far shows of its control loops."""

    margins: Fact
    """The fact on the margins: the judgement of the control loops, which is their status light."""

    processor_seconds: float
    """Processor time of the review, s."""


def review_margins(
    records: bytes,
    source: str,
    vehicle: str,
    parameters: Parameters,
    *,
    is_flying: bool,
    clock: float | None = None,
) -> ReviewedMargins:
    """Judges the stability margins of a flight so far, as the review of a log does.

    It takes some seconds of processor time, and runs in the process that learns models.

    Args:
        records: content of a telemetry log.
        source: name of the log in advice on commands.
        vehicle: "system:component" of the vehicle.
        parameters: the autopilot's parameters by name, which may have been received before the messages of the log.
        is_flying: whether the flight goes on.
        clock: time of the latest message, s of the boot clock; None if it is not known.

    Returns:
        The margins as the fact of their status light, and the processor time that the review took. Margins that are
        unknown have the reason.
    """
    start_time = process_time()
    # The loops of all axes are judged; the axis is that of a model, and none is learned.
    axis_of_model = AXES[0]
    assessment = None
    try:
        log = _with_parameters(tlog_from_bytes(source, records), parameters)
        latest_flight = log_of_latest_flight(log)
        assessment = assess(latest_flight, vehicle, axis_of_model, Options(with_model=False))
        margins = assessment.lights[Light.MARGINS]
        if is_flying:
            margins = _without_premature_margins(margins, assessment)
    except Refusal as error:
        margins = Fact(MarginsLight.MARGINS_UNKNOWN, reason=error.fact, rate=None)
    if is_flying:
        margins = _state_needed_duration(margins, clock, assessment)
    return ReviewedMargins(margins, process_time() - start_time)


def _without_premature_margins(margins: Fact, assessment: Assessment) -> Fact:
    """Returns the margins of a flight that goes on; unknown ones if it is still too short to identify the loop.

    Until then they follow from the motor outputs and the motion alone. Later in the flight the loop can be identified
    by its setpoints, which gives more certain margins.

    Args:
        margins: the judgement of the margins.
        assessment: the assessment of the flight so far.
    """
    refusal = _refusal_of_judged_loop(assessment, margins)
    if refusal is not None and refusal.code is LoopFact.LOOP_TOO_SHORT:
        return Fact(MarginsLight.MARGINS_UNKNOWN, reason=refusal, rate=None)
    return margins


def _settled_seconds(assessment: Assessment | None) -> float | None:
    """Returns how long the settled flight in a log lasts, s, that is the flight without take-offs and landings.

    Args:
        assessment: the assessment of the log; None if it was refused.

    Returns:
        The sum over all segments of settled flight; None if no vehicle was judged.
    """
    if assessment is None or assessment.evidence is None:
        return None
    return sum(segment.duration for segment in assessment.evidence.learnability.segments)


def _state_needed_duration(
    margins: Fact, clock: float | None, assessment: Assessment | None
) -> Fact:
    """Adds to unknown margins of a flight that is still too short how many seconds of settled flight they need.

    Any model needs some seconds of settled flight (without take-off and landing), and the control loops need more. So
    a reason that states the shorter duration is replaced too: the pilot reads the same goal from the beginning.

    Args:
        margins: the judgement of the margins. If its reason is not that the flight is too short, it is returned as it
            is.
        clock: until when the flight was reviewed, s of the boot clock; None if that is not known. It is stated, since
            the flight becomes longer until the next review.
        assessment: the assessment of the flight until then; None if it was refused.
    """
    reason = margins.figures.get("reason")
    too_short_codes = (LoopFact.LOOP_TOO_SHORT, NotLearnableReason.TOO_SHORT)
    if reason is None or reason.code not in too_short_codes:
        return margins
    too_short_for_loops = Fact(
        LoopFact.LOOP_TOO_SHORT,
        least_duration=MIN_IDENTIFIED_SECONDS,
        settled=_settled_seconds(assessment),
        clock=clock,
    )
    return margins.replace(reason=too_short_for_loops)


def _refusal_of_judged_loop(assessment: Assessment, margins: Fact) -> Fact | None:
    """Returns why the plant of the loop with the smallest margins was not identified from its setpoints.

    The plant is the response of the body rate to the motors. If the setpoints moved the vehicle enough, the plant is
    identified from them, in the closed loop. Otherwise it is identified from motor outputs and motion alone, and its
    ``refusal`` is the fact that says why, for example that the flight is too short.

    Args:
        assessment: the assessment of the log.
        margins: its fact on the margins.

    Returns:
        That fact. None if the plant was identified from the setpoints, or if no loop gave the margins.
    """
    is_margin_of_loop = margins.code is MarginsLight.LOOP_MARGINS
    if assessment.evidence is None or not is_margin_of_loop:
        return None
    axis_with_smallest_margins = margins.figures["axis"]
    loop = assessment.evidence.loops[axis_with_smallest_margins]
    # An axis whose loop was not identified has a fact in the place of the loop, which says why.
    if not isinstance(loop, Loop):
        return None
    return loop.plant.refusal


def _with_parameters(log: Log, parameters: Parameters) -> Log:
    """Returns a log with parameters of the autopilot added; values that the log has already are kept."""
    vehicles = [
        replace(telemetry, parameters={**parameters, **telemetry.parameters})
        for telemetry in log.vehicles
    ]
    return replace(log, vehicles=tuple(vehicles))


class MarginReview:
    """Reviews the stability margins of a live flight again and again, if setpoints of the body rate are received.

    Attributes:
        margins: the fact on the margins, as the latest review of the latest flight shows them; None before one
            (:meth:`present_margins`). A warning counts in flight once two reviews in a row give it.
        has_rate_setpoint: whether a setpoint of the body rate has come in the latest flight, by which the loops are
            identified.
    """

    def __init__(self, executor: Executor | None, recording_name: str | None) -> None:
        """Prepares the reviews of margins, before the first flight.

        Args:
            executor: executor in which margins are reviewed; None to review none.
            recording_name: the log to which advice refers; empty or None if it has no name.
        """
        self.margins: Fact | None = None
        self.has_rate_setpoint = False
        self._executor = executor
        self._source = recording_name or UNNAMED_RECORDING
        self._messages = FlightMessages()
        self._pending: Future[ReviewedMargins] | None = None
        self._confirmation = MarginConfirmation()
        self._was_flying = False
        # Whether the latest review is of a flight that goes on, so that another one follows.
        self._is_in_flight = False
        # Whether the latest flight has messages that no review has judged.
        self._has_new_messages = False
        # When the latest review began, s of the monotonic clock.
        self._start_time = -inf
        # When the next review may begin, s of that clock.
        self._next_review_time = inf

    @property
    def provisional_light(self) -> Fact | None:
        """What is said of the margins before the first review; None if no setpoint comes that a review needs."""
        return MARGINS_AWAITED if self.has_rate_setpoint else None

    def present_margins(self, now: float, settled_start: float | None) -> Fact | None:
        """Returns the margins by the latest review, with the settled flight since then if they need more of it.

        Args:
            now: present time, s of the boot clock.
            settled_start: since when the flight is settled, s of the boot clock; None if it is not settled now.

        Returns:
            The fact on the margins; None before the first review. If the flight was too short for them, the figure
            ``settled`` of its reason is how long settled flight has lasted until now, s, and ``is_settled`` is whether
            it goes on.
        """
        margins = self.margins
        if margins is None:
            return None
        reason = margins.figures.get("reason")
        if reason is None or reason.code is not LoopFact.LOOP_TOO_SHORT:
            return margins
        # Seconds of settled flight until the review, and when that was, s of the boot clock.
        settled_seconds = reason.figures["settled"]
        review_time = reason.figures["clock"]
        if settled_seconds is None:
            # The review refused the log before it measured this. Then the settled flight that goes on now is counted
            # from its beginning, as if no review had counted any of it.
            settled_seconds = 0.0
            review_time = -inf
        is_settled = settled_start is not None
        if settled_start is not None and review_time is not None:
            # The review has counted the settled flight until then already.
            uncounted_start = max(review_time, settled_start)
            settled_seconds += max(0.0, now - uncounted_start)
        present_reason = reason.replace(settled=settled_seconds, is_settled=is_settled)
        return margins.replace(reason=present_reason)

    def add_messages(
        self, stamp: float, frames: Sequence[Frame], vehicle: Component | None, boot: int
    ) -> None:
        """Keeps the messages that show the control loops, for later reviews.

        Args:
            stamp: when they were received, UNIX s.
            frames: frames of all senders, in the order of arrival.
            vehicle: the followed vehicle, whose frames are kept; None while it is not known, when all are.
            boot: number of the vehicle's boot, that is how often its autopilot has restarted so far.
        """
        if self._executor is not None:
            self._messages.add(stamp, frames, vehicle, boot)

    def update(
        self, now: float, stream: LiveStream, *, is_busy: bool, is_recording_assessed: bool
    ) -> None:
        """Takes the result of a finished review of the stability margins, or begins another one if that is due.

        It is called once a second, and never waits: reviews are computed in another process. The first one begins
        ``FIRST_REVIEW_SECONDS`` after the take-off. The last one is of the whole flight, after its landing, unless the
        recording is assessed then, which shows the same margins.

        Args:
            now: present time, s of the monotonic clock.
            stream: stream of the vehicle.
            is_busy: whether this computer has no time for a review now.
            is_recording_assessed: whether the recording of the flight is assessed after its landing.
        """
        self._note_phase(now, stream)
        if self._pending is not None:
            self._take_result(self._pending)
            return
        is_due = now >= self._next_review_time and not is_busy
        is_left_to_assessment = is_recording_assessed and not stream.is_flying
        # Without setpoints of the body rate a review would show no more than the model does.
        is_needed = self.has_rate_setpoint and self._has_new_messages
        if is_due and is_needed and not is_left_to_assessment:
            self._start_review(now, stream)

    def _note_phase(self, now: float, stream: LiveStream) -> None:
        """Notes a take-off, with which the reviews begin anew, and whether there are messages for another review.

        Args:
            now: present time, s of the monotonic clock.
            stream: stream of the vehicle.
        """
        has_taken_off = stream.is_flying and not self._was_flying
        has_just_landed = self._was_flying and not stream.is_flying
        self._was_flying = stream.is_flying
        if has_taken_off:
            self._begin_flight(now)
        if stream.is_flying or has_just_landed:
            self._has_new_messages = True
        if stream.is_flying and not self.has_rate_setpoint:
            # The stream looks through all setpoints of the last minute for this.
            self.has_rate_setpoint = stream.has_rate_setpoint

    def _start_review(self, now: float, stream: LiveStream) -> None:
        """Starts a review of the messages so far in the executor, if there is one and the vehicle is known.

        Args:
            now: present time, s of the monotonic clock.
            stream: stream of the vehicle.
        """
        vehicle = stream.followed_vehicle
        if self._executor is None or vehicle is None:
            return
        self._has_new_messages = False
        self._is_in_flight = stream.is_flying
        self._start_time = now
        # The executor raises RuntimeError when its processes are gone.
        with suppress(RuntimeError):
            self._pending = self._executor.submit(
                review_margins,
                self._messages.records,
                self._source,
                vehicle.name,
                stream.parameters,
                is_flying=stream.is_flying,
                clock=stream.now,
            )

    def _begin_flight(self, now: float) -> None:
        """Begins the reviews of another flight, which may have other gains than the flight before.

        Args:
            now: present time, s of the monotonic clock.
        """
        self._messages.forget_earlier_flights()
        self.margins = None
        self._confirmation = MarginConfirmation()
        self.has_rate_setpoint = False
        # A review of the flight before is given up.
        self._pending = None
        self._next_review_time = now + FIRST_REVIEW_SECONDS

    def _take_result(self, pending: Future[ReviewedMargins]) -> None:
        """Takes the result of a review that the executor has finished, and sets when the next one may begin.

        A review that failed is dropped, and the result before it stays: the next one may succeed. Whatever fails in the
        other process, such as too little memory, must not end the session, which watches the vehicle.

        Args:
            pending: the review that the executor computes.
        """
        if not pending.done():
            return
        self._pending = None
        # Seconds from the beginning of this review to that of the next one.
        period = REVIEW_PERIOD
        with suppress(Exception):
            margins, processor_seconds = pending.result()
            # After the landing no further review follows, which could confirm a warning.
            self.margins = (
                self._confirmation.confirmed_light(margins) if self._is_in_flight else margins
            )
            # After a long review the next one begins later, so that reviews take a small share of the processor.
            period = max(period, processor_seconds / MAX_PROCESSOR_SHARE)
        self._next_review_time = self._start_time + period
