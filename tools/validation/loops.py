#!/usr/bin/env python
"""Margins of identified loops compared with the truth, of simulated flights thinned to lower rates, and of logs.

Of each message all but one in so many are left out; stamps stay as they are. Without LOGS the flights are simulated
ones, of the half to choose a method on or of the half to report; they are flown once and kept in --cache. "rms",
"median", "size" (median without sign) and "close" (within 1.5 dB) are of errors where loops are given, relative but for
margins in dB and degrees; "inside": of 90 % intervals that hold the truth.
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
from sitl_scenarios.rotors import IDLE_COMMAND, MAX_PULSE, pulse_width, rotor_frame
from sitl_scenarios.scenario import AXES, Axis, Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import axis_model, truth
from sitl_scenarios.vehicles import airframe

GIVEN = load_adjacent_toml(__file__, "loops.toml")
HALVES = {"choose": range(1000, 1024), "report": range(2000, 2024)}  # seeds
RATE = DEFAULT_LOOP_RATES["ardupilot"]  # of the simulated autopilots' loops, and of their messages
AT_LIMIT = 0.15  # share of the time in the air with a motor at a limit, at most
LEAST_PHASE = 15.0  # ° of the loops that are flown
KINDS = ("type_mask", "axis", "port")  # fields by which messages of one name are of several kinds
MARGINS = ("crossover", "phase_margin", "gain_margin", "ms")
PLANT = ("effect", "damping", "lag", "delay")
LOOPS = ("rate", "attitude")
SHOWN = ("effect", *(f"rate_{name}" for name in MARGINS))
CLOSE = 1.5  # dB
LARGEST = 30.0  # dB, that the error of a gain margin counts at most, as of one that there is not
Array = NDArray[np.float64]
Truth = dict[str, dict[str, float]]
"""Figures by axis and name."""


def drawn(seed: int, rng: Generator) -> Scenario:
    """Draws a scenario whose gains have the proportions of the autopilot's defaults, and margins that are drawn."""

    def one(name: str) -> float:
        return float(rng.uniform(*GIVEN["ranges"][name]))

    autopilot = ("ardupilot", "px4")[seed % 2]
    vehicle = rng.choice(GIVEN["vehicles"])
    wind = str(rng.choice(GIVEN["winds"]))
    like = Case("iris", wind, "none", RATE, autopilot, varied(rng), seed)
    wanted = scenario(like).model_dump(mode="json")
    parameters = {LOOP_RATE_PARAMETERS[autopilot]: RATE, **GIVEN["filters"][autopilot]}
    if seed % 3:  # of three flights two have the gyro's low-pass
        parameters |= GIVEN["gyro"][autopilot]
    wanted["vehicle"] |= {**vehicle, "parameters": parameters}
    steering = GIVEN["steering"]
    turn = seed // 2 % len(steering)
    wanted["excitation"] = steering[turn]
    wanted["sensors"] |= {name: one(name) for name in ("delay", "rate_sd")}
    wanted["stream"]["rates"] = {"ATTITUDE_TARGET": RATE}
    of = scenario_of(wanted)
    body = airframe(of.vehicle)
    share = body.command_for(body.hover_speed) / body.full_command
    hover = [share] * 4
    least = 180.0
    for axis in AXES:
        controller = flown_by(of, axis)
        effect = axis_model(of.vehicle, axis).B[-1]
        plant = plant_of(of, axis, effect, hover)
        names = [controller.parameter_names[name] for name in "pid"]
        usual = dict(zip(names, GIVEN["gains"][autopilot][axis], strict=True))
        default = controller.with_parameters(usual)
        margin = truth_of(default, plant)["rate_gain_margin"]
        excess = margin - one("gain_margin")
        factor = 10 ** (excess / 20)
        gains = {name: factor * default.parameters[name] for name in names}
        gains[controller.parameter_names["angle_gain"]] = one("angle")
        truth = truth_of(default.with_parameters(gains), plant)
        least = min(least, truth["rate_phase_margin"], truth["attitude_phase_margin"])
        parameters |= gains
    if least > LEAST_PHASE:
        return scenario_of(wanted)
    return drawn(seed, rng)


def flown_by(of: Scenario, axis: Axis) -> Controller:
    """The controller of one axis that a scenario flies."""
    row = 2 + AXES.index(axis)
    columns = rotor_frame(of.vehicle.frame, airframe(of.vehicle).arm)
    weights = columns[row]
    parameters = control_parameters(of)
    return controller_from_parameters(parameters, axis, weights)


def plant_of(of: Scenario, axis: Axis, effect: Array, shares: Sequence[float]) -> list[float]:
    """As ``PLANT``: of a demand where outputs, each of ``effect`` (4,) rad/s² per µs, are at ``shares`` of a ms."""
    damping = -axis_model(of.vehicle, axis).A[-1, -1]
    per_demand = flown_by(of, axis).outputs_per_demand(shares)
    gain = 1000 * effect @ per_demand
    lag = sum(airframe(of.vehicle).rotor_lags) / 2
    delay = of.sensors.delay + of.cycle / 2
    return [float(gain), float(damping), lag, delay]


def figures_of(gains: Array, draws: Array, *loops: OpenLoop) -> dict[str, Array]:
    """(N,) each figure of the plant and its rate and attitude loop by name: the estimate, and draws."""
    parameters = dict(zip(PLANT, (gains, *draws.T), strict=True))
    for name, loop in zip(LOOPS, loops, strict=True):
        parameters |= {f"{name}_{margin}": loop.figures[margin] for margin in MARGINS}
    return parameters


def truth_of(controller: Controller, plant: Sequence[float]) -> dict[str, float]:
    """Likewise, of a known plant."""
    plants = np.array(plant[:1]), np.array([plant[1:]])
    rate = rate_loop(controller, *plants)
    attitude = attitude_loop(controller, rate)
    figures = figures_of(*plants, rate, attitude)
    return {name: float(figure[0]) for name, figure in figures.items()}


def flown(seed: int, cache: Path) -> Path:
    """The folder of a flight, with its log and truth.json: made unless it is there."""
    folder = cache / str(seed)
    if (folder / "truth.json").exists():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    rng = default_rng(seed)
    limited = np.ones(1)
    while limited.mean() > AT_LIMIT:
        of = drawn(seed, rng)
        with suppress(ValueError):  # it tumbles
            motion = fly(of)
            outputs = motion.outputs[motion.landed_state == IN_AIR]
            full = outputs >= MAX_PULSE
            idle = outputs <= pulse_width(IDLE_COMMAND)
            limited = (full | idle).any(axis=1)
    shares = (outputs.mean(axis=0) / 1000 - 1).tolist()
    effects = truth(of, motion)
    truths = {}
    for axis in AXES:
        plant = plant_of(of, axis, effects[f"{axis}_effect"], shares)
        truths[axis] = truth_of(flown_by(of, axis), plant)
    write_log(folder / "flight.tlog", of, motion)
    (folder / "truth.json").write_text(json.dumps(truths, indent=1), "utf-8")
    return folder


def simulated(seed: int, cache: Path) -> tuple[Log, Truth]:
    """The log of a flight, with exact stamps as in autopilots' own logs and not of whole ms; and the truth."""
    folder = flown(seed, cache)
    log = read_log(folder / "flight.tlog")
    exact = {
        name: {**columns, "time": np.round(columns["time"] * RATE) / RATE}
        for name, columns in log.vehicles[0].messages.items()
    }
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    vehicle = replace(log.vehicles[0], messages=exact)
    return replace(log, vehicles=(vehicle,)), truth


def loops_in(log: Log, rate: float) -> Mapping[str, Loop | NoLoop]:
    """What ``mavdem tune`` finds by axis, where messages faster than ``rate``, Hz, but one in so many are left out."""
    vehicles = tuple(thinned(vehicle, rate) for vehicle in log.vehicles)
    slower = replace(log, vehicles=vehicles)
    return assess(slower, options=Options(with_model=False)).loops


def thinned(vehicle: Telemetry, rate: float) -> Telemetry:
    """The vehicle's messages, fewer of those that come faster than ``rate``, Hz."""
    kept = {}
    for name, columns in vehicle.messages.items():
        recorded = (columns[key] for key in KINDS if key in columns)
        kinds = next(recorded, columns["boot"])
        rows = [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
        rates = (rate_without_gaps(np.diff(columns["time"][part])) for part in rows)
        parts = [part[:: max(1, round(own / rate))] for part, own in zip(rows, rates, strict=True)]
        chosen = np.sort(np.concatenate(parts))
        kept[name] = selected_rows(columns, chosen)
    return replace(vehicle, messages=kept)


def estimates_of(loop: Loop) -> dict[str, Array]:
    """(3,) of each figure by name: the estimate and the ends of its 90 % interval."""
    figures = figures_of(loop.effectiveness, loop.dynamics, loop.rate, loop.attitude)
    return {
        name: np.append(figure[0], np.quantile(figure[1:], INTERVAL_QUANTILES, method="nearest"))
        for name, figure in figures.items()
    }


def cause(fact: Fact) -> str:
    """The code of what a reason follows from."""
    because = fact.figures.get("because")
    if isinstance(because, Fact):
        return cause(because)
    return fact.code.name


def known_of(log: Log, name: str) -> Truth:
    """What is true of the axes of a recorded log, where that is known."""
    return {
        axis: truth_of(
            controller_from_parameters(log.vehicles[0].parameters, axis, (1.0,)), recording["plant"]
        )
        for recording in GIVEN["recorded"]
        if name.startswith(tuple(recording["files"]))
        for axis in recording["axes"]
    }


def judged(source: Path | int, rates: Sequence[float], cache: Path) -> list[Values]:
    """A row for each figure of an axis at a rate of a log, or of the flight of a seed; or one with the cause."""
    name = source.name if isinstance(source, Path) else str(source)
    try:
        if isinstance(source, Path):
            log = read_log(source)
            truth = known_of(log, name)
        else:
            log, truth = simulated(source, cache)
    except Refusal as error:
        row = {"log": name, "rate": np.nan, "axis": "", "figure": ""}
        return [row | {"cause": cause(error.fact)}]
    rows = []
    for rate in rates:
        for axis, loop in loops_in(log, rate).items():
            row = {"log": name, "rate": rate, "axis": axis, "figure": "", "cause": ""}
            if isinstance(loop, NoLoop):
                rows.append(row | {"cause": cause(loop.refusal)})
                continue
            for figure, (estimate, low, high) in estimates_of(loop).items():
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


def line_of(rows: Any) -> pd.Series:
    """Statistics of the errors of one figure, and the share of intervals that hold the truth."""
    errors = rows["estimate"] - rows["true"]
    if rows.name[0].endswith("gain_margin"):
        errors = errors.fillna(0.0).clip(-LARGEST, LARGEST)
    elif "margin" not in rows.name[0]:
        errors = errors / rows["true"]
    line = {"given": len(rows), "rms": (errors**2).mean() ** 0.5}
    line |= {"median": errors.median(), "size": errors.abs().median()}
    line["close"] = percent_true(errors.abs() <= CLOSE)
    line["inside"] = percent_true(rows["true"].between(rows["low"], rows["high"]))
    return pd.Series(line)


HALF = click.option("--half", type=click.Choice(list(HALVES)), default="choose", show_default=True)
CACHE = click.option("--cache", default="/tmp/loops", show_default=True, type=Path)


@command(__doc__, flights=24)
@click.argument("logs", nargs=-1, type=Path)
@click.option("--rates", default="400 200 100 50 25 10", help="Hz; inf: as recorded.")
@HALF
@CACHE
def main(
    logs: tuple[Path, ...], half: str, rates: str, flights: int, cache: Path, jobs: int
) -> None:
    hertz = [float(rate) for rate in rates.split()]
    read = partial(judged, rates=hertz, cache=cache)
    rows = evaluate_flights(read, logs or HALVES[half][:flights], jobs)
    if logs:
        is_shown = rows["figure"].isin(SHOWN) | (rows["cause"] != "")
        print_table("Logs", rows[is_shown])
        return
    axes = rows.drop_duplicates(["log", "rate", "axis"])
    counts = axes.groupby(["rate", "cause"]).size()
    print_table("Given or refused, axes", counts.reset_index(name="axes"))
    given = rows[rows["cause"] == ""]
    both = pd.concat([given, given.assign(axis="all")])
    grouped = both.groupby(["figure", "rate", "axis"], sort=False).apply(line_of)
    for figure, table in grouped.reset_index().groupby("figure", sort=False):
        print_table(figure, table.drop(columns="figure"))


if __name__ == "__main__":
    main()
