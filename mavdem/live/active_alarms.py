"""Active alarms of a live vehicle: each begins with a fault, and is over when the fault has not been found for long."""

from math import inf

from mavdem.facts import Fact
from mavdem.facts.watch import WatchedQuantity

CALM_SECONDS = 10.0
"""Time for which a fault must not be found before its alarm is over, s: a choice. It is doubled with each end of the
alarm in a flight, so that what comes and goes is not reported again and again."""


class ActiveAlarms:
    """The active alarms of one boot of a vehicle, at most one for each watched quantity, such as the vibration.

    Attributes:
        facts: the fact with which each alarm was raised last, by its quantity.
    """

    def __init__(self) -> None:
        """Begins without an alarm."""
        self.facts: dict[WatchedQuantity, Fact] = {}
        # When the fault of each alarm was found last, s of the boot clock; it is kept when the alarm is over.
        self._last_found: dict[WatchedQuantity, float] = {}
        # Time without the fault after which the alarm is over, s, once it was over before in this flight.
        self._calm_seconds: dict[WatchedQuantity, float] = {}

    def begin_flight(self) -> None:
        """Makes alarms of the new flight end after the usual time without their fault.

        :meth:`end` doubles that time for an alarm that came and went in the flight before.
        """
        self._calm_seconds = {}

    def last_found(self, quantity: WatchedQuantity) -> float:
        """Returns when the fault of an active alarm was found last, s of the boot clock.

        Args:
            quantity: what the alarm is about, such as the vibration.
        """
        return self._last_found[quantity]

    def raise_alarm(self, quantity: WatchedQuantity, fact: Fact, fault_time: float) -> bool:
        """Makes a fault the active alarm of the quantity that it is about.

        Args:
            quantity: watched quantity, such as the vibration.
            fact: the finding that states the fault. It replaces the finding of an alarm that is active already.
            fault_time: when the fault was there last, s of the boot clock.

        Returns:
            Whether the alarm is new to the user: it was not active, or has another level or code than before. Other
            figures are not new.
        """
        former_fact = self.facts.get(quantity)
        self.facts[quantity] = fact
        former_time = self._last_found.get(quantity, -inf)
        self._last_found[quantity] = max(fault_time, former_time)
        if former_fact is None:
            return True
        return former_fact.level is not fact.level or former_fact.code is not fact.code

    def is_calm(self, quantity: WatchedQuantity, now: float) -> bool:
        """Returns whether the fault of an active alarm has not been found for long enough to end the alarm.

        Args:
            quantity: what the alarm is about, such as the vibration.
            now: present time on the boot clock, s.
        """
        calm_seconds = self._calm_seconds.get(quantity, CALM_SECONDS)
        return now - self._last_found[quantity] >= calm_seconds

    def end(self, quantity: WatchedQuantity) -> Fact:
        """Ends an active alarm, and returns its fact.

        The next alarm of the quantity ends only after twice the time without its fault: a fault that comes and goes
        gives fewer and fewer alarms.

        Args:
            quantity: what the alarm is about, such as the vibration.
        """
        self._calm_seconds[quantity] = 2 * self._calm_seconds.get(quantity, CALM_SECONDS)
        return self.facts.pop(quantity)

    def discard(self, quantity: WatchedQuantity) -> None:
        """Removes the alarm of an earlier flight, if it is active. Unlike :meth:`end`, this delays no later end.

        Args:
            quantity: what the alarm is about, such as the vibration.
        """
        self.facts.pop(quantity, None)
