"""Advice to request a message that was requested already and does not come: what takes its place."""

from collections.abc import Mapping
from dataclasses import replace

from mavdem.assessment.judgement import Judgement
from mavdem.assessment.next_step import choose_next_step
from mavdem.facts import Code, Fact
from mavdem.facts.margins import TrackingLight
from mavdem.facts.vibration import VibrationLight
from mavdem.live.session_state import SessionState

REQUESTED_MESSAGES: Mapping[Code, str] = {
    VibrationLight.VIBRATION_UNKNOWN: "VIBRATION",
    TrackingLight.TRACKING_UNKNOWN: "ATTITUDE_TARGET",
}
"""The message that an unknown light advises to request, by the code of the light."""


def without_unanswered_requests(session: SessionState, judgement: Judgement) -> Judgement:
    """Replaces the advice to request a message that was requested already and does not come.

    For example, without the message VIBRATION the vibration is unknown, and its status light advises to request
    that message. If the autopilot does not answer the request, the light has to advise something else, and so has
    the next step where it repeats the advice of the light.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight so far: status lights (one for each part of the vehicle) and next step.

    Returns:
        The judgement with such lights and such a next step replaced; all others are as before.
    """
    lights = dict(judgement.lights)
    for part, light in lights.items():
        if _advises_unanswered_request(session, light):
            # The sentence of a light with this figure is that the message was requested in vain.
            lights[part] = light.replace(is_asked=True)
    if lights == judgement.lights:
        return judgement
    next_step = judgement.next_step
    repeated_light = next_step.figures.get("reason")
    if isinstance(repeated_light, Fact) and _advises_unanswered_request(session, repeated_light):
        # No step is offered that improves the model, which matters less than a part that is not judged.
        next_step = choose_next_step(judgement.headline, lights)
    return replace(judgement, next_step=next_step, lights=lights)


def _advises_unanswered_request(session: SessionState, fact: Fact) -> bool:
    """Returns whether a fact (coded finding) advises to request a message that was already requested in vain.

    For example, the fact that the vibration is unknown advises to request VIBRATION. This is no use if the session
    has requested it, and it still does not come.

    Args:
        session: what the session has received and found until now.
        fact: any fact, also one without such advice.
    """
    message = REQUESTED_MESSAGES.get(fact.code)
    return message in session.absent_messages


def verdict_after_requests(recording_verdict: Fact, absent_messages: frozenset[str]) -> Fact:
    """Replaces the advice of a recording's verdict to request a message that was requested and did not come.

    A recording does not show which messages were requested. The advice becomes that of the light of a session: to look
    into the autopilot's own log.

    Args:
        recording_verdict: what the recording of a flight shows; its figure ``next_step`` is the advice.
        absent_messages: names of the messages that were requested in vain, such as "VIBRATION".

    Returns:
        The verdict with the other advice; unchanged if it advises something else.
    """
    for code, message in REQUESTED_MESSAGES.items():
        # The library stores sentences, and no codes: advice to request this message is recognised by its text.
        not_received = Fact(code, recorder="", asked=False, axis="")
        if message in absent_messages and recording_verdict.remedy == not_received.remedy:
            return recording_verdict.replace(next_step=not_received.replace(is_asked=True).remedy)
    return recording_verdict
