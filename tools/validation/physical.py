#!/usr/bin/env python
"""Physical parameters compared with the truth of simulated flights, and of a Crazyflie.

"Inside" is the share of 90 % intervals that hold the truth. Progress and what is refused go to standard error.

The simulated flights are of each vehicle in each wind with each steering; rate and autopilot take turns, and three
flights in ten have another thrust curve, lag, inertia and battery.

Usage: tools/validation/physical.py simulated|crazyflie [--seed N] [--every K]
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle, product
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from mavdem import Flight
from mavdem.confidence import LEVEL, quantile
from mavdem.dem import NotIdentifiable, Physical, WindTorque, physical
from mavdem.dem.graybox.wind import wind
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable, Unreadable
from mavdem.ingest.vocabulary import IN_AIR
from mavdem.paper.runner import SHARED, logged
from mavdem.report.blocks import Sentence, Table, markdown
from sitl_scenarios.files import scenario_of
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

Array = NDArray[np.float64]

PARAMETERS = ("effect", "damping", "lag")
# and how it marks an estimate
STATUSES = {"reported": "", "biased": " (biased)", "not identifiable": " (no)"}
SPEEDS = {"iris": 1.0, "ardrone2": 0.6, "crazyflie": 0.3}  # of the winds, relative to those below
FLOWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
WINDS = tuple(FLOWN["winds"])
STEERING: dict[str, dict[str, Any]] = FLOWN["steering"]
SCALED = ("speed", "sd", "wind_at_20_feet")  # with the vehicle's of ``SPEEDS``
MOMENTS = {"iris": 0.05, "ardrone2": 0.006, "crazyflie": 2e-5}  # N m, sd
RATES = (50.0, 100.0, 200.0)  # Hz
AXES = {"roll": ("gyro.x", [-1.0, -1.0, 1.0, 1.0]), "pitch": ("gyro.y", [-1.0, 1.0, 1.0, -1.0])}


class Case(NamedTuple):
    vehicle: str
    wind: str
    steering: str
    rate: float
    autopilot: str
    varied: dict[str, float]
    seed: int


def cases(seed: int, every: int = 1) -> list[Case]:
    """Every vehicle in every wind with every steering, or one of ``every`` so many drawn by seed."""
    rng = np.random.default_rng(seed)
    places = list(product(SPEEDS, WINDS))
    kept = len(places) // every
    # Steering, and rates with autopilots, take turns: a part of the bank has as many of each.
    drawn = [
        [(*places[number], one) for number in rng.permutation(len(places))[:kept]]
        for one in STEERING
    ]
    turns = [case for some in zip(*drawn, strict=True) for case in some]
    return [
        Case(vehicle, wind, steering, *stream, _varied(rng), int(rng.integers(1_000_000)))
        for (vehicle, wind, steering), stream in zip(
            turns, cycle(product(RATES, ("px4", "ardupilot"))), strict=False
        )
    ]


def _varied(rng: np.random.Generator) -> dict[str, float]:
    """Of three flights in ten what differs from the published vehicles."""
    drawn = varied(rng)
    return drawn if rng.random() < 0.3 else {}


def varied(rng: np.random.Generator) -> dict[str, float]:
    """Thrust curve, lag, inertia and battery that are not the published ones."""
    up = float(rng.uniform(0.015, 0.06))
    return {
        "quadratic_thrust": float(rng.uniform(0.3, 1.0)),
        "lag_up": up,
        "lag_down": up * float(rng.uniform(1.0, 2.0)),
        "inertia_scale": float(rng.uniform(0.7, 1.6)),
        "battery_sag": float(rng.uniform(0.0, 0.15)),
    }


def scenario(case: Case) -> Scenario:
    values = {
        "duration": 60.0,
        "seed": case.seed,
        "height": 1.5 if case.wind == "jet" else 8.0,
        "vehicle": {"model": case.vehicle, **case.varied},
        "wind": _scaled(FLOWN["winds"][case.wind], SPEEDS[case.vehicle]),
        "moments": _scaled(FLOWN["moments"].get(case.wind, []), MOMENTS[case.vehicle]),
        "stream": {"rate": case.rate, "autopilot": case.autopilot},
    }
    steering = STEERING[case.steering]
    return scenario_of(values | ({"excitation": steering} if steering else {}))


def _scaled(sections: Sequence[dict[str, Any]], factor: float) -> list[dict[str, Any]]:
    return [one | {name: factor * one[name] for name in SCALED if name in one} for one in sections]


def truth_of(motion: Motion, of: Scenario, part: Flight) -> dict[str, Any]:
    """Each motor's effect (r,) at the trim of ``part``, damping (1/s) and lag (s), the mean of up and down."""
    within = (motion.time >= part.time[0]) & (motion.time <= part.time[-1])
    landed = np.where(within & (motion.landed_state == IN_AIR), IN_AIR, 1).astype(np.uint8)
    known = truth(of, replace(motion, landed_state=landed))
    turning = np.interp(part.time, motion.time, known["roll_disturbance"])
    damping = -float(known["roll_A"][1, 1])
    lag = known["lag"][0]
    return {"effect": known["roll_effect"], "damping": damping, "lag": lag, "wind": turning}


log = partial(click.echo, err=True)


def table(title: str, heads: list[str], rows: list[list[str]]) -> None:
    click.echo(markdown([Sentence(title), Table(heads, rows, words=True)]) + "\n")


def estimate_of(found: Physical, name: str) -> tuple[float, float]:
    """Of the mean effect, damping or lag, and the half width of its interval, NaN where it is not identifiable."""
    if name == "effect":
        return found.mean_effect(LEVEL)
    return float(getattr(found, name)), float(getattr(found.interval(LEVEL), name))


def parts_of(flight: Flight) -> dict[int | None, Flight]:
    size = round(7.0 / flight.dt)
    return {None: flight} | {
        i: flight[i * size : (i + 1) * size] for i in range(len(flight) // size)
    }


class Estimate(NamedTuple):
    """What physical parameters of one window, or of a whole flight, are, and what they should be."""

    case: Case
    window: int | None
    found: Physical
    true: dict[str, Any]
    torque: WindTorque | None  # of a whole flight

    def error(self, name: str) -> tuple[float, float]:
        """Of the mean effect, damping or lag, and the half width of its interval; both relative to the truth."""
        value, half = estimate_of(self.found, name)
        true = float(np.abs(self.true["effect"]).mean() if name == "effect" else self.true[name])
        return value / true - 1, half / true


def estimates(bank: Sequence[Case]) -> Iterator[Estimate]:
    for number, case in enumerate(bank, start=1):
        log(f"{number} of {len(bank)}")
        try:
            of = scenario(case)
            flight = logged(of)
            motion = fly(of)
        except (NotLearnable, Unreadable) as reason:
            log(f"{case}: refused: {reason}")
            continue
        for window, part in parts_of(flight).items():
            found = physical(part)
            if isinstance(found, NotIdentifiable):
                log(f"{case}: refused: {found.reason}")
                continue
            torque = wind(found, Record.of(part)) if window is None else None
            yield Estimate(case, window, found, truth_of(motion, of, part), torque)


GROUPS: dict[str, Callable[[Case], bool]] = {
    **{name: lambda case, name=name: case.steering == name for name in STEERING},  # type: ignore[misc]
    "multisine, 3°, 100 Hz or more": lambda case: (
        case.steering.startswith("multisine") and case.rate >= 100
    ),
    "all": lambda case: True,
    **{f"all, {rate:.0f} Hz": lambda case, rate=rate: case.rate == rate for rate in RATES},  # type: ignore[misc]
    "all, thrust curve, lag, inertia and battery varied": lambda case: bool(case.varied),
}


def share(of: Iterable[Any]) -> str:
    found = list(of)
    return f"{np.mean(found):.0%}" if found else "–"


def by_steering(name: str, every: Sequence[Estimate]) -> list[list[str]]:
    rows = []
    for label, belongs in GROUPS.items():
        for whole in (False, True):
            some = [each for each in every if belongs(each.case) and (each.window is None) == whole]
            if not some:
                continue
            row = [label, "flights" if whole else "7 s", str(len(some))]
            row += [
                share(each.found.status[name] == status for each in some) for status in STATUSES
            ]
            reported, biased, _ = (
                [each for each in some if each.found.status[name] == one] for one in STATUSES
            )
            if name == "effect":
                by_motor = [
                    (each.found.effect - each.true["effect"], each.found.interval(LEVEL))
                    for each in reported
                ]
                row.append(
                    share(held for error, half in by_motor for held in abs(error) <= half.effect)
                )
            known, doubted = (
                np.reshape([each.error(name) for each in of], (-1, 2)) for of in (reported, biased)
            )
            row.append(share(abs(known[:, 0]) <= known[:, 1]))
            errors = known[:, 0]
            row += (
                [f"{np.median(errors):+.0%}", f"{errors[np.argmax(abs(errors))]:+.0%}"]
                if reported
                else ["–", "–"]
            )
            rows.append([*row, share(abs(doubted[:, 0]) <= doubted[:, 1])])
    return rows


def by_wind(label: str, every: Sequence[Estimate]) -> list[str]:
    """A row of the wind torque: how often intervals and band hold the truth."""
    pairs = [
        (each.torque, each.true["wind"]) for each in every if each.torque and each.torque.resolved
    ]
    halves = [quantile(LEVEL) * torque.scale_error * torque.sd for torque, _ in pairs]
    sizes = share(
        abs(torque.sd - true.std()) <= half
        for (torque, true), half in zip(pairs, halves, strict=True)
    )
    means = share(abs(torque.mean - true.mean()) <= torque.mean_band for torque, true in pairs)
    course = share(
        held for torque, true in pairs for held in np.abs(torque.torque - true) <= torque.band
    )
    return [label, str(len(pairs)), sizes, means, course]


def simulated(seed: int, every: int) -> None:
    """Share that is reported, and how often intervals hold the truth, by steering."""
    found = list(estimates(cases(seed, every)))
    click.echo(f"{len({each.case.seed for each in found})} flights, seed {seed}.\n")
    heads = ["steering", "of", "number", *STATUSES]
    ends = ["median error of the reported", "worst", "inside, where biased"]
    for name in PARAMETERS:
        insides = ["inside, each motor", "inside, mean"] if name == "effect" else ["inside"]
        table(f"**{name.capitalize()}**", [*heads, *insides, *ends], by_steering(name, found))
    heads = ["effect", "flights", "standard deviation inside", "mean inside", "course inside"]
    rows = [
        by_wind(status, [each for each in found if each.found.status["effect"] == status])
        for status in STATUSES
    ]
    table("**Wind torque**, where it is resolved", heads, rows)


def row_of(label: Sequence[str], flight: Flight) -> list[str]:
    """A row of a table without a truth: estimates with their intervals, marked unless they are reported."""
    row = [*label, f"{flight.dt * len(flight):.0f}", f"{1 / flight.dt:.0f}"]
    found = physical(flight)
    if isinstance(found, NotIdentifiable):
        return [*row, found.reason.advised, *[""] * 5]
    for name in PARAMETERS:
        value, half = ((1e3 if name == "lag" else 1.0) * one for one in estimate_of(found, name))
        width = f" ± {half:.2g}" if np.isfinite(half) else ""
        row.append(f"{value:.3g}{width}{STATUSES[found.status[name]]}")
    more = ", ".join(f"{name} {value:.2f}" for name, value in found.refinements.items())
    return [*row, f"{found.wind_share:.0%}", f"{found.wind:.2g}", more]


def usdlog(path: Path) -> NDArray[Any]:
    """Rows of a Crazyflie's log, version 2, of one kind of event; ``time`` in µs, other columns as logged."""
    content = path.read_bytes()
    variables = list(re.finditer(rb"([\w.]+)\((\w)\)\0", content[:1000]))
    named = [(each[1].decode(), f"<{each[2].decode()}") for each in variables]
    row = np.dtype([("event", "<u2"), ("time", "<u8"), *named])
    begin = variables[-1].end()
    # A checksum, shorter than any row, ends the file.
    return np.frombuffer(content, row, (len(content) - begin) // row.itemsize, begin)


def crazyflie() -> None:
    """A Crazyflie 2.1 with roll and pitch excited, really flown, at three rates."""
    rows = usdlog(SHARED / "real/crazyflie/roll_pitch_excitation.usdlog")
    table_rows = list[list[str]]()
    clock = rows["time"] / 1e6
    for axis, (gyro, directions) in AXES.items():
        for rate in (100.0, 200.0, 400.0):
            time = np.arange(56.0 * rate, 89.0 * rate) / rate  # where it is excited
            motors = [
                np.interp(time, clock, rows[f"motor.m{motor}"] / 65535) for motor in range(1, 5)
            ]
            turning = np.radians(np.interp(time, clock, rows[gyro]))
            flight = Flight(
                time,
                np.stack(motors, 1),
                turning[:, None],
                dt=1 / rate,
                effect_directions=np.array(directions),
            )
            log(f"{axis}, {rate:.0f} Hz")
            table_rows += [
                row_of([axis, "whole"] if window is None else ["", f"7 s, no. {window + 1}"], part)
                for window, part in parts_of(flight).items()
            ]
    heads = [
        "axis",
        "of",
        "s",
        "Hz",
        "effect",
        "damping, 1/s",
        "lag, ms",
        "wind's share",
        "wind, rad/s²",
    ]
    # By published thrust curves and inertia.
    title = "**Crazyflie** (effect in rad/s² per unit of one motor's command; published: 318–403 for roll)"
    table(title, [*heads, "refinements"], table_rows)


@click.command(help=__doc__)
@click.argument("which", type=click.Choice(["simulated", "crazyflie"]))
@click.option("--seed", default=0, show_default=True, help="Of the simulated flights.")
@click.option(
    "--every", default=1, show_default=True, help="One of so many of these, drawn by seed."
)
def main(which: str, seed: int, every: int) -> None:
    if which == "crazyflie":
        crazyflie()
    else:
        simulated(seed, every)


if __name__ == "__main__":
    main()
