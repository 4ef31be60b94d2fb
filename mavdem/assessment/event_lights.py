"""The status light that shows an event: of the event in the headline, and of warnings if the light is unknown."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import worst_fact
from mavdem.facts import Code, Fact, Level, NamedFacts
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

WARNINGS_BY_LIGHT: dict[Light, tuple[Code, ...]] = {
    Light.MOTORS: (
        MotionEvent.MOTOR_AT_ITS_STOP,
        ReportedEvent.YAW_IMBALANCED,
        ReportedEvent.PROPELLER_IMBALANCED,
    ),
    Light.VIBRATION: (MotionEvent.CLIPPED, ReportedEvent.VIBRATION_COMPENSATED),
    Light.TRACKING: (MotionEvent.ATTITUDE_CAUGHT,),
    Light.POWER: (ReportedEvent.BATTERY_WARNED,),
    Light.ESTIMATOR: (
        MotionEvent.BAROMETER_DRIFTED,
        MotionEvent.HEIGHTS_DISAGREE,
        ReportedEvent.ESTIMATOR_SWITCHED,
        ReportedEvent.ESTIMATOR_RESET,
        ReportedEvent.GPS_JUMPED,
    ),
}
"""Further events, about the subject of a light, that the light shows if it is unknown otherwise.

A light that was judged weighs them by itself: a motor at its limit for a moment does not make sound motors doubtful.
"""

LIGHT_OF_WARNING: dict[Code, Light] = LIGHT_OF_EVENT | {
    code: light for light, codes in WARNINGS_BY_LIGHT.items() for code in codes
}
"""The light of each event of both tables."""


def light_or_warning(name: Light, light: Fact, evidence: Evidence) -> Fact:
    """Returns the fact that a light shows: the worst warning about its subject before any loss, if it is unknown.

    What could not be measured is not known to be sound, and a warning about it is known.

    Args:
        name: the light.
        light: the fact by which it was judged.
        evidence: events of the vehicle.

    Returns:
        The warning, of several as bad the longest. ``light`` unchanged if it is known, if there is no such warning, or
        if the vehicle is no multirotor, whose other lights are judged alone.
    """
    if light.level is not Level.UNKNOWN or evidence.other_vehicle is not None:
        return light
    warnings = []
    for event in evidence.warnings_before_loss(LIGHT_OF_WARNING):
        # Only events of the first table have a light in the headline.
        light_of_warning = light_of_event(event) or LIGHT_OF_WARNING[event.code]
        if light_of_warning is name:
            warnings.append(event)
    warnings.sort(key=_duration, reverse=True)
    return worst_fact([light, *warnings])


def _duration(event: Fact) -> float:
    """Returns how long an event lasted, s; 0 if it has no end. A motor at its limit has the time that it was there."""
    if "duration" in event.figures:
        return float(event.figures["duration"])
    return 0.0 if event.end_time is None else event.end_time - event.start_time


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
        light = lights[name]
        # A light that shows a warning for want of a measurement shows the headline instead, if that is as bad.
        facts = [headline, light] if light.code in LIGHT_OF_WARNING else [light, headline]
        lights_to_show[name] = worst_fact(facts)
    return lights_to_show


def light_of_event(event: Fact) -> Light | None:
    """Returns the light that shows an event in the headline; None for one of no light."""
    if event.figures.get("watchdog"):
        # A watchdog restarts a program that hangs, whatever its supply.
        return Light.TRACKING
    return LIGHT_OF_EVENT.get(event.code)
