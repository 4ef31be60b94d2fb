"""Section V.I of the paper: the free energy F̄ finds the order of the system, for systems of four orders.

Two methods are compared. The model search of ``mavdem order`` fits all orders to the same filtered data, with priors of
one form, so that their F̄ can be compared in nats. The checks are about the order that it chooses. The paper's rule
takes the order at which F̄ of its own fits saturates. The priors of these fits and the data that they use differ
between orders, so that their F̄ has no common scale.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import e
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.dem import learn
from mavdem.dem.order_choice import (
    DEFAULT_MAX_ORDER,
    FlightFreeEnergy,
    OrderChoice,
    free_energy_by_order,
)
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.checks import Check, ExperimentResult, percent
from mavdem.experiments.paper.flights import TRAINING_SAMPLES, settled_hover
from mavdem.experiments.paper.runner import PAPER_SETTINGS, Runner
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import listed, rounded
from sitl_scenarios.files import load
from sitl_scenarios.simulation import fly

SYSTEMS = {1: ("φ̇",), 2: ("φ", "φ̇"), 3: ("ẏ", "φ", "φ̇"), 4: ("y", "ẏ", "φ", "φ̇")}
"""Outputs of the systems of Table I, by number of the system, which is its order: the outputs are its states."""

ALL_OUTPUTS = 4
"""Number of outputs of the flights, the outputs of system 4; each system measures the last of them."""

ORDERS = tuple(range(1, 1 + DEFAULT_MAX_ORDER))
"""Orders of the models that are fitted to each system."""

KNOWN_INPUTS = "known"
"""Name of the fits that know the inputs."""

SETTINGS_BY_INPUTS = {
    "unknown": replace(PAPER_SETTINGS, known_inputs=False, input_precision=e**2),
    KNOWN_INPUTS: PAPER_SETTINGS,
}
"""Settings by whether the model knows the inputs.

Unknown inputs have the prior η = 0 with P = e², as in the paper; known ones are the recorded motors.
"""

CALM_SYSTEMS = (1, 2)
"""Systems whose order is also searched for without wind: with it, they show states of the coloured wind torque."""

NEGLIGIBLE_GAIN = 0.01
"""Gain of F̄ that the paper's rule counts as none, as a share of the range of F̄ over all orders; a choice."""

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
    """The result of one fit with the paper's settings."""

    free_energy: float
    """F̄ at the end of the fit, nats; NaN if the fit failed."""

    failure: str
    """Why the fit failed; empty if it did not."""


class SystemFlight(NamedTuple):
    """A flight of one system, whose order the model search looks for."""

    system: int
    """Number of the system, a key of ``SYSTEMS``."""

    inputs: str
    """Whether the inputs are known, a key of ``SETTINGS_BY_INPUTS``."""

    flight: Flight
    """The hover, with the outputs of this system only."""


def run(runner: Runner) -> ExperimentResult:
    """Checks that the free energy F̄ finds the true order of a system.

    Models of all ``ORDERS`` are fitted to each of four systems, on every simulated hover, with known and with unknown
    inputs: by the model search, whose answer is checked, and by the paper's settings, for its rule beside it. F̄ is
    averaged over the flights.

    Args:
        runner: runs the fits in several processes.

    Returns:
        Checks, a table and a figure; ``numbers`` has F̄ in nats and the orders, by inputs and system.
    """
    flights = runner.map_jobs(lateral_flight, runner.experiment_numbers)
    choices = _order_choices(runner, flights)
    calm_choices = _calm_choices(runner)
    free_energies, failures = _paper_free_energies(runner, flights)
    chosen_orders = {}
    saturation_orders = {}
    for inputs in SETTINGS_BY_INPUTS:
        chosen_orders[inputs] = [choices[inputs, system].chosen for system in SYSTEMS]
        saturation_orders[inputs] = [
            saturation_order(system_values.mean(axis=0)) for system_values in free_energies[inputs]
        ]
    return ExperimentResult(
        checks=order_checks(chosen_orders),
        numbers={
            "orders": list(ORDERS),
            "model_search_chooses": _values_by_system(chosen_orders),
            "model_search_free_energy": _values_by_system(
                {
                    inputs: [choices[inputs, system].free_energy.tolist() for system in SYSTEMS]
                    for inputs in SETTINGS_BY_INPUTS
                }
            ),
            "model_search_without_wind": {
                f"system {system}": choice.free_energy.tolist()
                for system, choice in calm_choices.items()
            },
            "saturates_at": _values_by_system(saturation_orders),
            "free_energy": _values_by_system(
                {inputs: values.tolist() for inputs, values in free_energies.items()}
            ),
            "failures": failures,
        },
        tables=_order_tables(choices, free_energies, saturation_orders),
        pictures=(_free_energy_picture(free_energies),),
        remarks=(
            _sentence_on_calm_flights(calm_choices),
            f"The paper’s rule: an order counts as saturated when no higher one up to {ORDERS[-1]} gains more than "
            f"{percent(NEGLIGIBLE_GAIN)} of the range of F̄ over all orders. It is relative to the scale of the "
            "curve: in nats, higher orders may still gain tens of thousands. A system of order 1 has no lower order to "
            "set the scale.",
        ),
    )


def _order_choices(runner: Runner, flights: Sequence[Flight]) -> dict[tuple[str, int], OrderChoice]:
    """Returns the choices of the model search, by inputs and system.

    Args:
        runner: runs the searches in several processes.
        flights: hovers with the outputs of all systems.

    Returns:
        The choice with known and with unknown inputs for each system, by all flights together.
    """
    searches = []
    for inputs in SETTINGS_BY_INPUTS:
        for system in SYSTEMS:
            for flight in flights:
                searches.append(SystemFlight(system, inputs, _system_flight(flight, system)))
    free_energies = runner.map_jobs(search_orders, searches)
    free_energies_by_case: dict[tuple[str, int], list[FlightFreeEnergy]] = {}
    for search, free_energy in zip(searches, free_energies, strict=True):
        free_energies_by_case.setdefault((search.inputs, search.system), []).append(free_energy)
    choices = {}
    for inputs_and_system, free_energies_of_case in free_energies_by_case.items():
        choices[inputs_and_system] = OrderChoice(tuple(free_energies_of_case))
    return choices


def _calm_choices(runner: Runner) -> dict[int, OrderChoice]:
    """Returns the choices of the model search without wind, with known inputs.

    Args:
        runner: runs the simulations and fits in several processes.

    Returns:
        Choice of the order, with the evidence, for each of ``CALM_SYSTEMS``.
    """
    flights = runner.map_jobs(partial(lateral_flight, has_wind=False), runner.experiment_numbers)
    choices = {}
    for system in CALM_SYSTEMS:
        searches = []
        for flight in flights:
            searches.append(SystemFlight(system, KNOWN_INPUTS, _system_flight(flight, system)))
        choices[system] = OrderChoice(tuple(runner.map_jobs(search_orders, searches)))
    return choices


def _sentence_on_calm_flights(choices: Mapping[int, OrderChoice]) -> str:
    """Returns the sentence on orders without wind, which explains the further states that are found with wind.

    Args:
        choices: choices of the model search without wind, by system.
    """
    findings = []
    for system, choice in choices.items():
        findings.append(
            f"order {choice.chosen} for system {system} (mean F̄ {_listed_means(choice)} nats)"
        )
    sentence = f"Without the blower’s wind the model search chooses {listed(findings)}"
    if any(choice.chosen != system for system, choice in choices.items()):
        return f"{sentence}."
    return (
        f"{sentence}: further states with wind are those of the wind torque, whose noise is coloured and moves the "
        "outputs by itself."
    )


def _listed_means(choice: OrderChoice) -> str:
    """Returns the mean F̄ of each order as a list in one text, nats."""
    return ", ".join(rounded(value, 4) for value in choice.mean)


def _paper_free_energies(
    runner: Runner, flights: Sequence[Flight]
) -> tuple[dict[str, Array], list[str]]:
    """Fits models of all orders with the paper's settings.

    Args:
        runner: runs the fits in several processes.
        flights: hovers with the outputs of all systems.

    Returns:
        The free energy at its maximum, F̄ (systems, flights, orders), nats, by the keys of ``SETTINGS_BY_INPUTS``, which
        say whether the inputs are known; and the reasons why fits failed, each once.
    """
    fits = []
    for inputs in SETTINGS_BY_INPUTS:
        for system in SYSTEMS:
            for flight in flights:
                for order in ORDERS:
                    fits.append(OrderFit(system, inputs, order, flight))
    fitted_orders = runner.map_jobs(fit_order, fits)
    # The results come in the order of the fits, so that each loop above is an axis of the array, from the outermost to
    # the innermost one.
    shape = (len(SETTINGS_BY_INPUTS), len(SYSTEMS), len(flights), len(ORDERS))
    all_free_energies = np.reshape([result.free_energy for result in fitted_orders], shape)
    free_energies = dict(zip(SETTINGS_BY_INPUTS, all_free_energies, strict=True))
    return free_energies, sorted({result.failure for result in fitted_orders if result.failure})


def _values_by_system(values: Mapping[str, list[Any]]) -> JsonValues:
    """Names the values of each system, for the JSON document: lists become dictionaries by the name of the system.

    Args:
        values: a list with one value for each of ``SYSTEMS``, by whether the inputs are "known" or "unknown".

    Returns:
        Dictionaries by the same key, then by system.
    """
    names = [f"system {system}" for system in SYSTEMS]
    named_values = {}
    for inputs, system_values in values.items():
        named_values[inputs] = dict(zip(names, system_values, strict=True))
    return named_values


def lateral_flight(experiment: int, has_wind: bool = True) -> Flight:
    """Simulates one of the paper's flights in front of a blower, and returns the first samples of its hover.

    Args:
        experiment: number of the flight in the paper.
        has_wind: whether the blower is on, as it was in the paper.

    Returns:
        ``TRAINING_SAMPLES`` of the flight, with the lateral position, m, its rate, m/s, the roll angle, rad, and the
        roll rate, rad/s, as outputs.
    """
    scenario = load(f"paper_{experiment}")
    if not has_wind:
        scenario = scenario.model_copy(update={"wind": ()})
    return settled_hover(scenario, fly(scenario))[:TRAINING_SAMPLES]


def search_orders(search: SystemFlight) -> FlightFreeEnergy:
    """Runs the model search of ``mavdem order`` on one flight of a system, up to the largest of ``ORDERS``."""
    return free_energy_by_order(search.flight, ORDERS[-1], search.inputs == KNOWN_INPUTS)


def fit_order(fit: OrderFit) -> FittedFreeEnergy:
    """Fits a model of one order to one system with the paper's settings, and returns its free energy.

    Args:
        fit: the system, the order of the model, the flight, and whether the model knows the inputs.

    Returns:
        The free energy F̄ after the last iteration, nats. A fit that fails has NaN, and the text of the error: one
        failure must not end the experiment.
    """
    settings = replace(SETTINGS_BY_INPUTS[fit.inputs], order=fit.order)
    try:
        with np.errstate(all="ignore"):
            learned = learn(_system_flight(fit.flight, fit.system), settings)
        return FittedFreeEnergy(float(learned.free_energy[-1]), failure="")
    except (ValueError, ArithmeticError) as error:
        return FittedFreeEnergy(float("nan"), failure=str(error))


def _system_flight(flight: Flight, system: int) -> Flight:
    """Returns a flight with the outputs of one system: of n states, the last n of the flight's four outputs."""
    first_output = ALL_OUTPUTS - system
    return Flight(flight.time, flight.inputs, flight.outputs[:, first_output:], dt=flight.dt)


def saturation_order(free_energy: Array) -> int:
    """Returns the order at which F̄ saturates, by the paper's rule.

    It is the lowest order beyond which F̄ gains no more than ``NEGLIGIBLE_GAIN`` of its range.

    Args:
        free_energy: (orders,) F̄ of models of order 1, 2, …, nats; NaN where no model could be fitted, but not
            everywhere.

    Returns:
        The order.
    """
    # An order without a model must not be chosen.
    comparable_values = np.where(np.isnan(free_energy), -np.inf, free_energy)
    finite_values = comparable_values[np.isfinite(comparable_values)]
    threshold = finite_values.max() - NEGLIGIBLE_GAIN * np.ptp(finite_values)
    saturated_indices = np.flatnonzero(comparable_values >= threshold)
    # The first entry is of order 1.
    return int(saturated_indices[0]) + 1


def order_checks(chosen_orders: Mapping[str, list[int]]) -> tuple[Check, ...]:
    """Checks, for each system, that the model search chooses its own order, both with known and with unknown inputs.

    The number of a system is its order.

    Args:
        chosen_orders: chosen order of each of ``SYSTEMS``, by whether the inputs are known.

    Returns:
        One check for each system.
    """
    checks = []
    for index, system in enumerate(SYSTEMS):
        orders = {inputs: values[index] for inputs, values in chosen_orders.items()}
        if len(set(orders.values())) == 1:
            orders_text = str(next(iter(orders.values())))
        else:
            orders_text = listed(
                f"{order} with {inputs} inputs" for inputs, order in orders.items()
            )
        checks.append(
            Check(
                rule=f"system {system}: F̄ of the model search, averaged over the flights, chooses order {system}, "
                f"with {listed(chosen_orders)} inputs",
                holds=all(order == system for order in orders.values()),
                finding=f"for system {system} F̄ chooses order {orders_text}",
            )
        )
    return tuple(checks)


def _order_tables(
    choices: Mapping[tuple[str, int], OrderChoice],
    free_energies: Mapping[str, Array],
    saturation_orders: Mapping[str, list[int]],
) -> tuple[Block, ...]:
    """Returns the table of the orders by the model search and by the paper's rule, with a sentence that explains it.

    The table has a row for each system with known and with unknown inputs.

    Args:
        choices: choices of the model search, by inputs and system.
        free_energies: F̄ of the paper's fits (systems, flights, orders), nats, by inputs.
        saturation_orders: orders by the paper's rule, for each of ``SYSTEMS``, by inputs.

    Returns:
        The sentence and the table.
    """
    rows = []
    for inputs in SETTINGS_BY_INPUTS:
        for index, system in enumerate(SYSTEMS):
            choice = choices[inputs, system]
            paper_means = free_energies[inputs][index].mean(axis=0)
            # The number of a system is its order, and the first column has order 1.
            surplus = np.nanmax(paper_means) - paper_means[system - 1]
            rows.append(
                [
                    str(system),
                    inputs,
                    str(choice.chosen),
                    _listed_means(choice),
                    str(saturation_orders[inputs][index]),
                    rounded(surplus, 3),
                ]
            )
    headings = [
        "system, its order",
        "inputs",
        "model search",
        f"its F̄ of orders {ORDERS[0]} to {ORDERS[-1]}, nats",
        "paper’s rule",
        "best order’s F̄ above the true one’s by the paper’s settings, nats",
    ]
    introduction = Sentence(
        "The model search fits all orders to the same data, with priors of one form, and takes the lowest order "
        "that no higher one beats by strong evidence. The paper’s settings give each order its own prior, and its rule "
        "takes the order at which F̄ saturates, relative to its range."
    )
    return introduction, Table(headings, rows)


def _free_energy_picture(free_energies: Mapping[str, Array]) -> Picture:
    """Returns the figure of the free energy F̄ by model order, a panel for known and one for unknown inputs.

    A panel has a line for each system: how far F̄, as the mean of the flights, is below that of the best order. The
    axis is logarithmic, and the distance is drawn as ``MIN_NATS_SHOWN`` at the best order itself, where it is 0.

    Args:
        free_energies: F̄ (systems, flights, orders), nats, by "known" and "unknown", what the inputs are.
    """
    panels = {}
    for inputs, values_by_system in free_energies.items():
        curves = {}
        for system, system_values in zip(SYSTEMS, values_by_system, strict=True):
            curves[f"system {system}"] = _nats_below_maximum(system_values)
        panels[f"inputs {inputs}"] = curves
    return Picture(
        "F̄ of the paper’s settings below its maximum by model order, nats",
        "Of the converged fit, mean of the flights; 1000 nats at least, where the maximum is.",
        partial(figures.draw_lines, panels, "order of the model, n", first_x=1, scale="log"),
    )


def _nats_below_maximum(free_energy: Array) -> Array:
    """Returns how far F̄ of each order, averaged over the flights, lies below that of the best order, nats.

    Args:
        free_energy: F̄ (flights, orders), nats; NaN where no model could be fitted.

    Returns:
        (orders,) differences, at least ``MIN_NATS_SHOWN``, since a logarithmic axis cannot show 0.
    """
    mean_over_flights = free_energy.mean(axis=0)
    distance_below_best = np.nanmax(mean_over_flights) - mean_over_flights
    return np.maximum(distance_below_best, MIN_NATS_SHOWN)
