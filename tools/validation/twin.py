#!/usr/bin/env python
"""What a twin from a calm flight foretells of larger gains, beside the vehicle itself; prints a row each in Markdown.

Simulated vehicles are drawn with lags, delays, gyro filters, autopilots and rates of the log; their rate loops have a
gain margin of 9 dB in the flight that is learned from. Then both are flown with 3.2 times P, I and D of roll and pitch,
where the vehicle oscillates. A LOG and a HOT flight with 3.2 times its gains are compared instead.

Usage: tools/validation/twin.py [--seed N] [--vehicles N: eight take two minutes] [--jobs N] [LOG HOT]
"""

import re
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from click.testing import CliRunner
from flights import (
    TABLES,
    Values,
    command,
    draw_values,
    evaluate_flights,
    print_table,
    scenario_from_values,
)
from numpy.random import default_rng
from scipy.signal import spectrogram

from mavdem.cli.twin import twin_command
from mavdem.dataset.flights import choose_vehicle
from mavdem.experiments.paper.flights import write_log
from mavdem.ingest import read_log
from sitl_scenarios.files import load, with_parameters, with_vehicle
from sitl_scenarios.gains import control_parameters
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

GAINS = re.compile(r"(ATC_RAT_(RLL|PIT)|MC_(ROLL|PITCH)RATE)_[PID]$")
MARGIN = 9.0  # dB of the flight that is learned from
TIMES = 3.2  # half of ArduCopter's default gains, and 1.6 times them
FILTERS = {"ardupilot": "INS_GYRO_FILTER", "px4": "IMU_GYRO_CUTOFF"}


def vehicle(seed: int, number: int) -> Scenario:
    """Returns a flight of a vehicle of its own, all axes excited."""
    rng = default_rng([seed, number])
    values = draw_values(TABLES["twin"], rng) | {"seed": number}
    defaults = load("iris_identification").model_dump(mode="json")
    name = FILTERS[values["stream"]["autopilot"]]
    values["vehicle"]["parameters"] = {name: values.pop("cutoff")}
    sections = {key: defaults[key] | values[key] for key in ("vehicle", "sensors", "stream")}
    scenario = scenario_from_values(defaults | values | sections)
    hover = in_hover(scenario, 1.0)
    margin = truth(hover, fly(hover))["roll_rate_margins"][2]
    excess = margin - MARGIN
    return with_gains(scenario, 10 ** (excess / 20))


def with_gains(scenario: Scenario, times: float) -> Scenario:
    """Returns the scenario with ``times`` the gains of roll and pitch."""
    parameters = control_parameters(scenario)
    raised = [f"{name}={times * value}" for name, value in parameters.items() if GAINS.match(name)]
    return with_parameters(scenario, raised)


def in_hover(scenario: Scenario, times: float) -> Scenario:
    """Returns a calm hover of the scenario's vehicle with ``times`` the gains."""
    changes = {"duration": 20.0, "seed": scenario.seed}
    calm = load("calm").model_copy(update=changes)
    return with_gains(with_vehicle(calm, scenario), times)


def oscillation(rates: Array, dt: float) -> tuple[float, float]:
    """Returns frequency, Hz, and sd, °/s, of the stronger oscillation above 4 Hz of ``rates`` (T, 2), rad/s."""
    frequency, _, windows = spectrogram(rates.T, 1 / dt, nperseg=round(2.5 / dt))
    powers = np.median(windows, axis=-1) * (frequency > 4)
    strongest = powers.max(axis=1).argmax()
    power = powers[strongest]
    peak = frequency[power.argmax()]
    power *= abs(frequency - peak) < 1.5
    variance = power.sum() * frequency[1]
    size = np.degrees(np.sqrt(variance))
    mean = power @ frequency / power.sum()
    return float(mean), float(size)


def simulated(scenario: Scenario) -> tuple[float, float]:
    """Returns the oscillation of the scenario's vehicle in hover with larger gains."""
    hovering = in_hover(scenario, TIMES)
    motion = fly(hovering)
    hover = (motion.time > 8) & (motion.time < 16)
    return oscillation(motion.known_rates[hover, :2], scenario.cycle)


def recorded(path: str) -> tuple[float, float]:
    """Returns the oscillation in a log."""
    flown = choose_vehicle(read_log(path).vehicles)
    attitude = flown.messages["ATTITUDE"]
    time, first = np.unique(attitude["time"], return_index=True)
    step = np.median(np.diff(time))
    grid = np.arange(time[0], time[-1], step)
    rates = [np.interp(grid, time, attitude[name][first]) for name in ("rollspeed", "pitchspeed")]
    return oscillation(np.column_stack(rates), grid[1] - grid[0])


def compared(name: str, log: str, truth: tuple[float, float]) -> list[Values]:
    """A row: the known oscillation, and that of the twin of a log."""
    row = {"vehicle": name, "Hz": truth[0], "°/s": truth[1]}
    with TemporaryDirectory() as folder:
        made = Path(folder) / "twin.toml"
        result = CliRunner().invoke(twin_command, [log, "--out", str(made)])
        if result.exception:
            return [row | {"why not": str(result.exception)}]
        row["Hz of the twin"], row["°/s of the twin"] = simulated(load(made))
    return [row]


def judged(number: int, seed: int) -> list[Values]:
    """A row of a simulated vehicle."""
    scenario = vehicle(seed, number)
    lag = 1e3 * (scenario.vehicle.lag_up or 0.0)
    name = f"{scenario.stream.autopilot}, {lag:.0f} ms, {scenario.stream.rate:.0f} Hz"
    with TemporaryDirectory() as folder:
        path = f"{folder}/flight.tlog"
        write_log(path, scenario, fly(scenario))
        return compared(name, path, simulated(scenario))


@command(__doc__, seed=0, vehicles=8)
@click.argument("logs", nargs=-1, metavar="[LOG HOT]")
def main(logs: tuple[str, ...], seed: int, vehicles: int, jobs: int) -> None:
    if logs:
        log, hot = logs
        print_table("Recorded", compared(Path(log).name, log, recorded(hot)))
        return
    rows = evaluate_flights(partial(judged, seed=seed), range(vehicles), jobs)
    close, like = (
        (abs(np.log(rows[f"{unit} of the twin"] / rows[unit])) <= np.log(factor)).sum()
        for unit, factor in (("Hz", 1.05), ("°/s", 1.5))
    )
    under = f"{close} within 5 % of frequency, {like} within 1.5 of size."
    print_table(f"{vehicles} vehicles, seed {seed}", rows, under)


if __name__ == "__main__":
    main()
