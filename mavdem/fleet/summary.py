"""The summary of a fleet: how many flights of how many vehicles, at which tiers, how healthy, and what failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from mavdem.fleet.row import OK, UNKNOWN, FlightRow


@dataclass(frozen=True)
class FleetSummary:
    """Counts of flights; a flight has a row for each axis, and counts by its better tier and its worse health.

    Attributes:
        flights: how many.
        vehicles: how many have a name.
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
    tiers: dict[tuple[str, str, int | None], set[str]] = {}
    health: dict[tuple[str, str, int | None], set[str]] = {}
    vehicles: set[str] = set()
    failed: dict[tuple[str, str], None] = {}
    for row in rows:
        if row.status != OK:
            failed[row.file, row.status] = None
            continue
        flight = row.key, row.vehicle, row.system
        vehicles.add(row.vehicle)
        tiers.setdefault(flight, set()).update({row.tier} if row.tier else ())
        health.setdefault(flight, set()).add(row.health)
    best = Counter(min(found) for found in tiers.values() if found)
    worst = Counter(next((one for one in HEALTHS if one in found), UNKNOWN) for found in health.values())
    return FleetSummary(
        len(tiers),
        len(vehicles - {UNKNOWN}),
        dict(sorted(best.items())),
        {one: worst[one] for one in HEALTHS if worst[one]},
        tuple(failed),
    )
