#!/usr/bin/env python
"""What a twin from a calm flight foretells of larger gains, beside the vehicle itself; prints a row each in Markdown.

Simulated vehicles are drawn with lags, delays, gyro filters, autopilots and rates of the log; their rate loops have a
gain margin of 9 dB in the flight that is learned from. Then both are flown with 3.2 times P, I and D of roll and pitch,
where the vehicle oscillates. A LOG and a HOT flight with 3.2 times its gains are compared instead.

Usage: tools/validation/twin.py [--seed N] [--vehicles N] [LOG HOT]
"""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from click.testing import CliRunner
from scipy.signal import spectrogram

from mavdem.alignment.read import choose_vehicle
from mavdem.cli.twin import twin_command
from mavdem.ingest import read_log
from mavdem.paper.runner import write_log
from mavdem.report.blocks import Table, markdown
from sitl_scenarios.files import load, scenario_of, with_parameters, with_vehicle
from sitl_scenarios.gains import cycle_of, parameters_of
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

GAINS = re.compile(r"(ATC_RAT_(RLL|PIT)|MC_(ROLL|PITCH)RATE)_[PID]$")
MARGIN = 9.0  # dB of the flight that is learned from
TIMES = 3.2  # half of ArduCopter's default gains, and 1.6 times them
HEADS = ["vehicle", "Hz", "°/s", "Hz of the twin", "°/s of the twin"]


def drawn(draw: np.random.Generator) -> Scenario:
    """Returns a flight of a vehicle of its own, all axes excited."""
    autopilot = str(draw.choice(["ardupilot", "px4"]))
    gyro = "INS_GYRO_FILTER" if autopilot == "ardupilot" else "IMU_GYRO_CUTOFF"
    cutoff = float(draw.choice([20, 30, 40, 60]))
    lag, expo, inertia = draw.uniform([0.01, 0.3, 0.7], [0.05, 0.8, 1.5]).tolist()
    table = load("iris_identification").model_dump(mode="json")
    table["vehicle"] |= {"lag_up": lag, "lag_down": lag, "parameters": {gyro: cutoff}}
    table["vehicle"] |= {"quadratic_thrust": expo, "inertia_scale": inertia}
    delay, noise = draw.uniform([0.001, -4.0], [0.008, -3.0]).tolist()
    table["sensors"] |= {"delay": delay, "rate_sd": 10**noise}
    table["stream"] |= {"autopilot": autopilot, "rate": float(draw.choice([50, 100, 200]))}
    table["moments"] = [{"axis": "roll", "sd": 0.01, "s": 0.1}]
    scenario = scenario_of(table | {"seed": int(draw.integers(1_000_000)), "duration": 70.0})
    hover = in_hover(scenario, 1.0)
    margin = truth(hover, fly(hover))["roll_rate_margins"][2]
    return with_gains(scenario, 10 ** ((margin - MARGIN) / 20))


def with_gains(scenario: Scenario, times: float) -> Scenario:
    """Returns the scenario with ``times`` the gains of roll and pitch."""
    known = parameters_of(scenario, cycle_of(scenario))
    raised = [f"{name}={times * value}" for name, value in known.items() if GAINS.match(name)]
    return with_parameters(scenario, raised)


def in_hover(scenario: Scenario, times: float) -> Scenario:
    """Returns a calm hover of the scenario's vehicle with ``times`` the gains."""
    calm = load("calm").model_copy(update={"duration": 20.0, "seed": scenario.seed})
    return with_gains(with_vehicle(calm, scenario), times)


def oscillation(rates: Array, dt: float) -> tuple[float, float]:
    """Returns frequency, Hz, and sd, °/s, of the stronger oscillation above 4 Hz of ``rates`` (T, 2), rad/s."""
    frequency, _, windows = spectrogram(rates.T, 1 / dt, nperseg=round(2.5 / dt))
    powers = np.median(windows, axis=-1) * (frequency > 4)
    power = powers[powers.max(axis=1).argmax()]
    power *= np.abs(frequency - frequency[power.argmax()]) < 1.5
    size = np.degrees(np.sqrt(power.sum() * frequency[1]))
    return float(power @ frequency / power.sum()), float(size)


def simulated(scenario: Scenario) -> tuple[float, float]:
    """Returns the oscillation of the scenario's vehicle in hover with larger gains."""
    motion = fly(in_hover(scenario, TIMES))
    hover = (motion.time > 8) & (motion.time < 16)
    return oscillation(motion.known_rates[hover, :2], cycle_of(scenario))


def recorded(path: str) -> tuple[float, float]:
    """Returns the oscillation in a log."""
    attitude = choose_vehicle(read_log(path).vehicles, None).messages["ATTITUDE"]
    time, first = np.unique(attitude["time"], return_index=True)
    grid = np.arange(time[0], time[-1], np.median(np.diff(time)))
    rates = [np.interp(grid, time, attitude[name][first]) for name in ("rollspeed", "pitchspeed")]
    return oscillation(np.column_stack(rates), grid[1] - grid[0])


@click.command(help=__doc__)
@click.argument("logs", nargs=-1, metavar="[LOG HOT]")
@click.option("--seed", default=0, show_default=True)
@click.option("--vehicles", default=8, show_default=True, help="Eight take two minutes.")
def main(logs: tuple[str, ...], seed: int, vehicles: int) -> None:
    rows = []
    known = []
    with TemporaryDirectory() as folder:
        made = Path(folder) / "twin.toml"
        for number in range(1 if logs else vehicles):
            if logs:
                path, hot = logs
                name = Path(path).name
                truly = recorded(hot)
            else:
                scenario = drawn(np.random.default_rng([seed, number]))
                path = f"{folder}/flight.tlog"
                write_log(path, scenario, fly(scenario))
                truly = simulated(scenario)
                lag = 1e3 * (scenario.vehicle.lag_up or 0.0)
                name = f"{scenario.stream.autopilot}, {lag:.0f} ms, {scenario.stream.rate:.0f} Hz"
            result = CliRunner().invoke(twin_command, [path, "--out", str(made)])
            if result.exception:
                rows.append([name, *(f"{one:.1f}" for one in truly), str(result.exception), ""])
                continue
            known.append([truly, simulated(load(made))])
            rows.append([name, *(f"{one:.1f}" for one in np.ravel(known[-1]))])
    click.echo(markdown([Table(HEADS, rows, words=True)]))
    apart = np.abs(np.diff(np.log(known), axis=1))[:, 0]
    within = (apart <= np.log([1.05, 1.5])).sum(axis=0)
    click.echo(
        f"Of {len(known)}, {within[0]} within 5 % of frequency, {within[1]} within 1.5 of size"
    )


if __name__ == "__main__":
    main()
