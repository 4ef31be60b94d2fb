"""``mavdem fly``: a simulated flight in wind, into files or live on the network."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import fields
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import numpy as np

from mavdem.cli.new_file import check_file, writing
from mavdem.cli.output import print_json, printable, progress, say, say_aside
from mavdem.cli.scenario_file import in_toml
from mavdem.cli.scenario_text import in_words
from mavdem.cli.signals import ending_at_once
from mavdem.cli.source import no_option
from mavdem.convert import STREAMS
from mavdem.errors import Unreadable
from mavdem.whole_file import replaceable, whole_files
from sitl_scenarios.files import load, names, scenario_of
from sitl_scenarios.frames import frame
from sitl_scenarios.holding import Holding
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS
from sitl_scenarios.mavlink.live import Ground, Outcome, fly_live
from sitl_scenarios.mavlink.recorded import recorded
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation
from sitl_scenarios.simulation import fly as fly_through
from sitl_scenarios.truth import write_truth
from sitl_scenarios.vehicles import AIRFRAMES

KEPT_UP = 0.95
"""Share of the speed asked for below which a live flight is said not to have kept up."""

SLOWEST, FASTEST = 0.01, 1000.0
"""Seconds that a live flight may fly in a second; no machine reaches the greater."""


@click.command()
@click.argument("scenario", required=False)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    callback=no_option,
    help="Telemetry log (.tlog) or MCAP recording (.mcap) to write; the truth goes beside it, .truth.npz.",
)
@click.option(
    "--rrd", type=click.Path(path_type=Path), callback=no_option, help="Rerun recording to write: the flight in 3D."
)
@click.option("--udp", metavar="HOST:PORT", callback=no_option, help="Fly live and speak MAVLink to HOST:PORT.")
@click.option(
    "--speed",
    type=click.FloatRange(SLOWEST, FASTEST),
    help="Of a live flight: seconds flown in a second.  [default: 1]",
)
@click.option("--seed", type=int, help="Of everything random, instead of the scenario's.")
@click.option("--duration", type=float, help="Seconds from arming to disarming, instead of the scenario's.")
@click.option(
    "--describe", is_flag=True, help="Say what the scenario is, every value and what it may be, and fly nothing."
)
@click.option("--list", "as_list", is_flag=True, help="List the scenarios, one a line, the name first.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
def fly(
    scenario: str | None,
    out: Path | None,
    rrd: Path | None,
    udp: str | None,
    speed: float | None,
    seed: int | None,
    duration: float | None,
    describe: bool,
    as_list: bool,
    as_json: bool,
) -> None:
    """Flies a simulated quadrotor in wind.

    SCENARIO is a name from --list, or the path of a .toml file. The vehicle arms, climbs, hovers as the scenario says,
    lands and disarms, and speaks MAVLink as PX4 or ArduPilot does: into a log (--out), which comes with the truth it
    was made of, or live to a ground station (--udp), which may ask it for messages and parameters, and arm and disarm
    it. The same scenario and seed give the same log, byte by byte; its clock begins on 1 January 2026.

    \b
    Examples:
      mavdem fly --list
      mavdem fly hover_blower --out flight.tlog --rrd flight.rrd
      mavdem learn flight.tlog --out result
    \b
    Scenarios of your own: begin with one of these.
      mavdem fly hover_blower --describe > mine.toml
      mavdem fly mine.toml --seed 2 --duration 120 --out flight.mcap
    \b
    Live, for a ground station that listens on port 14550:
      mavproxy.py --master=udpin:127.0.0.1:14550 --streamrate=-1
      mavdem fly hover_blower --udp 127.0.0.1:14550

    Without --streamrate=-1 MAVProxy asks ArduPilot for 4 Hz, from which nothing can be learnt.
    """
    asked = {"--out": out, "--rrd": rrd, "--udp": udp, "--speed": speed}
    if as_list:
        _refuse_beside(
            "--list",
            asked | {"SCENARIO": scenario, "--seed": seed, "--duration": duration, "--describe": describe or None},
        )
        _list(as_json)
        return
    if scenario is None:
        raise click.UsageError("Missing argument 'SCENARIO': one of `mavdem fly --list`, or a .toml file.")
    if describe:
        _refuse_beside("--describe", asked)
        _describe(scenario, _chosen(scenario, seed, duration), as_json)
        return
    if udp is not None and (out or rrd):
        raise click.UsageError("--udp flies live, --out and --rrd fly into files: choose one.")
    if udp is None and speed is not None:
        raise click.UsageError("--speed is of a live flight: leave it out, or fly live with --udp.")
    chosen = _chosen(scenario, seed, duration)
    if udp is not None:
        told = _live(Path(scenario).stem, chosen, udp, 1.0 if speed is None else speed)
    elif out or rrd:
        told = _to_files(Path(scenario).stem, chosen, out, rrd)
    else:
        raise click.UsageError("Nothing to fly for: name a file with --out or --rrd, or a ground station with --udp.")
    if as_json:
        print_json({"scenario": scenario, "seed": chosen.seed, "duration": chosen.duration, **told})


def _refuse_beside(option: str, asked: dict[str, Any]) -> None:
    """Refuses what ``option``, which flies nothing, would ignore."""
    ignored = [name for name, value in asked.items() if value is not None]
    if ignored:
        raise click.UsageError(f"{option} flies nothing: leave out {' and '.join(ignored)}.")


def _list(as_json: bool) -> None:
    described = {name: load(name).description for name in names()}
    if as_json:
        print_json({"scenarios": [{"name": name, "description": text} for name, text in described.items()]})
        return
    width = max(map(len, described))
    for name, text in described.items():
        say(f"{name:{width}}  {text}")


def _chosen(named: str, seed: int | None, duration: float | None) -> Scenario:
    """The scenario with what the command line says instead."""
    try:
        scenario = load(named)
    except ValueError as error:
        raise click.BadParameter(f"{error}.", param_hint="SCENARIO") from error
    if scenario == Scenario():
        say_aside(f"{printable(Path(named).name)} says nothing of its own: every value is the default.")
    given = {"seed": seed, "duration": duration}
    instead = {key: value for key, value in given.items() if value is not None}
    try:
        chosen = scenario_of(scenario.model_dump(mode="json") | instead)
    except ValueError as error:
        raise click.BadParameter(f"{error}.", param_hint="--seed or --duration") from error
    try:
        AUTOPILOTS[chosen.stream.speaks].rates(chosen.stream.rate, chosen.stream.rates)
    except ValueError as error:
        # Not after a long flight.
        raise click.BadParameter(f"{Path(named).name}: {error}.", param_hint="SCENARIO") from error
    return chosen


def _describe(named: str, scenario: Scenario, as_json: bool) -> None:
    if as_json:
        print_json({"scenario": named, "words": in_words(scenario), "values": scenario.model_dump(mode="json")})
        return
    for sentence in in_words(scenario):
        say(f"# {printable(sentence)}")
    say()
    say(in_toml(scenario))


def _to_files(name: str, scenario: Scenario, out: Path | None, rrd: Path | None) -> dict[str, Any]:
    check_file(out, "--out", tuple(STREAMS))
    truth = None if out is None else out.with_suffix(".truth.npz")
    check_file(truth, "--out", (".npz",))
    check_file(rrd, "--rrd", (".rrd",))
    # The log appears last, when all that goes with it is there.
    files = [path for path in (truth, rrd, out) if path is not None]
    if len({replaceable(path) for path in files}) < len(files):
        raise Unreadable("--out and --rrd lead to the same file: name another.")
    began = perf_counter()
    with _in_a_sentence(), progress(f"Flying {name}") as done:
        motion = fly_through(scenario, done)
    told: dict[str, Any] = {}
    with writing(*files), whole_files(*files) as unfinished, progress("Writing", measured=False):
        place = dict(zip(files, unfinished, strict=True))
        if out is not None and truth is not None:
            stream = recorded(scenario, motion, Simulation(scenario).cycle, lambda _: None)
            with place[out].open("wb") as file:
                told |= {"out": str(out), "frames": STREAMS[out.suffix.lower()](file, stream), "truth": str(truth)}
            write_truth(place[truth], scenario, motion)
        if rrd is not None:
            _write_rrd(place[rrd], name, scenario, motion)
            told |= {"rrd": str(rrd)}
    told["took"] = round(perf_counter() - began, 3)
    say_aside(f"Flew {motion.time[-1]:.1f} s in {told['took']:.1f} s.")
    holding = Holding(scenario)
    holding.add(motion)
    told |= _say_cautions(holding)
    if out is not None:
        say_aside(f"Wrote {told['frames']} frames to {printable(out)}, and the truth to {printable(truth)}.")
    if rrd is not None:
        say_aside(f"Wrote {printable(rrd)}; open it with `rerun {printable(rrd)}`.")
    return told


@contextmanager
def _in_a_sentence() -> Iterator[None]:
    """What a flight is refused for, or ends with, is one sentence."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(f"{str(error)[:1].upper()}{str(error)[1:]}.") from error


def _say_cautions(holding: Holding) -> dict[str, Any]:
    cautions = holding.cautions()
    for caution in cautions:
        say_aside(f"Caution: {caution}.")
    return {"cautions": cautions}


def _write_rrd(path: Path, name: str, scenario: Scenario, motion: Motion) -> None:
    # Rerun takes a second to load.
    with ending_at_once():
        from mavdem.view import Pose, write_pose

    rotors = frame(scenario.vehicle.frame, AIRFRAMES[scenario.vehicle.model].arm)
    shown = {field.name: getattr(motion, field.name) for field in fields(Pose) if field.name != "rotors"}
    write_pose(path, name, Pose(**shown, rotors=np.column_stack([rotors.forward, rotors.right])))


def _live(name: str, scenario: Scenario, udp: str, speed: float) -> dict[str, Any]:
    host, port = _address(udp)
    if not math.isfinite(speed):
        raise click.BadParameter("it must be a number.", param_hint="--speed")
    whole = scenario.duration
    with _in_a_sentence(), closing(Ground(host, port)) as ground:
        say_aside(f"Flying {printable(name)} for {whole:g} s, speaking to {printable(udp)}; Ctrl-C ends it.")
        with progress(f"Flying {name}") as done:
            outcome = fly_live(
                scenario, Simulation(scenario), ground, speed, lambda now: done(min(now / whole, 1.0)), say_aside
            )
    _say_outcome(outcome, speed)
    return {
        "udp": udp,
        "frames": outcome.sent,
        "commands": outcome.commands,
        "unheard": outcome.unheard,
        "flown": round(outcome.flown, 3),
        "took": round(outcome.took, 3),
        "stopped": outcome.stopped,
        **_say_cautions(outcome.holding),
    }


def _say_outcome(outcome: Outcome, speed: float) -> None:
    ended = "Stopped after" if outcome.stopped else "Flew"
    say_aside(f"{ended} {outcome.flown:.1f} s in {outcome.took:.1f} s: sent {outcome.sent} frames.")
    if outcome.flown < KEPT_UP * speed * outcome.took:
        say_aside(f"This machine kept up with {outcome.flown / outcome.took:.2g} times real time, not {speed:g}.")
    if outcome.unheard:
        say_aside(f"More was said to it than it can answer: {outcome.unheard} datagrams were dropped, or part of them.")


def _address(udp: str) -> tuple[str, int]:
    host, _, port = udp.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isascii() or not port.isdigit() or len(port) > 5 or not 0 < int(port) < 1 << 16:
        raise click.BadParameter(f"{udp} must be HOST:PORT, as 127.0.0.1:14550.", param_hint="--udp")
    return host, int(port)
