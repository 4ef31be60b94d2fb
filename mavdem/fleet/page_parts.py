"""Parts of a fleet's pages that its store caches: they are made again only for vehicles that were judged again."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import metadata

from mavdem.fleet.store import Store

MakePart = Callable[[str], str]
"""Makes the part of a vehicle, by its name."""


def cached_summaries(
    store: Store, version: str, outdated_vehicles: Iterable[str], make_summary: MakePart
) -> list[str]:
    """Returns the summaries of all vehicles as texts, in the order of their names; missing and outdated ones are made.

    Args:
        store: the open SQLite store of the fleet, with the rows of all logs.
        version: version of the summaries; summaries of another version, or of another version of mavdem, are outdated.
        outdated_vehicles: names of the vehicles that were judged since their summaries were made.
        make_summary: function that makes the summary of a vehicle, given its name. The store keeps what it returns.

    Returns:
        The summaries.
    """
    full_version = f"{version} of {metadata.version('mavdem')}"
    with store.transaction():
        names = [[vehicle] for vehicle in outdated_vehicles]
        store.db.executemany("delete from vehicle_parts where vehicle = ?", names)
        tracked_query = "select vehicle from flights where file is not null"
        query = f"delete from vehicle_parts where version <> ? or vehicle not in ({tracked_query})"
        store.db.execute(query, [full_version])
        missing_query = f"""select distinct vehicle from ({tracked_query})
            where vehicle not in (select vehicle from vehicle_parts)"""
        for (vehicle,) in store.db.execute(missing_query).fetchall():
            store.db.execute(
                "insert into vehicle_parts (vehicle, version, summary) values (?, ?, ?)",
                [vehicle, full_version, make_summary(vehicle)],
            )
        query = "select summary from vehicle_parts order by vehicle"
        return [summary for (summary,) in store.db.execute(query)]


def cached_charts(store: Store, vehicle: str, make_charts: MakePart) -> str:
    """Returns the charts of a vehicle as HTML; they are made and kept at the first call after it was judged.

    Args:
        store: the open store of the fleet, with the summary of the vehicle.
        vehicle: its name.
        make_charts: function that makes the charts of a vehicle.
    """
    query = "select charts from vehicle_parts where vehicle = ?"
    (charts,) = store.db.execute(query, [vehicle]).fetchone()
    if charts is None:
        charts = make_charts(vehicle)
        query = "update vehicle_parts set charts = ? where vehicle = ?"
        store.db.execute(query, [charts, vehicle])
    return str(charts)
