"""One review of a live vehicle by its watchdog: the state of the vehicle then, and the facts that were found."""

from __future__ import annotations

from dataclasses import dataclass, field

from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.watch import WatchedQuantity
from mavdem.ingest.telemetry import Telemetry


@dataclass
class Review:
    """One review of the vehicle, which fills it step by step with a fact on each watched quantity.

    A fact is a coded finding with a level. One of the level "watch" or "bad" is a fault, and becomes an alarm when the
    review ends. All times are of the vehicle's boot clock, s.
    """

    now: float
    """Time of the review."""

    vehicle: Telemetry
    """Identity and parameters of the vehicle, without messages."""

    is_flying: bool
    """Whether the vehicle is airborne and armed."""

    has_settled: bool
    """Whether the flight is settled, without take-off and landing: vibration counts only then."""

    phase_start: float
    """Since when the vehicle flies, or is on the ground."""

    recent_signals: Signals | None
    """Signals of the last minute; None where the review neither is thorough nor has an urgent message to judge."""

    facts: dict[WatchedQuantity, Fact] = field(default_factory=dict)
    """The fact that was found on each quantity, good or bad."""

    last_found_times: dict[WatchedQuantity, float] = field(default_factory=dict)
    """When the faults of the last minute were there last; a fault that is not listed is there now."""

    def last_found_time(self, quantity: WatchedQuantity) -> float:
        """Returns when the fault of a quantity was there last, s of the boot clock; the present time if it still is.

        Args:
            quantity: watched quantity with a fault, such as the height.
        """
        return self.last_found_times.get(quantity, self.now)

    def add_event(self, quantity: WatchedQuantity, event: Fact) -> None:
        """Adds an event of the last minute as the fact on a quantity, with the time until which it lasted.

        Args:
            quantity: watched quantity that the event is about, such as the height.
            event: the event; it has no end time while it lasts.
        """
        self.facts[quantity] = event
        end_time = event.end_time
        self.last_found_times[quantity] = self.now if end_time is None else end_time
