#!/usr/bin/env python
"""Oscillation that a simulated twin, learned from a calm flight, predicts for larger gains, compared with the true one.

Simulated vehicles are drawn with lags, delays, gyro filters, autopilots and rates of the log; their rate loops have a
gain margin of 9 dB in the flight that is learned from. Then both are flown with 3.2 times P, I and D of roll and pitch,
where the vehicle oscillates. A LOG and a HOT flight with 3.2 times its gains are compared instead.

Usage: tools/validation/twin.py [--seed N] [--vehicles N: eight take two minutes] [--jobs N] [LOG HOT]
"""

import re
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

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

RATE_GAIN_NAMES = re.compile(r"(ATC_RAT_(RLL|PIT)|MC_(ROLL|PITCH)RATE)_[PID]$")
"""Names of the rate controllers' gains of roll and pitch."""

FLIGHT_GAIN_MARGIN = 9.0
"""Gain margin of the flight that the twin is learned from, dB."""

GAIN_FACTOR = 3.2
"""Factor on the gains with which vehicle and twin oscillate: from half to 1.6 times ArduCopter's defaults."""

MIN_OSCILLATION_FREQUENCY = 4.0
"""Lowest frequency of an oscillation of the rate loop, Hz: manoeuvres are slower. A choice."""

LINE_HALF_WIDTH = 1.5
"""Half of the width of the spectral line of an oscillation, Hz: a choice."""

WINDOW_SECONDS = 2.5
"""Length of the windows of the spectra, s, which resolve 0.4 Hz: a choice."""

HOVER_START, HOVER_END = 8.0, 16.0
"""Times of the recording, s, between which the vehicle of :func:`in_hover` is certain to hover."""

GYRO_FILTER_PARAMETERS = {"ardupilot": "INS_GYRO_FILTER", "px4": "IMU_GYRO_CUTOFF"}
"""Parameter of the gyro's low-pass, by autopilot."""


def random_scenario(seed: int, number: int) -> Scenario:
    """Draws a vehicle for a flight with all axes excited, with gains for a gain margin of ``FLIGHT_GAIN_MARGIN``.

    The gain margin is inversely proportional to the gains of the rate loop. So the margin of a hover with the
    autopilot's usual gains is computed first; by how much it exceeds the wanted margin, dB, is the factor on the gains.

    Args:
        seed: seed of all vehicles.
        number: number of the vehicle.

    Returns:
        The scenario of the flight.
    """
    rng = default_rng([seed, number])
    values = draw_values(TABLES["twin"], rng) | {"seed": number}
    # The cut-off of the gyro's low-pass stands alone in flights.toml; a scenario has it as an autopilot's parameter.
    cutoff_parameter = GYRO_FILTER_PARAMETERS[values["stream"]["autopilot"]]
    values["vehicle"]["parameters"] = {cutoff_parameter: values.pop("cutoff")}
    # What is not drawn is as in this scenario, which excites all axes.
    defaults = load("iris_identification").model_dump(mode="json")
    sections = {key: defaults[key] | values[key] for key in ("vehicle", "sensors", "stream")}
    scenario = scenario_from_values(defaults | values | sections)
    hover = in_hover(scenario, 1.0)
    # The margins of a loop are crossover frequency, phase margin, gain margin and peak sensitivity Ms.
    _, _, gain_margin, _ = truth(hover, fly(hover))["roll_rate_margins"]
    excess_margin = gain_margin - FLIGHT_GAIN_MARGIN
    return with_gains(scenario, 10 ** (excess_margin / 20))


def with_gains(scenario: Scenario, factor: float) -> Scenario:
    """Returns a copy of a scenario in which all gains of the rate controllers of roll and pitch have a common factor.

    Args:
        scenario: scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.
        factor: factor on the gains, more than 0.
    """
    parameters = control_parameters(scenario)
    raised = [
        f"{name}={factor * value}"
        for name, value in parameters.items()
        if RATE_GAIN_NAMES.match(name)
    ]
    return with_parameters(scenario, raised)


def in_hover(scenario: Scenario, factor: float) -> Scenario:
    """Returns a calm hover of the scenario's vehicle with the gains multiplied by a factor."""
    changes = {"duration": 20.0, "seed": scenario.seed}
    calm = load("calm").model_copy(update=changes)
    return with_gains(with_vehicle(calm, scenario), factor)


class Oscillation(NamedTuple):
    """An oscillation of a body rate, as a line of its spectrum."""

    frequency: float
    """Mean frequency of its spectral line, Hz."""
    sd: float
    """Standard deviation of the line, °/s."""


def oscillation(rates: Array, dt: float) -> Oscillation:
    """Measures the oscillation of the roll or pitch rate, whichever has the higher spectral peak.

    The spectrum of an axis is the median over windows of ``WINDOW_SECONDS``, so that a short disturbance does not
    count. The oscillation is the line about its highest peak above ``MIN_OSCILLATION_FREQUENCY``.

    Args:
        rates: rates of roll and pitch (T, 2), rad/s.
        dt: time step, s.

    Returns:
        Frequency and size of the spectral line, within ``LINE_HALF_WIDTH`` of the highest peak.
    """
    window_samples = round(WINDOW_SECONDS / dt)
    frequency, _, windows = spectrogram(rates.T, 1 / dt, nperseg=window_samples)
    # Densities (2 axes, F), (rad/s)²/Hz.
    densities = np.median(windows, axis=-1) * (frequency > MIN_OSCILLATION_FREQUENCY)
    strongest_axis = densities.max(axis=1).argmax()
    density = densities[strongest_axis]
    peak_frequency = frequency[density.argmax()]
    density *= abs(frequency - peak_frequency) < LINE_HALF_WIDTH
    frequency_step = frequency[1]
    variance = density.sum() * frequency_step
    mean_frequency = density @ frequency / density.sum()
    return Oscillation(float(mean_frequency), sd=float(np.degrees(np.sqrt(variance))))


def simulated_oscillation(scenario: Scenario) -> Oscillation:
    """Returns the oscillation of the scenario's vehicle in hover with larger gains.

    Args:
        scenario: the scenario, whose vehicle and gains are used.

    Returns:
        Frequency, Hz, and standard deviation, °/s.
    """
    motion = fly(in_hover(scenario, GAIN_FACTOR))
    # The vehicle has taken off by the start of this interval, and does not land before its end.
    is_hover = (motion.time > HOVER_START) & (motion.time < HOVER_END)
    roll_and_pitch_rates = motion.known_rates[is_hover, :2]
    return oscillation(roll_and_pitch_rates, scenario.cycle)


def recorded_oscillation(path: str) -> Oscillation:
    """Returns the oscillation of the body rates in a log, which are resampled at a constant step first.

    Args:
        path: path of the log.

    Returns:
        Frequency, Hz, and standard deviation, °/s.
    """
    attitude = choose_vehicle(read_log(path).vehicles).messages["ATTITUDE"]
    time, unique_rows = np.unique(attitude["time"], return_index=True)
    step = np.median(np.diff(time))
    grid = np.arange(time[0], time[-1], step)
    rates = [
        np.interp(grid, time, attitude[field][unique_rows]) for field in ("rollspeed", "pitchspeed")
    ]
    return oscillation(np.column_stack(rates), grid[1] - grid[0])


def comparison_row(name: str, log: str, true_oscillation: Oscillation) -> list[Values]:
    """Compares the oscillation of a vehicle with larger gains with the one of its twin.

    The twin is a simulated vehicle that `mavdem twin` makes from a log of a flight without oscillation.

    Args:
        name: name of the vehicle for the table.
        log: path of the log that the twin is made from.
        true_oscillation: oscillation of the vehicle itself with the larger gains.

    Returns:
        One row; if no twin can be made, it has the reason under "why not".
    """
    row = {"vehicle": name, "Hz": true_oscillation.frequency, "°/s": true_oscillation.sd}
    with TemporaryDirectory() as folder:
        twin_file = Path(folder) / "twin.toml"
        result = CliRunner().invoke(twin_command, [log, "--out", str(twin_file)])
        if result.exception:
            return [row | {"why not": str(result.exception)}]
        row["Hz of the twin"], row["°/s of the twin"] = simulated_oscillation(load(twin_file))
    return [row]


def evaluate_vehicle(number: int, seed: int) -> list[Values]:
    """Simulates a vehicle with usual and with larger gains, and compares its oscillation with the one of its twin.

    Args:
        number: number of the vehicle.
        seed: seed of all vehicles.

    Returns:
        One row, as :func:`comparison_row` returns it.
    """
    scenario = random_scenario(seed, number)
    lag = 1e3 * (scenario.vehicle.lag_up or 0.0)
    name = f"{scenario.stream.autopilot}, {lag:.0f} ms, {scenario.stream.rate:.0f} Hz"
    with TemporaryDirectory() as folder:
        path = f"{folder}/flight.tlog"
        write_log(path, scenario, fly(scenario))
        return comparison_row(name, path, simulated_oscillation(scenario))


@command(__doc__, seed=0, vehicles=8)
@click.argument("logs", nargs=-1, metavar="[LOG HOT]")
def main(logs: tuple[str, ...], seed: int, vehicles: int, jobs: int) -> None:
    """Prints the oscillations of vehicles with larger gains beside the ones that their twins predict.

    Args:
        logs: a log, and another one of the same vehicle with larger gains, which oscillates. Without logs, simulated
            vehicles are compared.
        seed: seed of the simulated vehicles.
        vehicles: number of the simulated vehicles.
        jobs: number of processes.
    """
    if logs:
        log, oscillating_log = logs
        true_oscillation = recorded_oscillation(oscillating_log)
        print_table("Recorded", comparison_row(Path(log).name, log, true_oscillation))
        return
    rows = evaluate_flights(partial(evaluate_vehicle, seed=seed), range(vehicles), jobs)
    frequency_ratios = rows["Hz of the twin"] / rows["Hz"]
    size_ratios = rows["°/s of the twin"] / rows["°/s"]
    right_frequencies = _count_within_factor(frequency_ratios, factor=1.05)
    right_sizes = _count_within_factor(size_ratios, factor=1.5)
    summary = f"{right_frequencies} within 5 % of frequency, {right_sizes} within 1.5 of size."
    print_table(f"{vehicles} vehicles, seed {seed}", rows, summary)


def _count_within_factor(ratios: Any, factor: float) -> int:
    """Returns how many ratios, of a column, are from 1 / ``factor`` to ``factor``."""
    return int((abs(np.log(ratios)) <= np.log(factor)).sum())


if __name__ == "__main__":
    main()
