"""The summary of a fleet: how many flights of how many vehicles, at which tiers, how healthy, and what failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from mavdem.comparison.flight_figures import flown_once, is_shared, vehicles_of
from mavdem.fleet.row import OK, UNKNOWN, FlightRow


@dataclass(frozen=True)
class FleetSummary:
    """Counts of flights; a flight has a row for each axis, and counts by its better tier and its worse health.

    Attributes:
        flights: how many; one that several logs have counts once, by that of the best tier.
        vehicles: how many have a name of their own: a system id is none.
        tiers: flights by tier, "a" to "c".
        health: flights by health.
        failed: file and status of each log without a flight.
    """

    flights: int
    vehicles: int
    tiers: dict[str, int]
    health: dict[str, int]
    failed: tuple[tuple[str, str], ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self) | {"failed": [{"file": file, "status": status} for file, status in self.failed]}


HEALTHS = ("fault", "drift", OK, UNKNOWN)  # the worst first


def summarised(rows: Iterable[FlightRow]) -> FleetSummary:
    """The summary of a fleet's rows."""
    rows = list(rows)
    failed = dict.fromkeys((row.file, row.status) for row in rows if row.status != OK)
    vehicles = vehicles_of(rows)
    own = {name for name, flights in vehicles.items() if name != UNKNOWN and not is_shared(flights)}
    flown = [
        flight for name, flights in vehicles.items() for flight in (flown_once(flights) if name in own else flights)
    ]
    best = Counter(min(row.tier for row in flight if row.tier) for flight in flown if any(row.tier for row in flight))
    worst = Counter(min((row.health for row in flight), key=HEALTHS.index) for flight in flown)
    return FleetSummary(
        len(flown),
        len(own),
        dict(sorted(best.items())),
        {one: worst[one] for one in HEALTHS if worst[one]},
        tuple(failed),
    )
