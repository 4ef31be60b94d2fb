"""Section V.I: F̄ by model order, on four systems of four orders, with unknown and with known inputs."""

from dataclasses import replace
from functools import partial
from itertools import product
from math import e

import numpy as np

from mavdem.arrays import Array
from mavdem.dem import learn
from mavdem.dem.order_choice import DEFAULT_MAX_ORDER
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.runner import (
    PAPER,
    TRAIN,
    Check,
    ExperimentResult,
    Runner,
    hover,
    percent,
)
from mavdem.flight import Flight
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import listed
from sitl_scenarios.files import load
from sitl_scenarios.simulation import fly

SYSTEMS = {1: ("φ̇",), 2: ("φ", "φ̇"), 3: ("ẏ", "φ", "φ̇"), 4: ("y", "ẏ", "φ", "φ̇")}
"""The outputs of each system, which are its states: Table I."""

ORDERS = tuple(range(1, 1 + DEFAULT_MAX_ORDER))

INPUTS = {"unknown": replace(PAPER, known_inputs=False, input_precision=e**2), "known": PAPER}
"""The prior η = 0 with P = e², as in the paper, and the recorded inputs."""

# share of the range of F̄ over all orders: smaller gains of higher orders do not count
NEGLIGIBLE_SHARE = 0.01


def lateral_flight(experiment: int) -> Flight:
    """Returns the first 700 samples of the hover, with y, ẏ, φ and φ̇ as outputs."""
    scenario = load(f"paper_{experiment}")
    return hover(scenario, fly(scenario))[:TRAIN]


def fit_order(job: tuple[int, str, int, Flight]) -> tuple[float, str]:
    """Fits one order to one system: returns F̄ at the end of the fit, nats, and NaN with the reason where it failed.

    The job is system, inputs, order and the hover of all outputs.
    """
    system, inputs, order, flight = job
    measured = Flight(flight.time, flight.inputs, flight.outputs[:, 4 - system :], dt=flight.dt)
    try:
        with np.errstate(all="ignore"):
            learned = learn(measured, replace(INPUTS[inputs], order=order))
        return float(learned.free_energy[-1]), ""
    except (ValueError, ArithmeticError) as error:
        return float("nan"), str(error)


def saturates_at(free_energy: Array) -> int:
    """Returns the lowest order, from 1, beyond which none gains more than ``NEGLIGIBLE_SHARE`` of the range of F̄."""
    energy = np.where(np.isnan(free_energy), -np.inf, free_energy)
    finite = energy[np.isfinite(energy)]
    enough = energy >= finite.max() - NEGLIGIBLE_SHARE * np.ptp(finite)
    return int(np.flatnonzero(enough)[0]) + 1


def run(runner: Runner) -> ExperimentResult:
    """Fits models of each order to each system and finds where F̄ saturates."""
    numbers = runner.numbers
    flights = runner.each(lateral_flight, numbers)
    jobs = [
        (system, inputs, order, flight)
        for inputs, system, flight, order in product(INPUTS, SYSTEMS, flights, ORDERS)
    ]
    values, failures = zip(*runner.each(fit_order, jobs), strict=True)
    shape = (len(INPUTS), len(SYSTEMS), len(numbers), len(ORDERS))
    by_inputs = dict(zip(INPUTS, np.reshape(values, shape), strict=True))
    saturation = {
        inputs: [saturates_at(rows.mean(axis=0)) for rows in table]
        for inputs, table in by_inputs.items()
    }
    systems = [f"system {system}" for system in SYSTEMS]
    below = {
        f"inputs {inputs}": dict(zip(systems, map(_below_maximum, table), strict=True))
        for inputs, table in by_inputs.items()
    }
    return ExperimentResult(
        checks=checks(saturation),
        numbers={
            "orders": list(ORDERS),
            "free_energy": {
                name: dict(zip(systems, table.tolist(), strict=True))
                for name, table in by_inputs.items()
            },
            "saturates_at": {
                name: dict(zip(systems, orders, strict=True)) for name, orders in saturation.items()
            },
            "failures": sorted({failure for failure in failures if failure}),
        },
        pictures=(
            Picture(
                "F̄ below its maximum by model order, nats",
                "Of the converged fit, mean of the flights; 1000 nats at least, where the maximum is.",
                partial(figures.lines, below, "order of the model, n", first=1, scale="log"),
            ),
        ),
        remarks=(
            f"An order counts as saturated when no higher one up to {ORDERS[-1]} gains more than "
            f"{percent(NEGLIGIBLE_SHARE)} of the range of F̄ over all orders. "
            f"The rule is relative to the scale of the curve: in nats, higher "
            f"orders may still gain tens of thousands. A system of order 1 has no lower order to set the scale.",
        ),
    )


def _below_maximum(flights: Array) -> Array:
    """How far the mean over flights is below its maximum, by order, nats; 1000 at least, for a logarithmic axis."""
    mean = flights.mean(axis=0)
    return np.maximum(np.nanmax(mean) - mean, 1e3)


def checks(saturation: dict[str, list[int]]) -> tuple[Check, ...]:
    """Returns whether F̄ saturates at each system's own order, given where it does by inputs and by system."""
    checks_made = []
    for system, *orders in zip(SYSTEMS, *saturation.values(), strict=True):
        kinds = listed(saturation)
        rule = f"system {system}: F̄, averaged over the flights, saturates at order {system}, with {kinds} inputs"
        by_inputs = [
            f"{order} with {inputs} inputs"
            for order, inputs in zip(orders, saturation, strict=True)
        ]
        where = str(orders[0]) if len(set(orders)) == 1 else listed(by_inputs)
        right = all(order == system for order in orders)
        checks_made.append(Check(rule, right, f"F̄ of system {system} saturates at order {where}"))
    return tuple(checks_made)
