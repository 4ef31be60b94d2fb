#!/usr/bin/env python
"""Dominant poles of the closed loop: against the truth of simulated flights, and in thirds of recorded ones.

The simulated flights are those of ``physical.py``, at 50, 100 and 250 Hz, with the attitude setpoint in the log. The
limits were chosen on those of seed 5. "Inside" is the share of 90 % intervals that hold the truth. Progress, each
estimate and what is not identifiable go to standard error.

Usage: tools/validation/closed_loop.py simulated|recorded [--seed N …] [--every K]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from physical import log, other_logs, table, tried
from physical_flights import Case, cases, scenario

from mavdem import Flight
from mavdem.dem import Physical
from mavdem.dem.closed_loop.response import ClosedLoopResponse, LoopPole, attitude_loop
from mavdem.dem.engine.model import discretize
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable, Unreadable
from mavdem.paper.flights import logged, recorded_flights
from sitl_scenarios.controller import Controller
from sitl_scenarios.files import scenario_of
from sitl_scenarios.linear import axis
from sitl_scenarios.plan import Wanted
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.sensors import Known
from sitl_scenarios.simulation import CYCLES

Array = NDArray[np.float64]

RATES = {50.0: 50.0, 100.0: 100.0, 200.0: 250.0}  # Hz: of the flights of ``physical_flights``, and here
RESPONSE_SECONDS, STEP_SECONDS, KICK = 3.0, 0.01, 0.01  # of the true response; rad/s of the impulse
ROWS, LEAST_SINGULAR = 100, 1e-6  # of the Hankel matrix, and relative, of what is of the response and not rounding
BAND = 0.6, 10.0  # Hz, of the poles that are looked for


def with_setpoints(case: Case) -> Scenario:
    """The scenario of a case, whose log has the attitude setpoint as fast as the attitude."""
    of = scenario(case._replace(rate=RATES[case.rate])).model_dump(mode="json")
    return scenario_of(of | {"stream": of["stream"] | {"rates": {"ATTITUDE_TARGET": RATES[case.rate]}}})


def true_pole(of: Scenario) -> complex:
    """The dominant pole, 1/s, of the linearised vehicle with its autopilot, which holds the attitude.

    By the eigensystem realization (Juang and Pappa, "An eigensystem realization algorithm for modal parameter
    identification and model reduction", Journal of Guidance 8(5), 1985) of the roll's response to an impulse of torque.
    """
    cycle = CYCLES[of.stream.speaks]
    every = round(STEP_SECONDS / cycle)
    response = impulse_response(of, cycle)[::every]
    hankel = np.array([response[start : start + ROWS + 1] for start in range(ROWS)])
    left, sizes, right = np.linalg.svd(hankel[:, :-1])
    order = int(np.sum(sizes > LEAST_SINGULAR * sizes[0]))
    root = np.sqrt(sizes[:order])
    step = (left[:, :order] / root).T @ hankel[:, 1:] @ (right[:order].T / root)
    steps, shapes = np.linalg.eig(step)
    residues = np.abs((left[0, :order] * root) @ shapes * np.linalg.solve(shapes, root * right[:order, 0]))
    poles = np.log(steps.astype(complex)) / (every * cycle)
    frequency = np.abs(poles) / (2 * np.pi)
    weights = residues / np.sqrt(np.abs(poles.real)) * ((frequency > BAND[0]) & (frequency < BAND[1]))
    return complex(poles[np.argmax(weights)])


def impulse_response(of: Scenario, cycle: float) -> Array:
    """(N,) roll, rad, by cycles, after the rate has jumped by ``KICK``; nothing else moves, so no position is held."""
    plant = axis(of.vehicle)
    rank = len(plant.A)
    controller, late = Controller(of.vehicle, cycle, of.sensors.delay), of.sensors.delay / cycle
    whole, height = int(late), of.height
    wanted = Wanted(2, height, 0.0, 0.0)
    step = discretize(plant.A, plant.B, cycle)
    push = step.input_now + step.input_next
    states = [np.zeros(rank) for _ in range(whole + 2)]
    states[-1][1] = KICK
    found = []
    for _ in range(round(RESPONSE_SECONDS / cycle)):
        found.append(states[-1][0])
        share = late - whole
        roll, rate = ((1 - share) * states[-1 - whole] + share * states[-2 - whole])[:2]
        attitude = (float(np.cos(roll / 2)), float(np.sin(roll / 2)), 0.0, 0.0)
        known = Known((0.0, 0.0, -height), (0.0, 0.0, 0.0), attitude, (float(rate), 0.0, 0.0))
        demand = controller.asked(known, wanted, True).demands[0]
        # A demand of 1 is 1000 µs to each motor, with the signs of the effect.
        states = [*states[1:], step.state @ states[-1] + push @ (1000 * demand * np.sign(plant.B[-1]))]
    return np.array(found)


class Tried(NamedTuple):
    """A simulated flight, its true dominant pole (1/s), and what was found."""

    case: Case
    truth: complex
    found: ClosedLoopResponse

    @property
    def frequency(self) -> float:
        """Hz."""
        return abs(self.truth) / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """That of the truth."""
        return -self.truth.real / abs(self.truth)


def simulated_flights(seed: int, every: int) -> Iterator[Tried]:
    """Flies each case of a seed, reads its log and estimates."""
    bank = cases(seed, 1, every)
    for number, case in enumerate(bank, start=1):
        of = with_setpoints(case)
        try:
            flight = logged(of)
        except (NotLearnable, Unreadable) as reason:
            log(f"{case}: refused: {reason}")
            continue
        physical = tried(flight)
        found = attitude_loop(Record.of(flight), physical if isinstance(physical, Physical) else None)
        each = Tried(case._replace(rate=RATES[case.rate]), true_pole(of), found)
        said = ", ".join(map(words, found.poles)) or found.reason
        log(f"{number} of {len(bank)}: {each.case}: truth {each.frequency:.2f} Hz, {each.damping_ratio:.2f}: {said}")
        yield each


def words(pole: LoopPole) -> str:
    """A pole with its intervals."""
    return (
        f"{pole.frequency:.2f} ± {pole.frequency_half:.2f} Hz, {pole.damping_ratio:.2f} ± {pole.damping_ratio_half:.2f}"
    )


GROUPS: dict[str, Callable[[Case], bool]] = {
    "none": lambda case: case.steering == "none",
    "multisine, 3°": lambda case: case.steering == "multisine",
    "doublets, 6°": lambda case: case.steering == "doublets",
    "side steps, 2 m": lambda case: case.steering == "side steps",
    "pilot's sticks, 4°": lambda case: case.steering == "sticks",
    "all, 50 Hz": lambda case: case.rate == 50,
    "all, 100 Hz": lambda case: case.rate == 100,
    "all, 250 Hz": lambda case: case.rate == 250,
    "all": lambda case: True,
}
FIGURES = "error", "largest", "half width", "inside"
HEADS = ("steering", "flights", "reported", *FIGURES, f"damping ratio: {FIGURES[0]}", *FIGURES[1:])


def rows_of(every: Sequence[Tried]) -> list[list[str]]:
    """Of the table of one seed."""
    rows = []
    for name, belongs in GROUPS.items():
        some = [each for each in every if belongs(each.case)]
        known = [(each, each.found.poles[0]) for each in some if each.found.poles]
        row = [name, str(len(some)), f"{len(known) / max(len(some), 1):.0%}"]
        if not known:
            rows.append([*row, *["–"] * 8])
            continue
        of_frequency = np.array([(p.frequency / e.frequency - 1, p.frequency_half / e.frequency) for e, p in known])
        of_ratio = np.array([(p.damping_ratio - e.damping_ratio, p.damping_ratio_half) for e, p in known])
        for errors, form in ((of_frequency, ".0%"), (of_ratio, ".2f")):
            off, half = np.abs(errors).T
            row += [format(np.median(off), form), format(errors[np.argmax(off), 0], "+" + form)]
            row += [format(np.median(half), form), f"{np.mean(off <= half):.0%}"]
        rows.append(row)
    return rows


def simulated(seeds: Sequence[int], every: int) -> None:
    """One table for each seed."""
    for seed in seeds:
        found = list(simulated_flights(seed, every))
        table(f"**Simulated flights, seed {seed}**", HEADS, rows_of(found))
        more = sum(len(each.found.poles) > 1 for each in found)
        click.echo(f"More than one pole is reported in {more} flights; there is one in all of them.\n")


def recorded() -> None:
    """Every recorded flight, whole and in thirds, where there are any (``mavdem.paper.flights.SHARED``)."""
    rows = []
    for name, flight in chain(recorded_flights(), other_logs()):
        log(name)
        size = len(flight) // 3
        whole, *thirds = (response(each) for each in (flight, *(flight[k * size : (k + 1) * size] for k in range(3))))
        said = [", ".join(map(words, each.poles)) or "–" for each in (whole, *thirds)]
        rows.append([name, f"{1 / flight.dt:.0f}", *said, agreement(thirds), whole.reason])
    table(
        "**Recorded flights**: natural frequency and damping ratio",
        ("flight", "Hz", "whole", "1 of 3", "2 of 3", "3 of 3", "thirds agree", "why not"),
        rows,
    )


def response(flight: Flight) -> ClosedLoopResponse:
    """That of a flight, or of a part of one."""
    physical = tried(flight)
    return attitude_loop(Record.of(flight), physical if isinstance(physical, Physical) else None)


def agreement(thirds: Sequence[ClosedLoopResponse]) -> str:
    """Whether dominant poles differ by no more than their intervals together; "–" of fewer than two."""
    known = [each.poles[0] for each in thirds if each.poles]
    if len(known) < 2:
        return "–"
    values = np.array([(pole.frequency, pole.damping_ratio) for pole in known])
    halves = np.array([(pole.frequency_half, pole.damping_ratio_half) for pole in known])
    off = np.abs(values[:, None] - values) / np.hypot(halves[:, None], halves)
    return "yes" if off.max() <= 1 else "no"


@click.command(help=__doc__)
@click.argument("what", type=click.Choice(["simulated", "recorded"]))
@click.option("--seed", "seeds", type=int, multiple=True, default=(5, 6), show_default=True)
@click.option("--every", default=2, show_default=True, help="One of so many flights.")
def main(what: str, seeds: tuple[int, ...], every: int) -> None:
    if what == "simulated":
        simulated(seeds, every)
    else:
        recorded()


if __name__ == "__main__":
    main()
