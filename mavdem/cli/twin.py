"""``mavdem twin``: the vehicle that a log shows, for simulators, and how much alike the two fly."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from pathlib import Path

import click
import numpy as np
from numpy.random import default_rng

from mavdem.alignment.drive import AXES, TILT_AXES
from mavdem.assessment import Assessment
from mavdem.cli.options import (
    Number,
    assessed,
    json_option,
    params_option,
    vehicle_option,
)
from mavdem.cli.output import check_file, print_result, printable, say_aside, write_text
from mavdem.condition.condition import hover_of
from mavdem.condition.loop.loop import LoopByAxis, known_loops
from mavdem.condition.loop.twin import (
    BANDS,
    SETTLES,
    Again,
    Twin,
    again_of,
    alike,
    torque,
    twin_of,
)
from mavdem.dem.airflow.model import Drag
from mavdem.dem.engine.linalg import Array
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import Gains, Twins
from mavdem.ingest.telemetry import Parameters
from mavdem.report.blocks import Sentence, Table
from mavdem.report.vehicle_files import LEFT_OUT, vehicle_text
from sitl_scenarios.files import scenario_of
from sitl_scenarios.simulation import replayed

FLIGHTS = 3  # of the twin, each in other wind of the same spectrum
FORETOLD_SECONDS = 40.0  # of a flight, by gains to set: who has just landed waits for it
SHOWN = {
    "mass": "mass (kg)",
    "inertia": "inertia (kg m²)",
    "lag": "motor time constant, gyro filters apart (s)",
    "damping": "rate damping (1/s)",
    "delay": "delay (s)",
    "hover": "hover (share of range)",
    "drag.linear": "drag along body x and y (1/s)",
    "drag.quadratic": "quadratic drag along body x and y (1/m)",
    "wind_speed": "wind (m/s)",
    "wind_direction": "wind comes from (°)",
}
FIGURES = {"lean": ", mean (°)", "sway": ", sd (°)", "rate": " rate, sd (°/s)"}


@click.command("twin")
@click.argument("source", type=click.Path())
@click.option(
    "--out",
    multiple=True,
    type=click.Path(path_type=Path),
    help="File to write, one or more, by its ending: .toml for `mavdem fly --vehicle`, .json a frame of ArduPilot's "
    "SITL, .params of PX4's SIH, .sdf motors of Gazebo.",
)
@click.option(
    "--mass",
    type=Number(0.005, 1000.0),
    help="Mass of the vehicle, kg.  [default: 1.5, with a remark]",
)
@vehicle_option
@params_option
@json_option
def twin_command(
    source: str,
    out: tuple[Path, ...],
    mass: float | None,
    vehicle: str | None,
    params: Path | None,
    as_json: bool,
) -> None:
    """Makes a simulated vehicle of a log, and flies the log again.

    SOURCE is a log of a quadrotor with its autopilot's parameters, and motor outputs and attitude as `mavdem learn`
    needs them. Beside the vehicle's figures it prints how alike the log and the twin fly.

    \b
    Examples:
      mavdem twin flight.tlog --out mine.toml --mass 1.2
      mavdem fly iris_doublets --vehicle mine.toml --set MC_ROLLRATE_P=0.3 --out tried.tlog
    """
    for path in out:
        check_file(path, "--out", (".toml", *LEFT_OUT))
    assessment, evidence = assessed(source, vehicle, params)
    found = {
        axis: loop.grounded if isinstance(loop, Fact) and evidence.grounds else loop
        for axis, loop in evidence.loops.items()
    }
    if isinstance(found["roll"], Fact):
        raise NotLearnable([*evidence.grounds, found["roll"]][0])
    loops = known_loops(found)
    missing = [
        f"{axis.capitalize()} is not learned: {loop.advised}"
        for axis, loop in found.items()
        if isinstance(loop, Fact)
    ]
    twin = _twin(assessment, loops, mass)
    for path in out:
        write_text(path, vehicle_text(twin, path.suffix.lower(), Path(source).name))
        if left := LEFT_OUT.get(path.suffix.lower()):
            say_aside(f"{path.name} has no place for {left}.")
    known = {name: attrgetter(name)(twin) for name in SHOWN}
    rows = [
        [
            SHOWN[name],
            ", ".join(f"{each:.3g}" for each in np.ravel(value)),
            str(twin.notes.get(name.replace(".", "_"), "")),
        ]
        for name, value in known.items()
        if value is not None
    ]
    blocks: list[Sentence | Table] = [Sentence(sentence) for sentence in missing]
    blocks.append(Table(["Vehicle", "value", "how sure (90 %)"], rows, words=True))
    compared = _flown_again(twin, loops)
    document = {
        "vehicle": vars(twin) | {"drag": twin.drag.as_dict()},
        "missing": missing,
        "alike": compared,
    }
    for axis, figures in compared.items():
        cells = [
            [f"{axis} rate, {low:g} to {high:g} Hz (dB)", "0", f"{level:+.1f}"]
            for (low, high), level in zip(pairwise(BANDS), figures["levels"], strict=True)
        ]
        cells += [
            [f"{axis}{name}", *(f"{value:.2f}" for value in figures[key])]
            for key, name in FIGURES.items()
            if key in figures
        ]
        blocks.append(Table(["In wind of the same spectrum", "recorded", "twin"], cells))
    if not compared:
        blocks.append(
            Sentence("The setpoints of roll were not recorded: the twin does not fly them again.")
        )
    print_result(document, blocks, as_json)
    if out:
        say_aside(
            f"Written: {', '.join(printable(path) for path in out)}. Nothing was sent to a vehicle."
        )


def foretold(assessment: Assessment, gains: Parameters) -> Facts:
    """Returns by axis how far from its setpoints the twin of an assessed log flies, now and with the ``gains`` to set.

    Why not, where the twin cannot fly; nothing where the log has no setpoints of roll.
    """
    assert assessment.evidence is not None
    loops = known_loops(assessment.evidence.loops)
    again = again_of(loops) if "roll" in loops else {}
    if not again:
        return ()
    dt = loops["roll"].record.dt
    shown = slice(round(FORETOLD_SECONDS / dt))
    short = {axis: Again(*(part[shown] for part in whole)) for axis, whole in again.items()}
    settled = slice(round(SETTLES / dt), None)
    try:
        twin = _twin(assessment, loops, None)
        changed = replace(twin, parameters={**twin.parameters, **gains})
        flights = [_flown(each, loops, short, 1)[0] for each in (twin, changed)]
    except NotLearnable as error:
        return (error.fact,)
    facts = []
    for axis in filter(short.get, TILT_AXES):
        asked = short[axis].setpoints[settled, 0]
        missed = [motion[settled, AXES.index(axis), 0] - asked for motion in flights]
        before, after = np.degrees(np.std(missed, axis=1)).tolist()
        facts.append(
            Fact(Gains.TWIN_FLIES, subject=axis, present_error=before, expected_error=after)
        )
    return tuple(facts)


def _twin(assessment: Assessment, loops: LoopByAxis, mass: float | None) -> Twin:
    evidence = assessment.evidence
    assert evidence is not None
    hover = hover_of(evidence.signals.about("roll", "motors"), assessment.log.components)
    telemetry = evidence.signals.telemetry
    air, *_ = evidence.air
    drag = (
        Drag.of_parameters(telemetry.autopilot, telemetry.parameters) if air is None else air.drag
    )
    share = float(np.mean(hover.trim_of_range))
    return twin_of(loops, telemetry.autopilot == "PX4", share, air, drag, mass)


def _flown_again(twin: Twin, loops: LoopByAxis) -> dict[str, dict[str, list[float]]]:
    """By axis, figures of the recorded flight and of the twin's; none without setpoints of roll."""
    again = again_of(loops)
    if not again:
        return {}
    flown = _flown(twin, loops, again, FLIGHTS)
    return {
        axis: alike(loops[axis], loop.outputs, [motion[:, AXES.index(axis)] for motion in flown])
        for axis, loop in again.items()
    }


def _flown(twin: Twin, loops: LoopByAxis, again: Mapping[str, Again], flights: int) -> list[Array]:
    """Motions (T, 3, 2) of the twin, as the simulator's ``replayed`` has them, on the setpoints of a flight."""
    samples = len(again["roll"].outputs)
    setpoints = np.zeros((samples, len(AXES), 2))
    for axis, loop in again.items():
        setpoints[:, AXES.index(axis)] = loop.setpoints
    flown = []
    try:
        scenario = scenario_of(tomllib.loads(vehicle_text(twin, ".toml", "")))
        for seed in range(flights):
            noise = default_rng(seed)
            blown = np.zeros((samples, len(AXES)))
            for axis in again:
                blown[:, AXES.index(axis)] = torque(loops[axis], samples, noise)
            seeded = scenario.model_copy(update={"seed": seed})
            flown.append(replayed(seeded, loops["roll"].record.dt, setpoints, blown))
    except ValueError as error:
        raise NotLearnable(Twins.CANNOT_FLY, because=error) from None
    return flown
