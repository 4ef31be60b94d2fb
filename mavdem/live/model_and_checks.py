"""The judgement of a flight by the learned model, and by the checks that need no model, such as for alarms.

A judgement has a headline, the fact that matters most; a next step; and a light for each part of the vehicle.
"""

from collections import defaultdict
from dataclasses import replace

from mavdem.assessment.headline import headline_by_lights
from mavdem.assessment.judgement import Judgement, unjudged
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.assessment.limits import worst_fact
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.assessment import Headline as HeadlineCode
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import SessionFact
from mavdem.live.headline_from_lights import (
    judgement_from_headline,
    judgement_with_bad_lights,
    judgement_with_summary_of_lights,
)
from mavdem.live.lights_after_landing import lights_after_landing
from mavdem.live.live_lights import lights_before_model
from mavdem.live.recording_judgement import light_after_recording
from mavdem.live.session_state import SessionState
from mavdem.live.unanswered_requests import without_unanswered_requests
from mavdem.live.wind import WindEstimate
from mavdem.motors.motor_changes import torque_changes


def judgement_by_model_and_checks(session: SessionState) -> Judgement:
    """Returns the judgement of the flight by the learned model and by the checks that need no model.

    Each light (the judgement of one part of the vehicle) is the worse of both. The headline, the sentence that
    matters most, is made to agree with the lights:

    - If a light is bad, the headline is a fault.
    - If there is no model yet, the headline sums up the lights.
    - If the model shows no fault, but some light is not the model's, the headline also sums up the lights.
    - Otherwise the headline of the model stays.

    Args:
        session: what the session has received and found until now.
    """
    by_model = _judgement_by_model(session)
    lights = _combined_lights(session, by_model.lights, lights_by_checks(session))
    lights = lights_after_landing(session, lights)
    lights = _lights_during_oscillation(session, lights)
    judgement = without_unanswered_requests(session, replace(by_model, lights=lights))
    if any(light.is_bad for light in judgement.lights.values()):
        return judgement_with_bad_lights(judgement)
    if _is_judged_without_model(session):
        return _judgement_before_model(session, judgement)
    # Headlines with codes of this enumeration are not about a fault, so that a worse light may contradict them.
    is_without_fault = isinstance(judgement.headline.code, HeadlineCode)
    if is_without_fault and judgement.lights != by_model.lights:
        return judgement_with_summary_of_lights(judgement)
    return judgement


def _judgement_by_model(session: SessionState) -> Judgement:
    """Returns the judgement of the flight by the learned model: a headline, a next step, and a light for each part.

    A light judges one part of the vehicle, such as its motors. Before a model is learned, the headline names a
    motor that lost thrust, or else says why there is no model.

    Args:
        session: what the session has received and found until now.
    """
    if session.model_judgement is not None:
        lights = _lights_with_reasons(session, session.model_judgement.lights)
        return replace(session.model_judgement, lights=lights)
    headline = session.weak_motors[0] if session.weak_motors else session.reason_without_model
    return replace(unjudged(headline), lights=_preliminary_lights(session))


def _lights_with_reasons(session: SessionState, lights_by_model: NamedFacts) -> dict[str, Fact]:
    """Returns the lights of a model, of which those on tracking and estimator say why they are not judged yet.

    No model shows how well the vehicle follows its setpoints, nor how good the autopilot's estimator is. By the
    model alone, these two lights only say that they are judged after the flight.

    Args:
        session: what the session has received and found until now.
        lights_by_model: the judgement of each part of the vehicle by the model, by the name of the part.
    """
    lights = dict(lights_by_model)
    for part in (Light.TRACKING, Light.ESTIMATOR):
        if lights[part].code is Unjudged.JUDGED_LATER:
            reason = _preliminary_lights(session)[part].figures["reason"]
            lights[part] = lights[part].replace(reason=reason)
    return lights


def _preliminary_lights(session: SessionState) -> dict[str, Fact]:
    """Returns the lights before the first model is judged, by the name of the part of the vehicle, such as "motors".

    A light is the judgement of one part, a fact with a level. If the part is watched for faults, its light says
    that no alarm was raised so far. Otherwise its level is unknown, and the light has the reason, such as that a
    message does not come.

    Args:
        session: what the session has received and found until now.
    """
    return lights_before_model(
        no_model_reason=session.reason_without_model,
        rates=session.rates,
        watch_facts=_watch_states_of_flight(session),
        no_wind_reason=session.no_wind_reason,
        provisional_margins=session.provisional_margins,
    )


def _watch_states_of_flight(session: SessionState) -> dict[str, Fact]:
    """Returns for each watched quantity, such as vibration: since when it is watched for faults, or why it is not.

    If the vehicle has been silent since its flight, these are the states before the silence. The silence itself is
    no reason why a part of the vehicle could not be judged in the flight.

    Args:
        session: what the session has received and found until now.
    """
    if not session.is_silent_after_flight:
        return session.watch_states
    if session.status_before_silence is None:
        return {}
    return session.status_before_silence.watch_states


def _judgement_before_model(session: SessionState, judgement: Judgement) -> Judgement:
    """Returns the judgement before a model is learned: its headline sums up the checks that need no model.

    The next step depends on whether messages come:

    - While they do, a model can still be learned. If nothing warns, the next step stays that towards a model.
    - Without messages no model can be learned. The next step is what the headline advises.

    Args:
        session: what the session has received and found until now.
        judgement: the lights (judgements of motors, power and other parts of the vehicle), and a next step that
            says what has to happen before a model can be learned, such as to take off.
    """
    if session.is_vehicle_received:
        return judgement_with_summary_of_lights(judgement)
    headline = headline_by_lights(judgement.lights)
    return judgement_from_headline(headline, judgement.lights)


def _is_judged_without_model(session: SessionState) -> bool:
    """Returns whether only checks that need no learned model judge the vehicle, such as that of the battery.

    False once a model is learned, and if the checks judge no part of the vehicle. It is also false while a vehicle
    in flight sends no messages, since how it flies is not known then. After the flight or the session the checks
    still judge what was received, and no more messages are needed.

    Args:
        session: what the session has received and found until now.
    """
    if session.model_judgement is not None:
        return False
    needs_messages = not (session.is_over or session.is_silent_after_flight)
    if needs_messages and not session.is_vehicle_received:
        return False
    return any(part in lights_by_checks(session) for part in VEHICLE_LIGHTS)


def _lights_during_oscillation(session: SessionState, lights: NamedFacts) -> dict[str, Fact]:
    """Withdraws good judgements of motors and tracking while the vehicle oscillates in flight: they become unknown.

    In an oscillation the motors go from limit to limit, and the attitude swings about its setpoint. A good
    judgement is of the time before. A judgement that warns stays.

    Args:
        session: what the session has received and found until now.
        lights: the judgement of each part of the vehicle, by the name of the part.

    Returns:
        The lights, those of motors and tracking corrected.
    """
    present_lights = dict(lights)
    oscillation_alarms = [
        alarm for alarm in session.active_alarms if alarm.code is MarginsLight.OSCILLATES
    ]
    if not session.is_flying or not oscillation_alarms:
        return present_lights
    for name in (Light.MOTORS, Light.TRACKING):
        if not present_lights[name].is_watch_or_bad:
            present_lights[name] = Fact(Unjudged.NOT_JUDGED, reason=oscillation_alarms[0])
    return present_lights


def _combined_lights(
    session: SessionState, lights_by_model: NamedFacts, lights_in_flight: NamedFacts
) -> dict[str, Fact]:
    """Merges two sets of lights, which are judgements of the parts of the vehicle, into one light for each part.

    In flight the worse light of a part counts. Once the recording of the flight is judged, ``lights_by_model`` are
    the lights of the recording. Then :func:`light_after_recording` decides, mostly for the recording.

    Args:
        session: what the session has received and found until now.
        lights_by_model: a light for each part, by the learned model or the recording; keys are names of parts.
        lights_in_flight: the lights of some parts, by the checks in flight that need no model.
    """
    combined_lights = dict(lights_by_model)
    for part, light_by_model in lights_by_model.items():
        light_in_flight = lights_in_flight.get(part)
        if light_in_flight is None:
            continue
        if _is_only_new_loss_excluded(session, light_in_flight):
            combined_light = light_by_model
        elif session.is_recording_judged:
            combined_light = light_after_recording(light_by_model, light_in_flight)
        else:
            combined_light = worst_fact([light_in_flight, light_by_model])
        combined_lights[part] = combined_light
    return combined_lights


def _is_only_new_loss_excluded(session: SessionState, light_in_flight: Fact) -> bool:
    """Returns whether the motors are only known not to have lost thrust since the watch of their balance began.

    A motor may have lost thrust before, as by a propeller that chipped in the climb. The headroom of each motor shows
    that, which is judged with the first model, and after the landing by the recording. Until then, the motors are not
    good.

    Args:
        session: what the session has received and found until now.
        light_in_flight: the light of a part by the checks in flight.
    """
    is_no_loss = light_in_flight.code is MotorWatchFact.NO_LOSS_FOUND
    if not is_no_loss or session.model_judgement is not None:
        return False
    if session.is_flying:
        is_model_awaited = session.no_model_reason is None
        return is_model_awaited
    verdict = session.recording_verdict
    is_recording_judged = verdict is not None and verdict.code is SessionFact.RECORDING_JUDGED
    return session.is_latest_flight_over and session.is_recorded and not is_recording_judged


def lights_by_checks(session: SessionState) -> dict[str, Fact]:
    """Returns the lights by the checks that need no learned model, by the part of the vehicle that each judges.

    A light is the judgement of one part: the worst fact (coded finding) about it, of equally bad ones the first. A
    part about which nothing is known has no light. The watchdog, which looks for faults twice a second, finds facts
    about all parts. There are other facts about three of them:

    - motors: losses of thrust, which come first, and lasting shifts of the trims;
    - margins: those identified in flight, until the recording is judged, which has better ones;
    - wind: the mean wind of the flight.

    Args:
        session: what the session has received and found until now.
    """
    facts_by_part: dict[str, list[Fact]] = defaultdict(list)
    facts_by_part[Light.MOTORS] += session.weak_motors
    facts_by_part[Light.MOTORS] += torque_changes(session.motor_alarms_of_flight)
    for part, worst_fact_of_watchdog in session.worst_lights.items():
        facts_by_part[part].append(worst_fact_of_watchdog)
    if session.margins is not None and not session.is_recording_judged:
        facts_by_part[Light.MARGINS].append(session.margins)
    if session.mean_wind is not None:
        facts_by_part[Light.WIND].append(_light_of_mean_wind(session, session.mean_wind))
    return {part: worst_fact(facts) for part, facts in facts_by_part.items() if facts}


def _light_of_mean_wind(session: SessionState, mean_wind: WindEstimate) -> Fact:
    """Returns the light of the wind: the fact (a coded finding) that judges the mean wind, and states one wind.

    In flight it states the present wind, as the map and the table of lights do, and later the mean.

    Args:
        session: what the session has received and found until now.
        mean_wind: mean wind of the flight so far, with the time of its last estimate.

    Returns:
        The fact. If the present wind is known, it has the figure ``present_wind``, the facts on that. If the wind
        cannot be estimated any more, it has the figures ``known_until``, the time of the last estimate, and
        ``obstacle``, the reason; its sentence then ends with "not known since …".
    """
    if session.present_wind is not None:
        return mean_wind.light.replace(present_wind=session.present_wind.facts)
    if session.no_wind_reason is None:
        return mean_wind.light
    return mean_wind.light.replace(known_until=mean_wind.time, obstacle=session.no_wind_reason)
