"""The account of a live session's time: what each second was spent on."""

from dataclasses import dataclass

from mavdem.facts.session import SessionFact, TimeUse
from mavdem.live import clock
from mavdem.live.session_status import SessionStatus

ENTRY_SECONDS = 1.0
"""Time between two entries, s: a choice; also how long a short silence is not counted as one."""

ON_GROUND_CODES = (SessionFact.NOT_FLYING, SessionFact.FLIGHT_UNKNOWN, SessionFact.FLIGHT_OVER)
"""Codes of the reasons for learning no model with which messages come, and the vehicle does not fly."""


@dataclass(frozen=True)
class AccountedState:
    """State of a live session at the moment when its time is counted, which decides what the time is spent on."""

    link_is_lost: bool
    message_time: float
    """When a message came last, s of the monotonic clock."""

    motion_time: float
    """When a sample of attitude or motors came last, s of that clock."""

    learned_rows: int
    """Number of rows that the learner used so far."""

    dt: float
    """Time between two rows, s of this computer's clock; 0 before any."""

    status: SessionStatus
    """Status of link and vehicle."""

    def use_at(self, now: float) -> TimeUse:
        """Returns what time is spent on while nothing is learned: on waiting for the most basic thing that is missing.

        These may be missing, in this order: the link, messages, a vehicle, its attitude and motor outputs at sufficient
        rates, settled flight.

        Args:
            now: present time, s of the monotonic clock.
        """
        if self.link_is_lost:
            return TimeUse.LINK_LOST
        if now - self.message_time >= ENTRY_SECONDS:
            return TimeUse.SILENT
        if self.status.vehicle is None:
            return TimeUse.NO_VEHICLE
        reason = self.status.no_model_reason
        lacks_messages = reason is not None and reason.code not in ON_GROUND_CODES
        if lacks_messages or now - self.motion_time >= ENTRY_SECONDS:
            return TimeUse.WAITING
        return TimeUse.UNSETTLED if self.status.is_flying else TimeUse.ON_GROUND


class TimeAccount:
    """Counts the seconds of a live session by what they were spent on, in entries; their sum is the session's age.

    Attributes:
        entry_time: until when time is counted, s of the monotonic clock.
    """

    def __init__(self) -> None:
        """Begins now."""
        self.entry_time = clock.monotonic()
        self._seconds = dict.fromkeys(TimeUse, 0.0)
        self._learned_rows = 0
        # Learned samples span this much time, s, that no entry has counted yet.
        self._carried_over_seconds = 0.0

    def is_due(self, now: float) -> bool:
        """Returns whether an entry is due at ``now``, s."""
        return now - self.entry_time >= ENTRY_SECONDS

    def update(self, now: float, state: AccountedState) -> dict[TimeUse, float]:
        """Makes an entry: divides the time since the last one between learning and waiting.

        The time of learning is that of the new samples: their number times their time step. The rest of the entry is
        spent on what the present state lacks, such as settled flight (``AccountedState.use_at``). Samples may be
        analysed some time after their arrival, and then span more than the entry: up to ``ENTRY_SECONDS`` of what is
        too much are carried over to the next entry.

        Args:
            now: time up to which everything that arrived is analysed, s of the monotonic clock.
            state: present state of the session.

        Returns:
            Seconds of the session by activity; those after ``now`` are left out.
        """
        # Arrivals are converted from the wall clock, which may be set back: time is never counted backwards.
        now = max(now, self.entry_time)
        elapsed_seconds = now - self.entry_time
        # The rows are of the latest flight: their number is smaller than before where another flight has begun.
        has_flight_begun = state.learned_rows < self._learned_rows
        new_rows = state.learned_rows
        if not has_flight_begun:
            new_rows -= self._learned_rows
        self._learned_rows = state.learned_rows
        sample_seconds = self._carried_over_seconds + new_rows * state.dt
        learned_seconds = min(sample_seconds, elapsed_seconds)
        excess_seconds = sample_seconds - learned_seconds
        self._carried_over_seconds = min(excess_seconds, ENTRY_SECONDS)
        self._seconds[TimeUse.LEARNED] += learned_seconds
        self._seconds[state.use_at(now)] += elapsed_seconds - learned_seconds
        self.entry_time = now
        seconds_by_use = dict(self._seconds)
        seconds_by_use[TimeUse.LEFT_OUT] = max(clock.monotonic() - now, 0.0)
        return seconds_by_use
