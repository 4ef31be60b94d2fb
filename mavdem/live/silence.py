"""Silences of a live link: how long no message of the vehicle has come, or none of its attitude and motor outputs."""

from math import inf

from mavdem.facts import Fact
from mavdem.facts.session import MissingMessages, RowsFact
from mavdem.live import clock
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.link_loss import LONG_LOSS_SECONDS

SUCCESSION_SECONDS = 10.0
"""Silence of the followed vehicle after which another one that sends is followed, s: a choice.

An autopilot that reboots, or a radio that fades, is mostly back before.
"""


class SilenceMonitor:
    """Records when messages, and samples of attitude or motors, came last, and how long they had not come before.

    Attributes:
        message_time: when a message of the followed vehicle came last, of any sender while none is followed, s of the
            monotonic clock.
        link_time: when a message of any sender came last, s of that clock.
        noise_time: when bytes without an intact message came last, s of that clock.
        motion_time: when a sample of attitude or motors came last, s of that clock.
        attitude_time: when an attitude of any vehicle came last, followed or not, s of that clock.
        outage: longest time without messages in the latest flight, s, if that was an alarm; None without one. It stays
            until the next take-off, since the flight is judged after its landing.
    """

    def __init__(self) -> None:
        """Begins as if a message had just come, so that a new session does not count as silent at once."""
        self.message_time = clock.monotonic()
        self.link_time = self.message_time
        self.noise_time = -inf
        self.motion_time = -inf
        # When messages came first, or again after the latest silence, s of the monotonic clock.
        self._reception_start = inf
        self.attitude_time = -inf
        self.outage: float | None = None
        self._was_flying = False
        self._sample_count = 0
        self._attitude_count = 0
        # Whether any message has come: before that nothing can resume.
        self._has_received = False

    def note_messages(self, first_arrival: float, last_arrival: float) -> float:
        """Stores when a batch of messages arrived, and returns how long no message came before it, s.

        The duration is 0 for the first batch of the session.

        Args:
            first_arrival: when the first message of the batch arrived, s of the monotonic clock. The messages are those
                of the followed vehicle; while none is followed, those of any sender.
            last_arrival: when the last one arrived, s of the monotonic clock.
        """
        if self._has_received:
            silence_seconds = first_arrival - self.message_time
        else:
            silence_seconds = 0.0
        if not self._has_received or silence_seconds > SILENCE_SECONDS:
            self._reception_start = first_arrival
        self._has_received = True
        self.message_time = last_arrival
        self.link_time = last_arrival
        return silence_seconds

    def note_outage(self, silence: float, *, is_flying: bool) -> None:
        """Records how long no message of the vehicle had come before the latest ones, if that was an alarm.

        Args:
            silence: duration, s.
            is_flying: whether the vehicle flies by the latest messages. A take-off begins another flight.
        """
        has_taken_off = is_flying and not self._was_flying
        self._was_flying = is_flying
        if has_taken_off:
            self.outage = None
        if is_flying and silence >= LONG_LOSS_SECONDS:
            self.outage = max(silence, self.outage or 0.0)

    def note_noise(self, last_arrival: float) -> None:
        """Records that bytes arrived, and no intact message among them.

        Args:
            last_arrival: when the last of them arrived, s of the monotonic clock.
        """
        self.noise_time = last_arrival

    def note_other_messages(self, last_arrival: float) -> None:
        """Records that messages arrived, and none of the followed vehicle.

        Args:
            last_arrival: when the last of them arrived, s of the monotonic clock.
        """
        self.link_time = last_arrival

    def is_succeeded(self, arrival_time: float) -> bool:
        """Returns whether the followed vehicle has been silent so long that another one that sends is to be followed.

        Args:
            arrival_time: arrival of messages of the other one, s of the monotonic clock.
        """
        return self._has_received and arrival_time - self.message_time >= SUCCESSION_SECONDS

    def message_age(self, now: float) -> float | None:
        """Returns the time since the last message of the followed vehicle, s; None before any.

        Args:
            now: present time, s of the monotonic clock.
        """
        return max(now - self.message_time, 0.0) if self._has_received else None

    def has_received_for(self, seconds: float, now: float) -> bool:
        """Returns whether messages have come for so long, without a silence in between, as would show who sends them.

        Args:
            seconds: the duration, s.
            now: present time, s of the monotonic clock.
        """
        return now - self._reception_start >= seconds

    def motion_age(self, now: float) -> float | None:
        """Returns the time since the last attitude or motor outputs of the followed vehicle, s; None before any.

        Args:
            now: present time, s of the monotonic clock.
        """
        return max(now - self.motion_time, 0.0) if self._sample_count else None

    def note_samples(self, sample_count: int) -> float:
        """Records when attitude or motor outputs came last, and returns how long neither had come before.

        A vehicle may still send slow messages, such as HEARTBEAT, after attitude and motor outputs have stopped. A
        higher number of samples than at the last call shows that some were among the latest messages. These messages
        must have been passed to ``note_messages`` before, which stores when they came.

        Args:
            sample_count: number of samples of attitude and motors since the start.

        Returns:
            Time without samples before the new ones, s, infinite for the first ones; 0 if there are no new samples.
        """
        if sample_count == self._sample_count:
            return 0.0
        silence_before = self.message_time - self.motion_time
        self._sample_count = sample_count
        self.motion_time = self.message_time
        return silence_before

    def note_attitudes(self, attitude_count: int) -> None:
        """Records whether the latest messages, passed to ``note_messages`` before, contained an attitude.

        Args:
            attitude_count: number of messages of attitude of all vehicles since the start.
        """
        if attitude_count != self._attitude_count:
            self._attitude_count = attitude_count
            self.attitude_time = self.link_time

    def has_attitudes(self, now: float) -> bool:
        """Returns whether an attitude of any vehicle has come in the last ``SILENCE_SECONDS``.

        Args:
            now: as for ``missing_messages``.
        """
        return now - self.attitude_time <= SILENCE_SECONDS

    def missing_messages(self, now: float) -> Fact | None:
        """Returns a fact if the link is silent: if messages or motion have not come for ``SILENCE_SECONDS``.

        Either all messages are missing, as when the radio is lost; or only the motion is, that is attitude and motor
        outputs, while slow messages such as HEARTBEAT continue. All messages are tested first, since without them the
        motion is missing anyway. Motion counts as missing only after it has come once; before that, other facts report
        what the vehicle does not send. After a silence it may come a moment after the first other message, too.

        Args:
            now: time up to which every received byte has been analysed, s of the monotonic clock. It is not the present
                time: while the analysis is late, messages that wait for it must not count as missing.

        Returns:
            The fact NOTHING_RECEIVED, with what is missing, the duration, s, and ``is_noise`` where bytes come that are
            no intact messages; None if nothing is missing.
        """
        silent_since = now - SILENCE_SECONDS
        has_had_motion = self._sample_count > 0
        missing = None
        if self.message_time < silent_since:
            missing = MissingMessages.MESSAGES
        elif has_had_motion and max(self.motion_time, self._reception_start) < silent_since:
            missing = MissingMessages.MOTION
        if missing is None:
            return None
        silence = silence_of(missing)
        if missing is MissingMessages.MESSAGES and self.noise_time >= silent_since:
            return silence.replace(is_noise=True)
        return silence

    def hears_other_vehicles(self, now: float) -> bool:
        """Returns whether other senders than the followed vehicle were received in the last ``SILENCE_SECONDS``.

        Args:
            now: as for ``missing_messages``.
        """
        return self.link_time > self.message_time and now - self.link_time <= SILENCE_SECONDS


def silence_of(missing: MissingMessages) -> Fact:
    """Returns the fact that some or all messages of a vehicle have not come for ``SILENCE_SECONDS``.

    Args:
        missing: the messages that do not come.
    """
    return Fact(RowsFact.NOTHING_RECEIVED, subject=missing, duration=SILENCE_SECONDS)


def resumption(missing: MissingMessages, silence: float) -> Fact | None:
    """Makes the report that messages, or at least attitude and motor outputs, come again after a silence.

    Args:
        missing: messages that had not come.
        silence: duration of the silence, s; infinite if nothing had ever come.

    Returns:
        The report; None if the silence was at most ``SILENCE_SECONDS``, or nothing had ever come.
    """
    if silence <= SILENCE_SECONDS or silence == inf:
        return None
    return Fact(RowsFact.MESSAGES_RESUMED, subject=missing, duration=silence)
