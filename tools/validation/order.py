#!/usr/bin/env python
"""How often F̄ finds the order of simulated systems, and the orders of recorded flights; prints Markdown tables.

A row of the first table is a true order, of 100 systems or flights (``--runs``); the columns are the orders found, with
1 to 6 states tried. The systems are those of ``order_systems.py``. The recorded flights lie in MAVDEM_SHARED_DATA, or
there is no table of them.

Usage: tools/validation/order.py [--runs N] [--only WORD]
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import NamedTuple

import click
import numpy as np
from order_systems import paper_flight, random_flight

from mavdem import Flight
from mavdem.dem.order.choice import DEFAULT_MAX_ORDER, OrderChoice, orders_of
from mavdem.dem.parallel import parallel_map
from mavdem.paper.flights import recorded_flights

ORDERS = (1, 2, 3, 4)


class SystemKind(NamedTuple):
    """Systems of one kind; ``flight`` takes a true order and a seed."""

    name: str
    flight: Callable[..., Flight]
    known_inputs: bool = True


ONE, TWO = (partial(random_flight, channels=channels) for channels in (1, 2))

KINDS = (
    SystemKind("System 1 to 4", paper_flight),
    SystemKind("random, 1 output, disturbed by 2 %", ONE),
    SystemKind("random, 2 outputs, disturbed by 2 %", TWO),
    SystemKind("random, 1 output, disturbed by 5 %", partial(ONE, disturbance=0.05)),
    SystemKind("random, 2 outputs, disturbed by 5 %", partial(TWO, disturbance=0.05)),
    SystemKind("System 1 to 4, inputs unknown", paper_flight, False),
    SystemKind("random, 1 output, disturbed by 2 %, inputs unknown", ONE, False),
    SystemKind("random, 2 outputs, disturbed by 2 %, inputs unknown", TWO, False),
)


def found(job: tuple[SystemKind, int, int]) -> int:
    """The order found for a system of this kind, true order and seed."""
    kind, order, seed = job
    return OrderChoice((orders_of(kind.flight(order=order, seed=seed), known_inputs=kind.known_inputs),)).chosen


def table(runs: int, only: str) -> None:
    chosen = [kind for kind in KINDS if only in kind.name]
    answers = parallel_map(found, ((kind, order, seed) for kind in chosen for order in ORDERS for seed in range(runs)))
    print(f"| systems | order | {' | '.join(f'found {order}' for order in range(1, DEFAULT_MAX_ORDER + 1))} |")
    print("|" + "---|" * (DEFAULT_MAX_ORDER + 2))
    for kind in chosen:
        for order in ORDERS:
            counts = np.bincount(list(islice(answers, runs)), minlength=DEFAULT_MAX_ORDER + 1)[1:]
            cells = (f"**{count}**" if at == order else f"{count or ''}" for at, count in enumerate(counts, 1))
            print(f"| {kind.name} | {order} | {' | '.join(cells)} |", flush=True)


def table_of_flights() -> None:
    print("\n| flight | kernel, s | independent samples | order | inputs unknown |")
    print("|---|---|---|---|---|")
    for name, flight in recorded_flights():
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
