"""Loss of control in a live flight: the attitude leaves its setpoint, or the vehicle falls on its side, as in a log.

The functions that judge a log judge the last seconds, so that an alarm in flight and the review of the recording agree.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from math import hypot, inf, isnan
from typing import NamedTuple

from mavdem.assessment.attitude_error import WITHOUT_SETPOINT_SHARE, attitude_error
from mavdem.assessment.attitude_losses import LOST_ANGLE, attitude_losses
from mavdem.assessment.ending import ending_of
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.ground_contacts import ground_contact
from mavdem.assessment.reported import stopped_in_air
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import wrapped_angle
from mavdem.live.live_signals import LiveSignals, RecentMotion
from mavdem.live.messages import MESSAGE_FIELDS, Message
from mavdem.live.pose import LatestPose
from mavdem.live.recent_messages import RecentMessages, TimedValues, columns_from
from mavdem.witnesses.boot_sensors import BootSensors

SLOW_MESSAGES = ("HEARTBEAT", "EXTENDED_SYS_STATE", "AVAILABLE_MODES", *CLIMB_RATE_FIELDS)
"""Messages besides attitudes and setpoints by which a loss is judged: modes, the landed state, height and speed."""

MEMORY_SECONDS = 2 * RECOVERY_SECONDS + MAX_SETPOINT_DELAY
"""Attitudes and setpoints that are kept, s: an onset is looked for ``RECOVERY_SECONDS`` before a loss, which is serious
after as long."""

MAX_SAMPLES = 8192
"""Messages of one name that are kept, a choice: it bounds the memory for hostile stamps."""


class FlightEnd(NamedTuple):
    """How a flight ended, as far as the messages since then show it."""

    is_in_air: bool
    """Whether the motors were stopped in the air, so that the vehicle has not landed."""

    loss: Fact | None
    """How the vehicle was lost that fell from there; None before it has met the ground."""


class ControlWatch:
    """Watches whether the vehicle keeps its attitude, in one boot."""

    def __init__(self, recent: RecentMessages) -> None:
        """Begins without a sample; ``recent`` has the slow messages of the boot, among them heights and speeds."""
        self._recent = recent
        # Attitudes and setpoints of the last seconds, by the name of their message.
        self._samples: dict[str, deque[TimedValues]] = {}
        # When the attitude was last so far from its setpoint that control may be lost, s of the boot clock.
        self._far_time = -inf

    def take(self, message: Message, time: float) -> None:
        """Keeps an attitude or a setpoint of the attitude.

        Args:
            message: ATTITUDE, ATTITUDE_QUATERNION or ATTITUDE_TARGET.
            time: time on the boot clock, s.
        """
        samples = self._samples.setdefault(message.name, deque(maxlen=MAX_SAMPLES))
        samples.append(TimedValues(time, message.values))
        while samples[0].time < time - MEMORY_SECONDS:
            samples.popleft()

    def take_pose(self, pose: LatestPose) -> None:
        """Notes whether the vehicle is more than ``LOST_ANGLE`` from its latest setpoint, or leans far without one.

        The error by which a loss is judged allows for the setpoints of the last second too, and is never larger.

        Args:
            pose: the attitude that was kept last, with the latest setpoint.
        """
        roll, pitch, _ = pose.angles
        if isnan(pose.setpoint.roll):
            error = WITHOUT_SETPOINT_SHARE * hypot(roll, pitch)
        else:
            roll_error = wrapped_angle(roll - pose.setpoint.roll)
            error = hypot(roll_error, pitch - pose.setpoint.pitch)
        if error > LOST_ANGLE:
            self._far_time = pose.time

    def loss(
        self, now: float, vehicle: Telemetry, take_off: float, motion: RecentMotion | None
    ) -> Fact | None:
        """Returns how control of the flight was lost, as the review of its recording would; None if it was not.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            take_off: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.
            motion: motor outputs of the last seconds, which show what failed first; None if they do not come.

        Returns:
            The ending of the flight so far, with its cause where the motors show one. A loss that is not serious yet,
            from which the vehicle has recovered, or that no second sensor confirms, is none.
        """
        if now - self._far_time > RECOVERY_SECONDS:
            return None
        signals = self._signals(vehicle, motion)
        error = attitude_error(signals, self._recent.boot)
        if error is None:
            return None
        sensors = BootSensors(signals, self._recent.boot, take_off)
        events = attitude_losses(sensors, error, (take_off, inf), is_ongoing=True)
        lost = [event for event in events if event.code is not MotionEvent.ATTITUDE_CAUGHT]
        return ending_of(signals, lost)

    def flight_end(
        self,
        vehicle: Telemetry,
        flight_interval: TimeInterval,
        reports: Sequence[Fact],
        motion: RecentMotion | None,
    ) -> FlightEnd:
        """Judges a flight that has just ended, by disarming for example: it may have ended above the ground.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            flight_interval: take-off and end of the flight, s of the boot clock; the take-off is minus infinity where
                it was not seen.
            reports: events that the autopilot reports, which may say why the motors were stopped.
            motion: motor outputs of the last seconds; None if they do not come.

        Returns:
            Whether it ended in the air, and how the vehicle was lost then, as the review of its recording would say it.
        """
        signals = self._signals(vehicle, motion)
        boot = self._recent.boot
        if not stopped_in_air(signals, boot, flight_interval):
            return FlightEnd(is_in_air=False, loss=None)
        take_off, _ = flight_interval
        error = attitude_error(signals, boot)
        contact = None
        if error is not None:
            sensors = BootSensors(signals, boot, take_off)
            contact = ground_contact(sensors, error, flight_interval, None, reports)
        if contact is None:
            return FlightEnd(is_in_air=True, loss=None)
        return FlightEnd(is_in_air=True, loss=ending_of(signals, [*reports, contact]))

    def _signals(self, vehicle: Telemetry, motion: RecentMotion | None) -> LiveSignals:
        """Returns the last seconds in the form that a log has.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            motion: motor outputs of the last seconds; None if they do not come.
        """
        boot = self._recent.boot
        columns = self._recent.columns(SLOW_MESSAGES)
        for name, samples in self._samples.items():
            columns[name] = columns_from(MESSAGE_FIELDS[name], samples, boot)
        telemetry = replace(vehicle, messages=columns)
        recorded = Signals(telemetry)
        motors = None if motion is None else motion.motors
        return LiveSignals(
            telemetry,
            motors=motors,
            collective=None if motors is None else motors.collective,
            landed_state=recorded.landed_state,
            tilts=recorded.tilts,
        )
