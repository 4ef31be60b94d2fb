"""Why a part of the vehicle is not judged, as its light says it after the landing.

A light judges one part of the vehicle, such as its motors: a fact with a level.
"""

from mavdem.facts import Fact, NamedFacts
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.loops import LoopFact
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live.session_state import SessionState, are_most_rows_postponed
from mavdem.loops.identification import MIN_IDENTIFIED_SECONDS


def lights_after_landing(session: SessionState, lights: NamedFacts) -> dict[str, Fact]:
    """Returns the lights after a landing: an unknown one says why the part could not be judged in the flight.

    A light is the judgement of one part of the vehicle, and has a reason if its level is unknown.

    Args:
        session: what the session has received and found until now.
        lights: the judgement of each part of the vehicle, by the name of the part.

    Returns:
        The lights by name; unchanged in flight, and before the first flight.
    """
    lights_of_flight = dict(lights)
    if not session.is_after_flight:
        return lights_of_flight
    for name, light in lights.items():
        reason = light.figures.get("reason")
        if isinstance(reason, Fact):
            lights_of_flight[name] = _light_after_landing(session, name, light, reason)
    return lights_of_flight


def _light_after_landing(session: SessionState, name: str, light: Fact, reason: Fact) -> Fact:
    """Returns a light after a landing, with a reason that was true in the flight, such as that it was too short.

    That the vehicle is on the ground now, or that its flight is over, does not say why a part was not judged.

    Args:
        session: what the session has received and found until now.
        name: name of the part of the vehicle that the light judges.
        light: the light now.
        reason: its reason now.
    """
    if reason.code is WatchFact.ON_GROUND_NOW:
        # Margins take long to compute, so that a slow computer may be why there are none. All other parts are
        # judged even then: without a judgement too little was received.
        is_margins = name == Light.MARGINS
        return light.replace(
            reason=reason_for_no_model(session) if is_margins else _too_little_received(session)
        )
    if reason.code is LoopFact.LOOP_TOO_SHORT:
        return light.replace(reason=_reason_for_no_margins(session, reason))
    if reason.code is SessionFact.FLIGHT_OVER and light.code in Unjudged:
        return Fact(Unjudged.NOT_JUDGED, reason=None)
    return light


def reason_for_no_model(session: SessionState) -> Fact:
    """Returns why a flight that is over gave neither a model nor margins, as a fact (a coded finding).

    This computer was too slow if it had no time for most samples, or if the flight was long enough for margins;
    otherwise too little was received.

    Args:
        session: what the session has received and found until now.
    """
    has_postponed_most = are_most_rows_postponed(session.postponed_rows, session.learned_rows)
    if has_postponed_most or session.was_long_enough_for_margins:
        return _too_slow_to_judge(session)
    return _too_little_received(session)


def _reason_for_no_margins(session: SessionState, reason: Fact) -> Fact:
    """Returns why the latest review of a flight that is over found it too short for margins.

    Args:
        session: what the session has received and found until now.
        reason: the reason of the review. Its figure ``settled`` is how long the settled flight was until then, s;
            None if it is not known.

    Returns:
        That this computer was too slow, if the flight became long enough after that review, and no other one came.
        Otherwise the reason without the figures that matter only while the flight goes on.
    """
    reviewed_seconds = reason.figures.get("settled") or 0.0
    was_reviewed_too_early = reviewed_seconds < MIN_IDENTIFIED_SECONDS
    if was_reviewed_too_early and session.was_long_enough_for_margins:
        return _too_slow_to_judge(session)
    return reason.replace(clock=None, settled=None)


def _too_slow_to_judge(session: SessionState) -> Fact:
    """Returns the fact that this computer was too slow to judge a flight in time.

    Args:
        session: what the session has received and found until now.
    """
    return Fact(SessionFact.TOO_SLOW_TO_JUDGE, is_recorded=session.is_recorded)


def _too_little_received(session: SessionState) -> Fact:
    """Returns the fact that a flight was too short to be judged or, if it gave no samples, that too few messages came.

    Args:
        session: what the session has received and found until now.
    """
    has_rows = session.learned_rows + session.unlearned_rows > 0
    return Fact(SessionFact.TOO_LITTLE_RECEIVED, has_rows=has_rows)
