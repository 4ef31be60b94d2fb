"""``mavdem twin``: the vehicle that a log shows, for simulators, and how much alike the two fly."""

from __future__ import annotations

import tomllib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from mavdem.alignment.drive import AXES, TILT_AXES
from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.analysis.figures import axis_figures
from mavdem.cli.options import Number, no_option, vehicle_option
from mavdem.cli.output import check_file, print_result, progress, say_aside, write_text
from mavdem.cli.sources import read_source
from mavdem.condition.condition import hover_of
from mavdem.condition.loop.loop import Loop, loop_of
from mavdem.condition.loop.twin import BANDS, Twin, alike, asked, torque, twin_of
from mavdem.condition.wind_of_log import air_of
from mavdem.dem.engine.linalg import Array
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.flight import Flight
from mavdem.report.blocks import Sentence, Table
from mavdem.report.vehicle_files import LEFT_OUT, vehicle_text
from sitl_scenarios.files import scenario_of
from sitl_scenarios.replay import replayed

FLIGHTS, LONGEST = 3, 120.0  # of the twin, each in other wind of the same spectrum; s of the recorded flight
FIGURES = {"lean": "roll, mean (°)", "sway": "roll, sd (°)", "rate": "roll rate, sd (°/s)"}


@click.command("twin")
@click.argument("source", type=click.Path())
@click.option(
    "--out",
    multiple=True,
    type=click.Path(path_type=Path),
    callback=no_option,
    help="File to write, one or more, by its ending: .toml for `mavdem fly --vehicle`, .json a frame of ArduPilot's "
    "SITL, .params of PX4's SIH, .sdf motors of Gazebo.",
)
@click.option("--mass", type=Number(0.005, 1000.0), help="Mass of the vehicle, kg.  [default: 1.5, which is said]")
@vehicle_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
def twin_command(source: str, out: tuple[Path, ...], mass: float | None, vehicle: str | None, as_json: bool) -> None:
    """Makes a vehicle for simulators of a log, and flies the log again with it.

    SOURCE is a log of a quadrotor with its autopilot's parameters, and motor outputs and attitude as `mavdem learn`
    needs them. Change a gain before it is flown: mavdem fly hover_blower --vehicle mine.toml --set ATC_RAT_RLL_P=0.2
    """
    for path in out:
        check_file(path, "--out", (".toml", *LEFT_OUT))
    log = read_source(source)
    signals = Signals(choose_vehicle(log.vehicles, vehicle))
    px4, loops, flights, missing = signals.telemetry.autopilot == "PX4", dict[str, Loop](), dict[str, Flight](), []
    with progress("Learning the vehicle") as done:
        for number, axis in enumerate(AXES):
            figures = axis_figures(signals.about(axis), log.components)
            flights |= {axis: max(figures.flights, key=len)} if figures.flights else {}
            try:
                if figures.physical is None:
                    raise NotLearnable(figures.reason)
                loops[axis] = loop_of(figures.physical, Record.of(figures.flights))
            except NotLearnable as error:
                if axis == "roll":
                    raise
                missing.append(f"{axis.capitalize()} is not learned: {error.reason}")
            done((number + 1) / len(AXES))
    hover = hover_of(signals.about("roll", "motors"), log.components)
    drag = None if (wind := air_of(signals)[0]) is None else wind.drag
    twin = twin_of(loops, px4, float(np.mean(hover.trim_of_range)), drag, mass)
    for path in out:
        write_text(path, vehicle_text(twin, path.suffix.lower(), Path(source).name))
        if left := LEFT_OUT.get(path.suffix.lower()):
            say_aside(f"{path.name} has no place for {left}.")
    blocks: list[Sentence | Table] = [Sentence(one) for one in missing]
    shown = {"mass": "kg", "inertia": "kg m²", "lag": "s", "damping": "1/s", "delay": "s", "hover": "share of range"}
    rows = [
        [f"{name} ({unit})", ", ".join(f"{one:.3g}" for one in np.ravel(getattr(twin, name))), twin.notes.get(name, "")]
        for name, unit in shown.items()
    ]
    blocks.append(Table(["Vehicle", "value", "how sure (90 %)"], rows, words=True))
    document: dict[str, Any] = {"vehicle": asdict(twin), "missing": missing, "alike": None}
    setpoints = asked(flights, px4) if set(flights) >= set(TILT_AXES) else None
    if setpoints is None:
        blocks.append(Sentence("The setpoints of roll and pitch were not recorded: the twin does not fly them again."))
    else:
        document["alike"] = compared = _flown(twin, loops, flights["roll"], setpoints)
        bands = zip(BANDS[:-1], BANDS[1:], compared["levels"], strict=True)
        cells = [[f"roll rate, {low:g} to {high:g} Hz (dB)", "0", f"{level:+.1f}"] for low, high, level in bands]
        cells += [[name, *(f"{one:.2f}" for one in compared[key])] for key, name in FIGURES.items()]
        blocks.append(Table(["In wind of the same spectrum", "recorded", "twin"], cells))
    print_result(document, blocks, as_json)


def _flown(
    twin: Twin, loops: dict[str, Loop], flight: Flight, setpoints: tuple[Array, Array]
) -> dict[str, list[float]]:
    scenario, samples = scenario_of(tomllib.loads(vehicle_text(twin, ".toml", ""))), round(LONGEST / flight.dt)
    recorded, (angles, rates), flown = flight.outputs[:samples], setpoints, []
    with progress("Flying the twin", measured=False):
        for seed in range(FLIGHTS):
            noise, torques = np.random.default_rng(seed), np.zeros((len(recorded), 2))
            for number, axis in enumerate(one for one in TILT_AXES if one in loops):
                torques[:, number] = torque(loops[axis], len(recorded), flight.dt, noise)
            again = scenario.model_copy(update={"seed": seed})
            flown.append(replayed(again, flight.dt, angles[:samples], rates[:samples], torques))
    return alike(recorded, np.array(flown), flight.dt)
