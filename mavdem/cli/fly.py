"""``mavdem fly``: a simulated flight in wind, into files or live on the network."""

from __future__ import annotations

import math
import os
from contextlib import ExitStack, closing
from dataclasses import fields
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import numpy as np

from mavdem.cli.output import print_json, progress, say, say_aside
from mavdem.cli.scenario_text import in_toml, in_words
from mavdem.cli.signals import ending_at_once
from mavdem.cli.source import no_option
from mavdem.convert import STREAMS
from mavdem.errors import Unreadable
from mavdem.whole_file import whole_file
from sitl_scenarios.files import load, names, scenario_of
from sitl_scenarios.frames import frame
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
    type=click.FloatRange(0, min_open=True),
    default=1.0,
    show_default=True,
    help="Of a live flight: seconds flown in a second.",
)
@click.option("--seed", type=int, help="Of everything random, instead of the scenario's.")
@click.option("--duration", type=float, help="Seconds from arming to disarming, instead of the scenario's.")
@click.option("--describe", is_flag=True, help="Say what the scenario is, every value, and fly nothing.")
@click.option("--list", "as_list", is_flag=True, help="List the scenarios, one a line, the name first.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
def fly(
    scenario: str | None,
    out: Path | None,
    rrd: Path | None,
    udp: str | None,
    speed: float,
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
      mavproxy.py --master=udpin:127.0.0.1:14550
      mavdem fly hover_blower --udp 127.0.0.1:14550
    """
    if as_list:
        _list(as_json)
        return
    if scenario is None:
        raise click.UsageError("Missing argument 'SCENARIO': one of `mavdem fly --list`, or a .toml file.")
    chosen = _chosen(scenario, seed, duration)
    if describe:
        _describe(scenario, chosen, as_json)
        return
    if udp is not None and (out or rrd):
        raise click.UsageError("--udp flies live, --out and --rrd fly into files: choose one.")
    if udp is not None:
        told = _live(Path(scenario).stem, chosen, udp, speed)
    elif out or rrd:
        told = _to_files(Path(scenario).stem, chosen, out, rrd)
    else:
        raise click.UsageError("Nothing to fly for: name a file with --out or --rrd, or a ground station with --udp.")
    if as_json:
        print_json({"scenario": scenario, "seed": chosen.seed, "duration": chosen.duration, **told})


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
        raise click.BadParameter(f"{error}.", param_hint="SCENARIO") from error
    return chosen


def _describe(named: str, scenario: Scenario, as_json: bool) -> None:
    if as_json:
        print_json({"scenario": named, "words": in_words(scenario), "values": scenario.model_dump(mode="json")})
        return
    for sentence in in_words(scenario):
        say(f"# {sentence}")
    say()
    say(in_toml(scenario))


def _to_files(name: str, scenario: Scenario, out: Path | None, rrd: Path | None) -> dict[str, Any]:
    _check(out, "--out", tuple(STREAMS))
    _check(rrd, "--rrd", (".rrd",))
    began = perf_counter()
    with progress(f"Flying {name}") as done:
        motion = fly_through(scenario, done)
    told: dict[str, Any] = {}
    try:
        # The log appears last, when all that goes with it is there.
        with ExitStack() as stack, progress("Writing", measured=False):
            if out is not None:
                writing = stack.enter_context(whole_file(out))
                stream = recorded(scenario, motion, Simulation(scenario).cycle, lambda _: None)
                frames = STREAMS[out.suffix.lower()](writing, stream)
                told |= {"out": str(out), "frames": frames}
            if rrd is not None:
                _write_rrd(rrd, name, scenario, motion)
                told |= {"rrd": str(rrd)}
            if out is not None:
                truth = out.with_suffix(".truth.npz")
                write_truth(truth, scenario, motion)
                told |= {"truth": str(truth)}
    except OSError as error:
        files = " or ".join(str(path) for path in (out, rrd) if path is not None)
        raise Unreadable(f"{files} cannot be written ({error.strerror or error}): name another file.") from None
    told["took"] = round(perf_counter() - began, 3)
    say_aside(f"Flew {motion.time[-1]:.1f} s in {told['took']:.1f} s.")
    if out is not None:
        say_aside(f"Wrote {told['frames']} frames to {out}, and the truth to {told['truth']}.")
    if rrd is not None:
        say_aside(f"Wrote {rrd}; open it with `rerun {rrd}`.")
    return told


def _write_rrd(path: Path, name: str, scenario: Scenario, motion: Motion) -> None:
    # Rerun takes a second to load.
    with ending_at_once():
        from mavdem.view import Pose, write_pose

    rotors = frame(scenario.vehicle.frame, AIRFRAMES[scenario.vehicle.model].arm)
    shown = {field.name: getattr(motion, field.name) for field in fields(Pose) if field.name != "rotors"}
    write_pose(path, name, Pose(**shown, rotors=np.column_stack([rotors.forward, rotors.right])))


def _check(path: Path | None, option: str, kinds: tuple[str, ...]) -> None:
    """Refuses, before the flight, what could not be written after it."""
    if path is None:
        return
    if path.suffix.lower() not in kinds:
        raise click.BadParameter(f"{path} must end in {' or '.join(kinds)}.", param_hint=option)
    folder = path.parent
    if not folder.is_dir():
        raise click.BadParameter(f"there is no folder {folder}.", param_hint=option)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise Unreadable(f"{path} cannot be written: {folder} is not writable; name another file.")


def _live(name: str, scenario: Scenario, udp: str, speed: float) -> dict[str, Any]:
    host, port = _address(udp)
    if not math.isfinite(speed):
        raise click.BadParameter("it must be a number.", param_hint="--speed")
    whole = scenario.duration
    try:
        with closing(Ground(host, port)) as ground:
            say_aside(f"Flying {name} for {whole:g} s, speaking to {udp}; Ctrl-C ends it.")
            with progress(f"Flying {name}") as done:
                outcome = fly_live(
                    scenario, Simulation(scenario), ground, speed, lambda now: done(min(now / whole, 1.0))
                )
    except ValueError as error:
        raise click.UsageError(f"{str(error)[:1].upper()}{str(error)[1:]}.") from error
    _say_outcome(outcome, speed)
    return {
        "udp": udp,
        "frames": outcome.sent,
        "commands": outcome.commands,
        "flown": round(outcome.flown, 3),
        "took": round(outcome.took, 3),
        "stopped": outcome.stopped,
    }


def _say_outcome(outcome: Outcome, speed: float) -> None:
    ended = "Stopped after" if outcome.stopped else "Flew"
    say_aside(f"{ended} {outcome.flown:.1f} s in {outcome.took:.1f} s: sent {outcome.sent} frames.")
    if outcome.flown < KEPT_UP * speed * outcome.took:
        say_aside(f"This machine kept up with {outcome.flown / outcome.took:.2g} times real time, not {speed:g}.")


def _address(udp: str) -> tuple[str, int]:
    host, _, port = udp.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 1 << 16:
        raise click.BadParameter(f"{udp} must be HOST:PORT, as 127.0.0.1:14550.", param_hint="--udp")
    return host, int(port)
