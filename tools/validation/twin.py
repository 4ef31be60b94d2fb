#!/usr/bin/env python
"""What a twin from a calm flight foretells of larger gains, beside the vehicle itself; prints a row each in Markdown.

Vehicles are drawn with lags, delays, gyro filters, autopilots and rates of the log. A twin is made of a flight whose
rate loop has a gain margin of 9 dB. Then both are flown with --times P, I and D of roll and pitch, where the vehicle
oscillates. With --log and --hot, a twin of a recorded flight is held against another with --times its gains.

Usage: tools/validation/twin.py [--seed N] [--vehicles N] | --log half.tlog --hot hot.tlog --times 3.2
"""

from __future__ import annotations

import re
import tomllib
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.signal import periodogram

from mavdem.alignment.read import choose_vehicle
from mavdem.cli.twin import twin_command
from mavdem.errors import NotLearnable
from mavdem.ingest import read_log
from mavdem.paper.runner import write_log
from mavdem.report.blocks import Table, markdown
from sitl_scenarios.files import load, scenario_of, with_parameters, with_vehicle
from sitl_scenarios.gains import cycle_of, parameters_of
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

GAINS = re.compile(r"(ATC_RAT_(RLL|PIT)|MC_(ROLL|PITCH)RATE)_[PID]$")
MARGIN = 9.0  # dB of the flight that is learned from
WINDOW = 2.5  # s
NEAR = 1.5  # Hz about the strongest frequency
SLOWEST = 4.0  # Hz: what is slower is flying
HEADS = ["vehicle", "Hz", "°/s", "Hz of the twin", "°/s of the twin"]


def drawn(draw: np.random.Generator) -> Scenario:
    """Returns a flight of a vehicle of its own, all axes excited."""
    autopilot = str(draw.choice(["ardupilot", "px4"]))
    gyro = float(draw.choice([20, 30, 40, 60]))
    lag = float(draw.uniform(0.01, 0.05))
    named = {"INS_GYRO_FILTER" if autopilot == "ardupilot" else "IMU_GYRO_CUTOFF": gyro}
    vehicle = {
        "lag_up": lag,
        "lag_down": lag,
        "quadratic_thrust": float(draw.uniform(0.3, 0.8)),
        "inertia_scale": float(draw.uniform(0.7, 1.5)),
        "parameters": named,
    }
    table = load("iris_identification").model_dump(mode="json")
    table["vehicle"] |= vehicle
    sensors = {"delay": draw.uniform(0.001, 0.008), "rate_sd": 10 ** draw.uniform(-4, -3)}
    table["sensors"] |= {name: float(value) for name, value in sensors.items()}
    rate = float(draw.choice([50, 100, 200]))
    table["stream"] |= {"autopilot": autopilot, "rate": rate}
    table["moments"] = [{"axis": "roll", "sd": 0.01, "s": 0.1}]
    scenario = scenario_of(table | {"seed": int(draw.integers(1_000_000)), "duration": 70.0})
    hover = with_gains(scenario, 1.0)
    margin = truth(hover, fly(hover))["roll_rate_margins"][2]
    raised = raised_gains(scenario, 10 ** ((margin - MARGIN) / 20))
    return with_parameters(scenario, raised)


def raised_gains(scenario: Scenario, times: float) -> list[str]:
    """Returns the parameters of ``times`` the gains of roll and pitch."""
    known = parameters_of(scenario, cycle_of(scenario))
    return [f"{name}={times * value}" for name, value in known.items() if GAINS.match(name)]


def with_gains(scenario: Scenario, times: float) -> Scenario:
    """Returns the vehicle of a scenario with ``times`` the gains of roll and pitch, in a calm hover."""
    calm = load("calm").model_copy(update={"duration": 20.0, "seed": scenario.seed})
    return with_parameters(with_vehicle(calm, scenario), raised_gains(scenario, times))


def oscillation(rates: NDArray[Any], dt: float) -> tuple[float, float]:
    """Returns frequency, Hz, and standard deviation, °/s, of the stronger oscillation of ``rates`` (T, 2), rad/s."""
    return max((_oscillation(rate, dt) for rate in rates.T), key=itemgetter(1))


def _oscillation(rate: NDArray[Any], dt: float) -> tuple[float, float]:
    """The medians over windows of the strongest frequency and of what is about it."""
    length = round(WINDOW / dt)
    windows = sliding_window_view(rate, length)[::length]
    frequency, power = periodogram(windows, 1 / dt, "hann")
    power[:, frequency < SLOWEST] = 0.0
    strongest = frequency[power.argmax(axis=1)]
    power[np.abs(frequency - strongest[:, None]) > NEAR] = 0.0
    centre = power @ frequency / power.sum(axis=1)
    size = np.sqrt(power.sum(axis=1) * frequency[1])
    return float(np.median(centre)), float(np.degrees(np.median(size)))


def simulated(scenario: Scenario, times: float) -> tuple[float, float]:
    """Returns the oscillation of roll or pitch in hover with ``times`` the gains."""
    motion = fly(with_gains(scenario, times))
    hover = (motion.time > 8) & (motion.time < 16)
    return oscillation(motion.known_rates[hover, :2], cycle_of(scenario))


def recorded(path: str) -> tuple[float, float]:
    """Returns the oscillation of roll or pitch in a log."""
    attitude = choose_vehicle(read_log(path).vehicles, None).messages["ATTITUDE"]
    time, first = np.unique(attitude["time"], return_index=True)
    dt = float(np.median(np.diff(time)))
    grid = np.arange(time[0], time[-1], dt)
    rates = [np.interp(grid, time, attitude[f"{axis}speed"][first]) for axis in ("roll", "pitch")]
    return oscillation(np.column_stack(rates), dt)


def twin_of_log(path: Path, folder: Path) -> Scenario:
    """Returns the twin of a log; raises ``NotLearnable``."""
    made = folder / "twin.toml"
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        twin_command([str(path), "--out", str(made)], standalone_mode=False)
    return scenario_of(tomllib.loads(made.read_text("utf-8")))


def drawn_row(draw: np.random.Generator, times: float, folder: Path) -> list[Any]:
    """Returns what vehicle it is, and its and the twin's oscillation with ``times`` the gains; or why not."""
    scenario = drawn(draw)
    name = f"{scenario.stream.autopilot}, {1e3 * (scenario.vehicle.lag_up or 0):.0f} ms"
    name += f", {scenario.stream.rate:.0f} Hz"
    write_log(folder / "flight.tlog", scenario, fly(scenario))
    try:
        twin = twin_of_log(folder / "flight.tlog", folder)
        return [name, *simulated(scenario, times), *simulated(twin, times)]
    except (NotLearnable, ValueError) as error:
        return [name, str(error)]


@click.command(help=__doc__)
@click.option("--seed", default=0, show_default=True)
@click.option("--vehicles", default=8, show_default=True, help="Eight take two minutes.")
@click.option("--log", type=click.Path(path_type=Path), help="Recorded flight to make a twin of.")
@click.option("--hot", type=str, help="Recorded flight with --times its gains.")
@click.option("--times", default=3.2, show_default=True)
def main(seed: int, vehicles: int, log: Path | None, hot: str | None, times: float) -> None:
    rows = list[list[Any]]()
    with TemporaryDirectory() as made:
        folder = Path(made)
        if log is not None and hot is not None:
            twin = twin_of_log(log, folder)
            rows.append([log.name, *recorded(hot), *simulated(twin, times)])
        else:
            draws = [np.random.default_rng([seed, number]) for number in range(vehicles)]
            rows += [drawn_row(draw, times, folder) for draw in draws]
    cells = [
        [f"{one:.1f}" if isinstance(one, float) else one for one in row] + [""] * (5 - len(row))
        for row in rows
    ]
    click.echo(markdown([Table(HEADS, cells, words=True)]))
    known = np.array([row[1:] for row in rows if len(row) == len(HEADS)])
    if len(known):
        frequency, size = np.abs(np.log(known[:, 2:] / known[:, :2])).T
        click.echo(f"Frequency within 5 %: {np.sum(frequency <= np.log(1.05))} of {len(known)}.")
        click.echo(f"Size within a factor of 1.5: {np.sum(size <= np.log(1.5))} of {len(known)}.")


if __name__ == "__main__":
    main()
