"""From the bytes of a MAVLink link to rows of one vehicle: motor outputs and motion on one time grid, and events."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite, isnan
from typing import NamedTuple

import numpy as np

from mavdem.assessment.headline import with_weak_motor
from mavdem.assessment.wind_drifts import MAX_POSE_AGE, drift_sample
from mavdem.containers import Numbers
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.setpoints import SETPOINT_MESSAGE
from mavdem.facts import Fact, Facts
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import SessionFact, VehicleFact
from mavdem.facts.watch import WatchFact
from mavdem.ingest.mavlink.frame_reader import Frame, FrameReader
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.motors import MOTOR_MESSAGES, POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Parameters
from mavdem.live.boot_clock import BootClock, TimedMessage
from mavdem.live.flight_phase import PHASE_MESSAGES, FlightPhase
from mavdem.live.global_position import (
    GlobalPosition,
    fix_position,
    home_position,
    received_position,
)
from mavdem.live.height_watch import BAROMETER_MESSAGE, RECEIVER_MESSAGE
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.messages import (
    HOME_MESSAGE,
    IMU_MESSAGES,
    STATUS_MESSAGES,
    STICK_MESSAGES,
    Message,
    attitude_sample,
    decode_message,
    message_readers,
    port_outputs,
    tilt_setpoint,
)
from mavdem.live.motor_alarms import MotorAlarms
from mavdem.live.pose import LatestPose, PoseTracker
from mavdem.live.rate_check import RateCheck
from mavdem.live.recent_messages import MAX_EVENTS
from mavdem.live.row_builder import RowBuilder
from mavdem.live.rows import AlignedRow, FormattedRow, RowFormat
from mavdem.live.session_status import SessionStatus
from mavdem.live.takeoff_place import TakeoffPlace, displacement_from_home
from mavdem.live.vehicle_review import VehicleReview
from mavdem.live.vehicle_selection import Component, VehicleSelector
from mavdem.live.vehicle_state import VehicleState, vehicle_state
from mavdem.live.wind import LiveWind
from mavdem.motors.balance_blocks import UNKNOWN_LEAN
from mavdem.motors.motor_changes import thrust_losses
from mavdem.wind_velocity.from_log import ESTIMATOR_FLAG_MESSAGES
from mavdem.wind_velocity.ground_motion import VELOCITY_MESSAGES

REPLY_MESSAGES = ("MESSAGE_INTERVAL", "COMMAND_ACK")
"""Messages with which a vehicle replies to a request for rates."""

KEPT_MESSAGES = frozenset(
    (
        *STATUS_MESSAGES,
        *PHASE_MESSAGES,
        *STICK_MESSAGES,
        *ESTIMATOR_FLAG_MESSAGES,
        BAROMETER_MESSAGE,
    )
)
"""Slow messages that are kept for the periodic review."""

MAX_PORTS = 4
"""Ports of a message of motor outputs that are read, a choice that bounds the memory; PX4 has two."""

MAX_EARLY_MESSAGES = 8192
"""Messages that are kept until it is known which vehicle to follow: a choice that bounds the memory, 5 s and more."""

OTHER_VEHICLE_CODES = (SessionFact.ALARM, WatchFact.ALARM_OVER, MotorWatchFact.MOTOR_RECOVERED)
"""What is reported of vehicles that are not followed, besides warnings of their autopilots."""


class _EarlyMessage(NamedTuple):
    """A message that came before it was known which vehicle to follow."""

    sender: Component
    stamp: float
    """When it was received, UNIX s."""
    message: Message


class LiveStream:
    """Turns the bytes of a link into rows (motor outputs and motion at one time) and events of the followed vehicle.

    It has no threads, sockets or clock.

    The rows depend on the bytes alone, not on how they are cut into pieces nor on when they come.

    Attributes:
        axis: "roll" or "pitch": the rows' outputs are its angle and body rate.
        boot: number of the vehicle's boot, from 0 on.
        frame_reader: finds the frames in the bytes of the link.
        motor_alarms: lasting changes of the motors' balance.
        wind: the wind in m/s.
        other_vehicles: streams of vehicles that are watched without being followed, by name.
    """

    def __init__(
        self,
        axis: str = "roll",
        vehicle: str | None = None,
        *,
        rates_requested: bool = False,
    ) -> None:
        """Prepares the analysis of a link's bytes, before the first byte.

        Args:
            axis: axis whose rows are made, "roll" or "pitch".
            vehicle: "system:component", or "system", of the vehicle to follow; None for the only multirotor that sends
                attitude.
            rates_requested: whether the vehicle is asked for message rates; then no fact advises the user to do so.

        Raises:
            ValueError: unknown axis.
        """
        if axis not in TILT_AXES:
            raise ValueError(f"axis must be one of {', '.join(TILT_AXES)}, not {axis!r}")
        # The first call takes a while, and belongs before the first message.
        message_readers()
        self.axis = axis
        self.boot = 0
        self.frame_reader = FrameReader()
        self.motor_alarms = MotorAlarms()
        self.wind = LiveWind()
        self.other_vehicles: dict[str, LiveStream] = {}
        # When the latest frames were received, UNIX s.
        self._stamp = 0.0
        self._events: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._replies: deque[Message] = deque(maxlen=MAX_EVENTS)
        self._vehicles = VehicleSelector(vehicle, self._add_event)
        self._early_messages: deque[_EarlyMessage] = deque(maxlen=MAX_EARLY_MESSAGES)
        self._clock = BootClock(self._add_event)
        self._pose = PoseTracker()
        self._takeoff_place = TakeoffPlace()
        # The home position of this boot; None before it came.
        self._home: GlobalPosition | None = None
        # The latest geographic position; None before any. ``last_position`` is that of the present flight.
        self._latest_position: GlobalPosition | None = None
        # The boot and the flight in which it was received, by their numbers.
        self._position_boot = 0
        self._position_flight = 0
        self._rate_check = RateCheck(axis, can_request=not rates_requested, report=self._add_event)
        self._review = VehicleReview(
            self._vehicles, self._rate_check, self.motor_alarms, self.wind, self._add_event
        )
        self._rows = RowBuilder(axis, self._review.phase, self._add_event)

    @property
    def followed_vehicle(self) -> Component | None:
        """The vehicle from whose messages rows are made; None before one is chosen."""
        return self._vehicles.followed

    @property
    def has_heard_attitude(self) -> bool:
        """Whether any vehicle of the link, followed or not, has sent its attitude."""
        return any(component.attitude_count for component in self._vehicles)

    @property
    def not_followed_reason(self) -> Fact | None:
        """Why no vehicle is followed; None when one is."""
        return self._vehicles.not_followed_reason

    def other_vehicle_among(self, frames: Sequence[Frame]) -> Component | None:
        """Returns the first vehicle among the senders of some frames that is not the followed one.

        Args:
            frames: frames that were processed by :meth:`process_frames` already.

        Returns:
            The vehicle, one that sends its attitude; None if no such vehicle sent any of the frames.
        """
        for frame in frames:
            sender = self._vehicles.sender(frame)
            is_followed = sender is self.followed_vehicle
            if not is_followed and sender.name in self._vehicles.other_vehicles:
                return sender
        return None

    @property
    def row_format(self) -> RowFormat | None:
        """Names and units of the values in the rows since their latest interruption; None before any row."""
        return self._rows.row_format

    @property
    def sample_count(self) -> int:
        """Number of samples of attitude and motor outputs of the followed vehicle so far."""
        return self._rows.sample_count

    @property
    def attitude_count(self) -> int:
        """Number of messages of attitude of all vehicles so far, followed or not."""
        return sum(component.attitude_count for component in self._vehicles)

    @property
    def pose(self) -> LatestPose | None:
        """The latest attitude with its setpoint; None before any."""
        return self._pose.pose

    @property
    def now(self) -> float:
        """The latest time of the vehicle's clock, s; NaN before any."""
        return self._clock.now

    @property
    def parameters(self) -> Parameters:
        """The vehicle's parameters received so far, by name; also those that MAVProxy stores for it."""
        return self._vehicles.followed_parameters

    @property
    def _phase(self) -> FlightPhase:
        """The phase of flight of the followed vehicle: whether it flies, and since when."""
        return self._review.phase

    def feed(self, stamp: float, data: bytes) -> list[AlignedRow]:
        """Processes the next bytes of the link.

        Args:
            stamp: time of reception, UNIX s.
            data: bytes as they were received, which need not begin or end with a frame.

        Returns:
            The rows that these bytes complete, in the order of time: motor outputs and motion of the followed vehicle,
            each at one time.
        """
        return list(self.process_frames(stamp, self.frame_reader.feed(data)))

    def process_frames(self, stamp: float, frames: Sequence[Frame]) -> Iterator[AlignedRow]:
        """Processes the next frames of the link, and yields each row as soon as it is complete.

        It is a generator, so that the caller can use each row before the frames after it change the state, for example
        before a reboot. Frames of other vehicles on the link are watched for alarms, once they are known.

        Args:
            stamp: time of reception, UNIX s. Events get this time.
            frames: the frames of all senders, in the order of arrival.

        Yields:
            Rows of the followed vehicle, in the order of time.
        """
        self._stamp = stamp
        for frame in frames:
            yield from self._process_frame(frame)
            sender = self._vehicles.sender(frame)
            is_followed = sender is self._vehicles.followed
            if not is_followed and sender.name in self._vehicles.other_vehicles:
                self._watch_other_vehicle(sender.name, frame)

    def process_without_rows(self, stamp: float, frames: Sequence[Frame]) -> None:
        """Processes the next frames of the link, and discards the rows that they complete.

        It is for a vehicle that is only watched for alarms, since no model of it is learned.

        Args:
            stamp: time when they were received, UNIX s.
            frames: the frames of all senders, in the order of arrival.
        """
        for _ in self.process_frames(stamp, frames):
            # ``process_frames`` is a generator, which does its work while its rows are taken.
            pass

    def _watch_other_vehicle(self, name: str, frame: Frame) -> None:
        """Analyses a frame of a vehicle that is not followed, and reports alarms of that vehicle.

        A pilot of several vehicles must not miss a failure of one of them. A separate stream analyses each other
        vehicle. Of its reports only alarms and warnings are passed on.

        Args:
            name: "system:component" of the vehicle, the subject of the reported facts.
            frame: the next frame that this vehicle sent.
        """
        if name not in self.other_vehicles:
            # Nothing is requested from this vehicle. With ``rates_requested`` no fact advises the user to do so.
            self.other_vehicles[name] = LiveStream(self.axis, name, rates_requested=True)
        stream = self.other_vehicles[name]
        stream.process_without_rows(self._stamp, [frame])
        for event in stream.drain_events():
            fact = event.fact
            is_autopilot_warning = isinstance(fact.code, ReportedEvent) and not fact.is_good
            is_alarm = fact.code in OTHER_VEHICLE_CODES
            if is_autopilot_warning or is_alarm:
                # The reported fact names the vehicle. Its figure "reason" is what happened to it.
                self._add_event(
                    Fact(WatchFact.OTHER_VEHICLE_ALARM, fact.level, subject=name, reason=fact)
                )

    @property
    def is_flying(self) -> bool:
        """Whether the vehicle is in the air."""
        return self._phase.is_flying

    @property
    def flight_number(self) -> int:
        """Number of the latest flight in the session, from 1; 0 before the first."""
        return self._review.flight_number

    @property
    def takeoff_time(self) -> float:
        """When the vehicle left the ground last, s of this boot; minus infinity where that was not seen."""
        return self._phase.takeoff_time

    def pop_withdrawal_time(self) -> float | None:
        """Returns the time when a landing or a loss of control began, once after each.

        Either is recognised some time after it began. Until then the rows counted as free flight, and the model was
        trained with them. The caller makes the model forget the rows from this time on.

        Returns:
            The time, s of this boot; None if no landing and no loss was recognised since the last call.
        """
        return self._phase.pop_withdrawal_time()

    def latest_row(self) -> FormattedRow | None:
        """Returns the latest attitude and motor outputs as one row, for display while messages are too slow for rows.

        Returns:
            The row with its format, such as the names of the motors. None before any sample, and as soon as
            :meth:`feed` gives rows.
        """
        return self._rows.latest_row()

    def drain_replies(self) -> list[Message]:
        """Returns the vehicle's ``REPLY_MESSAGES`` since the last call, and forgets them."""
        replies = list(self._replies)
        self._replies.clear()
        return replies

    def drain_events(self) -> list[Event]:
        """Returns the events since the last call, and forgets them."""
        events = list(self._events)
        self._events.clear()
        return events

    def vehicle_state(self) -> VehicleState | None:
        """Returns mode, arming and battery of the followed vehicle by its latest messages; None before it is known."""
        vehicle = self._review.telemetry
        if self.followed_vehicle is None or vehicle is None:
            return None
        return vehicle_state(self._review.recent_messages, vehicle, self._clock.now)

    def status(self) -> SessionStatus:
        """Returns the status of the link and the vehicle after the latest frame.

        Fields of the status that concern learning and judging are left empty; ``StatusReport`` fills them in.
        """
        status = self._status_of_link()
        status = self._with_flight_phase(status)
        status = self._with_position(status)
        return self._with_findings(status)

    def _status_of_link(self) -> SessionStatus:
        """Returns a status that has only the vehicle, its clock, and the rates and losses of its messages."""
        vehicle = self.followed_vehicle
        return SessionStatus(
            vehicle=vehicle.name if vehicle else None,
            boot_clock=self._clock.now,
            boot=self.boot,
            no_model_reason=self._no_rows_reason,
            rates=self._rows.rates(self._clock.now),
            lost_messages=vehicle.lost_messages if vehicle else 0,
            gap_seconds=vehicle.uncounted_gap_seconds if vehicle else 0.0,
            late_samples=self._rows.late_samples,
            undecoded_frames=self.frame_reader.undecoded_frames,
        )

    def _with_flight_phase(self, status: SessionStatus) -> SessionStatus:
        """Adds to a status whether the vehicle flies, since when, and how its flight ended: by a landing or a loss."""
        watchdog = self._review.watchdog
        loss = None if watchdog.loss is None else self._loss_with_weak_motor(watchdog.loss)
        return replace(
            status,
            is_flying=self.is_flying,
            flight_number=self.flight_number,
            flight_seconds=self._flight_seconds,
            has_landed=watchdog.has_landed,
            landing_time=self._phase.landing_time,
            is_armed_since_landing=self._phase.is_armed_since_landing,
            loss=loss,
            ground_contact=watchdog.ground_contact,
        )

    def _with_position(self, status: SessionStatus) -> SessionStatus:
        """Adds to a status where the vehicle is: by its estimator, from its take-off, from home, and on Earth."""
        # If the take-off was not seen, the stored take-off position may be one in the air.
        is_takeoff_seen = isfinite(self.takeoff_time)
        return replace(
            status,
            position=None if self.pose is None else self.pose.position,
            takeoff_position=self._pose.takeoff_position if is_takeoff_seen else None,
            displacement=None if is_takeoff_seen else self._takeoff_place.displacement,
            displacement_from_home=displacement_from_home(self._home, self.last_position),
            last_position=self.last_position,
        )

    def _with_findings(self, status: SessionStatus) -> SessionStatus:
        """Adds to a status what is found without a model: what is watched for faults, alarms, lights and the wind."""
        return replace(
            status,
            watch_facts=self.watch_facts,
            worst_lights=self._review.watchdog.status_lights.latest,
            active_alarms=self._active_alarms,
            motor_alarms=tuple(self.motor_alarms.latest),
            motor_alarms_of_flight=self.motor_alarms.changes_in_latest_flight,
            wind=self.wind.latest,
            mean_wind=self.wind.mean,
            no_wind_reason=self.wind.no_estimate_reason,
        )

    @property
    def _flight_seconds(self) -> float | None:
        """Time since the take-off, s; None on the ground, or where the take-off was not seen."""
        if not self.is_flying or not isfinite(self.takeoff_time):
            return None
        return self._clock.now - self.takeoff_time

    @property
    def _active_alarms(self) -> Facts:
        """The active alarms of the followed vehicle, those of the watchdog first, then those of weak motors.

        The alarm that the vehicle is lost also names a motor that was weak before.
        """
        loss = self._review.watchdog.loss
        alarms = []
        for alarm in (*self._review.watchdog.active_alarms, *self.motor_alarms.active):
            is_loss = loss is not None and alarm == loss
            alarms.append(self._loss_with_weak_motor(alarm) if is_loss else alarm)
        return tuple(alarms)

    @property
    def _no_rows_reason(self) -> Fact | None:
        """Why there are no rows (samples of motor outputs and motion) to learn from; None if there are.

        After a crash it is that the flight is over, since learning does not wait for another take-off then. Otherwise
        it is the first thing that is missing: a vehicle to follow; its attitude, which gives the boot clock; or what
        the latest review found missing. A review examines the messages of the vehicle twice a second.
        """
        loss = self._review.watchdog.loss
        if loss is not None and not self.is_flying:
            return Fact(SessionFact.FLIGHT_OVER, reason=loss)
        if self._vehicles.not_followed_reason is not None:
            return self._vehicles.not_followed_reason
        # The boot clock begins with the first attitude; before it, the time is NaN.
        has_attitude = not isnan(self._clock.now)
        if not has_attitude:
            return self._rate_check.no_attitude
        reason = self._review.no_rows_reason
        is_of_ground = reason is not None and reason.code is SessionFact.NOT_FLYING
        if is_of_ground and self.is_flying:
            # The vehicle has taken off since the latest review, half a second ago at most.
            return None
        return reason

    @property
    def latest_restart(self) -> TimeInterval | None:
        """The interval in which the autopilot restarted last; None if it did not restart.

        It is from the last attitude message before the restart to the first one after it, UNIX s of reception.
        """
        return self._clock.latest_restart

    @property
    def settled_start(self) -> float | None:
        """Since when the flight is settled, s of the boot clock; None if it is not settled now."""
        return self._phase.settled_start(self.now)

    @property
    def has_rate_setpoint(self) -> bool:
        """Whether a setpoint of the body rate of the model's axis comes, by which a log identifies the control loop."""
        vehicle = self._review.telemetry
        return vehicle is not None and self._review.watchdog.has_rate_setpoint(vehicle, self.axis)

    @property
    def watch_facts(self) -> Facts:
        """Which quantities are monitored for faults, such as vibration or battery voltage, on each vehicle of the link.

        There is one fact (coded finding) for each quantity of each vehicle. It states since when the quantity is
        monitored, s on that vehicle's boot clock, or why it is not, for example because a message is missing. The
        followed vehicle comes first. Facts of other vehicles get the name of their vehicle as a figure.
        """
        facts = list(self._review.watchdog.watch_list.facts.values())
        for name, stream in self.other_vehicles.items():
            # Each other vehicle has a stream of its own, which does not name it.
            for fact in stream.watch_facts:
                facts.append(fact.replace(vehicle=name))
        return tuple(facts)

    def _process_frame(self, frame: Frame) -> Iterator[AlignedRow]:
        """Processes a frame of any component on the link, and yields the rows that it completes.

        Only messages of the followed vehicle are used. They get their time on the vehicle's boot clock here. A reboot
        is detected before the message is used: all data with times of the former boot are then discarded.

        Args:
            frame: the next frame, intact or not.
        """
        for message, reception_time in self._messages_of_followed_vehicle(frame):
            if message.name in REPLY_MESSAGES:
                # Replies to requests for message rates, which the session takes.
                self._replies.append(message)
                continue
            timed_message = self._clock.place(message, reception_time)
            if timed_message is None:
                # Its time is not known.
                continue
            has_rebooted = timed_message.boot != self.boot
            if has_rebooted:
                self._restart(timed_message.boot)
            yield from self._process_message(timed_message)

    def _messages_of_followed_vehicle(self, frame: Frame) -> list[tuple[Message, float]]:
        """Counts a frame for its sender, and returns its message if the sender is the followed vehicle.

        The vehicle to follow is chosen by the messages of all senders. Messages that come before the choice are kept,
        since the vehicle may take off meanwhile. Those of the chosen vehicle are returned with its next message.

        Args:
            frame: the next frame, intact or not.

        Returns:
            The message, and when it was received, UNIX s, after any kept ones. Empty for a damaged frame, a copy of an
            earlier one, a message that nothing needs, or another sender.
        """
        sender = self._vehicles.sender(frame)
        is_intact = frame.checksum == CHECKSUM_MATCHES
        message = decode_message(frame) if is_intact else None
        # Damaged frames and copies are counted, too.
        is_new = sender.count_frame(frame, self._stamp)
        if not is_new or not is_intact:
            return []
        if message is not None:
            sender.add_message(message)
        # This may choose the vehicle to follow, also by a frame whose message nothing needs.
        self._vehicles.update(sender)
        if message is None:
            return []
        message = _without_doubtful_stamp(message)
        if self._is_vehicle_unknown:
            self._early_messages.append(_EarlyMessage(sender, self._stamp, message))
            return []
        if sender is not self._vehicles.followed:
            return []
        return [*self._pop_early_messages(sender), (message, self._stamp)]

    @property
    def _is_vehicle_unknown(self) -> bool:
        """Whether no vehicle has been found yet that can be followed."""
        reason = self._vehicles.not_followed_reason
        return reason is not None and reason.code is VehicleFact.NO_VEHICLE_YET

    def _pop_early_messages(self, sender: Component) -> list[tuple[Message, float]]:
        """Returns what a vehicle sent before it was chosen to be followed, once; later calls return nothing.

        Args:
            sender: the vehicle. Early messages of all other senders are dropped.

        Returns:
            Each message with the time at which it was received, UNIX s.
        """
        messages = []
        for early in self._early_messages:
            if early.sender is sender:
                messages.append((early.message, early.stamp))
        self._early_messages.clear()
        return messages

    def _process_message(self, timed: TimedMessage) -> Iterator[AlignedRow]:
        """Passes a message of the followed vehicle to all objects that need it, and yields the rows that it completes.

        Slow messages about state and phase are kept for the periodic review. After each message the next step of that
        review is performed if it is due, which may end the flight, and with it the segment of rows.

        Args:
            timed: the message, with its time in s of the boot clock.
        """
        message = timed.message
        if timed.has_own_stamp:
            yield from self._process_fast_message(message, timed.time)
        self._process_slow_message(message, timed.time)
        if message.name in KEPT_MESSAGES:
            self._review.recent_messages.add(message.name, timed.time, message.values)
        self._review.proceed(self._clock.now, self._rows)
        self._rows.end_segment_unless_free()

    def _process_fast_message(self, message: Message, time: float) -> Iterator[AlignedRow]:
        """Processes a message with attitude, attitude setpoint or motor outputs, and ignores all other messages.

        Rows need exact times, so that the message must have a stamp of its own.

        Args:
            message: the message.
            time: its stamp, s of the boot clock.

        Yields:
            The rows that are complete with this message. A row has motor outputs and motion at one time, which come in
            different messages.
        """
        name = message.name
        if name in ATTITUDE_MESSAGES:
            yield from self._process_attitude(message, time)
        elif name == SETPOINT_MESSAGE:
            self._review.watchdog.add_message(message, time)
            self._pose.add_setpoint(time, tilt_setpoint(message))
        elif name in MOTOR_MESSAGES:
            port, outputs = port_outputs(message)
            # Memory is allocated for each port: without a limit, forged port numbers could exhaust it.
            if port < MAX_PORTS:
                yield from self._add_sample(name, port, time, outputs)

    def _process_slow_message(self, message: Message, time: float) -> None:
        """Processes a message about the motion and state of the vehicle that rows do not need; ignores all others.

        Args:
            message: the message.
            time: time on the boot clock, s, of its stamp or of other messages around it.
        """
        name = message.name
        if name in IMU_MESSAGES:
            self._review.watchdog.control.add_message(message, time)
        elif name in ESTIMATOR_FLAG_MESSAGES:
            self.wind.estimator_flags = message.values[0]
        elif name in VELOCITY_MESSAGES:
            self._process_velocity(message, time)
        elif name == HOME_MESSAGE:
            home = home_position(message.values, self._stamp)
            # Where the message has no position, the one before stays.
            self._home = home or self._home
        elif name in (BAROMETER_MESSAGE, RECEIVER_MESSAGE):
            self._update_takeoff_distance(message)

    def _update_takeoff_distance(self, message: Message) -> None:
        """Updates height and distance of the vehicle from its place of take-off with a barometer or GPS message.

        Usually the autopilot's own estimate of the position gives both. But if the autopilot reboots in flight, that
        estimate begins at 0 again, wherever the vehicle is. Air pressure and GPS positions do not, and then replace it.

        Args:
            message: SCALED_PRESSURE with the air pressure, or GPS_RAW_INT with the position by satellites.
        """
        if message.name == BAROMETER_MESSAGE:
            pressure = message.values[0]
            self._takeoff_place.add_pressure(pressure)
        else:
            satellite_position = fix_position(message.values, self._stamp)
            # Without enough satellites the message has no position.
            if satellite_position is not None:
                self._takeoff_place.add_fix(satellite_position)
                self._note_fix(satellite_position)
        # The take-off place is the latest place on the ground: it follows the vehicle until that flies, then stays.
        is_takeoff_seen = isfinite(self.takeoff_time)
        self._takeoff_place.note_phase(is_flying=self.is_flying, is_takeoff_seen=is_takeoff_seen)

    def _note_fix(self, fix: GlobalPosition) -> None:
        """Takes a position by satellites as the latest one, unless the autopilot sends an estimate of its own.

        Args:
            fix: latitude and longitude by satellites, with the time at which they were received.
        """
        latest = self.last_position
        # Only the estimate of the autopilot has a height above the home position.
        is_recent_estimate = (
            latest is not None
            and latest.height is not None
            and self._stamp - latest.reception <= SILENCE_SECONDS
        )
        if not is_recent_estimate:
            self._note_position(fix)

    def _note_position(self, position: GlobalPosition) -> None:
        """Takes a position as the latest one of the present boot and flight."""
        self._latest_position = position
        self._position_boot = self.boot
        self._position_flight = self.flight_number

    @property
    def last_position(self) -> GlobalPosition | None:
        """The latest geographic position of this boot or of this flight; None if none came.

        A crashed vehicle is searched there, even if its autopilot reboots after the crash. Once it flies again, a
        position from before the reboot is of no use.
        """
        # ``_note_position`` stores a position with the numbers of the boot and of the flight in which it came.
        is_of_boot = self._position_boot == self.boot
        is_of_flight = self._position_flight == self.flight_number
        return self._latest_position if is_of_boot or is_of_flight else None

    def _process_velocity(self, message: Message, time: float) -> None:
        """Uses a velocity to estimate the wind, and the position in the same message, if any, for the vehicle's pose.

        The search for drift takes LOCAL_POSITION_NED only, whose velocity is in m/s.

        Args:
            message: a decoded message. Its first three values are the velocity down, north and east, in the unit of the
                message. A position follows in two of them: in LOCAL_POSITION_NED north, east and down, m; in
                GLOBAL_POSITION_INT height above home, latitude and longitude.
            time: time on the boot clock, s.
        """
        velocity = message.values[:3]
        position = message.values[3:]
        self._estimate_wind(message.name, time, velocity)
        if message.name == "LOCAL_POSITION_NED":
            self._pose.add_position(time, position, is_flying=self.is_flying)
            _, north, east = velocity
            self._watch_drift(time, (north, east))
        elif message.name == "GLOBAL_POSITION_INT":
            new_position = received_position(position, self._stamp)
            # Without a position fix the position before stays the latest one.
            if new_position is not None:
                self._note_position(new_position)
                self._pose.add_global_position(time, new_position, is_flying=self.is_flying)

    def _estimate_wind(self, message_name: str, time: float, velocity: Numbers) -> None:
        """Adds a velocity to the estimate of the wind, which is reported as an event the first time there is one.

        Args:
            message_name: name of the message that has the velocity, which decides its unit.
            time: time on the boot clock, s.
            velocity: velocity down, north and east, in the unit of the message.
        """
        if self._review.watchdog.loss is not None:
            # The wind follows from how far the vehicle leans. Out of control it does not lean into the wind.
            self.wind.stop()
            return
        first_wind = self.wind.add_velocity(message_name, time, velocity)
        if first_wind is not None:
            self._add_event(first_wind)

    def _watch_drift(self, time: float, velocity: Numbers) -> None:
        """Passes a velocity in flight, with the latest attitude, to the watchdog, which looks for drift in wind.

        Args:
            time: time on the boot clock, s.
            velocity: north and east, m/s.
        """
        vehicle = self.followed_vehicle
        pose = self._pose.pose
        if vehicle is None or pose is None or not self.is_flying:
            return
        # The wings of a plane or VTOL lift it against its motion in each turn, as if it were drifting.
        is_multirotor = vehicle.vehicle_type in POSSIBLE_MULTIROTORS
        is_pose_recent = time - pose.time < MAX_POSE_AGE
        if not is_multirotor or not is_pose_recent:
            return
        is_finite = all(isfinite(value) for value in (*velocity, *pose.angles))
        if is_finite:
            sample = drift_sample(time, pose.angles, velocity)
            self._review.watchdog.drift.add_sample(sample, self.parameters)

    def _process_attitude(self, message: Message, time: float) -> list[AlignedRow]:
        """Passes an attitude on to all that use it, the learner included, and returns the rows that it completes.

        It goes to the watchdog, which looks for faults, to the estimator of the wind, to the pose (the latest position,
        velocity and attitude), and to the learner's rows (samples of attitude and motor outputs at one time).

        Args:
            message: decoded ATTITUDE or ATTITUDE_QUATERNION.
            time: time on the boot clock, s.
        """
        watchdog = self._review.watchdog
        watchdog.add_message(message, time)
        attitude = attitude_sample(message)
        tilt_and_rates = None
        if attitude is not None:
            tilt_and_rates = attitude.tilt_and_rates
            # Several messages may bring the attitude: the wind is estimated from the one that the learner uses. Held by
            # the ground, the vehicle does not lean into the wind.
            is_used_by_learner = message.name == self._rows.attitude_message
            if is_used_by_learner and self._phase.is_free(time):
                self.wind.add_attitude(time, attitude.roll, attitude.pitch, attitude.yaw)
            pose = self._pose.add_attitude(time, attitude)
            watchdog.control.add_pose(pose)
        # An attitude that is NaN cannot be used, but it was received, and must not count as missing. Only motor outputs
        # come in several ports.
        return self._add_sample(message.name, 0, time, tilt_and_rates)

    def _add_sample(
        self, name: str, port: int, time: float, values: Numbers | None
    ) -> list[AlignedRow]:
        """Adds a sample of attitude or motor outputs, and returns the rows that it completes: both at one time.

        Each sample of the port (group of outputs) that has most motors also continues the test for a motor that loses
        thrust.

        Args:
            name: name of the message.
            port: number of its port; 0 for attitude.
            time: time of the sample, s on the boot clock.
            values: outputs, or roll and pitch (rad) with their body rates (rad/s); None if they cannot be used.

        Returns:
            The rows that the sample completes.
        """
        stream = self._rows.add_sample(name, port, time, values)
        if stream is None:
            # The sample was refused, or no rows are made of this stream.
            return []
        if self._rows.is_main_motor_stream(stream):
            # The test comes before the rows, which mark the time when a motor is weak.
            self._test_motors(time)
        return self._rows.completed_rows(name, stream)

    def _test_motors(self, time: float) -> None:
        """Looks for a motor that works harder than before, at the latest motor outputs, and reports it as an event.

        The outputs are compared in settled flight only: in manoeuvres they differ in any case.

        Args:
            time: time of the latest sample of motor outputs, s of the boot clock.
        """
        inputs = self._rows.inputs
        if inputs is None or not self._phase.is_settled(time):
            return
        outputs = self._rows.latest_motor_outputs()
        if outputs is None:
            return
        motors = inputs.motors
        # Motor commands as fractions of their range.
        commands = motors.scale.fraction(np.array(outputs)).tolist()
        # The lean of the vehicle, rad, which explains part of the difference between motors.
        roll_and_pitch = UNKNOWN_LEAN
        if self._pose.pose is not None:
            roll, pitch, _ = self._pose.pose.angles
            roll_and_pitch = (roll, pitch)
        new_alarms = self.motor_alarms.add_sample(
            time, self.boot, motors, commands, self._pose.heading, roll_and_pitch
        )
        for fact in new_alarms:
            self._add_event(fact)

    def _restart(self, boot: int) -> None:
        """Begins a new boot after the autopilot has restarted: discards all data with times of the former boot's clock.

        The clock of the new boot begins at 0, so that times of both cannot be compared. The identity of the vehicle and
        its parameters have no times and stay.

        Args:
            boot: number of the new boot: how often the autopilot has restarted so far.
        """
        self.boot = boot
        self.wind.restart()
        self._pose.restart()
        self._takeoff_place.restart(was_flying=self.is_flying)
        self._home = None
        self.motor_alarms.restart()
        self._review.restart(boot)
        # The review has just made a new object for the phase of flight, by which the rows of the new boot are chosen.
        self._rows.restart(boot, self._review.phase)

    def _loss_with_weak_motor(self, loss: Fact) -> Fact:
        """Adds the motor that lost thrust earlier in the flight, if any did, to the fact that the flight was lost.

        The judgement of a log does the same.

        Args:
            loss: the fact that the flight was lost.

        Returns:
            The fact with the weakest motor as its likely cause; unchanged if no motor was weak.
        """
        weak_motors = thrust_losses(self.motor_alarms.changes_in_latest_flight)
        if not weak_motors:
            return loss
        return with_weak_motor(loss, weak_motors[0])

    def _add_event(self, fact: Fact) -> None:
        """Adds a fact to the events of the session, with the time at which the latest frames were received.

        Args:
            fact: what happened, such as an alarm or a take-off, as a coded finding. The figure "reason" of an alarm is
                the fault. If that is the loss of the vehicle, a motor that lost thrust before is added to it.
        """
        if fact.code is SessionFact.ALARM:
            fault = self._loss_with_weak_motor(fact.figures["reason"])
            fact = fact.replace(reason=fault)
        reception_time = self._stamp
        self._events.append(Event(reception_time, fact))


def _without_doubtful_stamp(message: Message) -> Message:
    """Returns a message, without its stamp if that may not be the time of the message on the autopilot's boot clock.

    Autopilots stamp messages on the state, IMUs and the home position by another clock, or by the time of an earlier
    message. Without a stamp (0 in MAVLink) their time is that of the stamped messages beside them.

    Args:
        message: the message as it was received.
    """
    has_doubtful_stamp = message.name in (*STATUS_MESSAGES, *IMU_MESSAGES, HOME_MESSAGE)
    return message._replace(stamp=0.0) if has_doubtful_stamp else message
