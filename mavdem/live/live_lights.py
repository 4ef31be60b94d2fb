"""Status lights of a live flight before a model is judged: for each part of the vehicle a fact with its judgement."""

from collections.abc import Mapping
from typing import NamedTuple

from mavdem.assessment.judgement import unjudged
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact, Level
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.log import LogLight
from mavdem.facts.margins import MarginsLight
from mavdem.facts.session import RowsFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live.tracking_watch import MIN_SETTLED_SECONDS

QUANTITIES_OF_SETTLED_FLIGHT = {
    Light.VIBRATION: WatchedQuantity.VIBRATION,
    Light.POWER: WatchedQuantity.BATTERY,
    Light.ESTIMATOR: WatchedQuantity.ESTIMATOR,
    Light.TRACKING: WatchedQuantity.TRACKING,
}
"""Quantities that are judged without a model in settled flight, by the light that then states the judgement."""


def lights_before_model(
    no_model_reason: Fact,
    rates: Mapping[str, float],
    watch_facts: Mapping[str, Fact],
    no_wind_reason: Fact | None,
    provisional_margins: Fact | None,
) -> dict[str, Fact]:
    """Returns the light of each part of the vehicle before a model is judged.

    A light is the judgement of one part of the vehicle, such as its motors. Without a model its fact says that there is
    no alarm so far, or why the part is not judged. The caller replaces the lights that are judged without a model.

    Args:
        no_model_reason: why there is no judgement of a model.
        rates: rates of attitude and motor messages, Hz, by message name.
        watch_facts: for each quantity that is watched on the followed vehicle, by its name: since when, or why it is
            not.
        no_wind_reason: why there is no estimate of the wind although the vehicle flies; None if nothing prevents it.
        provisional_margins: the light of the margins until they are computed from setpoints of the body rate; None if
            the vehicle does not send these.

    Returns:
        A fact for each light, by name, in the order in which they are shown.
    """
    # Every light that is not replaced below states why there is no model.
    lights = dict(unjudged(no_model_reason).lights)
    for light, quantity in QUANTITIES_OF_SETTLED_FLIGHT.items():
        lights[str(light)] = _light_before_settled_flight(quantity, watch_facts, no_model_reason)
    lights[str(Light.MOTORS)] = _motors_light(watch_facts, no_model_reason)
    lights[str(Light.MARGINS)] = _margins_light(watch_facts, no_model_reason, provisional_margins)
    if no_wind_reason is not None:
        lights[str(Light.WIND)] = Fact(Unjudged.NOT_JUDGED, reason=no_wind_reason)
    elif watch_facts:
        # Messages come, and nothing prevents an estimate of the wind.
        lights[str(Light.WIND)] = Fact(Unjudged.NOT_JUDGED, reason=Fact(WatchFact.WIND_AWAITED))
    if no_model_reason.code is RowsFact.LIVE_RATES_TOO_LOW:
        # The figure "reason" is the fact which messages are too slow for a model. It becomes the light on the messages,
        # with the level that it has for a log.
        lights[str(Light.LOG)] = no_model_reason.figures["reason"].replace(Level.WATCH)
    elif min(fastest_rates(rates)) >= MIN_STREAM_RATE:
        lights[str(Light.LOG)] = _fast_enough_fact(rates)
    return lights


def _light_before_settled_flight(
    quantity: WatchedQuantity, watch_facts: Mapping[str, Fact], no_model_reason: Fact
) -> Fact:
    """Returns the light of a quantity that is judged only in settled flight, such as the vibration, before that.

    The light states that the quantity is not judged yet, and why: it is not watched, or settled flight (after the
    climb-out) has not come yet. In the latter case it also states that an alarm of the quantity is possible already.

    Args:
        quantity: one of ``QUANTITIES_OF_SETTLED_FLIGHT``.
        watch_facts: since when each quantity is watched, or why it is not, by its name.
        no_model_reason: why there is no model.
    """
    reason = _reason_not_watched(quantity, watch_facts, no_model_reason)
    if reason is None and quantity is WatchedQuantity.TRACKING:
        # How well the vehicle follows its setpoints is judged over several seconds of settled flight.
        reason = Fact(WatchFact.TRACKING_AWAITED, duration=MIN_SETTLED_SECONDS)
    elif reason is None:
        reason = Fact(WatchFact.SETTLED_FLIGHT_AWAITED, is_watched=True)
    return Fact(Unjudged.NOT_JUDGED, reason=reason)


def _reason_not_watched(
    quantity: WatchedQuantity, watch_facts: Mapping[str, Fact], no_model_reason: Fact
) -> Fact | None:
    """Returns why a quantity of the vehicle is not watched for faults at present, as a fact; None if it is watched.

    For example, the vibration is not watched if the autopilot does not send VIBRATION.

    Args:
        quantity: what may be watched, such as the vibration.
        watch_facts: a fact for each quantity, by its name. Its figure "reason" is why the quantity is not watched, or
            None if it is. There are no such facts before the first messages of the vehicle, and not yet one for each
            quantity just after them.
        no_model_reason: why no model of the vehicle is learned, such as that no messages come.
    """
    no_messages_came = not watch_facts
    if no_messages_came:
        # For want of messages there is no model, and nothing can be watched.
        return no_model_reason
    watch_fact = watch_facts.get(quantity)
    if watch_fact is None:
        # It is not known yet whether the messages that this quantity needs come, and how fast.
        return Fact(RowsFact.RATES_BEING_MEASURED)
    reason: Fact | None = watch_fact.figures["reason"]
    return reason


def _motors_light(watch_facts: Mapping[str, Fact], no_model_reason: Fact) -> Fact:
    """Returns the light (judgement) of the motors as long as there was no alarm about them.

    It states that no motor was at its limit so far, or if not even that is watched, why the motors are not judged.

    Args:
        watch_facts: since when each quantity is watched, or why it is not, by its name.
        no_model_reason: why there is no model.

    Returns:
        The fact. Its figure ``reason`` is why a loss of thrust would not be detected; None if it would be.
    """
    why_not_watched = _reason_not_watched(
        WatchedQuantity.MOTOR_LIMITS, watch_facts, no_model_reason
    )
    if why_not_watched is not None:
        return Fact(Unjudged.NOT_JUDGED, reason=why_not_watched)
    why_loss_undetectable = _reason_not_watched(
        WatchedQuantity.MOTORS, watch_facts, no_model_reason
    )
    return Fact(WatchFact.NO_MOTOR_AT_LIMIT, reason=why_loss_undetectable)


def _margins_light(
    watch_facts: Mapping[str, Fact], no_model_reason: Fact, provisional_margins: Fact | None
) -> Fact:
    """Returns the light (judgement) of the control loops' stability margins as long as there was no alarm about them.

    Margins are computed from a model, or from setpoints of the body rate. Before that, the light states that no
    oscillation was seen so far, or if not even that is watched, why the margins are not judged.

    Args:
        watch_facts: since when each quantity is watched, or why it is not, by its name.
        no_model_reason: why there is no model.
        provisional_margins: the light until the margins are computed from setpoints of the body rate; None if the
            vehicle does not send these.

    Returns:
        The fact. Its figure ``reason`` is why the margins themselves are not known.
    """
    why_not_watched = _reason_not_watched(WatchedQuantity.OSCILLATION, watch_facts, no_model_reason)
    if why_not_watched is not None:
        return Fact(Unjudged.NOT_JUDGED, reason=why_not_watched)
    if provisional_margins is not None:
        return provisional_margins
    why_margins_unknown = no_model_reason
    if no_model_reason.code is RowsFact.LIVE_RATES_TOO_LOW:
        # The figure "reason" is the fact which messages are too slow for a model, as the review of a log states it.
        slow_messages = no_model_reason.figures["reason"]
        why_margins_unknown = Fact(MarginsLight.MARGINS_UNKNOWN, reason=slow_messages)
    return Fact(WatchFact.NO_OSCILLATION, reason=why_margins_unknown)


def _fast_enough_fact(rates: Mapping[str, float]) -> Fact:
    """Returns the good light "log": attitude and motor outputs are received often enough to learn a model.

    It is the same fact (a coded finding with figures) as for a recorded log, so that its sentence is the same, too.

    Args:
        rates: rates of the messages of attitude and motor outputs, Hz, by name of the message.
    """
    attitude_rate, motor_rate = fastest_rates(rates)
    return Fact(
        LogLight.RECORDED_FAST,
        attitude_rate=attitude_rate,
        # This figure is of the body rates, which come in the same message as the attitude.
        rate=attitude_rate,
        motor_rate=motor_rate,
        needed_rate=MIN_STREAM_RATE,
        # A stream has no file that could be damaged.
        damage=None,
    )


class FastestRates(NamedTuple):
    """Rates of the fastest messages of attitude and of motor outputs, from which the model's data are made."""

    attitude: float
    """Rate of the fastest attitude message, Hz; 0 without one."""

    motors: float
    """Rate of the fastest message of motor outputs, Hz; 0 without one."""


def fastest_rates(rates: Mapping[str, float]) -> FastestRates:
    """Returns the rates of the fastest messages of attitude and of motor outputs.

    Args:
        rates: rates of all messages of attitude and motor outputs, Hz, by name.
    """
    attitude_rate = 0.0
    motor_rate = 0.0
    for name, rate in rates.items():
        if name in ATTITUDE_MESSAGES:
            attitude_rate = max(attitude_rate, rate)
        else:
            motor_rate = max(motor_rate, rate)
    return FastestRates(attitude_rate, motor_rate)
