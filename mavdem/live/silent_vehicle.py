"""The judgement of a vehicle in flight that sends nothing: what is known of it, and why it may be silent."""

from dataclasses import replace

from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.session import MissingMessages
from mavdem.live.event_cause import cause_of_alarm
from mavdem.live.headline_from_lights import judgement_from_headline
from mavdem.live.link_loss import lights_during_silence, link_loss_fact
from mavdem.live.model_and_checks import judgement_by_model_and_checks
from mavdem.live.session_state import SILENT_LINK, SessionState, states_missing_message
from mavdem.live.urgent_faults import alarm_or_headline, is_urgent


def link_loss_in_flight(session: SessionState) -> Fact | None:
    """Returns the fact that a vehicle in flight sends nothing, with its last known state; None while its messages come.

    None also if the vehicle is known to be lost, since it has met the ground or is about to.

    Args:
        session: what the session has received and found until now.
    """
    if session.is_over and session.is_late:
        # The vehicle may have landed in the messages that were not analysed.
        return None
    # Without messages no model can be learned, so that the silence is why there is none.
    silence = session.no_model_reason
    if silence is None or silence.code not in SILENT_LINK:
        # Messages come; another reason may prevent learning.
        return None
    if not session.is_flying or session.loss is not None:
        return None
    age = session.silence_seconds(silence)
    return link_loss_fact(
        silence,
        age=age,
        reception=session.last_reception,
        displacement=session.displacement_from_takeoff,
        voltage=None if session.state is None else session.state.voltage,
        last_position=session.last_position,
        cause=_likely_cause_of_silence(session),
        unread_seconds=_unread_seconds(session, age),
        is_over=session.is_over,
    )


def _unread_seconds(session: SessionState, silence_seconds: float | None) -> float | None:
    """Returns how many seconds of messages came before a silence and still wait for their analysis.

    For example, the oldest message that waits came 12 s ago, and the latest message 5 s ago: 7 s of messages wait.

    Args:
        session: what the session has received and found until now.
        silence_seconds: time since the latest message, s; None if that is not known, which counts as 0.

    Returns:
        The duration, s. None if no message from before the silence waits, or if the oldest one has waited for less
        than ``MAX_ALARM_DELAY``.
    """
    if not session.is_late:
        return None
    age_of_oldest_message = session.analysis_delay
    age_of_latest_message = silence_seconds or 0.0
    unread_seconds = age_of_oldest_message - age_of_latest_message
    return unread_seconds if unread_seconds > 0.0 else None


def _likely_cause_of_silence(session: SessionState) -> Fact | None:
    """Returns the fault by which the vehicle may have stopped sending, such as an empty battery; None without one.

    Two kinds of faults explain a silence better than a vehicle out of radio range: first one for which a pilot must
    land at once, such as a loss of control, and then one of the power supply.

    Args:
        session: what the session has received and found until now.
    """
    judgement = judgement_by_model_and_checks(session)
    worst_fault = alarm_or_headline(session, judgement.headline)
    if is_urgent(session, worst_fault):
        return worst_fault
    power_light = judgement.lights[Light.POWER]
    if power_light.is_watch_or_bad:
        return power_light
    return None


def judgement_of_silent_vehicle(
    session: SessionState, judgement: Judgement, reason: Fact
) -> Judgement:
    """Returns a judgement for a vehicle in flight whose messages do not come: how it flies is not known.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight so far.
        reason: the fact that says which messages do not come.
    """
    lights = _lights_of_silent_vehicle(session, judgement.lights, reason)
    most_urgent_fact = alarm_or_headline(session, judgement.headline)
    is_landing_urgent = is_urgent(session, most_urgent_fact)
    link_loss = link_loss_in_flight(session)
    is_loss_certain = link_loss is not None and link_loss.figures["delay"] is None
    if is_landing_urgent and not is_loss_certain:
        headline = most_urgent_fact
    elif link_loss is not None:
        # This fact has an urgent alarm as its cause, and advises a landing by sight if that is certain.
        headline = link_loss
    else:
        headline = reason
    step = NextStep.LAND_NOW if is_landing_urgent else NextStep.DO_AS_ADVISED
    next_step = Fact(step, reason=headline)
    return replace(judgement, headline=headline, next_step=next_step, lights=lights)


def _lights_of_silent_vehicle(
    session: SessionState, present_lights: NamedFacts, reason: Fact
) -> dict[str, Fact]:
    """Returns the lights of a vehicle in flight that sends nothing: good ones become unknown, with what they were.

    Args:
        session: what the session has received and found until now.
        present_lights: the judgement of each part of the vehicle, by the name of the part.
        reason: the fact that says whether all messages are missing, or attitude and motor outputs only.
    """
    missing = MissingMessages.MESSAGES
    if reason.subject == MissingMessages.MOTION:
        missing = MissingMessages.MOTION
    silence_seconds = session.silence_seconds(reason)
    if silence_seconds is not None:
        # If this computer is late, what was analysed last is older than the last message.
        silence_seconds = max(silence_seconds, session.analysis_delay)
    lights_at_last_message = _lights_at_last_message(session, present_lights)
    return lights_during_silence(lights_at_last_message, silence_seconds, missing)


def _lights_at_last_message(session: SessionState, present_lights: NamedFacts) -> dict[str, Fact]:
    """Returns how the parts of a vehicle that sends nothing any more were judged when its last message came.

    During the silence, the judgement of many parts only says that no messages come. If such a part was good at the
    last message, that judgement is returned instead; and so is a judgement that the message that shows the part has
    never come, since the silence is not why it is unknown. A part that is judged as bad or to be watched stays so.

    Args:
        session: what the session has received and found until now.
        present_lights: the judgement of each part of the vehicle during the silence, by the name of the part.
    """
    lights = dict(present_lights)
    if session.status_before_silence is None:
        return lights
    lights_before_silence = judgement_by_model_and_checks(session.status_before_silence).lights
    for part, light_before_silence in lights_before_silence.items():
        lacks_message = _is_unknown_without_message(light_before_silence)
        is_kept = light_before_silence.is_good or lacks_message
        if is_kept and not lights[part].is_watch_or_bad:
            lights[part] = light_before_silence
    return lights


def judgement_of_lost_link(link_loss: Fact, lights: NamedFacts) -> Judgement:
    """Returns the judgement after a session whose link was lost in flight.

    Its next step is to search for the vehicle, and to repair the fault that was found before the loss, if any.

    Args:
        link_loss: the fact that the link was lost, with the fault that was found before as its ``cause``; None there
            for none.
        lights: the fact on each part of the vehicle, by the name of the part.
    """
    judgement = judgement_from_headline(link_loss, lights)
    # It is the loss of the link itself if no fault was found before.
    fault_before = cause_of_alarm(link_loss)
    search = judgement.next_step
    is_repair_advised = fault_before in search.figures["also"]
    if fault_before == link_loss or is_repair_advised:
        return judgement
    search_and_repair = search.replace(reason=link_loss.replace(repair=fault_before))
    return replace(judgement, next_step=search_and_repair)


def _is_unknown_without_message(light: Fact) -> bool:
    """Returns whether a part of the vehicle is not judged because the message that shows it does not come.

    Args:
        light: the judgement of the part, such as the estimator.
    """
    reason = light.figures.get("reason")
    is_not_judged = light.code is Unjudged.NOT_JUDGED
    return is_not_judged and isinstance(reason, Fact) and states_missing_message(reason)
