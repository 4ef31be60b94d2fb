"""Section V.I of the paper: the free energy F̄ saturates at the order of the system, for systems of four orders."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from math import e
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem import learn
from mavdem.dem.order_choice import DEFAULT_MAX_ORDER
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.checks import Check, ExperimentResult, percent
from mavdem.experiments.paper.flights import TRAINING_SAMPLES, settled_hover
from mavdem.experiments.paper.runner import PAPER_SETTINGS, Runner
from mavdem.flight import Flight
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import listed
from sitl_scenarios.files import load
from sitl_scenarios.simulation import fly

SYSTEMS = {1: ("φ̇",), 2: ("φ", "φ̇"), 3: ("ẏ", "φ", "φ̇"), 4: ("y", "ẏ", "φ", "φ̇")}
"""Outputs of the systems of Table I, by number of the system, which is its order: the outputs are its states."""

ALL_OUTPUTS = 4
"""Number of outputs of the flights, those of system 4; each system measures the last of them."""

ORDERS = tuple(range(1, 1 + DEFAULT_MAX_ORDER))
"""Orders of the models that are fitted to each system."""

SETTINGS_BY_INPUTS = {
    "unknown": replace(PAPER_SETTINGS, known_inputs=False, input_precision=e**2),
    "known": PAPER_SETTINGS,
}
"""Settings by whether the model knows the inputs.

Unknown inputs have the prior η = 0 with P = e², as in the paper; known ones are the recorded motors.
"""

NEGLIGIBLE_GAIN = 0.01
"""Gain of F̄ that counts as none, as a share of the range of F̄ over all orders; a choice."""

MIN_NATS_SHOWN = 1e3
"""Nats below the maximum that the figure shows at least: its axis is logarithmic, and the maximum itself is at 0."""


class OrderFit(NamedTuple):
    """A model to fit: of one order, to one system, on one flight."""

    system: int
    """Number of the system, a key of ``SYSTEMS``."""

    inputs: str
    """Whether the inputs are known, a key of ``SETTINGS_BY_INPUTS``."""

    order: int
    """Order of the model."""

    flight: Flight
    """The hover, with the outputs of all systems."""


class FittedFreeEnergy(NamedTuple):
    """The result of one fit."""

    free_energy: float
    """F̄ at the end of the fit, nats; NaN if the fit failed."""

    failure: str
    """Why the fit failed; empty if it did not."""


def run(runner: Runner) -> ExperimentResult:
    """Checks that the free energy F̄ stops rising at the true order of a system.

    Models of all ``ORDERS`` are fitted to each of four systems, on every simulated hover, with known and with unknown
    inputs. F̄ is averaged over the flights; it saturates at the order beyond which a higher one gains next to nothing.

    Args:
        runner: runs the fits in several processes.

    Returns:
        Checks and a figure; ``numbers`` has F̄ in nats and the order of saturation, by inputs and system.
    """
    flights = runner.map_jobs(lateral_flight, runner.experiment_numbers)
    fits = []
    for inputs in SETTINGS_BY_INPUTS:
        for system in SYSTEMS:
            for flight in flights:
                for order in ORDERS:
                    fits.append(OrderFit(system, inputs, order, flight))
    # The results come in the order of the fits, so that they can be put into an array of the four loops' axes.
    results = runner.map_jobs(fit_order, fits)
    shape = (len(SETTINGS_BY_INPUTS), len(SYSTEMS), len(flights), len(ORDERS))
    all_free_energies = np.reshape([result.free_energy for result in results], shape)
    # Each array is (systems, flights, orders).
    free_energies = dict(zip(SETTINGS_BY_INPUTS, all_free_energies, strict=True))
    saturation_orders = {}
    for inputs, values in free_energies.items():
        saturation_orders[inputs] = [
            saturation_order(system_values.mean(axis=0)) for system_values in values
        ]
    system_names = [f"system {system}" for system in SYSTEMS]
    return ExperimentResult(
        checks=order_checks(saturation_orders),
        numbers={
            "orders": list(ORDERS),
            "free_energy": {
                inputs: dict(zip(system_names, values.tolist(), strict=True))
                for inputs, values in free_energies.items()
            },
            "saturates_at": {
                inputs: dict(zip(system_names, orders, strict=True))
                for inputs, orders in saturation_orders.items()
            },
            "failures": sorted({result.failure for result in results if result.failure}),
        },
        pictures=(_free_energy_picture(free_energies),),
        remarks=(
            f"An order counts as saturated when no higher one up to {ORDERS[-1]} gains more than "
            f"{percent(NEGLIGIBLE_GAIN)} of the range of F̄ over all orders. "
            f"The rule is relative to the scale of the curve: in nats, higher "
            f"orders may still gain tens of thousands. A system of order 1 has no lower order to set the scale.",
        ),
    )


def lateral_flight(experiment: int) -> Flight:
    """Simulates an experiment and returns the first 700 samples of its hover, with y, ẏ, φ and φ̇ as outputs."""
    scenario = load(f"paper_{experiment}")
    return settled_hover(scenario, fly(scenario))[:TRAINING_SAMPLES]


def fit_order(fit: OrderFit) -> FittedFreeEnergy:
    """Fits a model of one order to one system, and returns its free energy.

    The flight has four outputs. A system of order n measures the last n of them, which are its states, so only those
    are given to the model.

    Args:
        fit: the system, the order of the model, the flight, and whether the model knows the inputs.

    Returns:
        The free energy F̄ after the last iteration, nats. A fit that fails has NaN, and the text of the error: one
        failure must not end the experiment.
    """
    flight = fit.flight
    first_output = ALL_OUTPUTS - fit.system
    system_flight = Flight(
        flight.time, flight.inputs, flight.outputs[:, first_output:], dt=flight.dt
    )
    settings = replace(SETTINGS_BY_INPUTS[fit.inputs], order=fit.order)
    try:
        with np.errstate(all="ignore"):
            learned = learn(system_flight, settings)
        return FittedFreeEnergy(float(learned.free_energy[-1]), failure="")
    except (ValueError, ArithmeticError) as error:
        return FittedFreeEnergy(float("nan"), failure=str(error))


def saturation_order(free_energy: Array) -> int:
    """Returns the lowest order beyond which F̄ no longer gains more than ``NEGLIGIBLE_GAIN`` of its range.

    Args:
        free_energy: F̄ of models of order 1, 2, …, nats; NaN where no model could be fitted, but not everywhere.
    """
    known_free_energy = np.where(np.isnan(free_energy), -np.inf, free_energy)
    finite = known_free_energy[np.isfinite(known_free_energy)]
    threshold = finite.max() - NEGLIGIBLE_GAIN * np.ptp(finite)
    saturated_indices = np.flatnonzero(known_free_energy >= threshold)
    return int(saturated_indices[0]) + 1


def order_checks(saturation_orders: Mapping[str, list[int]]) -> tuple[Check, ...]:
    """Checks, for each system, that F̄ saturates at its own order, both with known and with unknown inputs.

    The number of a system is its order.

    Args:
        saturation_orders: by whether the inputs are known, the order at which F̄ saturates, for each of ``SYSTEMS``.
    """
    checks = []
    for index, system in enumerate(SYSTEMS):
        orders = {inputs: values[index] for inputs, values in saturation_orders.items()}
        if len(set(orders.values())) == 1:
            orders_text = str(next(iter(orders.values())))
        else:
            orders_text = listed(
                f"{order} with {inputs} inputs" for inputs, order in orders.items()
            )
        checks.append(
            Check(
                f"system {system}: F̄, averaged over the flights, saturates at order {system}, with "
                f"{listed(saturation_orders)} inputs",
                all(order == system for order in orders.values()),
                f"F̄ of system {system} saturates at order {orders_text}",
            )
        )
    return tuple(checks)


def _free_energy_picture(free_energies: Mapping[str, Array]) -> Picture:
    """Returns the figure of F̄ by model order, a panel for known and one for unknown inputs.

    What is drawn is the distance below the maximum over all orders, the mean of the flights, on a logarithmic axis.

    Args:
        free_energies: F̄ (systems, flights, orders), nats, by whether the inputs are known.
    """
    panels = {}
    for inputs, values in free_energies.items():
        lines = {}
        for system, system_values in zip(SYSTEMS, values, strict=True):
            lines[f"system {system}"] = _nats_below_maximum(system_values)
        panels[f"inputs {inputs}"] = lines
    return Picture(
        "F̄ below its maximum by model order, nats",
        "Of the converged fit, mean of the flights; 1000 nats at least, where the maximum is.",
        partial(figures.draw_lines, panels, "order of the model, n", first=1, scale="log"),
    )


def _nats_below_maximum(free_energy: Array) -> Array:
    """Returns how far F̄, averaged over the flights, lies below its maximum over orders, nats.

    Args:
        free_energy: F̄ (flights, orders), nats.

    Returns:
        (orders,) differences, at least ``MIN_NATS_SHOWN``.
    """
    mean = free_energy.mean(axis=0)
    return np.maximum(np.nanmax(mean) - mean, MIN_NATS_SHOWN)
