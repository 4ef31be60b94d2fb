"""A link that is lost in flight: how long ago, where the vehicle was last, and which lights are no longer known.

A light is the judgement of one part of the vehicle, such as its motors: a fact with a level.
"""

from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.power import PowerLight
from mavdem.facts.session import LinkFact, MissingMessages
from mavdem.facts.wind import WindLight
from mavdem.live.global_position import GlobalPosition
from mavdem.live.takeoff_place import Displacement

LONG_LOSS_SECONDS = 10.0
"""Time without messages of a flying vehicle from which on that is bad, s: by then its autopilot counts the link as lost
too and may act (PX4 after 10 s, COM_DL_LOSS_T; ArduPilot after 5 s, FS_GCS_TIMEOUT)."""

LIGHTS_OF_MOTION = (Light.MOTORS, Light.TRACKING, Light.MARGINS, Light.WIND, Light.LOG)
"""Lights that are judged by attitude and motor outputs. The others have messages of their own, which may still come."""

MEASURED_CODES = (WindLight.WIND_BLEW, WindLight.WIND_NOT_KNOWN, PowerLight.POWER_UNMEASURED)
"""Lights that state a value, such as a voltage, also where their level is "unknown": in a silence it grows old."""


def link_loss_fact(
    reason: Fact,
    age: float | None,
    reception: float | None,
    displacement: Displacement | None,
    voltage: float | None,
    last_position: GlobalPosition | None,
    *,
    cause: Fact | None,
    is_over: bool,
    unread_seconds: float | None = None,
) -> Fact:
    """Returns the fact that a flying vehicle has fallen silent, or sends no motion, with its last known state.

    Args:
        reason: the silence of the link: which messages do not come.
        age: time since the last of them, s; None where that is not known.
        reception: UNIX time of the last message, s; None where that is not known.
        displacement: where the vehicle was then, from its take-off; None where that is not known.
        voltage: voltage of its battery then, V; None where that is not known.
        last_position: its latest geographic position in this flight; None where none came.
        cause: what was found before and may explain the silence, such as an alarm; None for nothing.
        is_over: whether the session has ended, so that the age grows no more.
        unread_seconds: how many seconds of messages from before the silence are not analysed yet, in which the vehicle
            may have landed; None if all are.

    Returns:
        The fact. It is bad after ``LONG_LOSS_SECONDS``, and at once where the cause is bad. While messages from before
        are unread it is no more than a warning: the landing may be among them.
    """
    is_long_loss = age is not None and age >= LONG_LOSS_SECONDS
    has_bad_cause = cause is not None and cause.is_bad
    is_certain = unread_seconds is None
    distance = None
    height = None
    if displacement is not None:
        distance = displacement.distance
        height = displacement.height
    fact = Fact(
        LinkFact.LOST_IN_FLIGHT,
        Level.BAD if is_certain and (is_long_loss or has_bad_cause) else Level.WATCH,
        subject=reason.subject or MissingMessages.MESSAGES,
        duration=age,
        reception=reception,
        distance=distance,
        height=height,
        voltage=voltage,
        cause=cause,
        reason=reason,
        delay=unread_seconds,
        is_over=is_over,
    )
    if last_position is None:
        return fact
    return fact.replace(
        latitude=last_position.latitude,
        longitude=last_position.longitude,
        home_height=last_position.height,
        position_reception=last_position.reception,
    )


def lights_during_silence(
    lights_at_last_message: NamedFacts, silence_seconds: float | None, missing: MissingMessages
) -> dict[str, Fact]:
    """Returns the status lights of a vehicle in flight that sends nothing, or neither attitude nor motor outputs.

    A light that was good needs messages to stay good: without them its level is not known, and its fact says what it
    was before. So does that of a value whose level was not known. A light that warns stays, since silence does not undo
    what was found.

    Args:
        lights_at_last_message: the judgement of each part of the vehicle, by the name of the part.
        silence_seconds: time since the last message, s; None if it is not known.
        missing: which messages do not come. If only those of the motion do not, this concerns only the
            ``LIGHTS_OF_MOTION``.

    Returns:
        The lights during the silence, by the same names.
    """
    present_lights = {}
    for name, light in lights_at_last_message.items():
        lacks_messages = missing is MissingMessages.MESSAGES or name in LIGHTS_OF_MOTION
        states_value = light.level is Level.UNKNOWN and light.code in MEASURED_CODES
        if lacks_messages and (light.is_good or states_value):
            present_lights[name] = Fact(
                Unjudged.KNOWN_BEFORE, duration=silence_seconds, reason=light
            )
        else:
            present_lights[name] = light
    return present_lights
