"""Section V.I: F̄ by model order, on four systems of four orders, with unknown and with known inputs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import e
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.dem import learn
from mavdem.flight import Flight
from mavdem.paper.checks import Check
from mavdem.paper.claims import ORDER
from mavdem.paper.flights import TRAIN, hover, paper_scenario
from mavdem.paper.item import Cell, Item, ItemResult, PageTable, Picture
from mavdem.paper.runner import PAPER, Runner
from mavdem.paper.words import number, percent
from mavdem.report.numbers import listed
from sitl_scenarios.simulation import fly

Array = NDArray[np.float64]

SYSTEMS = {1: ("φ̇",), 2: ("φ", "φ̇"), 3: ("ẏ", "φ", "φ̇"), 4: ("y", "ẏ", "φ", "φ̇")}
"""The outputs of each system, which are its states: Table I."""

ORDERS = (1, 2, 3, 4, 5, 6)

INPUTS = {"unknown": replace(PAPER, known_inputs=False, input_precision=e**2), "known": PAPER}
"""The prior η = 0 with P = e², as in the paper, and the recorded inputs."""

MIN_DRAWN_NATS = 1e3  # least distance below the highest F̄ on the logarithmic axis


class AscentOfOrder(NamedTuple):
    """F̄ at the end of a fit, nats; NaN where it failed, with the reason."""

    free_energy: float
    failure: str


def lateral_flight(experiment: int, duration: float | None = None) -> Flight:
    """The first 700 samples of the hover, with y, ẏ, φ and φ̇ as outputs."""
    scenario = paper_scenario(experiment, duration)
    return hover(scenario, fly(scenario))[:TRAIN]


def fit_order(job: tuple[int, int, str, int, Flight]) -> AscentOfOrder:
    """Fits one order to one system; the job is experiment, system, inputs, order and the hover of all outputs."""
    _, system, inputs, order, flight = job
    own = Flight(flight.time, flight.inputs, flight.outputs[:, 4 - system :], dt=flight.dt)
    try:
        with np.errstate(all="ignore"):
            learned = learn(own, replace(INPUTS[inputs], order=order))
        return AscentOfOrder(float(learned.free_energy[-1]), "")
    except (ValueError, ArithmeticError) as error:
        return AscentOfOrder(float("nan"), str(error))


SATURATED = 0.01  # share of the range of F̄ over all orders: smaller gains of higher orders do not count


def saturates_at(free_energy: Array) -> int:
    """The lowest order, from 1, beyond which no higher one gains more than ``SATURATED`` of the range of F̄."""
    known = np.where(np.isnan(free_energy), -np.inf, free_energy)
    finite = known[np.isfinite(known)]
    enough = known >= finite.max() - SATURATED * np.ptp(finite)
    return int(np.flatnonzero(enough)[0]) + 1


def run(runner: Runner) -> ItemResult:
    """Fits models of each order to each system and finds where F̄ saturates."""
    numbers = runner.extent.experiments
    flown = runner.each(partial(lateral_flight, duration=runner.extent.duration), numbers)
    flights = dict(zip(numbers, flown, strict=True))
    jobs = [
        (experiment, system, inputs, order, flights[experiment])
        for inputs in INPUTS
        for system in SYSTEMS
        for experiment in numbers
        for order in ORDERS
    ]
    fits = runner.each(fit_order, jobs)
    shape = (len(INPUTS), len(SYSTEMS), len(numbers), len(ORDERS))
    table = np.array([one.free_energy for one in fits]).reshape(shape)
    by_inputs = dict(zip(INPUTS, table, strict=True))
    found = {inputs: _found(own) for inputs, own in by_inputs.items()}
    systems = [f"system {system}" for system in SYSTEMS]
    return ItemResult(
        checks=checks(found),
        numbers={
            "orders": list(ORDERS),
            "free_energy": {name: dict(zip(systems, own.tolist(), strict=True)) for name, own in by_inputs.items()},
            "saturates_at": {name: dict(zip(systems, orders, strict=True)) for name, orders in found.items()},
            "failures": sorted({one.failure for one in fits if one.failure}),
        },
        tables=tuple(_table(inputs, own) for inputs, own in by_inputs.items()),
        pictures=(
            Picture(
                "order-free-energy",
                "F̄ of the converged fit by model order: mean and range of the flights, as in the paper (above), and "
                "the distance of the mean from its maximum (below). Squares: the system’s order.",
                partial(_curves, by_inputs),
            ),
        ),
        remarks=(
            f"An order counts as saturated when no higher one up to {ORDERS[-1]} gains more than {percent(SATURATED)} "
            f"of the range of F̄ over all orders. The rule is relative to the scale of the curve: in nats, higher "
            f"orders may still gain tens of thousands. A system of order 1 has no lower order to set the scale.",
        ),
    )


def _found(own: Array) -> list[int]:
    """The order at which the mean over flights saturates, by system."""
    return [saturates_at(rows.mean(axis=0)) for rows in own]


def checks(found: dict[str, list[int]]) -> tuple[Check, ...]:
    """Whether F̄ saturates at each system's own order; ``found`` has where it does, by inputs and by system."""
    return tuple(
        Check(
            f"system {system}: F̄, averaged over the flights, saturates at order {system}, with {listed(found)} inputs",
            all(one == system for one in orders),
            f"F̄ of system {system} saturates at order "
            + (str(orders[0]) if len(set(orders)) == 1 else listed(map("{} with {} inputs".format, orders, found))),
        )
        for system, *orders in zip(SYSTEMS, *found.values(), strict=True)
    )


def _table(inputs: str, own: Array) -> PageTable:
    rows = []
    for system, flights, found in zip(SYSTEMS, own, _found(own), strict=True):
        means = flights.mean(axis=0)
        each = sorted(saturates_at(row) for row in flights)
        cells = [Cell(number(float(mean)), order == found) for order, mean in zip(ORDERS, means, strict=True)]
        rows.append((Cell(f"{system}: [{', '.join(SYSTEMS[system])}]"), *cells, Cell(", ".join(map(str, each)))))
    return PageTable(
        f"F̄ by order, inputs {inputs}: mean of the flights, bold where it saturates; and the order of each flight",
        ("system", *(f"n = {order}" for order in ORDERS), "each flight"),
        tuple(rows),
    )


def _curves(by_inputs: dict[str, Array]) -> Figure:
    figure, panels = plt.subplots(2, len(by_inputs), figsize=(10, 5.6), sharex=True, sharey="row", squeeze=False)
    colours = ("#9467bd", "#d99a00", "#d9534f", "#3f80d0")
    for (whole, near), (inputs, own) in zip(panels.T, by_inputs.items(), strict=True):
        for system, rows, colour in zip(SYSTEMS, own, colours, strict=True):
            mean = rows.mean(axis=0)
            whole.plot(ORDERS, mean / 1e9, ".-", color=colour, label=f"system {system}")
            whole.fill_between(
                ORDERS, rows.min(axis=0) / 1e9, rows.max(axis=0) / 1e9, color=colour, alpha=0.18, linewidth=0
            )
            whole.plot(system, mean[system - 1] / 1e9, "s", color=colour, markersize=7)
            below = np.maximum(np.nanmax(mean) - mean, MIN_DRAWN_NATS)
            near.plot(ORDERS, below, ".-", color=colour)
            near.plot(system, below[system - 1], "s", color=colour, markersize=7)
        near.set_yscale("log")
        whole.set_title(f"inputs {inputs}")
        near.set(xlabel="order of the model, n", xticks=ORDERS)
    panels[1, 0].invert_yaxis()
    panels[0, 0].set_ylabel("F̄, 10⁹ nats")
    panels[1, 0].set_ylabel("nats below the maximum")
    panels[0, -1].legend(loc="lower right")
    return figure


ITEM = Item(ORDER, run)
