#!/usr/bin/env python
"""How soon, how rightly and how falsely a motor alarm comes in simulated flights; prints a table.

For each kind of flight and each half: where a motor loses a fifth of its thrust, or a propeller chips, how many were
found within five seconds, how many of those found were named right, and delays; where a load shifts, alarms on a motor;
and the same of sound flights with gusts, steps, sticks and take-offs. The test's parameters were chosen on the half of
even numbers. Flights are simulated without MAVLink, in about forty minutes on two processors, and kept in a folder.

Usage: tools/validation/alarms.py FOLDER [--rate HZ] [--flights N] [--jobs N]
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from alarm_flights import KINDS, RATE, SHIFTED, SOUND, read

from mavdem.health.in_flight import MotorAlarm, MotorWatch
from mavdem.ingest.motors import motor_geometry

IN_TIME = 5.0  # s


class Watched(NamedTuple):
    """What a watch said in one flight."""

    kind: str
    number: int
    hours: float  # settled
    breaks: float  # s
    motor: int  # at fault; 0: none
    alarms: tuple[MotorAlarm, ...]


def watched(kind: str, number: int, folder: Path, rate: float) -> Watched:
    """One flight, its motors at ``rate``, Hz."""
    flight, every = read(kind, number, folder), round(RATE / rate)
    layout = motor_geometry("QUADROTOR", "", {}, (1, 2, 3, 4), 8)
    assert layout is not None
    watch = MotorWatch(layout.names, layout.motors, layout.positions, layout.spins)
    time, motors, settled = (each[::every] for each in (flight.time, flight.motors, flight.settled))
    for at in np.flatnonzero(settled):
        watch.take(float(time[at]), motors[at], True)
    hours = float(settled.sum() / rate / 3600)
    return Watched(kind, number, hours, flight.breaks, flight.motor, tuple(watch.alarms))


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--rate", default=10.0, show_default=True, help="Hz of the motors' samples, at most 50.")
@click.option("--flights", type=int, help="Of each kind at most; all by default.")
@click.option("--jobs", default=2, show_default=True, help="Processes.")
@click.option("--verbose", is_flag=True, help="Also prints what was missed or wrong.")
def main(folder: Path, rate: float, flights: int | None, jobs: int, verbose: bool) -> None:
    """Prints the table of the simulated flights in FOLDER, which are flown where they are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    asked = [(kind, number) for kind, count in KINDS.items() for number in range(min(count, flights or count))]
    with ProcessPoolExecutor(jobs) as pool:
        done = list(pool.map(watched, *zip(*asked, strict=True), [folder] * len(asked), [rate] * len(asked)))
    click.echo(f"Motors at {rate:g} Hz; even numbers chose the parameters, odd ones did not.\n")
    click.echo("| flights | half | number | found in 5 s | named right, of found | median delay, s | longest, s |")
    click.echo("|---|---|---|---|---|---|---|")
    for kind in KINDS:
        for half in (0, 1):
            chosen = [one for one in done if one.kind == kind and one.number % 2 == half]
            if kind not in (SOUND, SHIFTED) and chosen:
                click.echo(_faulty(kind, half, chosen, verbose))
    click.echo("\n| flights | half | number | hours settled | alarms on a motor | changes in roll and pitch |")
    click.echo("|---|---|---|---|---|---|")
    for kind in (SOUND, SHIFTED):
        for half in (0, 1):
            chosen = [one for one in done if one.kind == kind and one.number % 2 == half]
            alarms = [alarm for one in chosen for alarm in one.alarms]
            named = sum(alarm.motor is not None for alarm in alarms)
            hours = sum(one.hours for one in chosen)
            click.echo(
                f"| {kind} | {_half(half)} | {len(chosen)} | {hours:.2f} | {named} | {len(alarms) - named} |",
            )
            if verbose:
                for one in chosen:
                    for alarm in one.alarms:
                        click.echo(f"  {kind} {one.number}: {alarm}", err=True)
    before = sum(alarm.time < one.breaks for one in done for alarm in one.alarms if one.motor)
    click.echo(f"\nAlarms before anything broke, in flights where a motor did: {before}.")


def _faulty(kind: str, half: int, flights: list[Watched], verbose: bool) -> str:
    delays, right = [], 0
    for one in flights:
        first = next((alarm for alarm in one.alarms if alarm.time >= one.breaks), None)
        delays.append(np.inf if first is None else first.time - one.breaks)
        right += first is not None and first.motor == one.motor
        if verbose and not (delays[-1] <= IN_TIME and first is not None and first.motor == one.motor):
            click.echo(f"  {kind} {one.number}: motor {one.motor}, {delays[-1]:.1f} s, {first}", err=True)
    found = int(np.isfinite(delays).sum())
    soon = int((np.array(delays) <= IN_TIME).sum())
    longest = max((delay for delay in delays if np.isfinite(delay)), default=np.nan)
    return (
        f"| {kind} | {_half(half)} | {len(flights)} | {soon} | {right} of {found} | {np.median(delays):.1f} | "
        f"{longest:.1f} |"
    )


def _half(half: int) -> str:
    return "odd" if half else "even"


if __name__ == "__main__":
    main()
