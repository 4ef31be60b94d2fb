"""Loss of control of a live vehicle, judged as in logs: the attitude leaves its setpoint, the vehicle falls or crashes.

The functions that judge a whole log are called with the messages of the last seconds, in the form that a log has. So an
alarm in flight and the review of the recording agree.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from math import hypot, inf, isfinite, isnan
from typing import NamedTuple

import numpy as np

from mavdem.assessment.attitude_losses import LOST_ANGLE, attitude_losses
from mavdem.assessment.ending import find_ending, lower_unconfirmed_crash_reports
from mavdem.assessment.flight_losses import flight_losses
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.ground_contacts import ground_contact
from mavdem.assessment.height_divergence import SINK_STICK
from mavdem.assessment.invalid_attitudes import MIN_INVALID_SECONDS, invalid_attitudes
from mavdem.assessment.motor_events import LASTING_SECONDS
from mavdem.assessment.reported import has_sunk_after, stopped_in_air
from mavdem.containers import Names
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.attitude_error import (
    WITHOUT_SETPOINT_SHARE,
    AttitudeError,
    attitude_error,
)
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.flight_states import (
    CLIMB_STICK_MODES,
    MANUAL_THROTTLE_MODES,
    min_airborne_collective,
)
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT, MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.setpoints import SETPOINT_MESSAGE
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import FailedFirst, MotionEvent
from mavdem.facts.watch import WatchFact
from mavdem.facts.witnesses import SensorFact
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.ingest.vocabulary import wrapped_angle
from mavdem.live.live_signals import FlightMoment, LiveSignals, RecentMotion
from mavdem.live.messages import IMU_MESSAGES, MESSAGE_FIELDS, STICK_MESSAGES, Message
from mavdem.live.pose import LatestPose
from mavdem.live.recent_messages import RecentMessages, TimedValues, columns_from
from mavdem.live.samples import DECISION_SECONDS
from mavdem.witnesses.boot_sensors import MIN_SINK_RATE, BootSensors
from mavdem.witnesses.sensors import BAROMETERS, throttle_stick

FLIGHT_STATE_MESSAGES = (
    "HEARTBEAT",
    "EXTENDED_SYS_STATE",
    "AVAILABLE_MODES",
    *CLIMB_RATE_FIELDS,
    *STICK_MESSAGES,
)
"""Messages of mode, landed state, height, speed and throttle, by which a loss is judged, besides attitude messages."""

MEMORY_SECONDS = 2 * RECOVERY_SECONDS + MAX_SETPOINT_DELAY
"""Attitudes and setpoints that are kept, s: an onset is looked for ``RECOVERY_SECONDS`` before a loss, which is serious
after as long."""

MIN_IDLE_SECONDS = 0.3
"""Time for which the motors must be at idle in a fall, s: a choice; the vehicle then falls at 3 m/s."""

MIN_PARACHUTE_HEIGHT = 3.0
"""Height, m, below which a parachute cannot open any more, whatever its maker: a choice."""

MAX_IMPACT_WAIT = 1.0
"""Time, s, for which a loss below ``MIN_PARACHUTE_HEIGHT`` waits for its impact: a fall from there takes 0.8 s."""

MAX_SAMPLES = 8192
"""Messages of one name that are kept, a choice: it bounds the memory for hostile stamps."""


class FlightEnd(NamedTuple):
    """How a flight ended, as far as the messages since then show it."""

    is_in_air: bool
    """Whether the motors were stopped in the air, so that the vehicle has not landed."""

    is_falling: bool
    """Whether the vehicle has sunk since then, as none does that has landed."""

    loss: Fact | None
    """How the vehicle was lost that fell, from there or before; None before it has met the ground."""

    contact: Fact | None = None
    """The contact with the ground, as an event of the motion; None before it."""


class ControlWatch:
    """Watches one boot of a vehicle for a loss of control: that it no longer follows its setpoint, or tips over."""

    def __init__(self, slow_messages: RecentMessages) -> None:
        """Begins the watch of a boot, without a sample of the attitude.

        Args:
            slow_messages: the slow messages of the boot, among them heights and speeds.
        """
        self._slow_messages = slow_messages
        # Attitudes, setpoints and specific forces of the last ``MEMORY_SECONDS``, by the name of their message.
        self._fast_messages: dict[str, deque[TimedValues]] = {}
        # The event that the attitudes are NaN; None while they are numbers.
        self._invalid_attitude: Fact | None = None
        # When the attitude last had an error from its setpoint with which control may be lost, and since when it has
        # such errors without a break, s of the boot clock.
        self._large_error_time = -inf
        self._large_error_start = inf
        # Times of the latest attitude and of the latest one that was a number, s of the boot clock.
        self._attitude_time = -inf
        self._valid_attitude_time = -inf
        # The latest loss of attitude, as an event of the motion; None before any.
        self._attitude_loss: Fact | None = None

    def add_message(self, message: Message, time: float) -> None:
        """Stores the measured values of a message, and removes those older than ``MEMORY_SECONDS``.

        They are the attitude, its setpoint, or the specific force, from which a loss of control is recognised.

        Args:
            message: ATTITUDE, ATTITUDE_QUATERNION, ATTITUDE_TARGET, or one of the ``IMU_MESSAGES``.
            time: time on the boot clock, s.
        """
        if message.name in ATTITUDE_MESSAGES:
            self._update_attitude_times(message, time)
        recent_values = self._fast_messages.setdefault(message.name, deque(maxlen=MAX_SAMPLES))
        recent_values.append(TimedValues(time, message.values))
        oldest_kept_time = time - MEMORY_SECONDS
        while recent_values[0].time < oldest_kept_time:
            recent_values.popleft()

    def _update_attitude_times(self, attitude: Message, time: float) -> None:
        """Updates the times of the latest attitude, and of the latest valid one, which is not NaN.

        The difference between them is how long the attitudes have been NaN (:meth:`invalid_attitude`).

        Args:
            attitude: ATTITUDE or ATTITUDE_QUATERNION, whose values begin with the angles or the quaternion.
            time: time on the boot clock, s.
        """
        self._attitude_time = time
        # The sum is NaN if any of the angles, or of three components of the quaternion, is.
        is_valid = isfinite(sum(attitude.values[:3]))
        if is_valid:
            self._valid_attitude_time = time

    def invalid_attitude(self, vehicle: Telemetry) -> Fact | None:
        """Returns the event that the attitudes have been NaN for ``MIN_INVALID_SECONDS``: the estimator has failed.

        The event is found by the rules for logs, in the messages of the last seconds. It is searched for once, and then
        kept while the attitudes stay NaN: later these messages no longer contain its beginning.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.

        Returns:
            The event; None while the latest attitudes are numbers.
        """
        invalid_seconds = self._attitude_time - self._valid_attitude_time
        if invalid_seconds < MIN_INVALID_SECONDS:
            self._invalid_attitude = None
        elif self._invalid_attitude is None:
            signals = self.recent_signals(vehicle, motion=None)
            any_time = (-inf, inf)
            for event in invalid_attitudes(signals, self._slow_messages.boot, any_time):
                # Earlier events, after which the attitudes were numbers again, are left out.
                is_ongoing = event.end_time is None
                if is_ongoing:
                    self._invalid_attitude = event
        return self._invalid_attitude

    def add_pose(self, pose: LatestPose) -> None:
        """Notes the time of an attitude that is far from its setpoint, since only then may control be lost.

        This quick test of each attitude spares :meth:`loss` the full judgement as long as all is well. It misses no
        loss: the full judgement compares an attitude with all setpoints of the last second, and its error is that to
        the nearest one. Without a setpoint the lean itself counts, weighted less.

        Args:
            pose: the attitude that was kept last, with the latest setpoint of roll and pitch, rad; NaN without one.
        """
        roll, pitch, _ = pose.angles
        has_setpoint = not isnan(pose.setpoint.roll)
        if has_setpoint:
            roll_error = wrapped_angle(roll - pose.setpoint.roll)
            pitch_error = pitch - pose.setpoint.pitch
            error = hypot(roll_error, pitch_error)
        else:
            error = WITHOUT_SETPOINT_SHARE * hypot(roll, pitch)
        is_error_large = error > LOST_ANGLE
        if not is_error_large:
            # No series of large errors goes on.
            self._large_error_start = inf
            return
        self._large_error_time = pose.time
        # The first error of a series is its start; for those after it the start stays.
        self._large_error_start = min(self._large_error_start, pose.time)

    @property
    def may_be_lost(self) -> bool:
        """Whether the attitude has been far from its setpoint for so long that control may be lost."""
        return self._large_error_time - self._large_error_start >= LASTING_SECONDS

    def loss(self, moment: FlightMoment) -> Fact | None:
        """Judges whether control of the flight has been lost, as the review of its recording would.

        The judgement takes long. So it is made only if an attitude of the last ``RECOVERY_SECONDS`` was far from its
        setpoint, which :meth:`add_pose` notes of each attitude. A loss that is found is also kept, for
        :meth:`flight_end`.

        Args:
            moment: present time, with the motor outputs, which show what failed first.

        Returns:
            The fact how the flight is being lost, with the cause if the motors show one, and with the figure ``is_low``
            if the vehicle is so low that a parachute does not help. None if control is not lost, if the loss is not
            serious yet, if the vehicle has recovered from it, or if no second sensor confirms it.
        """
        seconds_near_setpoint = moment.time - self._large_error_time
        if seconds_near_setpoint > RECOVERY_SECONDS:
            return None
        boot = self._slow_messages.boot
        signals = self.recent_signals(moment.vehicle, moment.motion)
        error = attitude_error(signals, boot)
        if error is None:
            return None
        sensors = BootSensors(signals, boot, moment.takeoff_time)
        attitude_loss = _lasting_attitude_loss(sensors, error, (moment.takeoff_time, inf))
        if attitude_loss is None:
            return None
        self._attitude_loss = attitude_loss
        # The ending is the loss with its cause; it is None if the loss is not confirmed.
        ending = find_ending(signals, [attitude_loss])
        if ending is None:
            return None
        if _is_too_low_for_parachute(sensors.height_at(moment.time)):
            ending = ending.replace(is_low=True)
        return _without_end_of_log(ending)

    def fall(self, moment: FlightMoment) -> Fact | None:
        """Judges whether the vehicle falls with its motors at idle, as after a closed throttle.

        In a log such a fall is judged by its end, a crash or a dive. In flight there is no time to wait for that: a
        vehicle falls 11 m in 1.5 s.

        Args:
            moment: present time, with the motor outputs.

        Returns:
            The fall as a fact, with height, m, and speed downward, m/s; its cause is the pilot's throttle stick if that
            was closed. None if the motors carry the vehicle, or have been idle for less than ``MIN_IDLE_SECONDS``; if
            it is near the ground, or its height is not known; or if it does not sink fast.
        """
        now = moment.time
        if moment.motion is None:
            return None
        idle_start = _idle_start(moment.motion.motors, moment.vehicle.parameters)
        if idle_start is None or now - idle_start < MIN_IDLE_SECONDS:
            return None
        signals = self.recent_signals(moment.vehicle, moment.motion)
        sensors = BootSensors(signals, self._slow_messages.boot, moment.takeoff_time)
        height = sensors.height_at(now)
        if height is None or height <= MAX_GROUND_HEIGHT:
            return None
        sink_rate = self._sink_rate_since(idle_start, signals)
        if sink_rate is None or sink_rate < MIN_SINK_RATE:
            return None
        closed_stick = sensors.throttle_closed_fact((idle_start - MAX_SETPOINT_DELAY, now))
        cause = None
        if closed_stick is not None:
            cause = Fact(FailedFirst.THROTTLE_CLOSED_FIRST, time=closed_stick.time)
        return Fact(
            WatchFact.FALLS_AT_IDLE,
            time=idle_start,
            speed=sink_rate,
            height=height,
            cause=cause,
        )

    def _sink_rate_since(self, start_time: float, signals: LiveSignals) -> float | None:
        """Returns the latest speed downward, m/s; None if none has come since a given time.

        Args:
            start_time: the time, such as when the motors became idle, s of the boot clock.
            signals: time series of the last seconds.
        """
        climb_rate = series_of_boot(signals.climb_rate, self._slow_messages.boot)
        if climb_rate is None or climb_rate.time[-1] < start_time:
            return None
        return -float(climb_rate.values[-1])

    @staticmethod
    def awaits_impact(loss: Fact, moment: FlightMoment) -> bool:
        """Returns whether a loss of control is to be reported only after the impact, since that is a moment away.

        That is so if the vehicle is too low for a parachute to open, and the loss began less than ``MAX_IMPACT_WAIT``
        ago. Nobody can act in that time, and the impact shows what happened.

        Args:
            loss: the loss, as :meth:`loss` returns it.
            moment: present time on the vehicle's clock.
        """
        is_new = moment.time - loss.start_time < MAX_IMPACT_WAIT
        return is_new and _is_too_low_for_parachute(loss.figures.get("height"))

    def climb_rate_in_height_hold(self, moment: FlightMoment) -> TimeSeries | None:
        """Returns the climb rate of a vehicle whose autopilot holds its height, so that it should not sink.

        Args:
            moment: present time.

        Returns:
            The estimated climb rate of the last seconds, m/s. None in a mode that lands or leaves the throttle to the
            pilot, if the sensors of the height contradict each other, or if no climb rate comes.
        """
        start_time = moment.time - MEMORY_SECONDS
        signals = self.recent_signals(
            moment.vehicle, moment.motion, (BAROMETERS[0],), start_time, uses_accelerometer=False
        )
        boot = self._slow_messages.boot
        landing_mode = signals.landing
        is_landing = landing_mode is not None and bool(landing_mode.values[-1])
        has_manual_throttle = signals.mode_at(boot, moment.time) in MANUAL_THROTTLE_MODES
        if is_landing or has_manual_throttle:
            return None
        sensors = BootSensors(signals, boot, moment.takeoff_time)
        if sensors.height.contradictions:
            return None
        return series_of_boot(signals.climb_rate, boot)

    def is_descent_commanded(self, moment: FlightMoment) -> bool:
        """Returns whether the pilot's stick commands a descent, in a mode in which it commands the vertical speed.

        A descent that a mission or a ground station commands is not known: its setpoint is not received.

        Args:
            moment: present time.
        """
        start_time = moment.time - DECISION_SECONDS
        signals = self.recent_signals(
            moment.vehicle, None, start_time=start_time, uses_accelerometer=False
        )
        boot = self._slow_messages.boot
        stick = series_of_boot(throttle_stick(signals), boot)
        commands_climb_rate = signals.mode_at(boot, moment.time) in CLIMB_STICK_MODES
        if stick is None or not commands_climb_rate:
            return False
        # The median, since the stick moves.
        return bool(np.median(stick.values) < SINK_STICK)

    def crash_after_loss(self, moment: FlightMoment) -> FlightEnd | None:
        """Judges whether a vehicle that lost control has met the ground, while the autopilot reports it as flying.

        Autopilots report the landing of a crashed vehicle, and disarm, seconds late. Until then the vehicle is examined
        as if its flight ended now, but only if it is so low that it may be on the ground.

        Args:
            moment: present time, with the vehicle's parameters, time of take-off, and motion of the last seconds.

        Returns:
            How the flight ended; None while the vehicle is in the air, or if its height is not known.
        """
        signals = self.recent_signals(moment.vehicle, moment.motion)
        sensors = BootSensors(signals, self._slow_messages.boot, moment.takeoff_time)
        height = sensors.height_at(moment.time)
        if height is None or height > MAX_GROUND_HEIGHT:
            return None
        flight_end = self.flight_end(moment, moment.time, reports=())
        if flight_end.loss is None:
            return None
        return flight_end

    def flight_end(
        self, moment: FlightMoment, end_time: float, reports: Sequence[Fact]
    ) -> FlightEnd:
        """Judges a flight that has just ended, for example by disarming: where it ended, and how it was lost.

        A vehicle whose motors stop in the air falls; one that lost its attitude may hit the ground with running motors.
        In both cases the contact with the ground shows how the vehicle was lost.

        Args:
            moment: present time, at or after the end.
            end_time: when the flight ended, s of the boot clock.
            reports: events that the autopilot reports, which may state why the motors were stopped.

        Returns:
            Whether the motors stopped in the air, whether the vehicle has sunk since, and how it was lost, as the
            review of its recording would find; no loss before it has met the ground.
        """
        signals = self.recent_signals(moment.vehicle, moment.motion, (BAROMETERS[0],))
        boot = self._slow_messages.boot
        takeoff_time = moment.takeoff_time
        flight_interval = (takeoff_time, end_time)
        sensors = BootSensors(signals, boot, takeoff_time)
        height = sensors.height_above_take_off
        is_in_air = stopped_in_air(height, end_time)
        is_falling = height is not None and is_in_air and has_sunk_after(height, end_time)
        error = attitude_error(signals, boot)
        if error is None:
            return FlightEnd(is_in_air, is_falling, loss=None)
        attitude_loss = self._attitude_loss_since(takeoff_time)
        if attitude_loss is None and not is_in_air:
            # A vehicle whose flight ended on the ground may have toppled over as it landed. One that hit the ground
            # upright, since it could not hold its height, has no loss of attitude.
            attitude_loss = self._toppling(sensors, error, flight_interval)
        contact = ground_contact(sensors, error, flight_interval, attitude_loss, reports)
        losses = flight_losses(attitude_loss, contact)
        if losses.contact is None:
            # The vehicle has not met the ground yet.
            return FlightEnd(is_in_air, is_falling, loss=None)
        events = [event for event in losses if event is not None]
        ending = find_ending(signals, [*reports, *events])
        if ending is not None:
            ending = _without_end_of_log(ending)
        return FlightEnd(is_in_air, is_falling, ending, _without_end_of_log(losses.contact))

    def _attitude_loss_since(self, takeoff_time: float) -> Fact | None:
        """Returns the latest loss of attitude if it was in the present flight; None otherwise.

        :meth:`loss` stores the latest loss of attitude of the boot.

        Args:
            takeoff_time: beginning of the present flight, s of the boot clock.
        """
        attitude_loss = self._attitude_loss
        if attitude_loss is None or attitude_loss.start_time < takeoff_time:
            # The latest loss, if there is one, was in an earlier flight.
            return None
        return attitude_loss

    def _toppling(
        self, sensors: BootSensors, error: AttitudeError, flight_interval: TimeInterval
    ) -> Fact | None:
        """Returns the loss of attitude of a vehicle that toppled over as it landed, as an event of the motion.

        Args:
            sensors: sensors of the boot, by the messages of the last seconds.
            error: error of the attitude in the last seconds.
            flight_interval: take-off and end of the flight, s of the boot clock.

        Returns:
            The event; None if the vehicle kept its attitude, or got it back.
        """
        _, end_time = flight_interval
        # The attitude was near its setpoint in the last ``RECOVERY_SECONDS``: no need for the slow search below.
        was_upright = self._large_error_time < end_time - RECOVERY_SECONDS
        if was_upright:
            return None
        return _lasting_attitude_loss(sensors, error, flight_interval)

    def lower_unconfirmed_crash_reports(
        self, vehicle: Telemetry, reports: Sequence[Fact]
    ) -> list[Fact]:
        """Lowers the level of a crash that the autopilot reports, if the motion of the last seconds does not show it.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            reports: events that the autopilot reports.

        Returns:
            All events, in the same order, as in the review of the recording.
        """
        return lower_unconfirmed_crash_reports(self.recent_signals(vehicle, None), reports)

    def setpoints(self, vehicle: Telemetry) -> dict[str, TimeSeries]:
        """Returns the setpoints of roll and pitch in the last seconds, rad, by axis; empty if none were received.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
        """
        samples = self._fast_messages.get(SETPOINT_MESSAGE)
        if not samples:
            return {}
        fields = MESSAGE_FIELDS[SETPOINT_MESSAGE]
        columns = {SETPOINT_MESSAGE: columns_from(fields, samples, self._slow_messages.boot)}
        signals = Signals(replace(vehicle, messages=columns))
        setpoints = {}
        for axis in TILT_AXES:
            setpoint = signals.for_axis(axis).angle_setpoint
            if setpoint is not None:
                setpoints[axis] = setpoint
        return setpoints

    def recent_signals(
        self,
        vehicle: Telemetry,
        motion: RecentMotion | None,
        other_names: Names = (),
        start_time: float = -inf,
        *,
        uses_accelerometer: bool = True,
    ) -> LiveSignals:
        """Returns the latest messages as ``Signals``, which the functions that judge a whole log take as their input.

        Motor outputs are not read from messages, as they are for a log: ``motion`` already has those that drive motors.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            motion: motor outputs of the last seconds; None if they do not come.
            other_names: names of slow messages that are needed besides the ``FLIGHT_STATE_MESSAGES``.
            start_time: slow messages before it are left out, s of the boot clock.
            uses_accelerometer: whether the specific force is included.

        Returns:
            The signals. Attitude, setpoints and specific force are of the last ``MEMORY_SECONDS``; those of slow
            messages begin at ``start_time``.
        """
        boot = self._slow_messages.boot
        slow_names = (*FLIGHT_STATE_MESSAGES, *other_names)
        # Columns as in a log, by the name of their message: first the slow messages, then the fast ones.
        columns = self._slow_messages.columns(slow_names, start_time)
        for name, samples in self._fast_messages.items():
            is_left_out = name in IMU_MESSAGES and not uses_accelerometer
            if not is_left_out:
                columns[name] = columns_from(MESSAGE_FIELDS[name], samples, boot)
        telemetry = replace(vehicle, messages=columns)
        signals_of_messages = Signals(telemetry)
        motors = None if motion is None else motion.motors
        return LiveSignals(
            telemetry,
            motors=motors,
            collective=None if motors is None else motors.collective,
            landed_state=signals_of_messages.landed_state,
            tilts=signals_of_messages.tilts,
        )


def _lasting_attitude_loss(
    sensors: BootSensors, error: AttitudeError, flight_interval: TimeInterval
) -> Fact | None:
    """Returns the loss of attitude from which the vehicle has not recovered, as an event of the motion.

    Args:
        sensors: sensors of the boot, by the messages of the last seconds.
        error: error of the attitude in the last seconds.
        flight_interval: take-off and end of the flight, s of the boot clock; the end is infinite while it goes on.

    Returns:
        The event; None if the vehicle kept its attitude, or got it back.
    """
    for event in attitude_losses(sensors, error, flight_interval, is_ongoing=True):
        has_recovered = event.code is MotionEvent.ATTITUDE_CAUGHT
        if not has_recovered:
            return event
    return None


def _is_too_low_for_parachute(height: float | None) -> bool:
    """Returns whether a vehicle is so low that a parachute cannot open any more.

    Args:
        height: height above the take-off, m; None if it is not known, which does not count as low.
    """
    return height is not None and height < MIN_PARACHUTE_HEIGHT


def _without_end_of_log(event: Fact) -> Fact:
    """Returns an event of the motion without the evidence that the log ended soon after it.

    Of a log that is evidence for a loss. The messages of a live flight end with the latest one at any time.

    Args:
        event: a loss of the vehicle, or its contact with the ground.
    """
    witnesses = event.figures.get("witnesses")
    if not witnesses:
        return event
    seen_in_flight = [fact for fact in witnesses if fact.code is not SensorFact.LOG_ENDED]
    return event.replace(witnesses=seen_in_flight)


def carries_vehicle(motion: RecentMotion | None, parameters: Parameters) -> bool:
    """Returns whether the latest motor outputs are high enough to carry the vehicle.

    Args:
        motion: motor outputs of the last seconds; None if they do not come.
        parameters: parameters of the vehicle; some of them state the idle output.
    """
    return motion is not None and _idle_start(motion.motors, parameters) is None


def _idle_start(motors: MotorOutputs, parameters: Parameters) -> float | None:
    """Returns since when the motors have been at idle: their mean output is too low to carry the vehicle.

    Args:
        motors: their outputs of the last seconds.
        parameters: parameters of the vehicle; some of them state the idle output.

    Returns:
        The time of the first output since then, s of the boot clock; None if the latest outputs carry the vehicle.
    """
    # The mean output of all motors at each sample, as a fraction of the range.
    collective = motors.collective
    powered_indices = np.flatnonzero(collective.values > min_airborne_collective(parameters))
    idle_times = collective.time
    if len(powered_indices):
        # The outputs after the last one that carries the vehicle.
        idle_times = collective.time[powered_indices[-1] + 1 :]
    if len(idle_times) == 0:
        return None
    return float(idle_times[0])
