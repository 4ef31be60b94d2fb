"""``mavdem fly``: a simulated flight in wind, into files or live on the network."""

import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from time import perf_counter

import click

from mavdem.cli.options import NumberRange, file_option, json_option
from mavdem.cli.output import print_json, progress
from mavdem.cli.output_files import check_output_file
from mavdem.cli.streams import print_to_stderr, print_to_stdout
from mavdem.containers import JsonValues, Names
from mavdem.export.conversion import STREAM_WRITERS
from mavdem.extras import require_extra
from mavdem.files import atomic_writes, reporting_write_errors
from mavdem.ingest.parameter_file import read_parameters
from sitl_scenarios.dynamics import frame
from sitl_scenarios.files import (
    in_toml,
    load,
    names,
    scenario_of,
    with_parameters,
    with_vehicle,
)
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS
from sitl_scenarios.mavlink.live import Ground, fly_live
from sitl_scenarios.mavlink.transmitter import recorded
from sitl_scenarios.plan import seconds
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation
from sitl_scenarios.simulation import fly as fly_through
from sitl_scenarios.truth import write_truth
from sitl_scenarios.vehicles import airframe


@click.command("fly")
@click.argument("scenario", type=click.Path(), required=False)
@file_option(
    "--out",
    "Telemetry log (.tlog) or MCAP recording (.mcap) to write; the true states go beside it, .truth.npz.",
)
@file_option("--rrd", "Rerun recording to write: the flight in 3D.")
@click.option("--udp", metavar="HOST:PORT", help="Fly live and send MAVLink to HOST:PORT.")
@click.option(
    "--speed",
    type=NumberRange(0.01, 1000.0),
    default=1.0,
    show_default=True,
    help="Speed of a live flight, as a multiple of real time.",
)
@file_option(
    "--vehicle", "A .toml file of `mavdem twin`, or a scenario's: its vehicle is flown instead."
)
@file_option("--params", "Parameters to set: gains.params or gains.param of `mavdem tune`.")
@click.option(
    "--set",
    "changed",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter to set.",
)
@click.option("--seed", type=int, help="Random seed, instead of the scenario's.")
@click.option(
    "--duration", type=float, help="Seconds from arming to disarming, instead of the scenario's."
)
@click.option(
    "--describe",
    is_flag=True,
    help="Print the scenario as a .toml file with the meaning and range of every value; nothing is flown.",
)
@click.option("--list", "as_list", is_flag=True, help="List the scenarios, one a line, name first.")
@json_option
def fly_command(
    scenario: str | None,
    out: Path | None,
    rrd: Path | None,
    udp: str | None,
    speed: float,
    vehicle: Path | None,
    params: Path | None,
    changed: Names,
    seed: int | None,
    duration: float | None,
    describe: bool,
    as_list: bool,
    as_json: bool,
) -> None:
    """Simulates the flight of a quadrotor in wind.

    SCENARIO is a name from --list, or the path of a .toml file. The vehicle arms, climbs, hovers as the scenario says,
    lands and disarms. It sends MAVLink as PX4 or ArduPilot does: into a log (--out), with the true states beside it, or
    live to a ground station (--udp), which may request messages and parameters, arm and disarm. The same scenario and
    seed give the same log, byte by byte; each seed has its own date.

    \b
    Examples:
      mavdem fly --list
      mavdem fly hover_blower --out flight.tlog --rrd flight.rrd
      mavdem learn flight.tlog --truth flight.truth.npz
      mavdem fly hover_blower --vehicle mine.toml --params tuned/gains.params --out flight.tlog

    \b
    Scenarios of your own: start from one of these.
      mavdem fly hover_blower --describe > mine.toml
      mavdem fly mine.toml --seed 2 --duration 120 --out flight.mcap

    \b
    Live, for a ground station that listens on port 14550:
      mavproxy.py --master=udpin:127.0.0.1:14550 --streamrate=-1
      mavdem fly hover_blower --udp 127.0.0.1:14550

    Without --streamrate=-1 MAVProxy requests 4 Hz from ArduPilot, which is too slow to learn from.
    """
    if as_list:
        scenarios = [{"name": name, "description": load(name).description} for name in names()]
        if as_json:
            return print_json({"scenarios": scenarios})
        width = max(map(len, names()))
        return print_to_stdout(
            "\n".join(
                f"{scenario['name']:{width}}  {scenario['description']}" for scenario in scenarios
            )
        )
    if scenario is None:
        raise click.UsageError(
            "Missing argument 'SCENARIO': one of `mavdem fly --list`, or a .toml file."
        )
    given = {} if params is None else read_parameters(params)
    changes = [*(f"{name}={value}" for name, value in given.items()), *changed]
    chosen = _chosen(scenario, seed, duration, vehicle, changes)
    if describe:
        if as_json:
            return print_json({"scenario": scenario, "values": chosen.model_dump(mode="json")})
        return print_to_stdout(in_toml(chosen))
    if (udp is None) == (out is None and rrd is None):
        raise click.UsageError(
            "Name files with --out and --rrd, or a ground station to fly live with --udp: choose one."
        )
    name = Path(scenario).stem
    report = _to_files(name, chosen, out, rrd) if udp is None else _live(name, chosen, udp, speed)
    if as_json:
        print_json(
            {"scenario": scenario, "seed": chosen.seed, "duration": chosen.duration, **report}
        )


@contextmanager
def _refusing(hint: str = "", before: str = "") -> Iterator[None]:
    """What is refused with a ``ValueError`` is bad usage: of the argument in ``hint``, or else in a sentence."""
    try:
        yield
    except ValueError as error:
        if hint:
            raise click.BadParameter(f"{before}{error}.", param_hint=hint) from error
        raise click.UsageError(f"{str(error)[:1].upper()}{str(error)[1:]}.") from error


def _chosen(
    named: str,
    seed: int | None,
    duration: float | None,
    vehicle: Path | None,
    changed: Sequence[str],
) -> Scenario:
    with _refusing("SCENARIO"):
        scenario = load(named)
    if scenario == Scenario():
        print_to_stderr(f"{Path(named).name} sets no value: every value is the default.")
    for key, value in {"seed": seed, "duration": duration}.items():
        if value is not None:
            with _refusing(f"--{key}"):
                scenario = scenario_of(scenario.model_dump(mode="json") | {key: value})
    if vehicle is not None:
        with _refusing("--vehicle"):
            scenario = with_vehicle(scenario, load(vehicle))
    if changed:
        with _refusing("--params, --set"):
            scenario = with_parameters(scenario, changed)
    with _refusing("SCENARIO", f"{Path(named).name}: "):  # not after a long flight
        AUTOPILOTS[scenario.stream.autopilot].rates(scenario.stream.rate, scenario.stream.rates)
    return scenario


def _to_files(name: str, scenario: Scenario, out: Path | None, rrd: Path | None) -> JsonValues:
    check_output_file(out, "--out", tuple(STREAM_WRITERS))
    truth = None if out is None else out.with_suffix(".truth.npz")
    check_output_file(truth, "--out", (".npz",))
    check_output_file(rrd, "--rrd", (".rrd",))
    if rrd is not None:
        require_extra("view", "--rrd")
    # The log appears last, with its companions in place.
    files = list(filter(None, (truth, rrd, out)))
    began = perf_counter()
    with _refusing(), progress(f"Flying {name}") as done:
        motion = fly_through(scenario, done)
    report: JsonValues = {}
    with (
        reporting_write_errors(*files),
        atomic_writes(*files) as unfinished,
        progress("Writing", measured=False),
    ):
        unfinished_of = dict(zip(files, unfinished, strict=True))
        if out is not None and truth is not None:
            stream = recorded(scenario, motion)
            with unfinished_of[out].open("wb") as file:
                report |= {
                    "out": str(out),
                    "frames": STREAM_WRITERS[out.suffix.lower()](file, stream),
                    "truth": str(truth),
                }
            write_truth(unfinished_of[truth], scenario, motion)
        if rrd is not None:
            # Rerun takes a second to load
            from mavdem.view import pose_of, write_pose

            rotors = frame(scenario.vehicle.frame, airframe(scenario.vehicle).arm)
            pose = pose_of(motion, (rotors.forward, rotors.right))
            write_pose(unfinished_of[rrd], name, pose)
            report |= {"rrd": str(rrd)}
    report["took"] = round(perf_counter() - began, 3)
    print_to_stderr(f"Flew {motion.time[-1]:.1f} s in {report['took']:.1f} s.")
    if out is not None:
        print_to_stderr(
            f"Wrote {report['frames']} frames to {out}, and the true states to {truth}."
        )
        print_to_stderr(
            f"Learn: {shlex.join(['mavdem', 'learn', str(out), '--truth', str(truth)])}"
        )
    if rrd is not None:
        print_to_stderr(f"Wrote {rrd}; open it with `rerun {rrd}`.")
    return report


def _live(name: str, scenario: Scenario, udp: str, speed: float) -> JsonValues:
    match = re.fullmatch(r"\[?([^]]+)\]?:(\d{1,5})", udp, re.ASCII)
    if match is None or not 0 < int(match[2]) < 1 << 16:
        raise click.BadParameter(
            f"{udp} must be HOST:PORT, such as 127.0.0.1:14550.", param_hint="--udp"
        )
    whole = seconds(scenario)
    with _refusing(), closing(Ground(match[1], int(match[2]))) as ground:
        print_to_stderr(f"Flying {name} for {whole:g} s, sending to {udp}; Ctrl-C ends it.")
        with progress(f"Flying {name}") as done:
            simulation = Simulation(scenario)
            outcome = fly_live(
                scenario, simulation, ground, speed, lambda now: done(min(now / whole, 1.0))
            )
    ended = "Stopped after" if outcome.stopped else "Flew"
    print_to_stderr(
        f"{ended} {outcome.flown:.1f} s in {outcome.took:.1f} s: sent {outcome.sent} frames."
    )
    if (ran := outcome.flown / outcome.took if outcome.took else speed) < 0.95 * speed:
        print_to_stderr(
            f"This machine is too slow: it ran at {ran:.2g} times real time, not {speed:g}."
        )
    return {
        "udp": udp,
        "frames": outcome.sent,
        "commands": outcome.commands,
        "flown": round(outcome.flown, 3),
        "took": round(outcome.took, 3),
        "stopped": outcome.stopped,
    }
