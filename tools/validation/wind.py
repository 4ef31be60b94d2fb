#!/usr/bin/env python
"""The wind's torque that is estimated from simulated flights, compared with the truth; prints a table.

Each scenario is flown with several seeds for a minute. Medians over the flights of the correlation (and the worst), of
the estimate over the truth for the motors' effect, the standard deviation and the mean of the wind's torque, and of the
share of samples inside the 90 % band; with the physical parameters that the flight itself gives. "Wind's share" is the
variance of the wind's torque over that of the motors'. "Live" is the same as the estimate comes live, a quarter of a
second later, from 20 s on. Where the true mean is below a tenth of the standard deviation its ratio does not count.

Usage: tools/validation/wind.py [--flights N] [--steer DEGREES] [SCENARIO]...
"""

from __future__ import annotations

import click
import numpy as np
from numpy.typing import NDArray
from rich.progress import track

import mavdem
from mavdem.dem import physical
from mavdem.dem.graybox.wind import wind
from mavdem.dem.online.learner import BLOCK_SECONDS
from mavdem.dem.online.memory import MemoryBlock
from mavdem.dem.online.wind import OnlineWind
from mavdem.dem.record import Record
from mavdem.paper.flights import hover
from sitl_scenarios.files import load
from sitl_scenarios.scenario import Multisine
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

Array = NDArray[np.float64]

SCENARIOS = (
    *("hover_blower", "iris_dryden", "iris_gusts", "crazyflie_gusts", "iris_von_karman"),
    *("iris_doublets", "iris_multisine"),
)
LIVE_FROM = 20.0  # s of samples before the live estimate counts
SMALL_MEAN = 0.1  # of the standard deviation


def flown(name: str, seed: int, steer: float) -> tuple[mavdem.Flight, Array, Array, float]:
    """A scenario's settled hover with another seed; the true torque (T,) and effect (r,), and the wind's share."""
    scenario = load(name)
    scenario = scenario.model_copy(update={"seed": scenario.seed + seed, "duration": 75.0})
    if steer:
        multisine = Multisine(kind="multisine", sd=steer, lowest=0.2, highest=4.0, period=10.0)
        scenario = scenario.model_copy(update={"excitation": multisine})
    motion = fly(scenario)
    known, flight = truth(scenario, motion), hover(scenario, motion)
    flight = mavdem.Flight(flight.time, flight.inputs, flight.outputs[:, 2:], dt=flight.dt)
    torque = np.interp(flight.time, motion.time, known["roll_disturbance"])
    effect = known["roll_effect"]
    return flight, torque, effect, float(torque.var() / (flight.inputs @ effect).var())


def live(record: Record) -> tuple[Array, Array]:
    """The torque (T,) and half width (T,) of each sample, as a live session has them later; NaN where it has none."""
    block = max(1, round(BLOCK_SECONDS / record.dt))
    online = OnlineWind(record.dt, block, None, record.effect_directions)
    lag = round(online.delay / record.dt)
    found = np.full((len(record) + lag, 2), np.nan)
    for k, (inputs, outputs) in enumerate(zip(record.inputs, record.outputs, strict=True)):
        found[k] = online.update(inputs, outputs)
        if (k + 1) % block == 0:
            rows = slice(k + 1 - block, k + 1)
            online.add(MemoryBlock(record.inputs[rows], record.outputs[rows], k + 1 == block, k * record.dt))
    return found[lag:, 0], found[lag:, 1]


def compared(torque: Array, band: Array, true: Array) -> tuple[float, float, float, float]:
    """Correlation, ratio of standard deviations, ratio of means, and the share of samples in the band."""
    known = np.isfinite(torque)
    torque, band, true = torque[known], band[known], true[known]
    ratio = torque.mean() / true.mean() if abs(true.mean()) > SMALL_MEAN * true.std() else np.nan
    inside = np.mean(np.abs(torque - true) <= band)
    return float(np.corrcoef(torque, true)[0, 1]), torque.std() / true.std(), float(ratio), float(inside)


def row(flight: mavdem.Flight, true: Array, effect: Array) -> list[float] | None:
    """Of one flight: effect, and offline and live what is ``compared``; ``None`` where no model can be fitted."""
    record = Record.of(flight)
    try:
        found = physical(record)
        whole = wind(found, record)
    except ValueError:
        return None
    correlation, _, mean, inside = compared(whole.torque, whole.band, true)
    torque, band = live(record)
    torque[: round(LIVE_FROM / flight.dt)] = np.nan
    size = np.abs(found.effect).mean() / np.abs(effect).mean()
    offline = [correlation, whole.sd / true.std(), mean, inside]
    return [size, *offline, float(whole.resolved), *compared(torque, band, true)]


@click.command(help=__doc__)
@click.argument("scenarios", nargs=-1, metavar="[SCENARIO]...")
@click.option("--flights", default=3, show_default=True, help="Flights of each scenario.")
@click.option("--steer", default=0.0, help="Degrees of roll, standard deviation, of a multisine added to each flight.")
def main(scenarios: tuple[str, ...], flights: int, steer: float) -> None:
    print("| scenario | flights | wind's share | effect | correlation, worst | sd | mean | inside | resolved | live |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in track(scenarios or SCENARIOS, description="Flying"):
        shares, rows = [], []
        for seed in range(flights):
            flight, true, effect, share = flown(name, seed, steer)
            shares.append(share)
            if (found := row(flight, true, effect)) is not None:
                rows.append(found)
        if not rows:
            print(f"| {name} | 0 of {flights} | {np.median(shares):.3f} |" + " - |" * 7, flush=True)
            continue
        table = np.array(rows)
        middle = np.nanmedian(table, axis=0)
        worst, resolved = table.min(axis=0), int(table[:, 5].sum())
        print(
            f"| {name} | {len(rows)} | {np.median(shares):.3f} | {middle[0]:.2f} | {middle[1]:.2f}, {worst[1]:.2f} | "
            f"{middle[2]:.2f} | {middle[3]:.2f} | {middle[4]:.2f} | {resolved} | {middle[6]:.2f}, {worst[6]:.2f}, "
            f"sd {middle[7]:.2f}, mean {middle[8]:.2f}, inside {middle[9]:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
