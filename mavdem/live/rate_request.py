"""Requests to a vehicle for message rates, which are restored at the end, and for parameters.

This is the only part of mavdem that makes frames to send to a vehicle.

Source: https://mavlink.io/en/services/command.html, https://mavlink.io/en/services/parameter.html, and
MAV_CMD_GET_MESSAGE_INTERVAL, MAV_CMD_SET_MESSAGE_INTERVAL and MESSAGE_INTERVAL of
https://mavlink.io/en/messages/common.html.
"""

from collections import deque
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from math import inf, nan
from typing import Any, NamedTuple

from mavdem.facts import Fact
from mavdem.facts.session import RateFact
from mavdem.ingest.mavlink.dialect import (
    definitions_by_id,
    definitions_by_name,
    mavlink_constant,
    mavlink_message_id,
)
from mavdem.ingest.mavlink.payloads import FrameSender, encode_frame, filled_payloads
from mavdem.ingest.telemetry import MICROSECONDS
from mavdem.ingest.vocabulary import ACTIVE, MAVLINK_VERSION
from mavdem.live.link import MAX_TRIES, RETRY_SECONDS
from mavdem.live.messages import Message
from mavdem.live.samples import DECISION_SECONDS

GROUND_STATION = FrameSender(255, 190)
"""Usual ids of ground stations, which requests come from; 190 is MAV_COMP_ID_MISSIONPLANNER."""

GREETER = FrameSender(254, 190)
"""Ids that HEARTBEATs come from. When HEARTBEATs of system 255 end, autopilots may fly home for a lost link."""

GET_INTERVAL = mavlink_constant("MAV_CMD_GET_MESSAGE_INTERVAL")
"""The command that asks for the interval of a message."""

SET_INTERVAL = mavlink_constant("MAV_CMD_SET_MESSAGE_INTERVAL")
"""The command that sets the interval of a message."""

BROADCAST = mavlink_constant("MAV_COMP_ID_ALL")
"""Target id of messages to everyone, and of messages that have no target."""

STOPPED = -1
"""Interval of a message that is not sent. 0, "the default", is never set, since autopilots differ in it."""

SHORTEST_INTERVAL = 1000
"""Shortest interval of a request, µs. Shorter ones are ignored, also 0, which means an unknown message."""

MOTION_MESSAGES = (
    mavlink_message_id("ATTITUDE"),
    mavlink_message_id("SERVO_OUTPUT_RAW"),
)
"""Ids of the messages that a model is learned from, which are requested at the full rate."""

SETPOINT_MESSAGE = mavlink_message_id("ATTITUDE_TARGET")
"""Id of the message of setpoints, by which control loops are identified.

It is requested at half the rate, or at ``MIN_SETPOINT_RATE`` where that is more: with less, loops are known worse; with
more, radios have no room for the other messages.
"""

MIN_SETPOINT_RATE = 50.0
"""Rate of setpoints that is requested at least, unless attitude and motors are requested more slowly, Hz."""

FLIGHT_STATE_MESSAGES = (
    mavlink_message_id("EXTENDED_SYS_STATE"),
    mavlink_message_id("LOCAL_POSITION_NED"),
    mavlink_message_id("VFR_HUD"),
    mavlink_message_id("VIBRATION"),
)
"""Ids of the messages that distinguish flight from landing, and of the one by which the vibration is judged."""

FLIGHT_STATE_RATE = 4.0
"""Rate of those messages that is requested, Hz: a choice. What comes faster already stays as it is."""

PARAMETER_PERIOD = 0.2
"""Time between two requests for parameters, s: a choice, since a slow radio has other messages to send."""

RATE_WINDOW_SECONDS = 5.0
"""Time over which rates are measured, s of arrival: a choice."""

COUNT_PERIOD = DECISION_SECONDS / 4
"""Least time, s, between two counts from which a measurement can begin: a quarter of the shortest one, a choice."""

MIN_RATE_RATIO = 0.7
"""Part of the rate reached before, below which a message is requested again: a choice; links lose some messages."""

REPEAT_SECONDS = 10.0
"""Time between two requests of a message that has come fast enough before, s.

Another ground station may set rates back, as MAVProxy does every 15 s. Each time costs as long as it takes to request
the rate again.
"""


NEVER = -inf
"""Time of what has not happened yet, s: however long one has to wait after it, that is over."""


class _MessageCounts(NamedTuple):
    """How many messages had arrived by a time."""

    time: float
    """Time on this computer's monotonic clock, s."""

    counts: dict[int, int]
    """Number of messages until then, by message id."""

    vehicle_seconds: float
    """Seconds of the vehicle's clock until then."""


class ArrivalRates:
    """Rates of messages over the last ``RATE_WINDOW_SECONDS``, by the vehicle's clock.

    The window is one of this computer's clock, since the vehicle's stops when no attitude comes. What arrived in it is
    divided by the seconds of the vehicle's clock in the same window: the speed of that clock may vary.
    """

    def __init__(self) -> None:
        """Begins without a count."""
        # Counts of the window, the oldest first.
        self._window: deque[_MessageCounts] = deque()

    def update(
        self, now: float, counts: Mapping[int, int], vehicle_seconds: float | None = None
    ) -> dict[int, float] | None:
        """Adds the present counts of messages, and returns the rate of each message over the last seconds.

        Args:
            now: s of this computer's monotonic clock.
            counts: number of messages that have arrived so far, by message id.
            vehicle_seconds: seconds of the vehicle's clock so far (``ClockSpeed.elapsed_seconds``); None if it runs as
                this computer's.

        Returns:
            Hz by message id; None while less than ``DECISION_SECONDS`` have been measured.
        """
        window = self._window
        if vehicle_seconds is None:
            vehicle_seconds = now
        if not window or now - window[-1].time >= COUNT_PERIOD:
            window.append(_MessageCounts(now, dict(counts), vehicle_seconds))
        # The window begins with the latest counts that are at least ``RATE_WINDOW_SECONDS`` old.
        while len(window) > 1 and window[1].time <= now - RATE_WINDOW_SECONDS:
            window.popleft()
        start = window[0]
        duration = now - start.time
        vehicle_duration = vehicle_seconds - start.vehicle_seconds
        if duration < DECISION_SECONDS or vehicle_duration <= 0:
            return None
        rates = {}
        for message_id, message_count in counts.items():
            new_messages = message_count - start.counts.get(message_id, 0)
            rates[message_id] = new_messages / vehicle_duration
        return rates


@dataclass
class _MessageInterval:
    """The interval at which the vehicle sends one message: what is requested, and what became of the requests."""

    message_id: int
    name: str
    """Name of the message."""

    rate: float
    """Rate that is requested, Hz."""

    needed_rate: float
    """Rate below which the message counts as too slow, so that its interval is set, Hz."""

    is_reported: bool
    """Whether the outcome of the request is reported; not of messages that mavdem can do without."""

    former_interval: int | None = None
    """The vehicle's own interval, µs; None before it is known."""

    query_count: int = 0
    """Number of times that the interval was asked for."""

    set_count: int = 0
    """Number of times that it was set since the message came fast enough last."""

    request_time: float = NEVER
    """When it was asked for or set last, s."""

    reachable_rate: float = nan
    """Rate that was accepted last, Hz: the requested one, or a lower one after ``MAX_TRIES`` failed settings."""

    may_have_changed: bool = False
    """Whether the vehicle may have changed it on request: a setting was sent, and none was refused."""

    may_be_forgotten: bool = False
    """Whether the vehicle may have rebooted since the interval was set last, and have forgotten it."""

    was_reached: bool = False
    """Whether the message came fast enough after its interval was set."""

    fall_count: int = 0
    """Number of times that the message became slow again, but did not end."""

    is_restored: bool = False
    """Whether the vehicle has confirmed the former interval."""

    was_received: bool = False
    """Whether the message has come at all."""

    is_absent: bool = False
    """Whether the message did not come at all, although it was requested, or was refused."""

    @property
    def is_unanswered(self) -> bool:
        """Whether the message was requested and has not come so far; just after the request it may still come."""
        is_requested = self.may_have_changed
        return self.is_absent or (is_requested and not self.was_received)

    def allow_new_settings(self) -> None:
        """Allows the interval to be set again at once, since the vehicle may have rebooted and forgotten it."""
        self.set_count = 0
        self.was_reached = False
        self.may_be_forgotten = self.may_have_changed
        self.request_time = NEVER
        self.needed_rate = MIN_RATE_RATIO * self.rate

    def note_rate(self, rate: float) -> None:
        """Notes whether the message comes, and whether it comes as fast as is needed.

        Args:
            rate: measured rate, Hz; 0 if the message does not come.
        """
        if rate > 0:
            self.was_received = True
            self.is_absent = False
        if rate < self.needed_rate:
            return
        # If the message becomes slow later, all ``MAX_TRIES`` settings of its interval are available again.
        self.set_count = 0
        # A message that is fast enough without a setting has not reached a requested rate, so that a later fall of its
        # rate is not reported as the loss of one.
        self.was_reached = self.may_have_changed

    def note_setting(self, now: float, rate: float) -> None:
        """Notes that the requested rate is set now, since the measured one is too low.

        The vehicle gets back its own interval, ``former_interval``, at the end of the session. If it has not reported
        that when it was asked, the measured interval takes its place; at a rate of 0 the message was not sent.

        Args:
            now: s of a monotonic clock.
            rate: measured rate, Hz.
        """
        if self.former_interval is None:
            self.former_interval = round(MICROSECONDS / rate) if rate else STOPPED
        self.reachable_rate = self.rate
        self.needed_rate = MIN_RATE_RATIO * self.rate
        # The vehicle gets a setting that it cannot have forgotten yet, and whose effect is still to be measured.
        self.may_be_forgotten = False
        self.was_reached = False
        self.set_count += 1
        self.may_have_changed = True
        self.request_time = now

    def accept_present_rate(self, rate: float) -> None:
        """Lowers the goal, since settings did not help: ``MIN_RATE_RATIO`` of the present rate, Hz, is enough now."""
        self.reachable_rate = rate
        self.needed_rate = MIN_RATE_RATIO * rate

    def leave_as_it_is(self) -> None:
        """Ends all settings of the interval, since the vehicle refuses to change it."""
        # A rate of 0 always suffices, so that the message is never set again.
        self.needed_rate = 0.0
        self.may_have_changed = False


class RateRequest:
    """Makes a vehicle send messages at requested rates, and restores its own rates at the end.

    Each interval is asked for, and then set until the message comes as fast as requested, at most ``MAX_TRIES`` times;
    whatever rate then comes is enough. A message that becomes much slower later, after a reboot or by another ground
    station, is set again, at most every ``REPEAT_SECONDS``. If the vehicle never reports an interval, the one that was
    measured before is restored. Parameters are requested by name until they come, at most ``MAX_TRIES`` times.

    Attributes:
        events: facts to report since the last call of ``drain_events``.
        unconfirmed: the intervals whose restoration awaits a reply, in the order of their commands.
    """

    def __init__(
        self,
        vehicle: FrameSender,
        rate: float,
        messages: Sequence[int] = MOTION_MESSAGES,
        secondary_messages: Sequence[int] = (SETPOINT_MESSAGE, *FLIGHT_STATE_MESSAGES),
        parameters: Sequence[str] = (),
    ) -> None:
        """Prepares the requests; nothing is sent by this class: its caller sends the frames that it returns.

        Args:
            vehicle: ids of the autopilot.
            rate: requested rate of ``messages``, Hz.
            messages: ids of the messages that are requested at the full rate.
            secondary_messages: ids of messages of which nothing is reported. Setpoints are requested at about half the
                rate, the others at ``FLIGHT_STATE_RATE``.
            parameters: names of the parameters to request.
        """
        self.events: list[Fact] = []
        self.unconfirmed: deque[_MessageInterval] = deque()
        self._vehicle = vehicle
        self._pending_parameters = deque(MAX_TRIES * [name.encode() for name in parameters])
        # When the next parameter may be requested, s.
        self._next_parameter_time = NEVER
        # When the next interval may be set, s. A confirmation does not name the message that it is about, so that only
        # one setting at a time may await one.
        self._next_setting_time = NEVER
        self._is_restoring = False
        # Whether ``RATES_CONTESTED`` was reported, which is done once for all messages.
        self._is_contest_reported = False
        self._intervals: list[_MessageInterval] = []
        for message_id in messages:
            name = definitions_by_id()[message_id].name
            self._intervals.append(
                _MessageInterval(message_id, name, rate, needed_rate=rate, is_reported=True)
            )
        for message_id in secondary_messages:
            self._intervals.append(_interval_of_secondary_message(message_id, rate))

    def drain_events(self) -> list[Fact]:
        """Returns the facts to report since the last call, and forgets them."""
        events = self.events
        self.events = []
        return events

    def frames_due(
        self,
        now: float,
        rates: Mapping[int, float] | None,
        received_parameters: Container[bytes] = (),
    ) -> list[bytes]:
        """Returns the frames to send now: a request for a parameter, and for each message a query or a setting.

        For each message the vehicle's own interval is queried first, at most ``MAX_TRIES`` times, since it is to be
        restored at the end. After that the interval is set where the message comes too slowly. Frames about the same
        message are at least ``RETRY_SECONDS`` apart. While rates are unknown, only messages whose setting the vehicle
        may have forgotten in a reboot are set again.

        Args:
            now: s of a monotonic clock.
            rates: measured rates, Hz, by message id; None while they are unknown.
            received_parameters: names of the parameters that have come.
        """
        frames = self._parameter_requests(now, received_parameters)
        for interval in self._intervals:
            if now - interval.request_time < RETRY_SECONDS:
                continue
            is_former_unknown = interval.former_interval is None
            if is_former_unknown and interval.query_count < MAX_TRIES:
                interval.query_count += 1
                interval.request_time = now
                frames.append(self._interval_command(GET_INTERVAL, interval.message_id))
            elif now >= self._next_setting_time:
                if rates is not None:
                    rate = rates.get(interval.message_id, 0.0)
                    frames += self._settings_due(interval, now, rate)
                elif interval.may_be_forgotten:
                    frames += self._settings_due(interval, now, 0.0)
        return frames

    def _parameter_requests(self, now: float, received_parameters: Container[bytes]) -> list[bytes]:
        """Returns the next request for a parameter, if one is due: one at a time, ``PARAMETER_PERIOD`` apart.

        All parameters at once would fill a slow radio. The queue holds each name ``MAX_TRIES`` times, for requests that
        get lost; names that have come are skipped.

        Args:
            now: s of a monotonic clock.
            received_parameters: names of the parameters that have come.

        Returns:
            A frame with a PARAM_REQUEST_READ, or nothing.
        """
        pending = self._pending_parameters
        while pending and pending[0] in received_parameters:
            pending.popleft()
        if not pending or now < self._next_parameter_time:
            return []
        self._next_parameter_time = now + PARAMETER_PERIOD
        # Index −1: the parameter is requested by its name.
        request = _encoded_frame(
            "PARAM_REQUEST_READ",
            GROUND_STATION,
            target_system=self._vehicle.system,
            target_component=self._vehicle.component,
            param_id=pending.popleft(),
            param_index=-1,
        )
        return [request]

    def _settings_due(self, interval: _MessageInterval, now: float, rate: float) -> list[bytes]:
        """Decides whether a message comes too slowly, and returns the command that sets its interval.

        A setting is one command MAV_CMD_SET_MESSAGE_INTERVAL: the vehicle shall send this message every so many µs. The
        measured rate decides what happens, in this order:

        1. Fast enough (``needed_rate``): nothing is sent, and the count of settings begins again.
        2. Set a short while ago: nothing is sent, because the measured rate is a mean over some seconds and has not
           followed the setting yet.
        3. Set ``MAX_TRIES`` times without success: the link or the vehicle cannot do more. That is reported, and the
           present rate counts as enough from then on, so that the requests end.
        4. Otherwise the interval is set. Before the first setting the vehicle's former interval is noted, to be
           restored at the end of the session. If the rate had been reached before, its fall is reported.

        Args:
            interval: the message, and what became of its earlier settings; it is updated.
            now: s of a monotonic clock.
            rate: measured rate of the message, Hz; 0 where none came.

        Returns:
            A frame with MAV_CMD_SET_MESSAGE_INTERVAL, or nothing.
        """
        interval.note_rate(rate)
        if rate >= interval.needed_rate:
            return []
        # Against another ground station that sets rates back, requests are rarer than while a rate is first reached.
        pause = REPEAT_SECONDS if interval.was_reached else RATE_WINDOW_SECONDS
        if interval.may_have_changed and now - interval.request_time < pause:
            return []
        if interval.set_count == MAX_TRIES:
            interval.accept_present_rate(rate)
            self._report_message(
                interval, RateFact.RATE_BELOW_ASKED, rate=rate, needed_rate=interval.rate
            )
            if rate == 0:
                self._report_absence(interval)
            return []
        if interval.was_reached:
            self._report_fall(interval, rate)
        interval.note_setting(now, rate)
        # Confirmations do not name the message, so the next setting waits for this one's, or until it is lost.
        self._next_setting_time = now + RETRY_SECONDS
        microseconds = round(MICROSECONDS / interval.rate)
        return [self._interval_command(SET_INTERVAL, interval.message_id, microseconds)]

    def _report_fall(self, interval: _MessageInterval, rate: float) -> None:
        """Reports that a message, once as fast as requested, is too slow again, and names the likely cause.

        Such a fall has two usual reasons. The vehicle rebooted and forgot its settings; then the message has ended, and
        its rate is 0. Or another ground station sets its rates back; then the message goes on slowly, and falls again
        after each new request. So falls are counted only while the message goes on (``fall_count``).

        Two facts may be reported: RATE_FELL for the first fall of a message, not for its repetitions; and
        RATES_CONTESTED, once for all messages, when the first of them has fallen ``MAX_TRIES`` times.

        Args:
            interval: the message, whose ``fall_count`` is updated.
            rate: its measured rate, Hz; 0 if the message no longer comes.
        """
        goes_on = rate > 0
        if goes_on:
            interval.fall_count += 1
        # The count is 0 if the message has only ever ended, which is reported each time.
        if interval.fall_count <= 1:
            self._report_message(interval, RateFact.RATE_FELL, former_rate=interval.reachable_rate)
        # Of some messages nothing is reported, since mavdem does not depend on them.
        is_contested = interval.is_reported and interval.fall_count == MAX_TRIES
        if is_contested and not self._is_contest_reported:
            self._is_contest_reported = True
            self.events.append(Fact(RateFact.RATES_CONTESTED))

    def _report_message(self, interval: _MessageInterval, code: RateFact, **figures: Any) -> None:
        """Reports a fact about a message to the user, if the message is one that is reported at all.

        Args:
            interval: the requested message; its ``is_reported`` says whether the user hears of it.
            code: code of the reported fact.
            **figures: figures of the fact by name.
        """
        if interval.is_reported:
            self.events.append(Fact(code, subject=interval.name, **figures))

    def _report_absence(self, interval: _MessageInterval) -> None:
        """Marks a requested message as absent, and reports that once.

        Args:
            interval: the message. If ``is_reported``, the caller has reported already that its request failed.
        """
        if not interval.is_absent and not interval.is_reported:
            self.events.append(Fact(RateFact.MESSAGE_ABSENT, subject=interval.name))
        interval.is_absent = True

    @property
    def absent_messages(self) -> frozenset[str]:
        """Names of the messages that were requested and have not come, even if the request was a moment ago."""
        return frozenset(interval.name for interval in self._intervals if interval.is_unanswered)

    def add_reply(self, message: Message) -> None:
        """Takes a reply of the vehicle: to a query a MESSAGE_INTERVAL, to a setting a COMMAND_ACK.

        Replies to other ground stations are ignored, and so is a COMMAND_ACK that only announces the final one. Older
        autopilots leave the target of a COMMAND_ACK at 0, which counts as meant for everyone.

        Args:
            message: the decoded reply, a MESSAGE_INTERVAL or COMMAND_ACK.
        """
        if message.name == "MESSAGE_INTERVAL":
            message_id, microseconds = message.values
            self._note_former_interval(message_id, microseconds)
            return
        command, result, target_system, target_component = message.values
        is_to_our_system = target_system in (BROADCAST, GROUND_STATION.system)
        is_to_our_component = target_component in (BROADCAST, GROUND_STATION.component)
        is_to_us = is_to_our_system and is_to_our_component
        is_final = result != mavlink_constant("MAV_RESULT_IN_PROGRESS")
        if command == SET_INTERVAL and is_to_us and is_final:
            self._take_confirmation(result)

    def _note_former_interval(self, message_id: int, microseconds: int) -> None:
        """Stores the interval at which the vehicle sent a message by itself, so that it can be restored at the end.

        It is stored once for each message, and only before this program has set an interval of its own. From then on
        the message's interval may be set at once.

        Args:
            message_id: MAVLink's number of the message whose interval is stored.
            microseconds: interval that the vehicle reported, µs, or ``STOPPED``. Intervals below ``SHORTEST_INTERVAL``
                are not real, and are ignored.
        """
        if microseconds != STOPPED and microseconds < SHORTEST_INTERVAL:
            return
        for interval in self._intervals:
            # After a setting, the vehicle replies with that setting, not with its own interval.
            awaits_own_interval = interval.former_interval is None and not interval.may_have_changed
            if interval.message_id == message_id and awaits_own_interval:
                interval.former_interval = microseconds
                # Nothing is awaited any more, so the next frame about this message need not wait.
                interval.request_time = NEVER

    def _take_confirmation(self, result: int) -> None:
        """Takes the vehicle's answer (COMMAND_ACK) to a command that sets the interval of a message.

        The answer does not name the message. While rates are requested, only one command is under way, so that the
        answer is about the latest one. When rates are restored, answers come in the order of the commands.

        Args:
            result: a MAV_RESULT, such as accepted.
        """
        is_accepted = result == mavlink_constant("MAV_RESULT_ACCEPTED")
        if self._is_restoring:
            if self.unconfirmed:
                restored_interval = self.unconfirmed.popleft()
                restored_interval.is_restored = is_accepted
            return
        # The next command need not wait for an answer to this one any more.
        self._next_setting_time = NEVER
        latest_interval = max(self._intervals, key=lambda interval: interval.request_time)
        was_set = latest_interval.set_count > 0
        if was_set and not is_accepted:
            latest_interval.leave_as_it_is()
            self._report_message(latest_interval, RateFact.RATE_REFUSED, result=result)
            if not latest_interval.was_received:
                self._report_absence(latest_interval)

    def allow_new_requests(self) -> None:
        """Allows all rates to be requested again at once: the vehicle may have rebooted, and forgotten them.

        The vehicle's own intervals, which are to be restored at the end, stay as they were noted first. If any rate was
        set before, it is reported that rates are requested again.
        """
        was_any_set = any(interval.may_have_changed for interval in self._intervals)
        if was_any_set:
            self.events.append(Fact(RateFact.RATES_ASKED_AGAIN))
        for interval in self._intervals:
            interval.allow_new_settings()

    def restoring_frames(self) -> list[bytes]:
        """Returns the frames that restore each interval which may have changed and is not confirmed as restored.

        From the first call on, confirmations count for restorations. The caller repeats the call until nothing is
        returned, or gives up.
        """
        self._is_restoring = True
        self.unconfirmed = deque()
        frames = []
        for interval in self._intervals:
            if not interval.may_have_changed or interval.is_restored:
                continue
            self.unconfirmed.append(interval)
            microseconds = interval.former_interval
            if not microseconds:
                # The former interval is unknown, or 0, "the default", which autopilots interpret differently.
                microseconds = STOPPED
            frames.append(self._interval_command(SET_INTERVAL, interval.message_id, microseconds))
        return frames

    def _interval_command(self, command: int, message_id: int, microseconds: float = 0.0) -> bytes:
        """Packs a COMMAND_LONG about the interval of a message.

        Args:
            command: what is requested: ``GET_INTERVAL`` or ``SET_INTERVAL``.
            message_id: id of the message, the command's first parameter.
            microseconds: interval to set, the second parameter; ``STOPPED`` to send the message no more.

        Returns:
            The bytes of the frame.
        """
        return _encoded_frame(
            "COMMAND_LONG",
            GROUND_STATION,
            target_system=self._vehicle.system,
            target_component=self._vehicle.component,
            command=command,
            param1=message_id,
            param2=microseconds,
        )


def _interval_of_secondary_message(message_id: int, rate: float) -> _MessageInterval:
    """Returns what to request of a message that is useful at any rate, such as the setpoints.

    If it comes nearly as fast already, it stays as it is: the rate below which it is requested is lower than the rate
    that is requested then.

    Args:
        message_id: MAVLink's number of the message.
        rate: rate that is requested of attitude and motor outputs, Hz.
    """
    requested_rate = FLIGHT_STATE_RATE
    if message_id == SETPOINT_MESSAGE:
        requested_rate = min(rate, max(MIN_SETPOINT_RATE, rate / 2))
    return _MessageInterval(
        message_id,
        name=definitions_by_id()[message_id].name,
        rate=requested_rate,
        needed_rate=MIN_RATE_RATIO * requested_rate,
        is_reported=False,
    )


def greeting() -> bytes:
    """Returns a HEARTBEAT, for vehicles that send only after they have received one."""
    return _encoded_frame(
        "HEARTBEAT",
        GREETER,
        type=mavlink_constant("MAV_TYPE_GCS"),
        autopilot=mavlink_constant("MAV_AUTOPILOT_INVALID"),
        system_status=ACTIVE,
        mavlink_version=MAVLINK_VERSION,
    )


_frame_numbers = count()


def _encoded_frame(name: str, sender: FrameSender, **fields: Any) -> bytes:
    """Makes a frame of one message.

    Args:
        name: name of the message.
        sender: ids that the frame comes from.
        **fields: values of its fields; all others are zero.

    Returns:
        The bytes of the frame, which has the next sequence number.
    """
    payload = filled_payloads(name, **fields).tobytes()
    # The sequence number of a frame is one byte.
    return encode_frame(payload, definitions_by_name()[name], sender, next(_frame_numbers) % 256)
