"""The status light that shows an event, if the event is the headline of a judgement."""

from mavdem.assessment.limits import worst_fact
from mavdem.facts import Code, Fact, NamedFacts
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light

EVENTS_BY_LIGHT: dict[Light, tuple[Code, ...]] = {
    Light.MOTORS: (
        MotionEvent.OUTPUT_FROZE,
        MotionEvent.MOTOR_OFF,
        MotionEvent.MOTOR_STOOD_STILL,
        MotionEvent.MOTORS_RAN_ON,
        ReportedEvent.THRUST_LOST,
        ReportedEvent.MOTOR_FAILED,
        ReportedEvent.MOTORS_STOPPED,
    ),
    Light.TRACKING: (
        *Ending,
        MotionEvent.HIT,
        MotionEvent.TOPPLED,
        MotionEvent.TIPPED,
        MotionEvent.ATTITUDE_LOST,
        MotionEvent.ATTITUDE_SWUNG,
        MotionEvent.SPUN,
        MotionEvent.FELL,
        ReportedEvent.ATTITUDE_FAILED,
        ReportedEvent.CRASH_DETECTED,
        ReportedEvent.FLIGHT_TERMINATED,
        ReportedEvent.PARACHUTE_RELEASED,
        ReportedEvent.FAILSAFE,
    ),
    Light.POWER: (
        ReportedEvent.RESTARTED,
        ReportedEvent.RESTARTED_IN_FLIGHT,
        ReportedEvent.BATTERY_ALARMED,
        ReportedEvent.BATTERY_SPENT,
        ReportedEvent.BOARD_VOLTAGE_LOW,
    ),
    Light.ESTIMATOR: (
        MotionEvent.ATTITUDE_INVALID,
        MotionEvent.HEIGHT_DIVERGED,
        MotionEvent.POSITION_LOST,
        ReportedEvent.ALTITUDE_FAILED,
        ReportedEvent.ESTIMATOR_DIVERGED,
        ReportedEvent.GPS_LOST,
    ),
    Light.WIND: (MotionEvent.CARRIED_AWAY,),
}
"""The events in the headline that each light shows, unless it is as bad by itself.

Tracking is the light of vehicles that did not do as they were commanded, for any reason."""

LIGHT_OF_EVENT: dict[Code, Light] = {
    code: light for light, codes in EVENTS_BY_LIGHT.items() for code in codes
}
"""The light of each event of ``EVENTS_BY_LIGHT``."""


def lights_with_event(lights: NamedFacts, headline: Fact) -> dict[str, Fact]:
    """Shows an event that is the headline in the status light of its subject too, so that they do not contradict.

    Status lights judge a flight until it was lost. So the light of tracking may be good although the headline is that
    control was lost; then the light shows the loss instead.

    Args:
        lights: the facts (coded findings) of the eight lights, by name.
        headline: fact that the first sentence of a result states: an event or a status light.

    Returns:
        The facts of the lights. Only the light to which the event belongs may differ: it shows the worse one of its own
        fact and the event.
    """
    name = light_of_event(headline)
    lights_to_show = dict(lights)
    if name is not None and headline.is_watch_or_bad:
        lights_to_show[name] = worst_fact([lights[name], headline])
    return lights_to_show


def light_of_event(event: Fact) -> Light | None:
    """Returns the light that shows an event in the headline; None for one of no light."""
    if event.figures.get("watchdog"):
        # A watchdog restarts a program that hangs, whatever its supply.
        return Light.TRACKING
    return LIGHT_OF_EVENT.get(event.code)
