"""The list of what is watched on a live vehicle, such as vibration or battery: since when, or why it is not."""

from collections.abc import Mapping
from math import isfinite

from mavdem.dataset.batteries import BATTERY_MESSAGES
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact
from mavdem.facts.power import PowerLight
from mavdem.facts.session import RowsFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.live.height_watch import BAROMETER_MESSAGE
from mavdem.live.live_signals import RecentMotion
from mavdem.live.motor_limits import MIN_LIMIT_SAMPLES
from mavdem.wind_velocity.from_log import ESTIMATOR_FLAG_MESSAGES, estimator_message

UNWATCHED_BATTERIES = frozenset(
    {PowerLight.POWER_UNMEASURED, PowerLight.SUPPLY_HELD, PowerLight.CELLS_UNKNOWN}
)
"""Judgements of the power that say nothing of a battery: it was not measured, or has no limit."""

BATTERY_NOT_KNOWN_YET = Fact(RowsFact.RATES_BEING_MEASURED)
"""Why the battery is not watched before it is judged first: too few voltages have come to say what they measure."""

LISTENING_SECONDS = 3.0
"""Time after the first review of a boot, and after a take-off, in which no message counts as missing, s: some come once
a second."""


class WatchList:
    """For each watched quantity of one vehicle the fact since when it is watched, or why it is not.

    Attributes:
        facts: the facts, by the quantity that they are about.
    """

    def __init__(self) -> None:
        """Begins with an empty list."""
        self.facts: dict[WatchedQuantity, Fact] = {}
        # Time of the first update, s of the boot clock; None before it.
        self._first_time: float | None = None

    def set(self, quantity: WatchedQuantity, reason: Fact | None, now: float) -> None:
        """Stores for a quantity that it is watched now, or why it is not.

        The stored fact has the time since which it is true. So it is replaced only if the present state differs.

        Args:
            quantity: what is watched, such as the vibration.
            reason: why it is not watched; None if it is.
            now: present time on the boot clock, s.
        """
        code = WatchFact.WATCHED if reason is None else WatchFact.NOT_WATCHED
        former_fact = self.facts.get(quantity)
        is_unchanged = (
            former_fact is not None
            and former_fact.code is code
            and former_fact.figures.get("reason") == reason
        )
        if not is_unchanged:
            self.facts[quantity] = Fact(code, time=now, subject=quantity, reason=reason)

    def update(
        self, now: float, reasons: Mapping[WatchedQuantity, Fact], *, is_flying: bool
    ) -> None:
        """Updates, for each watched quantity, the fact that says since when it is watched, or why it cannot be.

        On the ground only the autopilot's warnings are watched. The balance of the motors is left out, since the caller
        sets its fact.

        Args:
            now: present time on the boot clock, s.
            reasons: for each quantity that its messages do not show, the reason; others can be watched.
            is_flying: whether the vehicle is in the air.
        """
        if self._first_time is None:
            self._first_time = now
        is_listening = now - self._first_time < LISTENING_SECONDS
        for quantity in WatchedQuantity:
            if quantity is WatchedQuantity.MOTORS:
                continue
            reason = reasons.get(quantity)
            is_message_missing = reason is not None and reason.code is WatchFact.MESSAGE_MISSING
            if is_message_missing and is_listening:
                # Messages that are sent once a second may just not have come yet.
                continue
            is_watched_on_ground = quantity is WatchedQuantity.WARNINGS
            if reason is None and not is_flying and not is_watched_on_ground:
                reason = Fact(WatchFact.ON_GROUND_NOW)
            self.set(quantity, reason, now)


def not_watched(watch_fact: Fact, reason: Fact, time: float) -> Fact:
    """Returns the fact that a quantity is not watched, in the place of its fact in the list.

    While the link is silent nothing is watched, whatever the list states.

    Args:
        watch_fact: the quantity's fact in the list: since when it was watched, or why it was not.
        reason: why it is not watched now.
        time: since when it is not, s on the boot clock; NaN where none is known, and then the fact has no time.

    Returns:
        The fact NOT_WATCHED on the same quantity, with the reason.
    """
    figures = dict(watch_fact.figures)
    figures["reason"] = reason
    known_time = time if isfinite(time) else None
    return Fact(WatchFact.NOT_WATCHED, time=known_time, subject=watch_fact.subject, **figures)


def quantities_without_motion(motion: RecentMotion | None) -> dict[WatchedQuantity, Fact]:
    """Finds what attitude and motor outputs of the last seconds do not show: oscillation, or motors at their limits.

    An oscillation (a limit cycle) shows only if both come at half of ``MIN_STREAM_RATE`` at least; a motor at its limit
    shows in any ``MIN_LIMIT_SAMPLES``.

    Args:
        motion: attitude and motor outputs of the last seconds; None if they do not come, or it is not known yet which
            outputs drive the motors.

    Returns:
        The reason by the quantity that is not shown.
    """
    if motion is None:
        # Their messages may come, but parameters and samples have not shown yet which channels drive motors.
        no_motors = Fact(RowsFact.MOTORS_NOT_KNOWN)
        return {WatchedQuantity.OSCILLATION: no_motors, WatchedQuantity.MOTOR_LIMITS: no_motors}
    if motion.rate >= MIN_STREAM_RATE / 2:
        return {}
    too_slow = Fact(WatchFact.MESSAGE_MISSING, name=motion.motors.message, rate=motion.rate)
    reasons = {WatchedQuantity.OSCILLATION: too_slow}
    if len(motion.motors.time) < MIN_LIMIT_SAMPLES:
        reasons[WatchedQuantity.MOTOR_LIMITS] = too_slow
    return reasons


def quantities_without_message(
    received_names: set[str], autopilot: str
) -> dict[WatchedQuantity, Fact]:
    """Finds the quantities whose slow messages do not come: vibration, battery, estimator, drift, height, warnings.

    Args:
        received_names: names of the messages that have come in the last minute.
        autopilot: name of the MAV_AUTOPILOT, which decides the name of the estimator's message.

    Returns:
        The fact that names the missing message, by the quantity that it would show.
    """
    # One of several messages is enough. If all are missing, the first one is named, which this autopilot sends.
    needed_messages = {
        WatchedQuantity.VIBRATION: ("VIBRATION",),
        WatchedQuantity.BATTERY: BATTERY_MESSAGES,
        WatchedQuantity.ESTIMATOR: (estimator_message(autopilot), *ESTIMATOR_FLAG_MESSAGES),
        WatchedQuantity.WARNINGS: ("HEARTBEAT",),
        WatchedQuantity.DRIFT: ("LOCAL_POSITION_NED",),
        WatchedQuantity.HEIGHT: (BAROMETER_MESSAGE,),
    }
    reasons = {}
    for quantity, names in needed_messages.items():
        if not received_names.intersection(names):
            reasons[quantity] = Fact(WatchFact.MESSAGE_MISSING, name=names[0], rate=None)
    return reasons


def reason_battery_not_judged(power: Fact) -> Fact | None:
    """Returns why no battery is watched, such as that its voltage is not measured; None if one is.

    Args:
        power: the fact of the status light of the power.

    Returns:
        The reason. It has no measured values, so that it changes only if the reason itself does.
    """
    if power.code not in UNWATCHED_BATTERIES:
        return None
    # A battery sensor that is not connected reports a voltage that never changes.
    has_voltage = bool(power.figures.get("voltage"))
    is_constant = has_voltage and bool(power.figures.get("is_constant"))
    return Fact(WatchFact.BATTERY_NOT_JUDGED, cause=power.code, is_constant=is_constant)
