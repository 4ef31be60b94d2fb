#!/usr/bin/env python
"""How often F̄ finds the order of simulated systems, and what it says of recorded flights; prints Markdown tables.

A row of the first table is a true order, of 100 systems or flights (``--runs``); the columns are the orders found, with
1 to 6 states tried. The systems are those of ``order_systems.py``. The recorded flights lie in MAVDEM_SHARED_DATA, or
there is no table of them.

Usage: tools/engine/order.py [--runs N] [--only WORD]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from order_systems import paper_flight, random_flight

from mavdem import Flight
from mavdem.dem.many import answer_many
from mavdem.dem.order import MOST_STATES, OrderChoice, orders_of

sys.path.append(str(Path(__file__).parents[1] / "bench"))

ORDERS = (1, 2, 3, 4)


class Kind(NamedTuple):
    """Systems of one kind.

    Attributes:
        name: for the table.
        flight: of a true order and a seed.
        known_inputs: whether the inputs are known.
    """

    name: str
    flight: Callable[[int, int], Flight]
    known_inputs: bool = True


def _one(order: int, seed: int, disturbance: float = 0.02) -> Flight:
    return random_flight(order, 1, seed, disturbance=disturbance)


def _two(order: int, seed: int, disturbance: float = 0.02) -> Flight:
    return random_flight(order, 2, seed, disturbance=disturbance)


def kinds() -> tuple[Kind, ...]:
    noisy = {"disturbance": 0.05}
    return (
        Kind("System 1 to 4", paper_flight),
        Kind("random, 1 output, disturbed by 2 %", _one),
        Kind("random, 2 outputs, disturbed by 2 %", _two),
        Kind("random, 1 output, disturbed by 5 %", partial(_one, **noisy)),
        Kind("random, 2 outputs, disturbed by 5 %", partial(_two, **noisy)),
        Kind("System 1 to 4, inputs unknown", paper_flight, False),
        Kind("random, 1 output, disturbed by 2 %, inputs unknown", _one, False),
        Kind("random, 2 outputs, disturbed by 2 %, inputs unknown", _two, False),
    )


def found(kind: Kind, order: int, seed: int) -> int:
    """The order that is found of one of them."""
    return OrderChoice((orders_of(kind.flight(order, seed), known_inputs=kind.known_inputs),)).chosen


def _found(job: tuple[Kind, int, int]) -> int:
    return found(*job)


def table(runs: int, only: str) -> None:
    chosen = [kind for kind in kinds() if only in kind.name]
    answers = answer_many(_found, ((kind, order, seed) for kind in chosen for order in ORDERS for seed in range(runs)))
    print(f"| systems | order | {' | '.join(f'found {order}' for order in range(1, MOST_STATES + 1))} |")
    print("|" + "---|" * (MOST_STATES + 2))
    for kind in chosen:
        for order in ORDERS:
            counts = np.bincount(list(islice(answers, runs)), minlength=MOST_STATES + 1)[1:]
            cells = (f"**{count}**" if at == order else f"{count or ''}" for at, count in enumerate(counts, 1))
            print(f"| {kind.name} | {order} | {' | '.join(cells)} |", flush=True)


def recorded() -> Iterator[tuple[str, Flight]]:
    from flights import recorded_flights

    return recorded_flights()


def table_of_flights() -> None:
    print("\n| flight | kernel, s | independent samples | order | inputs unknown |")
    print("|---|---|---|---|---|")
    for name, flight in recorded():
        known, unknown = (OrderChoice((orders_of(flight, known_inputs=knows),)) for knows in (True, False))
        told = known.flights[0]
        print(f"| {name} | {told.width:.2g} | {told.samples:.0f} | {known.chosen} | {unknown.chosen} |", flush=True)


@click.command(help=__doc__)
@click.option("--runs", type=click.IntRange(1), default=100, show_default=True, help="Systems of each order.")
@click.option("--only", default="", help="Only kinds of systems with this in their name.")
def main(runs: int, only: str) -> None:
    table(runs, only)
    if not only:
        table_of_flights()


if __name__ == "__main__":
    main()
