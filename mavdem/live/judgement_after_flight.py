"""The judgement of a vehicle that does not fly now, or whose session is over."""

from dataclasses import replace

from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.session import MissingMessages, RecordingState, SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live.link_loss import lights_during_silence
from mavdem.live.link_outage import judgement_with_outage
from mavdem.live.next_step_in_flight import landing_step
from mavdem.live.recording_judgement import judgement_with_recording, lights_with_recording
from mavdem.live.session_state import SessionState
from mavdem.live.silent_vehicle import judgement_of_lost_link, link_loss_in_flight
from mavdem.live.unseen_end import judgement_with_unseen_end
from mavdem.live.urgent_faults import is_urgent

AUTOMATIC_DISARM_SECONDS = 10.0
"""Time after a landing in which an autopilot disarms its vehicle, s: the default of ArduPilot's DISARM_DELAY. That of
PX4's COM_DISARM_LAND is 2 s."""


def judgement_after_flight(session: SessionState, judgement: Judgement) -> Judgement:
    """Corrects a judgement for a vehicle that does not fly now, or whose session is over.

    The headline, the fact that matters most, is the first of these that applies:

    1. The link was lost in flight.
    2. The server ended in flight, so that nobody watches the vehicle any more.
    3. It is not certain that the flight ended well, unless something was wrong in it anyway.
    4. The autopilot restarted after the last message of the flight in the air, so that nobody saw how it ended. A
       bad fault comes first.
    5. What the recording of the flight shows, or that it is not judged yet.

    Where none of these is a fault, an outage of the link in the flight is added (:func:`judgement_with_outage`).
    If the session has ended in flight, the next step begins with the landing.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the latest flight by this session; the one before any flight, too.
    """
    link_loss = link_loss_in_flight(session)
    if link_loss is not None:
        # What was found before, such as a weak motor, is the figure "cause" of this fact.
        lights_to_show = lights_with_recording(session, judgement.lights)
        return judgement_of_lost_link(link_loss, lights_to_show)
    if _is_left_in_air(session):
        return _judgement_of_vehicle_left_in_air(session, judgement)
    uncertainty = _uncertainty_after_landing(session)
    if uncertainty is not None and not judgement.headline.is_watch_or_bad:
        next_step = Fact(NextStep.DO_AS_ADVISED, reason=uncertainty)
        return replace(judgement, headline=uncertainty, next_step=next_step)
    judgement = judgement_with_recording(session, judgement)
    if _is_end_unseen(session):
        judgement = judgement_with_unseen_end(judgement)
    if session.link_outage is not None:
        judgement = judgement_with_outage(judgement, session.link_outage)
    has_ended_in_flight = session.is_in_air and session.loss is None
    if has_ended_in_flight:
        return _judgement_until_landing(session, judgement)
    return judgement


def _is_end_unseen(session: SessionState) -> bool:
    """Returns whether the autopilot restarted after the last message of the latest flight in the air, and does not fly.

    Args:
        session: what the session has received and found until now.
    """
    if session.is_flying or not session.verdicts:
        return False
    latest_verdict = session.verdicts[-1]
    return latest_verdict.number == session.flight_number and latest_verdict.is_lost_in_air


def _judgement_until_landing(session: SessionState, judgement: Judgement) -> Judgement:
    """Puts the landing before the next step of a judgement, after a session that has ended in flight.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight. Its next step, such as a repair, is for the vehicle on the ground.
    """
    step_on_ground = judgement.next_step
    if is_urgent(session, judgement.headline):
        # The end of the session has not changed how urgent the fault is.
        step = Fact(NextStep.LAND_NOW, reason=judgement.headline, next_step=step_on_ground)
    else:
        step = landing_step(session, step_on_ground)
    return replace(judgement, next_step=step)


def _is_left_in_air(session: SessionState) -> bool:
    """Returns whether the session has ended with its server while the vehicle flew, so that nobody watches it any more.

    Then the recording of the flight is judged only once the server runs again, which ``recording_verdict`` states.

    Args:
        session: what the session has received and found until now.
    """
    if not session.is_over or not session.is_in_air or session.loss is not None:
        return False
    verdict = session.recording_verdict
    if verdict is None or verdict.code is not SessionFact.RECORDING_NOT_JUDGED:
        return False
    return verdict.figures["kind"] is RecordingState.READ_AT_NEXT_START


def _judgement_of_vehicle_left_in_air(session: SessionState, judgement: Judgement) -> Judgement:
    """Returns the judgement after the server has ended in flight: how the vehicle flies is not known any more.

    So no light, which judges one part of the vehicle, stays good.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight until then. If its headline is a fault, the new headline names it as its
            cause.
    """
    cause = judgement.headline if judgement.headline.is_watch_or_bad else None
    headline = session.end_in_flight(cause)
    lights = lights_during_silence(judgement.lights, None, MissingMessages.MESSAGES)
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=headline)
    return Judgement(headline, next_step, lights)


def _uncertainty_after_landing(session: SessionState) -> Fact | None:
    """Returns what is uncertain just after a flight, so that the flight is not called sound yet; None if nothing is.

    The motors may have stopped in the air: a fall is found a moment later. While they are still armed after the
    landing, the vehicle may topple over. A vehicle that is armed anew is about to begin another flight.

    Args:
        session: what the session has received and found until now.
    """
    if not session.is_after_flight or session.is_over:
        return None
    if not session.has_landed:
        return Fact(WatchFact.MOTORS_JUST_STOPPED)
    is_armed = session.state is not None and session.state.is_armed
    if is_armed and session.is_armed_since_landing:
        return Fact(WatchFact.ARMED_AFTER_LANDING, awaits_disarming=_awaits_disarming(session))
    return None


def _awaits_disarming(session: SessionState) -> bool:
    """Returns whether the vehicle has landed so lately that its autopilot may still disarm it without the pilot.

    Args:
        session: what the session has received and found until now.
    """
    if session.landing_time is None:
        return False
    return session.boot_clock - session.landing_time < AUTOMATIC_DISARM_SECONDS
