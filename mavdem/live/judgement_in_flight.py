"""The judgement of a flight that goes on: what cannot wait until the landing."""

from dataclasses import replace

from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.assessment import Headline as HeadlineCode
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.session import MissingMessages
from mavdem.live.link_loss import lights_during_silence
from mavdem.live.next_step_in_flight import next_step_in_flight
from mavdem.live.session_state import HEADLINES_WITHOUT_ALARM, SessionState
from mavdem.live.silent_vehicle import judgement_of_silent_vehicle
from mavdem.live.urgent_faults import alarm_or_headline, is_urgent


def judgement_in_flight(session: SessionState, judgement: Judgement) -> Judgement:
    """Returns the judgement of a flight that goes on, with headline and next step for the pilot in the air.

    The headline, the sentence that matters most, is the first of these that applies:

    1. No messages come, so that nothing below is known to be true any more (:func:`judgement_of_silent_vehicle`).
    2. A fault for which the pilot should land now. It counts even if this computer notices it late.
    3. This computer analyses messages, or did so some seconds ago, so late that the absence of an alarm means
       nothing.
    4. The headline so far, with what is not known of the flight.

    Without messages or with late ones it is not known how the vehicle flies now. So none of the lights (judgements
    of motors, power and other parts of the vehicle) is good then.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight so far, with the next step after its landing.
    """
    if session.no_model_reason is not None and not session.is_vehicle_received:
        return judgement_of_silent_vehicle(session, judgement, session.no_model_reason)
    lights = judgement.lights
    if session.are_alarms_late:
        lights = lights_during_silence(lights, session.alarm_delay, MissingMessages.MESSAGES)
    headline = alarm_or_headline(session, judgement.headline)
    if is_urgent(session, headline):
        next_step = Fact(NextStep.LAND_NOW, reason=headline, is_landing=session.is_landing)
        return replace(judgement, headline=headline, next_step=next_step, lights=lights)
    if session.are_alarms_late:
        headline = session.warning_of_delay
    else:
        headline = _headline_with_unknowns(session, headline, lights)
    judgement_in_flight = replace(judgement, headline=headline, lights=lights)
    next_step = next_step_in_flight(session, judgement_in_flight)
    return replace(judgement_in_flight, next_step=next_step)


def _headline_with_unknowns(session: SessionState, headline: Fact, lights: NamedFacts) -> Fact:
    """Adds to a headline such as "Nothing wrong" for how long no messages came, and which parts were not judged.

    Without them the headline would say too much.

    Args:
        session: what the session has received and found until now.
        headline: the fact that matters most. One that states a fault is returned as it is.
        lights: the judgement of each part of the vehicle, by the name of the part.
    """
    if session.link_outage is not None and headline.code in HEADLINES_WITHOUT_ALARM:
        # Meanwhile the pilot flew without alarms, and what would have been one is still not known.
        headline = headline.replace(outage=session.link_outage)
    if headline.code is not HeadlineCode.NOTHING_WRONG:
        return headline
    # The flight is called sound only once all parts of the vehicle are judged, which the wind is none of.
    unjudged_parts = list(headline.figures["missing"])
    if not unjudged_parts:
        return headline.replace(is_in_flight=True)
    if lights[Light.WIND].level is Level.UNKNOWN:
        unjudged_parts.append(str(Light.WIND))
    return headline.replace(Level.UNKNOWN, is_in_flight=True, missing=unjudged_parts)
