"""What the pilot of a vehicle in flight should do next."""

from mavdem.assessment.judgement import Judgement
from mavdem.assessment.next_step import choose_next_step
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.power import PowerLight
from mavdem.facts.session import RowsFact
from mavdem.live.session_state import STATES_OF_LEARNING, SessionState

EMPTYING_BATTERY = (ReportedEvent.BATTERY_WARNED, PowerLight.BATTERY_LOW, PowerLight.CHARGE_LOW)
"""Lights of the power that advise a landing in flight, even if they are to be watched only."""


TOO_FEW_MESSAGES = (RowsFact.LIVE_RATES_TOO_LOW, RowsFact.NO_LIVE_ATTITUDE)
"""Reasons for learning no model that another option of mavdem removes: that needs a new start, after the landing."""


def next_step_in_flight(session: SessionState, judgement: Judgement) -> Fact:
    """Returns what the pilot of a vehicle in flight without an active alarm should do.

    The first of these conditions that applies decides:

    1. The battery is getting empty: to land soon.
    2. Alarms come late: to watch the vehicle itself.
    3. The headline warns: to follow its advice after the landing, and until then :func:`_step_until_landing`.
    4. Nothing warns: :func:`_step_without_warning`.

    Args:
        session: what the session has received and found until now.
        judgement: judgement of the flight so far.
    """
    is_battery_emptying = judgement.lights[Light.POWER].code in EMPTYING_BATTERY
    if is_battery_emptying:
        return Fact(NextStep.LAND_SOON)
    if session.are_alarms_late:
        return Fact(NextStep.FLY_BY_SIGHT, delay=session.alarm_delay)
    headline = judgement.headline
    if headline.is_watch_or_bad:
        advice_after_landing = choose_next_step(headline, judgement.lights)
        step = _step_until_landing(session, headline)
        return Fact(step, reason=advice_after_landing, awaits_motors=session.lacks_motor_reference)
    return _step_without_warning(session, judgement.next_step)


def _step_without_warning(session: SessionState, step_to_model: Fact) -> Fact:
    """Returns what the pilot of a vehicle in flight should do as long as nothing warns.

    The first of these conditions that applies decides:

    1. The vehicle lands by itself: to let it land.
    2. Whether it oscillates, or a motor loses thrust, is not watched yet: to hover until then.
    3. A model was judged, or there is none for a reason without a remedy: to fly on.
    4. Too few messages come: to fly on, and to start mavdem again after the landing, with a request for more.
    5. Nothing measures some of what is watched: to fly on. This comes before what a model needs.
    6. Otherwise: what has to happen before a model can be learned.

    A step to fly on names what nothing measures, so that the pilot flies on only if that can be done without it.

    Args:
        session: what the session has received and found until now.
        step_to_model: what has to happen before a model can be learned.
    """
    if session.lands_by_itself:
        return Fact(NextStep.LET_LAND, reason=None)
    if session.should_hover_first:
        return Fact(NextStep.HOVER_FIRST, reason=None, awaits_motors=session.lacks_motor_reference)
    unmeasured = session.unmeasured_quantities
    reason = session.reason_without_model
    needs_nothing = session.model_judgement is not None or not reason.remedy
    if needs_nothing:
        return Fact(NextStep.FLY_ON, reason=None, unmeasured=unmeasured)
    if reason.code in TOO_FEW_MESSAGES:
        return Fact(NextStep.FLY_ON, reason=step_to_model, unmeasured=unmeasured)
    if unmeasured:
        return Fact(NextStep.FLY_ON, reason=None, unmeasured=unmeasured)
    return step_to_model


def _step_until_landing(session: SessionState, warning: Fact) -> NextStep:
    """Returns whether a pilot should land soon, hover or fly on with a fault that is repaired after the landing.

    Args:
        session: what the session has received and found until now.
        warning: the fault, whose level is watch or bad.
    """
    if session.lands_by_itself:
        return NextStep.LET_LAND
    has_torque_changed = warning.code is MotorWatchFact.STEADY_TORQUE_CHANGED
    # A motor that probably lost thrust may lose more of it.
    is_motor_suspected = has_torque_changed and "suspect" in warning.figures
    if warning.is_bad or is_motor_suspected:
        return NextStep.LAND_SOON
    if session.should_hover_first:
        return NextStep.HOVER_FIRST
    return NextStep.FLY_ON


def landing_step(session: SessionState, step_on_ground: Fact) -> Fact:
    """Returns the next step after a session that ended in flight: to land, and what to do after the landing.

    Args:
        session: what the session has received and found until now.
        step_on_ground: what to do after the landing, such as a repair.
    """
    landing = NextStep.LET_LAND if session.lands_by_itself else NextStep.LAND_BY_SIGHT
    reason = step_on_ground.figures.get("reason")
    is_step_of_learning = isinstance(reason, Fact) and reason.code in STATES_OF_LEARNING
    # What would have made the model better is out of date: nothing more is learned.
    return Fact(landing, reason=None if is_step_of_learning else step_on_ground)
