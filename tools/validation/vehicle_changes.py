#!/usr/bin/env python
"""How often `mavdem diff` reports a change between simulated flights of a vehicle that is the same, or weaker.

Each vehicle is flown again and again, in winds of other kinds, speeds and directions, with other steering and another
battery; then with a motor that has lost thrust. Every pair of flights is compared, and every healthy half with another.
What the comparison assumes was chosen on the flights with even numbers; those with odd ones are the test. Progress goes
to standard error.

Usage: tools/validation/vehicle_changes.py [--seed N] [--healthy N] [--weak N] [--thrust SHARE] [--rows FILE]
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations, product
from math import degrees, hypot
from pathlib import Path
from typing import NamedTuple

import click
from physical_flights import SPEEDS
from repeated_flights import RepeatedFlight, repeated, rows_of

from mavdem.comparison.flight_figures import flights_of
from mavdem.comparison.vehicle_difference import VehicleDifference, vehicle_difference
from mavdem.comparison.vehicle_estimates import EFFECT, SHARE
from mavdem.errors import NotLearnable
from mavdem.fleet.row import FlightRow

Flight = list[FlightRow]
HALVES = {"chosen on": 0, "test": 1}
FEW = 3  # flights of each state, where several are compared
LIKE = 4.0  # degrees of lean within which wind is taken for alike


class Counted(NamedTuple):
    """Pairs of states: how many were compared, changed in anything, and had the weak motor named."""

    pairs: int
    changed: int
    named: int
    others: int


def flown(flights: Sequence[RepeatedFlight]) -> list[FlightRow]:
    rows = []
    with ProcessPoolExecutor(2) as pool:
        for flight, found in zip(flights, pool.map(_flown, flights), strict=True):
            click.echo(f"{flight}: {'no settled flight' if not found else 'read'}", err=True)
            rows += found
    return rows


def _flown(flight: RepeatedFlight) -> list[FlightRow]:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        return rows_of(flight)
    except (NotLearnable, AssertionError):
        return []


def counted(pairs: Iterable[tuple[Sequence[FlightRow], Sequence[FlightRow]]], motor: int = 0) -> Counted:
    found = [vehicle_difference(before, after) for before, after in pairs]
    named = sum(_names(one, motor) for one in found)
    others = sum(any(_harder(one, other) for other in range(1, 5) if other != motor) for one in found)
    return Counted(len(found), sum(bool(one.of("changed")) for one in found), named, others if motor else 0)


def _names(found: VehicleDifference, motor: int) -> bool:
    """Whether the motor works harder, or does less, beyond chance."""
    return motor > 0 and _harder(found, motor)


def _harder(found: VehicleDifference, motor: int) -> bool:
    return any(
        one.quantity.motor == motor and one.difference * {SHARE: 1, EFFECT: -1}[one.quantity.kind] > 0
        for one in found.of("changed")
        if one.quantity.kind in (SHARE, EFFECT)
    )


def added(some: Sequence[Counted]) -> Counted:
    return Counted(*(sum(column) for column in zip(*some, strict=True))) if some else Counted(0, 0, 0, 0)


def together(flights: Sequence[Flight]) -> list[list[FlightRow]]:
    """Flights as states of ``FEW`` each."""
    groups = [flights[place : place + FEW] for place in range(0, len(flights) - FEW + 1, FEW)]
    return [[row for flight in group for row in flight] for group in groups]


@click.command(help=__doc__)
@click.option("--seed", default=1, show_default=True)
@click.option("--healthy", default=14, show_default=True, help="Flights of each healthy vehicle.")
@click.option("--weak", default=6, show_default=True, help="Flights of each vehicle with a weak motor.")
@click.option("--thrust", default=0.8, show_default=True, help="Share of its thrust that a weak motor has left.")
@click.option("--rows", type=click.Path(path_type=Path), help="Rows to read, or to keep if there are none.")
def main(seed: int, healthy: int, weak: int, thrust: float, rows: Path | None) -> None:
    if rows is not None and rows.exists():
        known = [FlightRow.from_dict(json.loads(line)) for line in rows.read_text().splitlines()]
    else:
        known = flown(repeated(seed, healthy, weak, thrust))
        if rows is not None:
            rows.write_text("".join(f"{row.to_json()}\n" for row in known))
    click.echo(
        "| half | vehicle | states | lean | same: pairs | changed | weak: pairs | found | named | another named |"
    )
    click.echo("|---|---|---|---|---:|---:|---:|---:|---:|---:|")
    for (half, rest), vehicle in product(HALVES.items(), SPEEDS):
        flights = flights_of(row for row in known if row.vehicle == vehicle)
        good = [one for one in flights if one[0].suspect_motor is None]
        good = [one for place, one in enumerate(good) if place % 2 == rest]
        bad = [one for one in flights if one[0].suspect_motor is not None]
        for name, states in (("1 flight", good), (f"{FEW} flights", together(good))):
            same = counted(combinations(states, 2))
            for lean, limit in (("like", LIKE), ("any", 180.0)):
                same = counted(pair for pair in combinations(states, 2) if _leans(*pair) < limit)
                # Of a weak vehicle always one flight: what is asked is whether it is seen at once.
                found_of = [
                    counted([(state, one) for state in states if _leans(state, one) < limit], one[0].suspect_motor or 0)
                    for one in bad
                ]
                found = added(found_of)
                counts = (same.pairs, same.changed, found.pairs, found.changed, found.named, found.others)
                click.echo(f"| {half} | {vehicle} | {name} | {lean} | {' | '.join(map(str, counts))} |")


def _leans(one: Sequence[FlightRow], other: Sequence[FlightRow]) -> float:
    """By how many degrees the mean leans of two states differ."""
    roll, pitch = (
        sum(getattr(row, name) or 0.0 for row in one) / len(one)
        - sum(getattr(row, name) or 0.0 for row in other) / len(other)
        for name in ("lean_roll", "lean_pitch")
    )
    return degrees(hypot(roll, pitch))


if __name__ == "__main__":
    main()
