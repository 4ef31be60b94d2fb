"""The second pass: every flight of a vehicle beside the vehicle's healthy ones."""

from __future__ import annotations

from collections.abc import Sequence

from mavdem.fleet.row import FlightRow


def with_health(rows: Sequence[FlightRow], baseline: Sequence[FlightRow]) -> Sequence[FlightRow]:
    """All rows of one vehicle with what its other flights say of each."""
    return rows
