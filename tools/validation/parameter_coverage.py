#!/usr/bin/env python
"""Coverage of physical parameters: how often their 90 % intervals hold the truth of simulated flights, by loop gain.

Where the gains of a loop are several times the suitable ones, the noise of the gyro moves the motors from one cycle of
the controller to the next, more quickly than a log has samples. Each scenario of ``SCENARIOS`` is flown with each
multiple of the rate loop's gain, and with several seeds of wind and noise.

Further flights are steered by doublets so hard that motors reach their limits: the effect changes with the command.

With --unsteered, only flights in smooth or turbulent wind that nobody steers are flown: the motors answer the wind.

The flights are split into two halves by a hash of their names. What is chosen is chosen on half A; half B only tests.

Usage: tools/validation/parameter_coverage.py [--seeds N] [--jobs N] [--unsteered]
"""

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click
import numpy as np
import pandas as pd
from flights import Values, command, evaluate_flights, print_table
from physical import true_values

from mavdem import read_flight
from mavdem.errors import NotLearnable
from mavdem.experiments.paper.flights import write_log
from mavdem.facts.identifiability import Status
from mavdem.plant import NotIdentifiable, Physical, physical
from sitl_scenarios.files import load as load_scenario
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

SCENARIOS = (
    "iris_identification",
    "iris_identification_wind",
    "iris_multisine",
    "iris_sticks",
    "ardupilot_steps",
    "first_flight_ardupilot",
)
"""Scenarios that are flown: a vehicle that is steered, in calm air and in wind, under both autopilots."""

GAINS = (1.0, 3.0, 5.0)
"""Multiples of the rate loop's gain that suits the vehicle; at 5 the loop has little margin, and is still stable."""

VARIED_SCENARIO = "iris_doublets"
"""Scenario that flights at the limits of motors and in wind are variants of."""

HARD_DOUBLETS = {"kind": "doublets", "axis": "all", "amplitude": 14.0, "width": 0.1, "period": 1.2}
"""Doublets that drive motors to their limits."""

FLIGHTS_AT_MOTOR_LIMITS = {
    f"{vehicle}, hard doublets": {"vehicle": {"model": vehicle}, "excitation": HARD_DOUBLETS}
    for vehicle in ("iris", "ardrone2", "crazyflie")
}
"""Values by which flights with hard doublets differ from ``VARIED_SCENARIO``, by the name of the case."""

SMOOTH_WIND = [
    {"kind": "steady", "speed": 5.0, "direction": 90.0},
    {"kind": "gaussian", "sd": 1.0, "s": 0.25},
]
"""Wind from the side, with smooth gusts."""

TURBULENT_WIND = [{"kind": "dryden", "speed": 5.0, "direction": 90.0, "wind_at_20_feet": 7.7}]
"""Wind from the side, with turbulence."""

FLIGHTS_IN_WIND = {
    f"{vehicle}, {wind}, {steering}": {
        "vehicle": {"model": vehicle},
        "wind": winds,
        "excitation": excitation,
    }
    for vehicle in ("iris", "ardrone2")
    for wind, winds in (("smooth wind", SMOOTH_WIND), ("turbulence", TURBULENT_WIND))
    for steering, excitation in (("none", None), ("doublets", {"kind": "doublets"}))
}
"""Values by which flights in wind differ from ``VARIED_SCENARIO``, by the name of the case.

Nobody steers them; for comparison, others in the same wind have doublets.
"""

FLIGHT_SECONDS = 45.0
"""Duration of each flight, s."""

FIRST_SEED = 11
"""Seed of the first flight of each kind."""


class Case(NamedTuple):
    """A simulated flight whose parameters are estimated."""

    scenario: str
    """Name of the scenario, or of a case of ``FLIGHTS_AT_MOTOR_LIMITS`` or ``FLIGHTS_IN_WIND``."""

    gain: float
    """Multiple of the rate loop's gain that suits the vehicle; always 1 in those two tables."""

    seed: int
    """Seed of wind and noise."""

    @property
    def half(self) -> str:
        """Half of the flights that this one belongs to: "A" to choose settings on, "B" only to test, by a hash."""
        name = f"{self.scenario} {self.gain:g} {self.seed}"
        return "AB"[hashlib.sha256(name.encode()).digest()[0] % 2]

    def flown_scenario(self) -> Scenario:
        """Returns the scenario that is simulated, with the seed of this case, for ``FLIGHT_SECONDS``.

        It is either a variant of ``VARIED_SCENARIO`` that a table defines, with another vehicle, wind or excitation;
        or the scenario of this name, with the multiple of the rate loop's gain.
        """
        seed_and_duration = {"seed": self.seed, "duration": FLIGHT_SECONDS}
        variants = FLIGHTS_AT_MOTOR_LIMITS | FLIGHTS_IN_WIND
        if self.scenario in variants:
            values = load_scenario(VARIED_SCENARIO).model_dump(mode="json")
            return scenario_from_table(values | variants[self.scenario] | seed_and_duration)
        scenario = load_scenario(self.scenario)
        vehicle_with_gain = scenario.vehicle.model_copy(update={"rate_gain": self.gain})
        return scenario.model_copy(update={"vehicle": vehicle_with_gain, **seed_and_duration})


def cases(seeds: int) -> Iterator[Case]:
    """Yields all flights: each scenario with each gain and each seed, and the flights with strong doublets.

    Args:
        seeds: number of flights of each scenario with each gain.
    """
    yield from _cases_with_one_gain(FLIGHTS_AT_MOTOR_LIMITS, seeds)
    for name in SCENARIOS:
        for gain in GAINS:
            for number in range(seeds):
                yield Case(name, gain, FIRST_SEED + number)


def unsteered_cases(seeds: int) -> Iterator[Case]:
    """Yields the flights of ``FLIGHTS_IN_WIND``.

    Args:
        seeds: number of flights that a scenario of ``SCENARIOS`` has with each gain.
    """
    yield from _cases_with_one_gain(FLIGHTS_IN_WIND, seeds)


def _cases_with_one_gain(names: Iterable[str], seeds: int) -> Iterator[Case]:
    """Yields flights that have the suitable gain only, with as many seeds that their number is that of all gains.

    Args:
        names: names of the cases in ``FLIGHTS_AT_MOTOR_LIMITS`` or ``FLIGHTS_IN_WIND``.
        seeds: number of flights that a scenario of ``SCENARIOS`` has with each gain.
    """
    flights_per_name = len(GAINS) * seeds
    for name in names:
        for number in range(flights_per_name):
            yield Case(name, gain=1.0, seed=FIRST_SEED + number)


class _ComparedParameter(NamedTuple):
    """An estimated physical parameter and its truth, both in its unit."""

    name: str
    """"effect", "damping", "lag" or "delay"."""
    estimate: float
    half_width: float
    """Half width of the 90 % interval of the estimate."""
    truth: float


def interval_rows(plant: Physical, truths: Values, true_delay: float) -> list[Values]:
    """Compares all parameters of a flight with their truth.

    Args:
        plant: estimated control effectiveness, damping, time constant and delay.
        truths: "effect" of each motor (r,), "damping" and "lag", as from :func:`physical.true_values`.
        true_delay: dead time of the control loop from the gyro's measurement to the motors, s.

    Returns:
        A row for each motor's effect, for damping, lag and delay: name of the parameter, status, relative error, and
        whether the 90 % interval holds the truth.
    """
    half_widths = plant.interval()
    parameters = [
        _ComparedParameter("effect", estimate, half_width, truth)
        for estimate, half_width, truth in zip(
            plant.effect, half_widths.effect, truths["effect"], strict=True
        )
    ]
    parameters += [
        _ComparedParameter("damping", plant.damping, half_widths.damping, truths["damping"]),
        _ComparedParameter("lag", plant.lag, half_widths.lag, truths["lag"]),
        _ComparedParameter("delay", plant.delay, half_widths.delay, true_delay),
    ]
    rows = []
    for name, estimate, half_width, truth in parameters:
        # The delay is identified together with the lag, and has no status of its own.
        status_name = "lag" if name == "delay" else name
        row = {
            "parameter": name,
            "status": plant.status[status_name],
            "error": estimate / truth - 1,
            "inside": abs(estimate - truth) <= half_width,
        }
        rows.append(row)
    return rows


def evaluate_case(case: Case) -> list[Values]:
    """Simulates a flight, estimates the physical parameters of roll from its log, and compares them with the truth.

    The simulated flight is written to a telemetry log and read again, so that the estimates are affected by the
    resolution, rates and delays of a log.

    Args:
        case: the flight to simulate.

    Returns:
        The rows of :func:`interval_rows`, one for each parameter, with the fields of the case and its ``half``. Empty
        if the vehicle tumbles, or nothing can be learned or identified from the log; the reason is printed.
    """
    scenario = case.flown_scenario()
    try:
        # A vehicle that tumbles is a ValueError.
        motion = fly(scenario)
        with TemporaryDirectory() as folder:
            log = Path(folder) / "flight.tlog"
            write_log(log, scenario, motion)
            flight = read_flight(log, axis="roll")
    except (NotLearnable, ValueError) as reason:
        click.echo(f"{case}: refused: {reason}", err=True)
        return []
    estimate = physical(flight)
    if isinstance(estimate, NotIdentifiable):
        click.echo(f"{case}: refused: {estimate.reason}", err=True)
        return []
    # The controller holds its output for a cycle, which delays it by half a cycle on average.
    true_delay = scenario.sensors.delay + scenario.cycle / 2
    true_parameters = true_values(motion, scenario, flight)
    rows = interval_rows(estimate, true_parameters, true_delay)
    return [{"half": case.half, **case._asdict(), **row} for row in rows]


def coverage(rows: Any) -> str:
    """Returns how many intervals of reported parameters hold the truth, as "12/13".

    Args:
        rows: rows of :func:`evaluate_case`.
    """
    reported_rows = rows[rows["status"] == Status.REPORTED]
    return f"{reported_rows['inside'].sum()}/{len(reported_rows)}"


def table_row(rows: Any) -> pd.Series:
    """Summarises the intervals of one parameter: how many hold the truth, and the worst error.

    Args:
        rows: rows of :func:`evaluate_case` with this parameter.

    Returns:
        By column: how many intervals of reported estimates hold the truth, as "12/13", in half A of the flights, on
        which settings were chosen, and in half B; the worst relative error of a reported estimate; how many intervals
        of biased estimates hold the truth; and how many estimates are "withheld", since they are not identifiable.
    """
    reported_rows = rows[rows["status"] == Status.REPORTED]
    biased_rows = rows[rows["status"] == Status.BIASED]
    worst_error = max(reported_rows["error"], key=abs, default=np.nan)
    cells = {
        "inside, half A": coverage(rows[rows["half"] == "A"]),
        "inside, half B": coverage(rows[rows["half"] == "B"]),
        "worst error": "–" if np.isnan(worst_error) else f"{worst_error:+.0%}",
        "inside, where biased": f"{biased_rows['inside'].sum()}/{len(biased_rows)}",
        "withheld": (rows["status"] == Status.NOT_IDENTIFIABLE).sum(),
    }
    return pd.Series(cells)


@click.option("--unsteered", is_flag=True, help="Only flights in wind that nobody steers.")
@command(__doc__, seeds=2)
def main(seeds: int, jobs: int, unsteered: bool) -> None:
    """Prints two tables: coverage by gain and parameter, and by vehicle and parameter with motors at their limits.

    Args:
        seeds: number of flights of each scenario with each gain.
        jobs: number of processes.
        unsteered: whether to print the effects in wind, with and without steering, instead.
    """
    if unsteered:
        rows = evaluate_flights(evaluate_case, unsteered_cases(seeds), jobs)
        print_coverage("Effects in wind", rows[rows["parameter"] == "effect"], "scenario")
        return
    rows = evaluate_flights(evaluate_case, cases(seeds), jobs)
    has_hard_doublets = rows["scenario"].isin(FLIGHTS_AT_MOTOR_LIMITS)
    print_coverage("Intervals that hold the truth", rows[~has_hard_doublets], "gain")
    click.echo()
    print_coverage("The same with motors at their limits", rows[has_hard_doublets], "scenario")


def print_coverage(title: str, rows: Any, group_column: str) -> None:
    """Prints a table of coverage, the fraction of the flights in which an interval of a parameter holds the true value.

    It has a row for each parameter in each group of flights, and a last row for all together.

    Args:
        title: title of the table.
        rows: data frame with the rows of :func:`evaluate_case`, one for each parameter of each flight.
        group_column: column by whose values the flights are grouped, "gain" or "scenario".
    """
    flights = rows[["scenario", "gain", "seed"]].drop_duplicates()
    table_rows = rows.groupby([group_column, "parameter"], sort=False).apply(table_row)
    rows_as_one_group = rows.assign(**{group_column: "all"}, parameter="all")
    total_row = rows_as_one_group.groupby([group_column, "parameter"]).apply(table_row)
    table = pd.concat([table_rows, total_row]).reset_index()
    print_table(f"**{title}**, {len(flights)} flights", table)


if __name__ == "__main__":
    main()
