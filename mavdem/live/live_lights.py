"""The lights (judgements by level) of a live flight before a model of it is judged: what is watched, or why not."""

from collections.abc import Mapping
from typing import NamedTuple

from mavdem.assessment.judgement import unjudged
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact, Level
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.log import LogLight
from mavdem.facts.margins import MarginsLight
from mavdem.facts.session import RowsFact, SessionFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live.tracking_watch import MIN_SETTLED_SECONDS


def lights_before_model(
    reason: Fact,
    rates: Mapping[str, float],
    watch_facts: Mapping[str, Fact],
    no_wind_reason: Fact | None,
) -> dict[str, Fact]:
    """Returns the fact of each light before a model is judged.

    A light is the judgement of one part of the vehicle, such as its motors. Without a model its fact says what is
    watched so far, or why the light is not judged. The caller replaces the lights that are judged without a model.

    Args:
        reason: why there is no judgement of a model.
        rates: rates of attitude and motor messages, Hz, by message name.
        watch_facts: for each thing that is watched on the followed vehicle, by its name: since when, or why it is not.
        no_wind_reason: why there is no estimate of the wind although the vehicle flies; None if nothing prevents it.

    Returns:
        A fact for each light, by name, in the order in which they are shown.
    """

    def reason_not_watched(kind: WatchedQuantity) -> Fact | None:
        """Returns why something is not watched; None if it is."""
        fact = watch_facts.get(kind)
        if fact is None:
            # Just after the first messages it is not known what comes; before them nothing is watched at all.
            return Fact(RowsFact.RATES_BEING_MEASURED) if watch_facts else reason
        stated_reason: Fact | None = fact.figures["reason"]
        return stated_reason

    lights = dict(unjudged(reason).lights)
    for light, kind in (
        (Light.VIBRATION, WatchedQuantity.VIBRATION),
        (Light.POWER, WatchedQuantity.BATTERY),
        (Light.ESTIMATOR, WatchedQuantity.ESTIMATOR),
        (Light.TRACKING, WatchedQuantity.TRACKING),
    ):
        # A quantity that is watched will be judged in settled flight, the tracking after some seconds of it.
        awaited = Fact(SessionFact.NOT_SETTLED)
        if light is Light.TRACKING:
            awaited = Fact(WatchFact.TRACKING_AWAITED, duration=MIN_SETTLED_SECONDS)
        reason_for_light = reason_not_watched(kind) or awaited
        lights[str(light)] = Fact(Unjudged.NOT_JUDGED, reason=reason_for_light)
    for light, kind, code in (
        (Light.MOTORS, WatchedQuantity.MOTOR_LIMITS, WatchFact.NO_MOTOR_AT_LIMIT),
        (Light.MARGINS, WatchedQuantity.OSCILLATION, WatchFact.NO_OSCILLATION),
    ):
        watch_reason = reason_not_watched(kind)
        if watch_reason is not None:
            lights[str(light)] = Fact(Unjudged.NOT_JUDGED, reason=watch_reason)
            continue
        # There was no alarm so far. The rest of the light is not judged: for the motors that is their balance, which is
        # watched by itself, and for the margins all that needs a model.
        if light is Light.MOTORS:
            reason_for_rest = reason_not_watched(WatchedQuantity.MOTORS)
        elif reason.code is RowsFact.LIVE_RATES_TOO_LOW:
            reason_for_rest = Fact(MarginsLight.MARGINS_UNKNOWN, reason=reason.figures["reason"])
        else:
            reason_for_rest = reason
        lights[str(light)] = Fact(code, reason=reason_for_rest)
    if watch_facts and no_wind_reason is None:
        no_wind_reason = Fact(WatchFact.WIND_AWAITED)
    if no_wind_reason is not None:
        lights[str(Light.WIND)] = Fact(Unjudged.NOT_JUDGED, reason=no_wind_reason)
    log_light = _log_light(rates)
    if reason.code is RowsFact.LIVE_RATES_TOO_LOW:
        # As of a log, rates that are too low for a model are to be watched.
        lights[str(Light.LOG)] = reason.figures["reason"].replace(Level.WATCH)
    elif log_light is not None:
        lights[str(Light.LOG)] = log_light
    return lights


def _log_light(rates: Mapping[str, float]) -> Fact | None:
    """Judges by the rates of the messages whether a model can be learned from what is received.

    Args:
        rates: rates of the messages of attitude and motor outputs, Hz, by name.

    Returns:
        The fact that both are fast enough, which is the light "log" of the session; None where one is too slow.
    """
    attitude_rate, motor_rate = fastest_rates(rates)
    if min(attitude_rate, motor_rate) < MIN_STREAM_RATE:
        return None
    # The sentence is that of a recorded log. In a stream the body rates come in the message of the attitude, so that
    # their rate is the same, and damage of a file does not exist.
    body_rate_rate = attitude_rate
    return Fact(
        LogLight.RECORDED_FAST,
        attitude_rate=attitude_rate,
        rate=body_rate_rate,
        motor_rate=motor_rate,
        needed_rate=MIN_STREAM_RATE,
        damage=None,
    )


class FastestRates(NamedTuple):
    """Rates of the messages that rows are made of where several come."""

    attitude: float
    """Rate of the fastest attitude message, Hz; 0 without one."""

    motors: float
    """Rate of the fastest message of motor outputs, Hz; 0 without one."""


def fastest_rates(rates: Mapping[str, float]) -> FastestRates:
    """Returns the rates of the fastest messages of attitude and of motor outputs.

    Args:
        rates: rates of all messages of attitude and motor outputs, Hz, by name.
    """
    attitude_rates = [rate for name, rate in rates.items() if name in ATTITUDE_MESSAGES]
    motor_rates = [rate for name, rate in rates.items() if name not in ATTITUDE_MESSAGES]
    return FastestRates(max(attitude_rates, default=0.0), max(motor_rates, default=0.0))
