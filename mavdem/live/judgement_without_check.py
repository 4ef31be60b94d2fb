"""The headline of a flight in which nothing of the vehicle was checked so far."""

from dataclasses import replace

from mavdem.assessment.judgement import Judgement
from mavdem.facts import Fact
from mavdem.facts.assessment import Headline as HeadlineCode
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live.headline_from_lights import judgement_from_headline
from mavdem.live.lights_after_landing import reason_for_no_model
from mavdem.live.session_state import STATES_OF_LEARNING, SessionState


def judgement_without_check(session: SessionState, judgement: Judgement) -> Judgement:
    """Replaces the headline of a judgement that no check of the vehicle supports so far.

    In flight the new headline is that there is no alarm of what is watched; after a flight, that nothing was
    checked in it. Before the first flight, and if nothing is watched yet, the judgement stays as it is.

    Args:
        session: what the session has received and found until now.
        judgement: the judgement so far. Its headline says that nothing was checked, or what the session does, such
            as to wait for steady flight.
    """
    if session.is_in_flight:
        if not session.watched_names:
            return judgement
        no_alarm = Fact(WatchFact.NO_ALARM, names=session.watched_names)
        return replace(judgement, headline=no_alarm)
    if session.flight_number > 0:
        return _unchecked_flight_judgement(session, judgement)
    return judgement


def _unchecked_flight_judgement(session: SessionState, judgement: Judgement) -> Judgement:
    """Returns the judgement of a flight that is over, during which nothing of the vehicle could be checked.

    Its headline says so with the reason. Where the headline so far says only what the session did, such as to wait
    for steady flight, the reason is that too little was received.

    Args:
        session: what the session has received and found until now.
        judgement: the judgement so far. Its headline is either ``HeadlineCode.NOTHING_CHECKED`` with a reason, or
            one of ``STATES_OF_LEARNING``.
    """
    reason = judgement.headline
    if reason.code is HeadlineCode.NOTHING_CHECKED:
        reason = reason.figures["reason"]
    if reason.code in STATES_OF_LEARNING:
        reason = reason_for_no_model(session)
    headline = Fact(HeadlineCode.NOTHING_CHECKED, reason=reason)
    if (
        session.no_model_reason is not None
        and session.no_model_reason.code is SessionFact.NOT_FLYING
    ):
        # The session goes on with the next flight, so its next step, such as to take off, remains right.
        return replace(judgement, headline=headline)
    # Otherwise, as at the end of the session, the next step follows from the new headline.
    return judgement_from_headline(headline, judgement.lights)
