"""V.I: F̄ by the order of the model, on four systems of four orders, with unknown inputs and with known ones."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import e
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from paper.item import Cell, Found, Item, Picture, Table
from paper.laboratory import PAPER, Laboratory
from paper.published import ORDER
from paper.verdict import Check
from paper.words import listed, number, percent

import mavdem
from mavdem.windows import TRAIN
from sitl_scenarios.attitude import euler
from sitl_scenarios.files import load, scenario_of
from sitl_scenarios.simulation import fly

Array = NDArray[np.float64]

SYSTEMS = {1: ("φ̇",), 2: ("φ", "φ̇"), 3: ("ẏ", "φ", "φ̇"), 4: ("y", "ẏ", "φ", "φ̇")}
"""The outputs of each, which are its states: Table I."""

ORDERS = (1, 2, 3, 4, 5, 6)

INPUTS = {"unknown": replace(PAPER, known_inputs=False, input_precision=e**2), "known": PAPER}
"""η = 0 with P = e², as in the paper, and the recorded ones."""

CLOSE = 1e3
"""Nats below the highest F̄ that are drawn as so many, on a logarithmic scale."""

AFTER_CLIMB = 3.0
"""Seconds of hover that are left out."""


class Climb(NamedTuple):
    """One fit.

    Attributes:
        experiment, system, inputs, order: of which.
        free_energy: F̄ at its end, nats; NaN where it failed.
        failure: why.
    """

    experiment: int
    system: int
    inputs: str
    order: int
    free_energy: float
    failure: str


def lateral_flight(experiment: int, duration: float | None = None) -> mavdem.Flight:
    """y, ẏ, φ and φ̇ as the autopilot knows them over the first 700 samples of the hover, and the motors."""
    scenario = load(f"paper_{experiment}")
    if duration is not None:
        scenario = scenario_of(scenario.model_dump(mode="json") | {"duration": duration})
    motion = fly(scenario)
    first = motion.time[motion.landed_state == 2][0] + AFTER_CLIMB
    time = first + np.arange(TRAIN) / scenario.stream.rate
    roll = np.array([euler(attitude)[0] for attitude in motion.known_attitude.tolist()])
    columns = (motion.known_position[:, 1], motion.known_velocity[:, 1], roll, motion.known_rates[:, 0])
    outputs = [np.interp(time, motion.time, column) for column in columns]
    motors = [np.interp(time, motion.time, column) for column in motion.outputs.T]
    return mavdem.Flight(time, np.column_stack(motors), np.column_stack(outputs), dt=1 / scenario.stream.rate)


def climb(job: tuple[int, int, str, int, mavdem.Flight]) -> Climb:
    experiment, system, inputs, order, flight = job
    own = mavdem.Flight(flight.time, flight.inputs, flight.outputs[:, 4 - system :], dt=flight.dt)
    try:
        with np.errstate(all="ignore"):
            learned = mavdem.learn(own, replace(INPUTS[inputs], order=order))
        return Climb(experiment, system, inputs, order, float(learned.free_energy[-1]), "")
    except (ValueError, ArithmeticError) as error:
        return Climb(experiment, system, inputs, order, float("nan"), str(error))


SATURATED = 0.01
"""Share of the range of F̄ over all orders: higher orders that gain less than it do not count."""


def saturates_at(free_energy: Array) -> int:
    """The lowest order beyond which no higher one gains more than ``SATURATED`` of the range of F̄.

    Args:
        free_energy: by order, from 1 on; NaN where there is none.
    """
    known = np.where(np.isnan(free_energy), -np.inf, free_energy)
    finite = known[np.isfinite(known)]
    enough = known >= finite.max() - SATURATED * np.ptp(finite)
    return int(np.flatnonzero(enough)[0]) + 1


def run(laboratory: Laboratory) -> Found:
    numbers = laboratory.extent.experiments
    flights = dict(
        zip(
            numbers,
            laboratory.each(partial(lateral_flight, duration=laboratory.extent.duration), numbers),
            strict=True,
        )
    )
    jobs = [
        (experiment, system, inputs, order, flights[experiment])
        for inputs in INPUTS
        for system in SYSTEMS
        for experiment in numbers
        for order in ORDERS
    ]
    climbs = laboratory.each(climb, jobs)
    shape = (len(INPUTS), len(SYSTEMS), len(numbers), len(ORDERS))
    table = np.array([one.free_energy for one in climbs]).reshape(shape)
    by_inputs = dict(zip(INPUTS, table, strict=True))
    return Found(
        checks=checks({inputs: _found(own) for inputs, own in by_inputs.items()}),
        numbers={
            "orders": list(ORDERS),
            "free_energy": {
                inputs: {f"system {system}": rows.tolist() for system, rows in zip(SYSTEMS, own, strict=True)}
                for inputs, own in by_inputs.items()
            },
            "saturates_at": {
                inputs: {f"system {system}": found for system, found in zip(SYSTEMS, _found(own), strict=True)}
                for inputs, own in by_inputs.items()
            },
            "failures": sorted({one.failure for one in climbs if one.failure}),
        },
        tables=tuple(_table(inputs, own) for inputs, own in by_inputs.items()),
        pictures=(
            Picture(
                "order-free-energy",
                "F̄ at the end of the climb by the order of the model, mean and range of the flights, as the paper "
                "draws it (above), and how far its mean lies below its highest (below). Squares: the system’s order.",
                partial(_curves, by_inputs),
            ),
        ),
        remarks=(
            f"An order counts as saturated when no higher one up to {ORDERS[-1]} gains more than {percent(SATURATED)} "
            f"of the range of F̄ over all orders. It is a rule for the scale of such a curve: in nats higher orders may "
            f"still gain tens of thousands, and a system of order 1 has no lower order to set the scale.",
        ),
    )


def _found(own: Array) -> list[int]:
    """The order at which the mean over flights saturates, by system."""
    return [saturates_at(rows.mean(axis=0)) for rows in own]


def checks(found: dict[str, list[int]]) -> tuple[Check, ...]:
    """Whether each system's own order is the one at which F̄ saturates.

    Args:
        found: that order, by inputs and by system.
    """
    return tuple(
        Check(
            f"system {system}: F̄, averaged over the flights, saturates at order {system}, with {listed(found)} inputs",
            all(one == system for one in orders),
            f"F̄ of system {system} saturates at order "
            + (str(orders[0]) if len(set(orders)) == 1 else listed(map("{} with {} inputs".format, orders, found))),
        )
        for system, *orders in zip(SYSTEMS, *found.values(), strict=True)
    )


def _table(inputs: str, own: Array) -> Table:
    rows = []
    for system, flights, found in zip(SYSTEMS, own, _found(own), strict=True):
        means = flights.mean(axis=0)
        each = sorted(saturates_at(row) for row in flights)
        cells = [Cell(number(float(mean)), order == found) for order, mean in zip(ORDERS, means, strict=True)]
        rows.append((Cell(f"{system}: [{', '.join(SYSTEMS[system])}]"), *cells, Cell(", ".join(map(str, each)))))
    return Table(
        f"F̄ by order, inputs {inputs}: mean of the flights, bold where it saturates; and where each flight’s does",
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
            below = np.maximum(np.nanmax(mean) - mean, CLOSE)
            near.plot(ORDERS, below, ".-", color=colour)
            near.plot(system, below[system - 1], "s", color=colour, markersize=7)
        near.set_yscale("log")
        whole.set_title(f"inputs {inputs}")
        near.set(xlabel="order of the model, n", xticks=ORDERS)
    panels[1, 0].invert_yaxis()
    panels[0, 0].set_ylabel("F̄, 10⁹ nats")
    panels[1, 0].set_ylabel("nats below the highest")
    panels[0, -1].legend(loc="lower right")
    return figure


ITEM = Item("order", "Model order by free energy", ORDER, run)
