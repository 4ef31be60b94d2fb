"""The status of a live session at one moment, with the judgement of its flights.

A judgement has a headline, the fact that matters most; a next step, what the pilot should do; and lights, each the fact
that judges one part of the vehicle, such as its motors.
"""

from dataclasses import dataclass, replace
from functools import cached_property

from mavdem.assessment.event_lights import lights_with_event
from mavdem.assessment.flight_verdict import FlightVerdict, worst_first
from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact, Facts
from mavdem.facts.assessment import Headline as HeadlineCode
from mavdem.facts.assessment import NextStep
from mavdem.facts.ending import Ending
from mavdem.facts.session import SessionFact
from mavdem.live.event_cause import cause_of_alarm
from mavdem.live.headline_from_lights import judgement_from_headline
from mavdem.live.judgement_after_flight import judgement_after_flight
from mavdem.live.judgement_in_flight import judgement_in_flight
from mavdem.live.judgement_without_check import judgement_without_check
from mavdem.live.model_and_checks import judgement_by_model_and_checks
from mavdem.live.next_step_in_flight import landing_step
from mavdem.live.session_state import STATES_OF_LEARNING, SessionState
from mavdem.live.silent_vehicle import link_loss_in_flight

STATUS_PERIOD = 1.0
"""Time between two reports of a status, s: a choice."""


STEPS_TO_THE_GROUND = (
    NextStep.LAND_NOW,
    NextStep.LAND_SOON,
    NextStep.LET_LAND,
    NextStep.FLY_BY_SIGHT,
)
"""Next steps in flight that end it, or let the pilot watch the vehicle itself: none of them lets it fly on."""


@dataclass(frozen=True)
class SessionStatus(SessionState):
    """The status of a live session at one moment: what was received and found, and the judgements that follow from it.

    ``LiveStream.status`` fills in what concerns the link and the vehicle, ``StatusReport.status`` adds the model, and
    ``LiveSession.status`` the ``shortfall`` and the ``verdicts``.
    """

    @cached_property
    def overall_judgement(self) -> Judgement:
        """The judgement of the latest flight: headline, next step and lights, by the model and by checks without one.

        The headline is the fact that matters most, and the next step what the pilot should do. The lights are the
        judgements of the parts of the vehicle, such as its motors: each is a fact with a level. The headline is found
        in steps, each of which may replace the headline of the step before:

        1. The headline of the model or, if that is no fault, of the worst lights.
        2. If nothing was checked so far: in flight, that there is no alarm; later, that the flight was not judged.
        3. How the flight was lost.
        4. In flight, what cannot wait until the landing. After the flight, see :func:`judgement_after_flight`.
        """
        judgement = judgement_by_model_and_checks(self)
        is_nothing_checked = judgement.headline.code in (
            HeadlineCode.NOTHING_CHECKED,
            *STATES_OF_LEARNING,
        )
        if is_nothing_checked:
            judgement = judgement_without_check(self, judgement)
        # The judgement of the recording, where there is one, has a headline on the loss that says more than this one.
        states_loss = judgement.headline.code in Ending
        if self.loss is not None and not states_loss:
            lights = lights_with_event(judgement.lights, self.loss)
            judgement = judgement_from_headline(self.loss, lights)
        if self.is_in_flight:
            return judgement_in_flight(self, judgement)
        return judgement_after_flight(self, judgement)

    @property
    def verdict(self) -> FlightVerdict:
        """The judgement of the latest flight so far as if it were over: without what a pilot must do in flight."""
        # A vehicle that flies on after a restart in the air still has the verdict by which it seemed to be lost.
        verdicts = () if self.is_flying else self.verdicts
        flight_so_far = replace(self, is_flying=False, is_over=True, verdicts=verdicts)
        return FlightVerdict(
            self.flight_number, flight_so_far.overall_judgement, self.flight_seconds
        )

    @property
    def verdicts_worst_first(self) -> list[FlightVerdict]:
        """The verdicts on all flights of the session, the worst first; a verdict is the judgement of one flight.

        Each was made when its flight ended. That on the latest flight is made anew, since the recording of the flight
        may have been judged meanwhile. There is one exception: if the autopilot restarted after a loss in the air, the
        present judgement is about the time after the restart, and the verdict from before it stays until the recording
        is judged.
        """
        if not self.verdicts:
            return []
        earlier_verdicts = self.verdicts[:-1]
        latest_verdict = self.verdicts[-1]
        is_of_latest_flight = latest_verdict.number == self.flight_number
        is_from_before_restart = latest_verdict.is_lost_in_air and not self.is_recording_judged
        if is_of_latest_flight and not is_from_before_restart:
            latest_verdict = latest_verdict._replace(judgement=self.overall_judgement)
        return worst_first([*earlier_verdicts, latest_verdict])

    @property
    def worst_earlier_verdict(self) -> FlightVerdict | None:
        """The worst bad verdict on a flight of the session before the latest one; None if no such flight was bad."""
        for verdict in self.verdicts_worst_first:
            if verdict.number != self.flight_number and verdict.judgement.headline.is_bad:
                return verdict
        return None

    @property
    def session_judgement(self) -> Judgement:
        """The judgement to show: that of the latest flight, with a warning of faults that earlier flights had.

        A take-off repairs nothing. So a next step that lets the vehicle fly on gets the condition "if the fault was
        repaired", and as long as nothing else warns in flight, the fault is the headline. On the ground the headline is
        that of the worst flight: one of the session, or an earlier one in the library. While the link is lost in
        flight, what to do about that comes first. The lights, which judge the parts of the vehicle, remain those of the
        latest flight.
        """
        judgement = self._judgement_with_worst_headline
        fault = self.unrepaired_fault
        if fault is None or self.link_loss is not None:
            return judgement
        if self.is_in_flight:
            return self._judgement_with_condition(judgement, fault)
        if self._is_most_important_before_take_off(fault, judgement):
            next_step = Fact(NextStep.TAKE_OFF_IF_REPAIRED, reason=fault)
            return replace(judgement, headline=fault, next_step=next_step)
        return judgement

    def _is_most_important_before_take_off(self, fault: Fact, judgement: Judgement) -> bool:
        """Returns whether the fault of an earlier flight is to be the headline, since the next thing is a take-off.

        Three conditions must be met:

        1. The vehicle is known to be on the ground, and is not advised to land first.
        2. The fault is one of an earlier session. Of two flights of this session, the worse one is the headline anyway.
        3. The fault matters more for a take-off than the present headline.

        Args:
            fault: the warning that the fault may still be there; its ``reason`` is the fault itself.
            judgement: judgement of the latest flight, with the present headline.
        """
        is_landing_advised = judgement.next_step.code in STEPS_TO_THE_GROUND
        if is_landing_advised or not self._is_known_to_be_on_ground:
            return False
        earlier_fault = fault.figures["reason"]
        is_of_earlier_session = earlier_fault == self.fault_in_library
        return is_of_earlier_session and _is_worse_for_take_off(earlier_fault, judgement.headline)

    @property
    def _is_known_to_be_on_ground(self) -> bool:
        """Whether it is known where the vehicle is, and that it does not fly: it is received, or its flight is over."""
        is_vehicle_known = self.flight_number > 0 or self.is_over or self.is_vehicle_received
        return is_vehicle_known and not self.is_in_air

    def _judgement_with_condition(self, judgement: Judgement, fault: Fact) -> Judgement:
        """Adds a condition to the next step of a judgement in flight: that the fault of an earlier flight was repaired.

        Args:
            judgement: judgement of the present flight. Its headline stays if it warns.
            fault: the warning of the fault, which becomes the headline otherwise.
        """
        headline = judgement.headline if judgement.headline.is_watch_or_bad else fault
        if judgement.next_step.code in STEPS_TO_THE_GROUND:
            # No repair allows more than the landing that is advised anyway.
            return replace(judgement, headline=headline)
        step = Fact(NextStep.FLY_ON_IF_REPAIRED, reason=fault, next_step=judgement.next_step)
        return replace(judgement, headline=headline, next_step=step)

    @property
    def _judgement_with_worst_headline(self) -> Judgement:
        """The judgement of the latest flight; on the ground, a worse earlier flight gives its headline and next step.

        A vehicle that crashed in flight 1 and made a good flight 2 thus keeps the warning of flight 1 until its faults
        are known to be repaired. If the session ended in flight, the landing comes first. In flight the pilot needs the
        state of the present flight. The lights, which judge the parts of the vehicle, are always those of the latest
        flight.
        """
        latest_judgement = self.overall_judgement
        earlier_verdict = self.worst_earlier_verdict
        if earlier_verdict is None or self.is_in_flight:
            return latest_judgement
        is_earlier_flight_worst = self.verdicts_worst_first[0] == earlier_verdict
        if not is_earlier_flight_worst:
            return latest_judgement
        if self.is_in_air and self.loss is None:
            return self._judgement_with_landing_first(latest_judgement, earlier_verdict)
        next_step = earlier_verdict.judgement.next_step
        return replace(latest_judgement, headline=earlier_verdict.fact, next_step=next_step)

    def _judgement_with_landing_first(
        self, latest_judgement: Judgement, earlier_verdict: FlightVerdict
    ) -> Judgement:
        """Returns the judgement of a session that ended with the vehicle in the air, if an earlier flight had a fault.

        The vehicle in the air matters more than the fault. The headline says that the session ended in flight, and
        then names the fault; the next step is to land, and then to repair it.

        Args:
            latest_judgement: judgement of the flight in which the session ended. It is returned as it is if the link to
                the vehicle was lost, since its next step is then to search for the vehicle.
            earlier_verdict: verdict on the earlier flight, whose fault is worse than those of the latest one.
        """
        if self.link_loss is not None:
            return latest_judgement
        headline = self.end_in_flight(earlier_verdict.fact)
        next_step = landing_step(self, earlier_verdict.judgement.next_step)
        return replace(latest_judgement, headline=headline, next_step=next_step)

    @property
    def unrepaired_fault(self) -> Fact | None:
        """The warning that a fault with which the vehicle must not fly may still be there since an earlier flight.

        The earlier flight is one of this session. If none of these has such a fault, it is one of a former session,
        whose recording the library has judged, or else the latest one of this session whose end was not seen. None if
        there is no such fault, or if the headline states it already.
        """
        worst_verdict = self.worst_earlier_verdict
        if worst_verdict is None or not worst_verdict.judgement.headline.forbids_flight:
            return self._library_warning or self._warning_of_unseen_end
        headline = self._judgement_with_worst_headline.headline
        if worst_verdict.fact in (headline, headline.figures.get("cause")):
            return None
        return self._warning_of_unrepaired_fault(
            worst_verdict.fact, worst_verdict.judgement.next_step
        )

    @property
    def _warning_of_unseen_end(self) -> Fact | None:
        """The warning that the end of an earlier flight of this session was not seen, so that it may have been a crash.

        None without such a flight, and after a later flight that was judged good: then the vehicle was sound.
        """
        for verdict in reversed(self.verdicts):
            if verdict.number == self.flight_number:
                continue
            if verdict.is_lost_in_air:
                end_unknown = Fact(SessionFact.FLIGHT_END_UNKNOWN, reason=None)
                return self._warning_of_unrepaired_fault(
                    end_unknown, Fact(NextStep.DO_AS_ADVISED, reason=end_unknown)
                )
            if verdict.judgement.headline.is_good:
                return None
        return None

    @property
    def _library_warning(self) -> Fact | None:
        """The warning that a fault may still be there which an earlier recording in the library has shown.

        None if the library knows no fault of the vehicle, or if a flight of this session has shown since whether the
        fault is still there.
        """
        fault = self.fault_in_library
        if fault is None or self._was_fault_checked_again:
            return None
        return self._warning_of_unrepaired_fault(fault, Fact(NextStep.DO_AS_ADVISED, reason=fault))

    @property
    def _was_fault_checked_again(self) -> bool:
        """Whether a flight of this session has checked the fault that the library knows of an earlier flight.

        Any flight checks a fault with which the vehicle may fly, such as a small stability margin. It does not check a
        fault that forbids to fly, nor an earlier flight whose end was not received: the warning of these stays.
        """
        fault = self.fault_in_library
        if fault is None or fault.code is not SessionFact.RECORDING_JUDGED or fault.forbids_flight:
            return False
        return self.is_latest_flight_over

    def _warning_of_unrepaired_fault(self, earlier_fault: Fact, next_step: Fact) -> Fact:
        """Returns the warning that the vehicle may still have a fault of an earlier flight.

        Args:
            earlier_fault: the fault that was found in the earlier flight.
            next_step: what to do about the fault, such as to check a motor.
        """
        return Fact(
            SessionFact.UNREPAIRED_FAULT,
            reason=earlier_fault,
            next_step=next_step,
            is_in_flight=self.is_in_flight,
        )

    @property
    def link_loss(self) -> Fact | None:
        """The fact that a vehicle in flight sends nothing, with its last known state; None while its messages come."""
        return link_loss_in_flight(self)

    @property
    def alarms(self) -> Facts:
        """What is bad now, or lasts from before: the active alarms, and a link that was lost in flight for long."""
        link_loss = self.link_loss
        if link_loss is not None and link_loss.is_bad:
            return (link_loss, *self.active_alarms)
        return self.active_alarms

    @property
    def further_alarms(self) -> Facts:
        """The active alarms that are about another fault than the headline, which states the most important one.

        Codes and subjects are compared: an alarm on the fault of the headline may have older figures.
        """
        headline_fault = cause_of_alarm(self.session_judgement.headline)
        further_alarms = []
        for alarm in self.active_alarms:
            fault = cause_of_alarm(alarm)
            is_same_fault = (
                fault.code == headline_fault.code and fault.subject == headline_fault.subject
            )
            if not is_same_fault:
                further_alarms.append(alarm)
        return tuple(further_alarms)


def _is_worse_for_take_off(earlier_fault: Fact, headline: Fact) -> bool:
    """Returns whether a fault of an earlier flight matters more before a take-off than the headline so far.

    A fault that forbids to fly comes before all others. Of two faults that are alike in this, the headline stays.

    Args:
        earlier_fault: the fault of the earlier flight.
        headline: headline of the latest flight.
    """
    if earlier_fault.forbids_flight:
        return not (headline.is_bad and headline.forbids_flight)
    return not headline.is_bad
