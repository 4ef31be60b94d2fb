"""How the judgement of a recording, made after the landing, takes the place of that of the session."""

from collections.abc import Mapping
from dataclasses import replace

from mavdem.assessment.headline import headline_by_lights
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.margins import MarginsLight
from mavdem.facts.session import RecordingState, SessionFact
from mavdem.live.session_state import SessionState
from mavdem.live.unanswered_requests import verdict_after_requests

PERMANENT_FAULTS = (MarginsLight.LOOP_MARGINS,)
"""Bad findings that do not arise in flight: the vehicle has had them since its take-off, and need not land now."""


LOG_KEEPING_STEPS = (NextStep.KEEP_LOG, NextStep.KEEP_MODEL)
"""Next steps after a flight without fault that need a log of it."""


def judgement_with_recording(session: SessionState, judgement: Judgement) -> Judgement:
    """Makes the verdict of the recording the headline (the fact that matters most) after a flight.

    Before the recording is judged, a bad fault that was found in flight stays the headline. Otherwise the headline
    says that the recording, which may show more, is still to be judged, and names what is to be watched so far.
    Where nothing was recorded, the next step is not to keep a log.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight by this session.
    """
    if not session.is_recorded and judgement.next_step.code in LOG_KEEPING_STEPS:
        judgement = replace(judgement, next_step=Fact(NextStep.RECORD_NEXT_FLIGHT))
    verdict = session.recording_verdict
    if verdict is None or session.flight_number == 0 or session.is_recording_judged:
        return judgement
    if verdict.code is SessionFact.RECORDING_NOT_JUDGED:
        return _judgement_before_recording(session, judgement, verdict)
    lights = lights_with_recording(session, judgement.lights)
    verdict = _verdict_by_shown_lights(verdict, lights)
    verdict = verdict_after_requests(verdict, session.absent_messages)
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=verdict)
    return replace(judgement, headline=verdict, next_step=next_step, lights=lights)


def _judgement_before_recording(
    session: SessionState, judgement: Judgement, not_judged: Fact
) -> Judgement:
    """Returns what to show of a flight that has ended until its recording has been judged.

    The headline "nothing wrong" becomes "not judged yet", since the recording may show faults that the session did
    not. A fault becomes "not judged yet; so far: …", unless :func:`_is_final_before_recording`.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight by this session.
        not_judged: the fact that the recording is not judged, with the reason as its ``kind``.
    """
    headline_so_far = judgement.headline
    if _is_final_before_recording(headline_so_far, not_judged):
        return judgement
    if session.is_silent_after_flight:
        not_judged = not_judged.replace(is_switched_off=True)
    headline = not_judged
    if headline_so_far.is_watch_or_bad:
        headline = not_judged.replace(headline_so_far.level, so_far=headline_so_far)
    lights = dict(judgement.lights)
    if _will_be_judged(not_judged) and not lights[Light.MARGINS].is_good:
        # This light would advise to change gains. The recording, of the whole flight, has better margins to do so.
        lights[Light.MARGINS] = Fact(Unjudged.NOT_JUDGED, reason=not_judged)
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=not_judged)
    return replace(judgement, headline=headline, next_step=next_step, lights=lights)


def _is_final_before_recording(headline: Fact, not_judged: Fact) -> bool:
    """Returns whether a headline states a fault that no judgement of the recording will change.

    That is a bad fault that began in flight, such as a crash. Small stability margins are none, since the recording
    shows margins better than the session. If the recording could not be read, any fault is final.

    Args:
        headline: headline of the flight by this session.
        not_judged: the fact that the recording is not judged, with the reason as its ``kind``.
    """
    if not _will_be_judged(not_judged):
        return headline.is_watch_or_bad
    return headline.is_bad and headline.code not in PERMANENT_FAULTS


def _will_be_judged(not_judged: Fact) -> bool:
    """Returns whether a recording that is not judged yet will be; it will not if it could not be read.

    Args:
        not_judged: the fact that the recording is not judged, with the reason as its ``kind``.
    """
    return not_judged.figures["kind"] is not RecordingState.FAILED


def lights_with_recording(session: SessionState, lights: NamedFacts) -> NamedFacts:
    """Replaces the lights of a flight that is over by those of its recording, once that is judged as a log is.

    Args:
        session: what the session has received and found until now.
        lights: the judgement of each part of the vehicle by this session, by the name of the part.

    Returns:
        The lights of the recording, and bad ones of the session where that leaves a part unknown; before the
        recording is judged, the lights of the session.
    """
    recording_verdict = session.recording_verdict
    if recording_verdict is None or recording_verdict.code is not SessionFact.RECORDING_JUDGED:
        return lights
    return _lights_of_recording(lights, recording_verdict)


def _lights_of_recording(lights_in_flight: NamedFacts, recording_verdict: Fact) -> dict[str, Fact]:
    """Returns the final judgement of each part of the vehicle, after the recording of its flight was judged.

    The judgement by the recording takes the place of that in flight, even one of the same level, so that all figures on
    the page are those of the recording. For what it leaves unknown see :func:`light_after_recording`.

    Args:
        lights_in_flight: the judgement of each part by the session, by the name of the part.
        recording_verdict: the library's judgement of the recording.
    """
    lights = {}
    for part, light_in_flight in lights_in_flight.items():
        recorded_light = _light_in_verdict(part, recording_verdict)
        if recorded_light is None:
            lights[part] = light_in_flight
            continue
        has_same_level = recorded_light.level == light_in_flight.level
        if has_same_level and not recorded_light.figures["statement"]:
            # The light in flight has figures, and so says more than the same level without a sentence.
            lights[part] = light_in_flight
        else:
            lights[part] = light_after_recording(recorded_light, light_in_flight)
    return lights


def light_after_recording(recorded_light: Fact, light_in_flight: Fact) -> Fact:
    """Returns the final judgement of one part of the vehicle, such as the motors, after the recording was judged.

    Args:
        recorded_light: the judgement of this part by the recording, which has all that was received.
        light_in_flight: the judgement of this part by the checks in flight.

    Returns:
        The judgement by the recording. If that is unknown, a bad judgement in flight stays, so that its fault is not
        forgotten. A good one becomes ``GOOD_IN_FLIGHT_ALONE``: an unknown light that states what was good in flight,
        and what the recording lacks.
    """
    if recorded_light.level is not Level.UNKNOWN:
        return recorded_light
    if light_in_flight.is_bad:
        return light_in_flight
    if light_in_flight.is_good:
        return Fact(
            SessionFact.GOOD_IN_FLIGHT_ALONE, in_flight=light_in_flight, reason=recorded_light
        )
    return recorded_light


def _light_in_verdict(part: str, recording_verdict: Fact) -> Fact | None:
    """Returns how the verdict on a recording judges one part of the vehicle, such as its motors; None if it does not.

    Args:
        part: name of the part.
        recording_verdict: the library's judgement of the recording. By the name of the part, its figures have the
            level, empty if that is not judged; a sentence; and a short figure such as "14.9 V". Libraries of earlier
            versions have neither sentence nor figure.
    """
    verdict_figures = recording_verdict.figures
    level = verdict_figures["levels"][part]
    if not level:
        return None
    return Fact(
        SessionFact.LIGHT_OF_RECORDING,
        Level(level),
        statement=verdict_figures["light_sentences"].get(part, ""),
        figure=verdict_figures.get("light_figures", {}).get(part, ""),
    )


def _verdict_by_shown_lights(recording_verdict: Fact, lights: NamedFacts) -> Fact:
    """Makes the verdict on a recording agree with the lights (judgements of motors, power, …) shown beside it.

    The recording may show no fault and leave a part unknown that was bad in flight, and whose light stays bad. A
    verdict without a fault would contradict that light.

    Args:
        recording_verdict: the library's judgement of the recording, with the level of each part as ``levels``.
        lights: the lights by the recording, or a bad one in flight where the recording leaves a part unknown.

    Returns:
        The verdict, which states the worst of these lights as its figure ``shown``, and has its level. It is unchanged
        if it states a fault, or if each light has the level that the recording gives it.
    """
    levels: Mapping[str, str] = recording_verdict.figures["levels"]
    vehicle_lights = {part: lights[part] for part in VEHICLE_LIGHTS}
    has_other_level = any(
        light.level != (levels[part] or Level.UNKNOWN) for part, light in vehicle_lights.items()
    )
    if recording_verdict.is_watch_or_bad or not has_other_level:
        return recording_verdict
    bad_lights = [light for light in vehicle_lights.values() if light.is_bad]
    headline = bad_lights[0] if bad_lights else headline_by_lights(lights)
    return recording_verdict.replace(headline.level, shown=headline)
