#!/usr/bin/env python
"""Gains that are advised, judged by the truth of simulated flights.

Vehicles of 0.4 to 5 kg have rotors with lags of 15 to 70 ms, sensors with delays of 0 to 12 ms, and gains about those
that suit them, of either autopilot. The plant is identified from a steered flight (roll); or its posterior is made up
about the truth, as wide as flights at the same rate leave it (roll, pitch and yaw). The goal is that of --margins, in
the rate and the attitude loop. The lean is that in the wind's torque, by the gains advised over those of the log.

Usage: tools/validation/advice.py [--seed N] [--vehicles N] [--margins NAME]
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from mavdem.alignment.drive import AXES
from mavdem.condition.loop.advice import advise
from mavdem.condition.loop.controllers import controller_of
from mavdem.condition.loop.from_flight import DRAWS, LEAST, loop_of
from mavdem.condition.loop.loop import TARGETS, Loop, Target
from mavdem.dem import NotIdentifiable, physical
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.paper.runner import logged
from mavdem.report.blocks import Sentence, Table, markdown
from sitl_scenarios.files import scenario_of
from sitl_scenarios.gains import cycle_of, parameters_of
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import loops, truth

FLOWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
EFFECTS = 1.0, 1.2, 1.44
"""Of the flight's control effectiveness: 1.44 is by 20 % more volts."""
SPLITS = {50.0: 4e-3, 100.0: 2.4e-3, 200.0: 0.7e-3, 400.0: 0.7e-3}
"""Hz, and the standard deviation, s, of the delay in flights at that rate, its sum with the lag known."""
SD = 0.04, 0.35, 0.0012
"""Of effect and damping, as a share, and of the sum of lag and delay, s."""


class Case(NamedTuple):
    """A loop, and what the truth of it is computed from."""

    kind: str
    loop: Loop
    scenario: Scenario
    effect: Any
    damping: float
    width: float

    def judged(
        self, parameters: dict[str, float], target: Target, factor: float
    ) -> tuple[bool, float]:
        """Whether both loops have the margins with these ``parameters``, and the lean in the wind."""
        own = {**self.scenario.vehicle.parameters, **parameters}
        vehicle = self.scenario.vehicle.model_copy(update={"parameters": own})
        of = self.scenario.model_copy(update={"vehicle": vehicle})
        axis = self.loop.axis
        found = loops(of, cycle_of(of), AXES.index(axis), self.damping, factor * self.effect)
        margins = np.array([found[f"{axis}_{name}_margins"] for name in ("rate", "attitude")])
        phase, gain = np.nanmin(margins[:, 1:3], axis=0)
        met = phase >= target.phase_margin and not gain < target.gain_margin
        frequency = found["loop_frequency"]
        s = 2j * np.pi * frequency
        turned = 1 / (s * (s + self.damping))
        for name in ("rate", "attitude"):
            turned = turned / (1 + found[f"{axis}_{name}_loop"])
        wind = np.exp(-np.square(np.abs(s) * self.width))
        lean = np.trapezoid(np.abs(turned) ** 2 * wind, frequency) ** 0.5
        return bool(met and margins[:, 3].max() <= target.ms), float(lean)


def scenarios(seed: int, vehicles: int) -> Iterator[Scenario]:
    """Steered flights whose gains are about those that suit the vehicle."""
    for number in range(vehicles):
        rng = np.random.default_rng([seed, number])
        lag = rng.uniform(0.015, 0.06)
        rate = rng.choice(list(SPLITS))
        flown = FLOWN["vehicles"][number % 3]
        lags = {"lag_up": lag, "lag_down": lag * rng.uniform(1.0, 1.3)}
        autopilot = ("px4", "ardupilot")[number % 2]
        values = FLOWN["flight"] | {
            "seed": int(rng.integers(1_000_000)),
            "sensors": {"delay": rng.uniform(0.0, 0.012)},
            "moments": [{"sd": flown["moment"], "s": rng.uniform(0.05, 0.3)}],
            "stream": {"autopilot": autopilot, "rate": rate, "rates": {"ATTITUDE_TARGET": rate}},
        }
        vehicle = flown["vehicle"] | lags
        suited = scenario_of(values | {"vehicle": vehicle})
        suits = parameters_of(suited, cycle_of(suited))
        usual = FLOWN[autopilot]
        gains = dict(usual["filters"])
        hotter = np.exp(rng.uniform(0.3, 1.9))
        for name, ratios in usual["rate"].items():
            for letter, ratio in zip("PID", ratios, strict=True):
                varied = np.exp(rng.normal(0.0, 0.3))
                gains[name + letter] = float(suits[f"{name}P"] * hotter * ratio * varied)
        for name, angle in usual["angle"].items():
            gains[name] = float(angle * np.exp(rng.normal(0.0, 0.2)))
        yield scenario_of(values | {"vehicle": vehicle | {"parameters": gains}})


def cases(scenario: Scenario) -> Iterator[Case]:
    """The identified loop of a flight, and those with a posterior that is made up."""
    record = Record.of(logged(scenario))
    known = truth(scenario, fly(scenario))
    plant = physical(record)
    if isinstance(plant, NotIdentifiable):
        raise NotLearnable(plant.reason)
    loop = loop_of(plant, record)
    rng = np.random.default_rng(scenario.seed)
    width = scenario.moments[0].s
    shares = (known["trim"] - 1000) / 1000
    for axis in AXES:
        effect = known[f"{axis}_effect"]
        damping = -float(known[f"{axis}_A"][-1, -1])
        if axis == "roll":
            yield Case("identified", loop, scenario, effect, damping, width)
        controller = controller_of(loop.controller.parameters, axis, effect.tolist())
        # of the estimate about the truth, and of draws about the estimate
        split = SPLITS[scenario.stream.rate]
        errors = rng.standard_normal((DRAWS + 1, 4)) * [*SD, split]
        errors[1:] += errors[0]
        gain = effect @ controller.per_demand(shares.tolist()) * 1000
        gains = gain * np.exp(errors[:, 0])
        damped = damping * np.exp(errors[:, 1])
        delay = float(known["delay"]) + errors[:, 3]
        lag = known["lag"][0] + errors[:, 2] - errors[:, 3]
        draws = np.maximum(np.column_stack([damped, lag, delay]), LEAST)
        made = replace(
            loop, axis=axis, controller=controller, gains=gains, draws=draws, measured=None
        )
        yield Case(f"made up, {axis}", made.changed({}), scenario, effect, damping, width)


class Outcome(NamedTuple):
    """What the truth says of an advice: whether the goal is met and the lean, with each of ``EFFECTS``."""

    labels: tuple[str, ...]
    before: list[tuple[bool, float]]
    after: list[tuple[bool, float]]


def outcome(case: Case, margins: str) -> Outcome | None:
    """None where nothing is advised."""
    found = advise(case.loop, margins, more=True)
    if found.refusals:
        click.echo(f"{case.kind}: {found.sentence}", err=True)
        return None
    before, after = (
        [case.judged(gains, found.target, factor) for factor in EFFECTS]
        for gains in ({}, found.parameters)
    )
    return Outcome((case.kind, found.sentence.code, "all"), before, after)


def row(label: str, found: list[Outcome]) -> list[str]:
    """Of the loops: how many have the margins now, and with the gains advised; their lean."""
    before = np.array([one.before for one in found])
    after = np.array([one.after for one in found])
    met = [before[:, 0, 0].sum(), *after[:, :, 0].sum(axis=0)]
    lean = np.median(after[:, 0, 1] / before[:, 0, 1])
    return [label, str(len(found)), *(f"{number:.0f}" for number in met), f"{lean:.2f}"]


@click.command(help=__doc__)
@click.option("--seed", default=0, show_default=True, help="Of the simulated flights.")
@click.option("--vehicles", default=24, show_default=True, help="How many fly.")
@click.option("--margins", type=click.Choice(list(TARGETS)), default="default", show_default=True)
def main(seed: int, vehicles: int, margins: str) -> None:
    groups = dict[str, list[Outcome]]()
    for scenario in scenarios(seed, vehicles):
        try:
            outcomes = [outcome(case, margins) for case in cases(scenario)]
        except NotLearnable as reason:
            click.echo(f"refused: {reason}", err=True)
            continue
        for found in filter(None, outcomes):
            for label in found.labels:
                groups.setdefault(label, []).append(found)
    heads = ["advice", "loops", "goal met before", "after", "1.2 times", "1.44 times", "lean"]
    rows = [row(label, found) for label, found in groups.items()]
    title = Sentence(f"Seed {seed}, {vehicles} vehicles, margins {margins}.")
    click.echo(markdown([title, Table(heads, rows, words=True)]))


if __name__ == "__main__":
    main()
