"""How well a live vehicle follows its attitude setpoints, by the rules for logs, in its latest minute of flight."""

from collections import deque
from dataclasses import replace
from math import inf

import numpy as np

from mavdem.assessment.condition import Condition
from mavdem.assessment.lights.tracking import tracking_light
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.resampling import mean_rate
from mavdem.dataset.setpoints import SETPOINT_MESSAGE, recorded_setpoints
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.facts import Fact, Level
from mavdem.facts.watch import WatchFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.live_signals import LiveSignals, live_evidence
from mavdem.live.messages import MESSAGE_FIELDS, Message
from mavdem.live.recent_messages import RecentMessages, TimedValues, columns_from
from mavdem.plant.online_wind_torque import MEMORY_SECONDS

MAX_SAMPLE_RATE = 400.0
"""Rate of one message, Hz, up to which a whole minute of it is kept: that of ArduPilot's main loop (SCHED_LOOP_RATE).

No message is left out, since a log is judged by all of its messages. Between samples a setpoint is interpolated: with
fewer of them quick setpoints are smoothed, and the error looks up to a third smaller than it is.
"""

MIN_SETTLED_SECONDS = 20.0
"""Settled flight by which the tracking is judged, s: a choice, since a gust alone lasts for some seconds."""

TRACKING_AWAITED = Fact(WatchFact.TRACKING_AWAITED, duration=MIN_SETTLED_SECONDS)
"""Why the tracking is not judged before its first judgement."""

MODE_MESSAGES = ("HEARTBEAT", "AVAILABLE_MODES")
"""Messages with the flight mode: some modes have no setpoint of the angle."""


class TrackingWatch:
    """Keeps attitudes and setpoints of the latest minute of one boot, and judges how well the angles follow."""

    def __init__(self, slow_messages: RecentMessages) -> None:
        """Begins without a sample; ``slow_messages`` has those of the boot, among them the flight mode."""
        self._slow_messages = slow_messages
        self._samples: dict[str, deque[TimedValues]] = {
            name: deque(maxlen=round(MEMORY_SECONDS * MAX_SAMPLE_RATE))
            for name in (*ATTITUDE_MESSAGES, SETPOINT_MESSAGE)
        }
        # Time of the latest attitude or setpoint, and of the first one after the latest gap, s of the boot clock.
        self._latest_time = inf
        self._gap_end = -inf
        # Whether the latest judgement found that the setpoints show too little.
        self._shows_too_little = False

    def add_message(self, message: Message, time: float) -> None:
        """Keeps an attitude or a setpoint.

        It also notes the end of a gap: the first of these messages after ``SILENCE_SECONDS`` without any.

        Args:
            message: Decoded ATTITUDE, ATTITUDE_QUATERNION or ATTITUDE_TARGET.
            time: time on the boot clock, s.
        """
        if time - self._latest_time > SILENCE_SECONDS:
            self._gap_end = time
        self._latest_time = time
        self._samples[message.name].append(TimedValues(time, message.values))

    def has_setpoints(self, now: float) -> bool:
        """Returns whether a setpoint has come in the last ``MEMORY_SECONDS`` before ``now``, s of the boot clock."""
        samples = self._samples[SETPOINT_MESSAGE]
        return bool(samples) and now - samples[-1].time <= MEMORY_SECONDS

    def _judged_start(self, now: float, settled_start: float) -> float:
        """Returns the time from which on messages are judged, s of the boot clock.

        Args:
            now: present time on the boot clock, s.
            settled_start: since when the flight is settled, s of the boot clock.
        """
        return max(settled_start, now - MEMORY_SECONDS, self._gap_end)

    def remaining_seconds(self, now: float, settled_start: float | None) -> float | None:
        """Returns how much more settled flight the judgement needs, s: 0 if it had it; None if it is not settled.

        Args:
            now: present time on the boot clock, s.
            settled_start: since when the flight is settled, s of the boot clock; None if it is not settled now.
        """
        if settled_start is None:
            return None
        remaining_seconds = MIN_SETTLED_SECONDS - (now - self._judged_start(now, settled_start))
        return max(remaining_seconds, 0.0)

    def reason_not_judged(self, now: float, settled_start: float | None) -> Fact:
        """Returns why the tracking is not judged so far although setpoints come.

        Args:
            now: present time on the boot clock, s.
            settled_start: since when the flight is settled, s of the boot clock; None if it is not settled now.

        Returns:
            The fact that settled flight was too short, with the seconds that it still needs; or, once it was long
            enough, that the setpoints showed too little.
        """
        remaining_seconds = self.remaining_seconds(now, settled_start)
        if remaining_seconds == 0.0 and self._shows_too_little:
            return Fact(WatchFact.SETPOINTS_SHOW_LITTLE)
        return TRACKING_AWAITED.replace(remaining_duration=remaining_seconds)

    def has_rate_setpoint(self, vehicle: Telemetry, axis: str) -> bool:
        """Returns whether the stream has a setpoint of the body rate with which the rate loop may be identified later.

        The setpoint must come as often as a log must have it for that, and must change: a constant one excites nothing.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            axis: "roll" or "pitch".
        """
        samples = self._samples[SETPOINT_MESSAGE]
        if not samples:
            return False
        columns = columns_from(MESSAGE_FIELDS[SETPOINT_MESSAGE], samples, self._slow_messages.boot)
        telemetry = replace(vehicle, messages={SETPOINT_MESSAGE: columns})
        for setpoint in recorded_setpoints(telemetry, axis):
            is_of_angle = setpoint.unit != "rad/s"
            times = setpoint.signal.time
            if is_of_angle or len(times) < 2:
                continue
            is_fast_enough = mean_rate(times) >= MIN_SLOW_MOTION_RATE
            has_changed = np.diff(setpoint.signal.values).any()
            if is_fast_enough and has_changed:
                return True
        return False

    def judge(self, now: float, vehicle: Telemetry, settled_start: float) -> Fact | None:
        """Judges how roll, pitch and yaw follow their setpoints, by the rules for logs.

        Only messages after the latest gap are judged: across it, a turn and its setpoint are known only in part.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            settled_start: since when the flight is settled, that is since the end of the climb-out, s of the boot
                clock.

        Returns:
            The fact that they follow well or badly; None before ``MIN_SETTLED_SECONDS`` of settled flight since the
            latest gap, where no setpoint comes, or if the setpoints show too little.
        """
        start_time = self._judged_start(now, settled_start)
        duration = now - start_time
        has_setpoints = bool(self._samples[SETPOINT_MESSAGE])
        if duration < MIN_SETTLED_SECONDS or not has_setpoints:
            return None
        boot = self._slow_messages.boot
        columns = self._slow_messages.columns(MODE_MESSAGES)
        for name, samples in self._samples.items():
            if samples:
                columns[name] = columns_from(MESSAGE_FIELDS[name], samples, boot)
        telemetry = replace(vehicle, messages=columns)
        recorded = Signals(telemetry)
        signals = LiveSignals(
            telemetry, tilts=recorded.tilts, preset_settled_intervals=[(start_time, now)]
        )
        evidence = live_evidence(signals, Condition(duration=duration))
        tracking = tracking_light(evidence)
        self._shows_too_little = tracking.level is Level.UNKNOWN
        return None if self._shows_too_little else tracking
