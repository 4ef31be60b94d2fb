#!/usr/bin/env python
"""Margins of identified loops compared with the truth, of simulated flights thinned to lower rates, and of logs.

Of each message all but one in so many are left out. Stamps stay as they are; those of simulated flights are exact, as
in autopilots' own logs, or with --rounded as MAVLink sends them, some in whole milliseconds. Without LOGS the flights
are simulated ones, of the half to choose a method on or of the half to report; they are flown once and kept in --cache.
"rms", "median", "size" (median without sign) and "close" (within 1.5 dB) are of errors where loops are given, relative
but for margins in dB and degrees; "inside": of 90 % intervals that hold the truth.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd
from flights import Values, command, evaluate_flights, percent_true, print_table
from numpy.random import Generator, default_rng
from numpy.typing import NDArray
from physical import Case, scenario, varied

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.record import NoLoop
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.errors import Refusal
from mavdem.experiments.paper.flights import write_log
from mavdem.facts import Fact
from mavdem.files import load_adjacent_toml
from mavdem.ingest import Log, read_log
from mavdem.ingest.telemetry import Telemetry, rate_without_gaps, selected_rows
from mavdem.ingest.vocabulary import IN_AIR
from mavdem.loops.autopilot_parameters import DEFAULT_LOOP_RATES, LOOP_RATE_PARAMETERS
from mavdem.loops.axis_loops import Loop
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.margins import OpenLoop, attitude_loop, rate_loop
from sitl_scenarios.files import scenario_of
from sitl_scenarios.gains import control_parameters
from sitl_scenarios.motion import Motion
from sitl_scenarios.rotors import IDLE_COMMAND, MAX_PULSE, pulse_width, rotor_frame
from sitl_scenarios.scenario import AXES, Axis, Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import axis_model, truth
from sitl_scenarios.vehicles import airframe

TABLES = load_adjacent_toml(__file__, "loops.toml")
"""Vehicles, winds, steering, gains and ranges from which flights are drawn, and plants of recorded logs."""

HALVES = {"choose": range(1000, 1024), "report": range(2000, 2024)}
"""Seeds of the flights to choose a method on, and of those to report."""

LOOP_RATE = DEFAULT_LOOP_RATES["ardupilot"]
"""Rate of the simulated autopilots' loops, and of their messages, Hz."""

CACHE_FOLDER = Path.home() / ".cache" / "mavdem" / "loops"
"""Folder in which simulated flights are kept, 4 MB each, unless another is given."""

MAX_AT_LIMIT_SHARE = 0.15
"""Largest share of the time in the air with a motor at a limit."""

MIN_PHASE_MARGIN = 15.0
"""Least phase margin of the loops that are flown, degrees."""

KIND_FIELDS = ("type_mask", "axis", "port")
"""Fields by which messages of one name are of several kinds."""

MARGINS = ("crossover", "phase_margin", "gain_margin", "ms")
PLANT = ("effect", "damping", "lag", "delay")
LOOPS = ("rate", "attitude")
SHOWN_FIGURES = ("effect", *(f"rate_{name}" for name in MARGINS))
CLOSE_GAIN_ERROR = 1.5
"""Largest error of a gain margin that is called close, dB."""

MAX_GAIN_ERROR = 30.0
"""Largest error of a gain margin, dB: one that does not exist has an infinite error."""

Array = NDArray[np.float64]
Truth = dict[str, dict[str, float]]
"""Figures by axis and name."""


def random_scenario(seed: int, rng: Generator) -> Scenario:
    """Draws a scenario whose gains have the proportions of the autopilot's defaults, and random margins.

    It is drawn again until all loops have ``MIN_PHASE_MARGIN``.

    Args:
        seed: seed of the flight, by which autopilots, filters and steering take turns.
        rng: source of the random numbers.
    """

    def random_value(name: str) -> float:
        """Draws a value uniformly from its range in the tables."""
        return float(rng.uniform(*TABLES["ranges"][name]))

    autopilot = ("ardupilot", "px4")[seed % 2]
    vehicle = rng.choice(TABLES["vehicles"])
    wind = str(rng.choice(TABLES["winds"]))
    like = Case("iris", wind, "none", LOOP_RATE, autopilot, varied(rng), seed)
    wanted = scenario(like).model_dump(mode="json")
    parameters = {LOOP_RATE_PARAMETERS[autopilot]: LOOP_RATE, **TABLES["filters"][autopilot]}
    if seed % 3:  # of three flights two have the gyro's low-pass
        parameters |= TABLES["gyro"][autopilot]
    wanted["vehicle"] |= {**vehicle, "parameters": parameters}
    steering = TABLES["steering"]
    turn = seed // 2 % len(steering)
    wanted["excitation"] = steering[turn]
    wanted["sensors"] |= {name: random_value(name) for name in ("delay", "rate_sd")}
    wanted["stream"]["rates"] = {"ATTITUDE_TARGET": LOOP_RATE}
    of = scenario_of(wanted)
    body = airframe(of.vehicle)
    share = body.command_for(body.hover_speed) / body.full_command
    hover = [share] * 4
    least = 180.0
    for axis in AXES:
        controller = axis_controller(of, axis)
        effect = axis_model(of.vehicle, axis).B[-1]
        plant = true_plant(of, axis, effect, hover)
        names = [controller.parameter_names[name] for name in "pid"]
        usual = dict(zip(names, TABLES["gains"][autopilot][axis], strict=True))
        default = controller.with_parameters(usual)
        margin = true_figures(default, plant)["rate_gain_margin"]
        excess = margin - random_value("gain_margin")
        factor = 10 ** (excess / 20)
        gains = {name: factor * default.parameters[name] for name in names}
        gains[controller.parameter_names["angle_gain"]] = random_value("angle")
        truth = true_figures(default.with_parameters(gains), plant)
        least = min(least, truth["rate_phase_margin"], truth["attitude_phase_margin"])
        parameters |= gains
    if least > MIN_PHASE_MARGIN:
        return scenario_of(wanted)
    return random_scenario(seed, rng)


def axis_controller(of: Scenario, axis: Axis) -> Controller:
    """Returns the controller of one axis that a scenario flies."""
    row = 2 + AXES.index(axis)
    columns = rotor_frame(of.vehicle.frame, airframe(of.vehicle).arm)
    weights = columns[row]
    parameters = control_parameters(of)
    return controller_from_parameters(parameters, axis, weights)


def true_plant(of: Scenario, axis: Axis, effect: Array, shares: Sequence[float]) -> list[float]:
    """Returns the true plant of one axis, in the order of ``PLANT``.

    Args:
        of: the scenario.
        axis: the axis.
        effect: angular acceleration per output of each motor (4,), rad/s² per µs.
        shares: mean output of each motor (4,), as a share of its range of 1 ms.

    Returns:
        Control effectiveness, rad/s² per demand, damping, 1/s, lag, s, and delay, s.
    """
    damping = -axis_model(of.vehicle, axis).A[-1, -1]
    per_demand = axis_controller(of, axis).outputs_per_demand(shares)
    gain = 1000 * effect @ per_demand
    lag = sum(airframe(of.vehicle).rotor_lags) / 2
    delay = of.sensors.delay + of.cycle / 2
    return [float(gain), float(damping), lag, delay]


def figures_by_name(gains: Array, draws: Array, *loops: OpenLoop) -> dict[str, Array]:
    """Returns the figures of N plants and of their rate and attitude loops by name (N,).

    Args:
        gains: control effectiveness of each plant (N,), rad/s² per demand.
        draws: damping, 1/s, lag, s, and delay, s, of each plant (N, 3).
        loops: rate loop and attitude loop of these plants.
    """
    parameters = dict(zip(PLANT, (gains, *draws.T), strict=True))
    for name, loop in zip(LOOPS, loops, strict=True):
        parameters |= {f"{name}_{margin}": loop.figures[margin] for margin in MARGINS}
    return parameters


def true_figures(controller: Controller, plant: Sequence[float]) -> dict[str, float]:
    """Returns the figures of a known plant and of its rate and attitude loop by name.

    Args:
        controller: controller of the axis.
        plant: the plant, in the order of ``PLANT``.
    """
    plants = np.array(plant[:1]), np.array([plant[1:]])
    rate = rate_loop(controller, *plants)
    attitude = attitude_loop(controller, rate)
    figures = figures_by_name(*plants, rate, attitude)
    return {name: float(figure[0]) for name, figure in figures.items()}


def flight_folder(seed: int, cache: Path) -> Path:
    """Returns the folder of a simulated flight, with its log and truth.json; the flight is flown if it is not there.

    Args:
        seed: seed of the flight.
        cache: folder of all flights.
    """
    folder = cache / str(seed)
    if (folder / "truth.json").exists():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    of, motion = drawn_flight(seed)
    write_log(folder / "flight.tlog", of, motion)
    truths = true_figures_of_flight(of, motion)
    (folder / "truth.json").write_text(json.dumps(truths, indent=1), "utf-8")
    return folder


def drawn_flight(seed: int) -> tuple[Scenario, Motion]:
    """Draws a scenario and flies it, until it neither tumbles nor has motors at limits for too long.

    Args:
        seed: seed of the flight.
    """
    rng = default_rng(seed)
    while True:
        of = random_scenario(seed, rng)
        with suppress(ValueError):  # it tumbles
            motion = fly(of)
            outputs = _outputs_in_air(motion)
            full = outputs >= MAX_PULSE
            idle = outputs <= pulse_width(IDLE_COMMAND)
            if (full | idle).any(axis=1).mean() <= MAX_AT_LIMIT_SHARE:
                return of, motion


def true_figures_of_flight(of: Scenario, motion: Motion) -> Truth:
    """Returns the figures of the true plants and loops of all axes of a flight."""
    shares = (_outputs_in_air(motion).mean(axis=0) / 1000 - 1).tolist()
    effects = truth(of, motion)
    truths: Truth = {}
    for axis in AXES:
        plant = true_plant(of, axis, effects[f"{axis}_effect"], shares)
        truths[axis] = true_figures(axis_controller(of, axis), plant)
    return truths


def _outputs_in_air(motion: Motion) -> Array:
    """Returns the outputs of all motors in the air (T, 4), µs."""
    outputs: Array = motion.outputs[motion.landed_state == IN_AIR]
    return outputs


def simulated_log(seed: int, cache: Path, is_rounded: bool = False) -> tuple[Log, Truth]:
    """Returns the log of a simulated flight, and its true figures.

    Args:
        seed: seed of the flight.
        cache: folder of all flights.
        is_rounded: whether stamps are those of MAVLink, of which some are whole milliseconds; else all are exact, as in
            autopilots' own logs.
    """
    folder = flight_folder(seed, cache)
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    path = folder / "flight.tlog"
    log = read_log(path) if is_rounded else exact_log(path)
    return log, truth


def exact_log(path: Path) -> Log:
    """Reads the log of a simulated flight, and gives its messages the exact times of the autopilot's cycles."""
    log = read_log(path)
    exact = {
        name: {**columns, "time": np.round(columns["time"] * LOOP_RATE) / LOOP_RATE}
        for name, columns in log.vehicles[0].messages.items()
    }
    vehicle = replace(log.vehicles[0], messages=exact)
    return replace(log, vehicles=(vehicle,))


def identified_loops(log: Log, rate: float) -> Mapping[str, Loop | NoLoop]:
    """Returns the loops that ``mavdem tune`` identifies by axis, with messages thinned to a rate.

    Args:
        log: the log.
        rate: rate of the messages, Hz; infinite for all messages.
    """
    vehicles = tuple(thinned(vehicle, rate) for vehicle in log.vehicles)
    slower = replace(log, vehicles=vehicles)
    return assess(slower, options=Options(with_model=False)).loops


def thinned(vehicle: Telemetry, rate: float) -> Telemetry:
    """Returns the telemetry without some of the messages that come faster than a rate, in Hz."""
    kept = {}
    for name, columns in vehicle.messages.items():
        recorded = (columns[key] for key in KIND_FIELDS if key in columns)
        kinds = next(recorded, columns["boot"])
        rows = [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
        rates = (rate_without_gaps(np.diff(columns["time"][part])) for part in rows)
        parts = [part[:: max(1, round(own / rate))] for part, own in zip(rows, rates, strict=True)]
        chosen = np.sort(np.concatenate(parts))
        kept[name] = selected_rows(columns, chosen)
    return replace(vehicle, messages=kept)


def estimates_with_intervals(loop: Loop) -> dict[str, Array]:
    """Returns the figures of a loop by name: the estimate and the ends of its 90 % interval (3,)."""
    figures = figures_by_name(loop.effectiveness, loop.dynamics, loop.rate, loop.attitude)
    return {
        name: np.append(figure[0], np.quantile(figure[1:], INTERVAL_QUANTILES, method="nearest"))
        for name, figure in figures.items()
    }


def root_cause(fact: Fact) -> str:
    """Returns the name of the fact that a reason follows from in the end."""
    because = fact.figures.get("because")
    if isinstance(because, Fact):
        return root_cause(because)
    return fact.code.name


def recorded_truth(log: Log, name: str) -> Truth:
    """Returns the true figures of the axes of a recorded log, where they are known.

    Args:
        log: the log, with the parameters of the autopilot.
        name: name of its file.
    """
    return {
        axis: true_figures(
            controller_from_parameters(log.vehicles[0].parameters, axis, (1.0,)), recording["plant"]
        )
        for recording in TABLES["recorded"]
        if name.startswith(tuple(recording["files"]))
        for axis in recording["axes"]
    }


def evaluate_log(
    source: Path | int, rates: Sequence[float], cache: Path, is_rounded: bool = False
) -> list[Values]:
    """Returns a row for each figure of each axis at each rate, or a row with the cause where there is no loop.

    Args:
        source: path of a log, or seed of a simulated flight.
        rates: rates to which messages are thinned, Hz.
        cache: folder of all simulated flights.
        is_rounded: whether a simulated flight has the stamps of MAVLink, as for :func:`simulated_log`.
    """
    name = source.name if isinstance(source, Path) else str(source)
    try:
        if isinstance(source, Path):
            log = read_log(source)
            truth = recorded_truth(log, name)
        else:
            log, truth = simulated_log(source, cache, is_rounded)
    except Refusal as error:
        row = {"log": name, "rate": np.nan, "axis": "", "figure": ""}
        return [row | {"cause": root_cause(error.fact)}]
    rows = []
    for rate in rates:
        for axis, loop in identified_loops(log, rate).items():
            row = {"log": name, "rate": rate, "axis": axis, "figure": "", "cause": ""}
            if isinstance(loop, NoLoop):
                rows.append(row | {"cause": root_cause(loop.refusal)})
                continue
            for figure, (estimate, low, high) in estimates_with_intervals(loop).items():
                true = truth.get(axis, {}).get(figure, np.nan)
                rows.append(
                    row
                    | {
                        "figure": figure,
                        "estimate": estimate,
                        "low": low,
                        "high": high,
                        "true": true,
                    }
                )
    return rows


def error_statistics(rows: Any) -> pd.Series:
    """Returns statistics of the errors of one figure, and the share of intervals that hold the truth.

    Args:
        rows: rows of this figure, as :func:`evaluate_log` returns them.
    """
    errors = rows["estimate"] - rows["true"]
    if rows.name[0].endswith("gain_margin"):
        errors = errors.fillna(0.0).clip(-MAX_GAIN_ERROR, MAX_GAIN_ERROR)
    elif "margin" not in rows.name[0]:
        errors = errors / rows["true"]
    line = {"given": len(rows), "rms": (errors**2).mean() ** 0.5}
    line |= {"median": errors.median(), "size": errors.abs().median()}
    line["close"] = percent_true(errors.abs() <= CLOSE_GAIN_ERROR)
    line["inside"] = percent_true(rows["true"].between(rows["low"], rows["high"]))
    return pd.Series(line)


HALF = click.option("--half", type=click.Choice(list(HALVES)), default="choose", show_default=True)
CACHE = click.option("--cache", default=CACHE_FOLDER, show_default=True, type=Path)


@command(__doc__, flights=24)
@click.argument("logs", nargs=-1, type=Path)
@click.option("--rates", default="400 200 100 80 50 25 10", help="Hz; inf: as recorded.")
@click.option("--rounded", is_flag=True, help="Stamps as MAVLink rounds them.")
@HALF
@CACHE
def main(
    logs: tuple[Path, ...],
    half: str,
    rates: str,
    rounded: bool,
    flights: int,
    cache: Path,
    jobs: int,
) -> None:
    hertz = [float(rate) for rate in rates.split()]
    read = partial(evaluate_log, rates=hertz, cache=cache, is_rounded=rounded)
    rows = evaluate_flights(read, logs or HALVES[half][:flights], jobs)
    if logs:
        is_shown = rows["figure"].isin(SHOWN_FIGURES) | (rows["cause"] != "")
        print_table("Logs", rows[is_shown])
        return
    axes = rows.drop_duplicates(["log", "rate", "axis"])
    counts = axes.groupby(["rate", "cause"]).size()
    print_table("Given or refused, axes", counts.reset_index(name="axes"))
    given = rows[rows["cause"] == ""]
    both = pd.concat([given, given.assign(axis="all")])
    grouped = both.groupby(["figure", "rate", "axis"], sort=False).apply(error_statistics)
    for figure, table in grouped.reset_index().groupby("figure", sort=False):
        print_table(figure, table.drop(columns="figure"))


if __name__ == "__main__":
    main()
