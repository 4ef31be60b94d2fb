#!/usr/bin/env python
"""Physical parameters compared with the truth of simulated flights, and of a Crazyflie; prints tables.

"Inside" is the share of 90 % intervals that hold the truth. Progress, each estimate and what is refused go to standard
error.

The simulated flights are of each vehicle in each wind with each steering; rate and autopilot take turns, and three
flights in ten have another thrust curve, lag, inertia and battery.

Usage: tools/validation/physical.py simulated|crazyflie [--seed N] [--flights N] [--every K]
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from physical_flights import Case, cases, flown

from mavdem import Flight
from mavdem.dem import NotIdentifiable, Physical, physical
from mavdem.errors import NotLearnable, Unreadable
from mavdem.paper.flights import SHARED

Array = NDArray[np.float64]

WINDOW_SECONDS = 7.0
PARAMETERS = ("effect", "damping", "lag")
STATUSES = ("reported", "biased", "not identifiable")
LEVEL = 0.9


log = partial(click.echo, err=True)


def table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    click.echo(f"{title}\n\n| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for row in rows:
        click.echo(f"| {' | '.join(row)} |")
    click.echo()


def estimate_of(found: Physical, name: str) -> tuple[float, float]:
    """Of the mean effect, damping or lag, and the half width of its interval, NaN where it is not identifiable."""
    if name == "effect":
        return found.mean_effect(LEVEL)
    return float(getattr(found, name)), float(getattr(found.interval(LEVEL), name))


def parts_of(flight: Flight) -> dict[int | None, Flight]:
    """The whole flight, and its windows by number."""
    size = round(WINDOW_SECONDS / flight.dt)
    return {None: flight} | {i: flight[i * size : (i + 1) * size] for i in range(len(flight) // size)}


class Estimate(NamedTuple):
    """What physical parameters of one window, or of a whole flight, are, and what they should be."""

    case: Case
    window: int | None
    found: Physical
    true: dict[str, Any]

    def error(self, name: str) -> tuple[float, float]:
        """Of the mean effect, damping or lag, and the half width of its interval; both relative to the truth."""
        value, half = estimate_of(self.found, name)
        true = float(np.abs(self.true["effect"]).mean() if name == "effect" else self.true[name])
        return value / true - 1, half / true

    def inside(self, name: str) -> bool:
        """Whether the interval of the mean effect, damping or lag holds the truth."""
        error, half = self.error(name)
        return abs(error) <= half

    def inside_by_motor(self) -> list[bool]:
        """Whether the interval of each motor's effect does."""
        return list(abs(self.found.effect - self.true["effect"]) <= self.found.interval(LEVEL).effect)

    def __str__(self) -> str:
        errors = [(name, *self.error(name)) for name in PARAMETERS]
        words = [f"{name} {error:+.1%} ± {half:.1%}, {self.found.status[name]}" for name, error, half in errors]
        where = "whole" if self.window is None else f"window {self.window}"
        return f"{self.case} | {where} | {' | '.join(words)} | wind {self.found.wind_share:.0%}"


def estimates(bank: Sequence[Case]) -> Iterator[Estimate]:
    """Of all windows of each flight, and of the whole flight."""
    for number, case in enumerate(bank, start=1):
        log(f"{number} of {len(bank)}")
        try:
            flight = flown(case)
        except (NotLearnable, Unreadable) as reason:
            log(f"{case}: refused: {reason}")
            continue
        for window, part in parts_of(flight.flight).items():
            found = physical(part)
            if isinstance(found, NotIdentifiable):
                log(f"{case}: refused: {found.reason}")
                continue
            estimate = Estimate(case, window, found, flight.true(part))
            log(str(estimate))
            yield estimate


GROUPS: dict[str, Callable[[Case], bool]] = {
    "none": lambda case: case.steering == "none",
    "multisine, 3°": lambda case: case.steering == "multisine",
    "multisine, 3°, 100 Hz or more": lambda case: case.steering == "multisine" and case.rate >= 100,
    "doublets, 6°": lambda case: case.steering == "doublets",
    "side steps, 2 m": lambda case: case.steering == "side steps",
    "pilot's sticks, 4°": lambda case: case.steering == "sticks",
    "all": lambda case: True,
    "all, 50 Hz": lambda case: case.rate == 50,
    "all, 100 Hz": lambda case: case.rate == 100,
    "all, 200 Hz": lambda case: case.rate == 200,
    "all, thrust curve, lag, inertia and battery varied": lambda case: bool(case.varied),
}


def share(of: Iterable[bool]) -> str:
    found = list(of)
    return f"{np.mean(found):.0%}" if found else "–"


def by_steering(name: str, every: Sequence[Estimate]) -> list[list[str]]:
    """Rows of the table of one parameter."""
    rows = []
    for label, belongs in GROUPS.items():
        for whole in (False, True):
            some = [each for each in every if belongs(each.case) and (each.window is None) == whole]
            if not some:
                continue
            row = [label, "flights" if whole else "7 s", str(len(some))]
            row += [f"{np.mean([each.found.status[name] == status for each in some]):.0%}" for status in STATUSES]
            reported = [each for each in some if each.found.status[name] == "reported"]
            if name == "effect":
                row.append(share(held for each in reported for held in each.inside_by_motor()))
            row.append(share(each.inside(name) for each in reported))
            errors = np.array([each.error(name)[0] for each in reported])
            row += [f"{np.median(errors):+.0%}", f"{errors[np.argmax(abs(errors))]:+.0%}"] if reported else ["–", "–"]
            biased = [each for each in some if each.found.status[name] == "biased"]
            row.append(share(each.inside(name) for each in biased))
            rows.append(row)
    return rows


def simulated(seed: int, flights: int, every: int) -> None:
    """Share that is reported, and how often intervals hold the truth, by steering."""
    found = list(estimates(cases(seed, flights, every)))
    click.echo(f"{len({each.case.seed for each in found})} flights, seed {seed}.\n")
    heads = ["steering", "of", "number", *STATUSES]
    for name in PARAMETERS:
        insides = ["inside, each motor", "inside, mean"] if name == "effect" else ["inside"]
        ends = ["median error of the reported", "worst", "inside, where biased"]
        table(f"**{name.capitalize()}**", [*heads, *insides, *ends], by_steering(name, found))


def row_of(label: Sequence[str], flight: Flight) -> list[str]:
    """A row of a table without a truth: estimates with their intervals, marked unless they are reported."""
    row = [*label, f"{flight.dt * len(flight):.0f}", f"{1 / flight.dt:.0f}"]
    found = physical(flight)
    if isinstance(found, NotIdentifiable):
        return [*row, found.reason, *[""] * 5]
    for name in PARAMETERS:
        value, half = estimate_of(found, name)
        scale = 1e3 if name == "lag" else 1.0
        width = f" ± {scale * half:.2g}" if np.isfinite(half) else ""
        mark = {"reported": "", "biased": " (biased)", "not identifiable": " (no)"}[found.status[name]]
        row.append(f"{scale * value:.3g}{width}{mark}")
    more = ", ".join(f"{name} {value:.2f}" for name, value in found.refinements.items())
    return [*row, f"{found.wind_share:.0%}", f"{found.wind:.2g}", more]


HEADS = ("s", "Hz", "effect", "damping, 1/s", "lag, ms", "wind's share", "wind, rad/s²", "refinements")


CRAZYFLIE = SHARED / "real" / "crazyflie" / "roll_pitch_excitation.usdlog"
EXCITED = (56.0, 89.0)  # s of its clock
AXES = {"roll": ("gyro.x", [-1.0, -1.0, 1.0, 1.0]), "pitch": ("gyro.y", [-1.0, 1.0, 1.0, -1.0])}
EXPECTED = "318–403"  # rad/s² of roll per unit of one motor's command, by published thrust curves and inertia


def usdlog(path: Path) -> dict[str, Array]:
    """Columns of the fixed-frequency event of a Crazyflie's log, version 2, and ``time``, s; units as logged."""
    file = BytesIO(path.read_bytes()[1:])

    def numbers(form: str) -> tuple[Any, ...]:
        return struct.unpack(f"<{form}", file.read(struct.calcsize(f"<{form}")))

    def text() -> str:
        return b"".join(iter(partial(file.read, 1), b"\0")).decode()

    events: dict[int, tuple[str, list[str], list[tuple[Any, ...]]]] = {}
    _, kinds = numbers("HH")
    for _ in range(kinds):
        (kind,), event, (count,) = numbers("H"), text(), numbers("H")
        events[kind] = event, [text() for _ in range(count)], []
    # A variable is called name(letter); a checksum, shorter than any event, ends the file.
    with suppress(struct.error, KeyError):
        while True:
            _, variables, rows = events[numbers("H")[0]]
            rows.append(numbers("Q" + "".join(each[-2] for each in variables)))
    _, variables, rows = next(one for one in events.values() if one[0] == "fixedFrequency")
    time, *columns = np.array(rows).T
    return {"time": time / 1e6, **{name[:-3]: values for name, values in zip(variables, columns, strict=True)}}


def crazyflie() -> None:
    """A Crazyflie 2.1 with roll and pitch excited, really flown, at three rates."""
    logged = usdlog(CRAZYFLIE)
    rows = []
    for axis, (gyro, directions) in AXES.items():
        for rate in (100.0, 200.0, 400.0):
            time = np.arange(EXCITED[0] * rate, EXCITED[1] * rate) / rate
            motors = [np.interp(time, logged["time"], logged[f"motor.m{motor}"] / 65535) for motor in range(1, 5)]
            turning = np.radians(np.interp(time, logged["time"], logged[gyro]))
            flight = Flight(
                time, np.stack(motors, 1), turning[:, None], dt=1 / rate, effect_directions=np.array(directions)
            )
            log(f"{axis}, {rate:.0f} Hz")
            for window, part in parts_of(flight).items():
                rows.append(row_of([axis, "whole"] if window is None else ["", f"7 s, no. {window + 1}"], part))
    title = f"**Crazyflie** (effect in rad/s² per unit of command; published: {EXPECTED} for roll)"
    table(title, ["axis", "of", *HEADS], rows)


@click.command(help=__doc__)
@click.argument("which", type=click.Choice(["simulated", "crazyflie"]))
@click.option("--seed", default=0, show_default=True, help="Of the simulated flights.")
@click.option("--flights", default=1, show_default=True, help="Simulated, of each vehicle, wind and steering.")
@click.option("--every", default=1, show_default=True, help="One of so many of these, drawn by seed.")
def main(which: str, seed: int, flights: int, every: int) -> None:
    {"simulated": lambda: simulated(seed, flights, every), "crazyflie": crazyflie}[which]()


if __name__ == "__main__":
    main()
