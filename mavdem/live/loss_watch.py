"""Watch for the loss of a live vehicle: a loss of control, a fall with idle motors, and the contact with the ground."""

from __future__ import annotations

from collections.abc import Sequence

from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, FailedFirst
from mavdem.facts.lights import Light
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live.active_alarms import ActiveAlarms
from mavdem.live.control_watch import ControlWatch, FlightEnd, carries_vehicle
from mavdem.live.flight_lights import FlightLights
from mavdem.live.landed_states import LandedStates
from mavdem.live.live_signals import FlightMoment
from mavdem.live.review import Review
from mavdem.motors.motor_changes import alarm_if_bad

LOSSES_IN_AIR = (Ending.CONTROL_LOST, WatchFact.STOPPED_IN_AIR)
"""Losses of vehicles that are still in the air: how they meet the ground, which ends the flight, is not known yet."""

REPLACEABLE_LOSSES = (*LOSSES_IN_AIR, Ending.LOSS_REPORTED)
"""Losses that a contact with the ground replaces: by the motion a flight is known to be lost better, as in a log, than
by the autopilot's report."""

LOSSES_BY_MOTORS = (Ending.CONTROL_LOST, Ending.CRASHED)
"""Losses that a motor at its limit may have caused."""

FALL_SECONDS = 2 * RECOVERY_SECONDS
"""Time after a flight in which a vehicle whose motors were stopped in the air meets the ground and lies still, s."""


class LossWatch:
    """Finds out whether and how a vehicle is lost, in flight and just after it; one boot, all times of its clock.

    Three events follow each other, some of which may be missing: a fall with idle motors, which the pilot may still
    catch; the loss of the vehicle; and its contact with the ground.

    Attributes:
        loss: how the flight was lost, by its motion or a report of the autopilot; it stays until the next take-off.
            None as long as nothing was lost.
        ground_contact: how the lost vehicle met the ground, even while the autopilot reports it as flying; it is the
            loss itself where the ground ended the flight. None before, and where nothing was lost.
        ongoing_fall: the alarm of a fall with the motors at idle that has not ended; None without one.
        has_landed: whether the latest flight ended on the ground; not in flight, nor while a vehicle whose motors were
            stopped may still be in the air. True before any flight.
    """

    def __init__(
        self,
        control: ControlWatch,
        landed_states: LandedStates,
        alarms: ActiveAlarms,
        status_lights: FlightLights,
        former: LossWatch | None,
    ) -> None:
        """Begins with the loss of the former boot, since an autopilot may well restart in a crash.

        Args:
            control: finds by the motion that control was lost, or that the vehicle falls or hits the ground.
            landed_states: when the vehicle was in the air.
            alarms: the active alarms. Those of the control and of the motors' limits are read.
            status_lights: judgements of the parts of the vehicle. A loss changes that of the motors.
            former: the watch of the former boot; None for the first boot.
        """
        self.loss: Fact | None = None if former is None else former.loss
        self.ground_contact: Fact | None = None if former is None else former.ground_contact
        self.ongoing_fall: Fact | None = None
        self.has_landed = True
        self._control = control
        self._landed_states = landed_states
        self._alarms = alarms
        self._status_lights = status_lights
        # A contact with the ground after a loss in the air, until it is reported.
        self._unreported_contact: Fact | None = None

    def begin_flight(self) -> None:
        """Begins the watch of a flight at its take-off: the vehicle has not landed, and no fall is known.

        A loss of the vehicle that was recorded before stays, since a crashed vehicle may only have bounced off the
        ground. If another flight begins, the watchdog calls :meth:`forget_loss` too.
        """
        self.ongoing_fall = None
        self.has_landed = False

    def forget_loss(self) -> None:
        """Forgets how the vehicle was lost: it is under control again, or another flight begins."""
        self.loss = None
        self.ground_contact = None

    @property
    def loss_that_ended_flight(self) -> Fact | None:
        """The loss of the vehicle, if it is one of those by which a flight in a log ends (``Ending``); otherwise None.

        Whatever is measured after such a loss, of a tumbling or crashed vehicle, does not count in its judgement.
        """
        # Other losses, such as motors that stopped in the air, do not yet say how the flight ended.
        is_end_of_flight = self.loss is not None and self.loss.code in Ending
        return self.loss if is_end_of_flight else None

    @property
    def _has_sinking_alarm(self) -> bool:
        """Whether the alarm is active that the vehicle cannot hold its height."""
        alarm = self._alarms.facts.get(WatchedQuantity.MOTOR_LIMITS)
        return alarm is not None and alarm.code is WatchFact.SINKS_AT_LIMIT

    def pop_contact_report(self, now: float) -> list[Fact]:
        """Returns the alarm that a vehicle that was lost in the air has met the ground, once after each such contact.

        Args:
            now: present time, s.

        Returns:
            A list with the alarm; empty if there was no such contact since the last call.
        """
        contact = self._unreported_contact
        self._unreported_contact = None
        if contact is None:
            return []
        return [alarm_if_bad(contact, now)]

    def judge_flight(self, review: Review, moment: FlightMoment) -> list[Fact]:
        """Looks for a loss of the vehicle in flight, and if there is none, for a fall with idle motors.

        A loss is recorded as soon as it is found, in one of two ways:

        - Control is lost. The loss stays as it was found first, as a lost vehicle soon looks lost in other ways, too.
          How it meets the ground, and how fast, is added when that is found. Close to the ground nothing is recorded
          for a moment, as the impact will show what happened.
        - The vehicle hits the ground under control: the crash itself is the loss.

        Args:
            review: the review, whose ``facts`` get the loss. It becomes an alarm from there, and so is not returned.
            moment: present time, and the motion.

        Returns:
            The alarm of a fall with idle motors that begins, or its end once the motors carry the vehicle again. A fall
            is no loss yet: the pilot may catch the vehicle. Empty in all other reviews.
        """
        present_loss = self._control.loss(moment)
        flight_end = self._crash(present_loss, moment)
        if present_loss is not None:
            if self._awaits_impact(present_loss, flight_end, moment):
                return []
            first_loss = self._alarms.facts.get(WatchedQuantity.CONTROL, present_loss)
            self._record_loss(first_loss, flight_end, review)
        elif flight_end is not None and flight_end.loss is not None:
            self._record_loss(flight_end.loss, flight_end, review)
        if self.loss is not None:
            self.ongoing_fall = None
            return []
        return self._update_fall(review, moment)

    def _crash(self, present_loss: Fact | None, moment: FlightMoment) -> FlightEnd | None:
        """Returns how a flying vehicle has met the ground in a crash, as its motion shows; None without a new crash.

        A crash is looked for only after a loss of control, or if the vehicle sinks although its motors are at their
        limit.

        Args:
            present_loss: loss of control that the latest messages show; None for none.
            moment: present time, and the motion.
        """
        if self.ground_contact is not None:
            # The contact was found before.
            return None
        # A vehicle that sinks at full throttle may hit the ground although its attitude follows the setpoint.
        is_sinking = self.loss is None and self._has_sinking_alarm
        if present_loss is None and not is_sinking:
            return None
        return self._control.crash_after_loss(moment)

    def _awaits_impact(
        self, loss: Fact, flight_end: FlightEnd | None, moment: FlightMoment
    ) -> bool:
        """Returns whether a loss of control is recorded only after the impact, which is a moment away.

        The impact shows what happened. It is awaited only after a new loss near the ground.

        Args:
            loss: loss of control that the latest messages show.
            flight_end: how the flight ended; None before the vehicle has met the ground.
            moment: present time.
        """
        is_new = WatchedQuantity.CONTROL not in self._alarms.facts
        has_met_ground = self.ground_contact is not None or flight_end is not None
        is_still_in_air = loss.code in LOSSES_IN_AIR and not has_met_ground
        return is_new and is_still_in_air and self._control.awaits_impact(loss, moment)

    def _update_fall(self, review: Review, moment: FlightMoment) -> list[Fact]:
        """Begins or ends the alarm that the vehicle falls because its motors idle, as after a closed throttle.

        The alarm begins when the fall is found, and ends only when the motors carry the vehicle again. A fall that is
        no longer found, for example because no climb rate is received, does not end it.

        Args:
            review: the review, with its time and the vehicle's parameters.
            moment: present time, and the motion of the last seconds.

        Returns:
            The alarm when it begins, or the fact that it is over when it ends; empty in all other reviews.
        """
        former_fall = self.ongoing_fall
        present_fall = self._control.fall(moment)
        if present_fall is not None:
            # The newest fact has the present height and speed.
            self.ongoing_fall = present_fall
            if former_fall is None:
                return [alarm_if_bad(present_fall, review.now)]
            return []
        motors_carry_vehicle = carries_vehicle(moment.motion, review.vehicle.parameters)
        if former_fall is not None and motors_carry_vehicle:
            self.ongoing_fall = None
            return [Fact(WatchFact.ALARM_OVER, time=review.now, reason=former_fall)]
        return []

    def judge_end_of_flight(
        self, review: Review, moment: FlightMoment, reports: Sequence[Fact]
    ) -> None:
        """Judges in the reviews just after a flight whether the vehicle has landed and, if not, how it was lost.

        A vehicle that was disarmed in the air falls. Its impact is looked for in each review until ``FALL_SECONDS``
        after the end of the flight. If none is found, it stays unknown how the vehicle came down, and it does not count
        as landed.

        Args:
            review: a review on the ground, whose ``facts`` get the loss.
            moment: present time, and the motion.
            reports: reports of the autopilot in the last minute, such as that of a crash.
        """
        end_time = self._landed_states.flight_end
        if end_time is None:
            # There was no flight yet.
            return
        if review.now - end_time > FALL_SECONDS:
            # How the flight ended was judged by the reviews before.
            return
        flight_end = self._control.flight_end(moment, end_time, reports)
        self.has_landed = not flight_end.is_in_air
        loss = self._loss_at_end_of_flight(flight_end, review)
        if loss is None or not self._replaces_known_loss(loss):
            return
        self._record_loss(loss, flight_end, review)
        # A fall that was an alarm in flight has become this loss.
        self.ongoing_fall = None

    def _loss_at_end_of_flight(self, flight_end: FlightEnd, review: Review) -> Fact | None:
        """Returns how a flight that has just ended was lost, such as by a crash, or by motors that stopped in the air.

        Args:
            flight_end: how the flight ended.
            review: the review, with the time when the flight ended.

        Returns:
            The loss as a fact (a coded finding); None if the vehicle has landed, if it is not known how it came down,
            or if its loss is known already.
        """
        if flight_end.loss is not None and flight_end.loss.is_bad:
            return flight_end.loss
        if not flight_end.is_falling or self.loss is not None:
            return None
        # The motors stopped between the last review in flight and the first one after it.
        fall_start: float | None = review.phase_start
        if self.ongoing_fall is not None:
            fall_start = self.ongoing_fall.time
        return Fact(WatchFact.STOPPED_IN_AIR, Level.BAD, time=fall_start)

    def _replaces_known_loss(self, loss: Fact) -> bool:
        """Returns whether the loss of a vehicle, as found at the end of its flight, replaces the one found before.

        A loss that was found in the air, or that the autopilot reported, is replaced, since it does not state how the
        vehicle met the ground. But if the autopilot reports a loss twice, its second report adds nothing.

        Args:
            loss: the event that the vehicle was lost, as the end of the flight shows it.
        """
        earlier_loss = self.loss
        if earlier_loss is None:
            return True
        are_both_reports = (
            earlier_loss.code is Ending.LOSS_REPORTED and loss.code is Ending.LOSS_REPORTED
        )
        return earlier_loss.code in REPLACEABLE_LOSSES and not are_both_reports

    def _record_loss(self, loss: Fact, flight_end: FlightEnd | None, review: Review) -> None:
        """Records how the vehicle was lost and has met the ground, and judges the motors by it.

        A vehicle that loses control in the air is lost before it meets the ground: loss and contact are two facts. In a
        crash the contact is itself the loss.

        Args:
            loss: the fact (coded finding) that the vehicle was lost, as it was found first.
            flight_end: how the vehicle met the ground; None before that. If it states a loss, this replaces ``loss``,
                since the end of the flight shows better what happened.
            review: the review, whose ``facts`` get the loss, so that it becomes an alarm.
        """
        if flight_end is not None and flight_end.loss is not None:
            loss = flight_end.loss
        loss = self._with_motor_as_cause(loss)
        if loss.code not in LOSSES_IN_AIR:
            self.ground_contact = loss
        elif flight_end is not None and flight_end.contact is not None:
            self._record_contact_after_loss(flight_end.contact)
            # With this figure the fact does not advise to release the parachute, which would not help on the ground.
            loss = loss.replace(is_low=True)
        self.loss = loss
        review.facts[WatchedQuantity.CONTROL] = loss
        self._judge_motors_after_loss(loss)

    def _record_contact_after_loss(self, contact: Fact) -> None:
        """Records that a vehicle that was lost in the air has met the ground, and keeps that to be reported once.

        Args:
            contact: the contact with the ground, as an event of the motion. Of several only the first one counts.
        """
        if self.ground_contact is not None:
            return
        self.ground_contact = contact.replace(Level.BAD)
        self._unreported_contact = self.ground_contact

    def _with_motor_as_cause(self, loss: Fact) -> Fact:
        """Adds to the loss of a vehicle its cause, if a single motor was at its upper limit just before.

        A motor may reach its limit many seconds before the vehicle meets the ground. The outputs that are kept, of the
        last seconds, no longer show that, but the alarm on the motor's limit does.

        Args:
            loss: the event that the vehicle was lost, such as a fall or a crash.

        Returns:
            The loss with the motor as cause; unchanged if another cause is known, or if no motor caused it.
        """
        has_known_cause = loss.figures.get("cause") is not None
        if has_known_cause or loss.code not in LOSSES_BY_MOTORS:
            return loss
        limit_alarm = self._alarms.facts.get(WatchedQuantity.MOTOR_LIMITS)
        # An alarm about several motors has no subject: it is not known which of them failed first.
        if limit_alarm is None or not limit_alarm.subject:
            return loss
        # The alarm stays active for a while after the motor has left its limit.
        last_time_at_limit = self._alarms.last_found(WatchedQuantity.MOTOR_LIMITS)
        was_at_limit_just_before = last_time_at_limit >= loss.start_time - RECOVERY_SECONDS
        if not was_at_limit_just_before:
            return loss
        motor_name = limit_alarm.subject
        cause = Fact(FailedFirst.LIMIT_FIRST, subject=motor_name)
        # The flight mode that was chosen explains nothing if a motor is the cause.
        return loss.replace(subject=motor_name, cause=cause, mode="")

    def _judge_motors_after_loss(self, loss: Fact) -> None:
        """Updates the status light of the motors, that is the judgement of them, after the vehicle was lost.

        If a motor failed first, the loss becomes the judgement. Otherwise a good judgement is removed, since it is no
        longer certain that the motors are sound.

        Args:
            loss: the event that the vehicle was lost; its subject is the motor that failed first, if one is known.
        """
        if loss.subject:
            self._status_lights.add(Light.MOTORS, loss)
        self._status_lights.remove_good(Light.MOTORS)
