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
from mavdem.export.stream_writers import STREAM_WRITERS
from mavdem.files import atomic_writes, reporting_write_errors
from mavdem.ingest.parameter_file import read_parameters
from sitl_scenarios.files import (
    load,
    names,
    scenario_from_table,
    scenario_toml,
    with_parameters,
    with_vehicle,
)
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS
from sitl_scenarios.mavlink.live import Ground, fly_live
from sitl_scenarios.mavlink.transmitter import recorded_stream
from sitl_scenarios.motion import Motion
from sitl_scenarios.plan import total_seconds
from sitl_scenarios.rotors import rotor_frame
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly as fly_through
from sitl_scenarios.simulation import simulation_of
from sitl_scenarios.truth import write_truth
from sitl_scenarios.vehicles import airframe

HOST_AND_PORT = re.compile(r"\[?(?P<host>[^]]+)\]?:(?P<port>\d{1,5})", re.ASCII)
"""Address of a ground station: HOST:PORT, with an IPv6 address in brackets."""

MAX_PORT = 65535
"""Largest port number of UDP."""

MIN_SPEED_RATIO = 0.95
"""A live flight that reaches less than this fraction of the chosen speed is reported as too slow; a choice."""


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
@file_option("--params", "Parameters to set: a .params or .param file of `mavdem tune`.")
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
    """Simulates the flight of a multirotor in wind.

    SCENARIO is a name from --list, or the path of a .toml file. The vehicle arms, climbs, hovers as the scenario
    says, lands and disarms. It sends MAVLink as PX4 or ArduPilot does: into a log (--out), with the true states
    beside it, or live to a ground station (--udp), which may request messages, read and set parameters, arm and
    disarm. The same scenario and seed give the same log, byte by byte; each seed has its own date.

    \b
    Examples:
      mavdem fly --list
      mavdem fly hover_blower --out flight.tlog
      mavdem learn flight.tlog --truth flight.truth.npz
      mavdem fly hover_blower --vehicle mine.toml --params tuned/gains.stage1.params --out flight.tlog

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
        _list_scenarios(as_json=as_json)
        return
    if scenario is None:
        raise click.UsageError(
            "Missing argument 'SCENARIO': one of `mavdem fly --list`, or a .toml file."
        )
    assignments = []
    if params is not None:
        for parameter, value in read_parameters(params).items():
            assignments.append(f"{parameter}={value}")
    assignments += changed
    chosen = _chosen_scenario(scenario, seed, duration, vehicle, assignments)
    if describe:
        _describe_scenario(scenario, chosen, as_json=as_json)
        return
    writes_files = out is not None or rrd is not None
    flies_live = udp is not None
    if writes_files == flies_live:
        raise click.UsageError(
            "Name files with --out and --rrd, or a ground station to fly live with --udp: choose one."
        )
    name = Path(scenario).stem
    if udp is not None:
        report = _fly_live(name, chosen, udp, speed)
    else:
        report = _fly_into_files(name, chosen, out, rrd)
    if as_json:
        print_json(
            {"scenario": scenario, "seed": chosen.seed, "duration": chosen.duration, **report}
        )


def _list_scenarios(*, as_json: bool) -> None:
    """Prints name and description of each built-in scenario, one per line or as a JSON document.

    Args:
        as_json: Whether to print a JSON document.
    """
    descriptions = {name: load(name).description for name in names()}
    if as_json:
        scenarios = []
        for name, description in descriptions.items():
            scenarios.append({"name": name, "description": description})
        print_json({"scenarios": scenarios})
        return
    # The descriptions begin in one column.
    name_width = max(len(name) for name in descriptions)
    for name, description in descriptions.items():
        print_to_stdout(f"{name:{name_width}}  {description}")


def _describe_scenario(name: str, scenario: Scenario, *, as_json: bool) -> None:
    """Prints all values of a scenario, as a .toml file with comments or as a JSON document.

    Args:
        name: Name or path by which the user has chosen the scenario.
        scenario: The scenario, with the values that options have changed.
        as_json: Whether to print the JSON document.
    """
    if as_json:
        print_json({"scenario": name, "values": scenario.model_dump(mode="json")})
    else:
        print_to_stdout(scenario_toml(scenario))


@contextmanager
def _usage_errors(argument: str = "", prefix: str = "") -> Iterator[None]:
    """Turns a ``ValueError`` in its block into an error of Click, which is reported as wrong usage.

    Args:
        argument: Name of the argument or option whose value is wrong; empty if no single one is.
        prefix: Text before the message of the error, if there is an argument.

    Raises:
        click.UsageError: The block raised a ``ValueError``.
    """
    try:
        yield
    except ValueError as error:
        message = str(error)
        if argument:
            raise click.BadParameter(f"{prefix}{message}.", param_hint=argument) from error
        capitalised_message = message[:1].upper() + message[1:]
        raise click.UsageError(f"{capitalised_message}.") from error


def _chosen_scenario(
    name: str,
    seed: int | None,
    duration: float | None,
    vehicle: Path | None,
    assignments: Sequence[str],
) -> Scenario:
    """Loads a scenario of simulated flight, and replaces the values that options of the command set.

    Everything is checked here, before the simulation, and each error names the option that caused it.

    Args:
        name: Name of a built-in scenario, or the path of a .toml file.
        seed: Random seed; None for the scenario's.
        duration: Time from arming to disarming, s; None for the scenario's.
        vehicle: File with the vehicle to fly; None for the scenario's.
        assignments: Parameters of the autopilot to set, such as "MC_ROLLRATE_P=0.3".

    Returns:
        The scenario, valid as a whole.

    Raises:
        click.BadParameter: There is no such scenario, or a value is not possible.
    """
    with _usage_errors("SCENARIO"):
        scenario = load(name)
    if scenario == Scenario():
        print_to_stderr(f"{Path(name).name} sets no value: every value is the default.")
    for key, value in {"seed": seed, "duration": duration}.items():
        if value is not None:
            with _usage_errors(f"--{key}"):
                scenario = scenario_from_table(scenario.model_dump(mode="json") | {key: value})
    if vehicle is not None:
        with _usage_errors("--vehicle"):
            scenario = with_vehicle(scenario, load(vehicle))
    if assignments:
        with _usage_errors("--params, --set"):
            scenario = with_parameters(scenario, assignments)
    # The rates of messages are checked here, since otherwise they would be refused only after a long flight.
    stream = scenario.stream
    with _usage_errors("SCENARIO", prefix=f"{Path(name).name}: "):
        AUTOPILOTS[stream.autopilot].rates(stream.rate, stream.rates, scenario.has_instruments)
    return scenario


def _fly_into_files(
    name: str, scenario: Scenario, out: Path | None, rrd: Path | None
) -> JsonValues:
    """Flies a scenario as fast as the machine can, and writes the files of the flight.

    Args:
        name: Name of the scenario, for progress and for the recording.
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.
        out: Log to write, with the true states in a file next to it; None for none.
        rrd: Recording for Rerun to write; None for none.

    Returns:
        Values of the command's document: the files, the number of frames, and the time that it took, s.

    Raises:
        Unreadable: A file cannot be written; then none is.
    """
    check_output_file(out, "--out", tuple(STREAM_WRITERS))
    truth = None if out is None else out.with_suffix(".truth.npz")
    check_output_file(truth, "--out", (".npz",))
    check_output_file(rrd, "--rrd", (".rrd",))
    # The log is the last to appear, so that the other files are there when a program waits for it.
    files = [path for path in (truth, rrd, out) if path is not None]
    start_time = perf_counter()
    with _usage_errors(), progress(f"Flying {name}") as show_fraction:
        motion = fly_through(scenario, show_fraction)
    report: JsonValues = {}
    with (
        reporting_write_errors(*files),
        atomic_writes(*files) as temporary_paths,
        progress("Writing", measured=False),
    ):
        temporary_path_of = dict(zip(files, temporary_paths, strict=True))
        if out is not None and truth is not None:
            write_frames = STREAM_WRITERS[out.suffix.lower()]
            with temporary_path_of[out].open("wb") as file:
                frame_count = write_frames(file, recorded_stream(scenario, motion))
            write_truth(temporary_path_of[truth], scenario, motion)
            report |= {"out": str(out), "frames": frame_count, "truth": str(truth)}
        if rrd is not None:
            _write_recording(temporary_path_of[rrd], name, scenario, motion)
            report["rrd"] = str(rrd)
    report["took"] = round(perf_counter() - start_time, 3)
    print_to_stderr(f"Flew {motion.time[-1]:.1f} s in {report['took']:.1f} s.")
    if out is not None:
        print_to_stderr(
            f"Wrote {report['frames']} frames to {out}, and the true states to {truth}."
        )
        learn_command = shlex.join(["mavdem", "learn", str(out), "--truth", str(truth)])
        print_to_stderr(f"Learn: {learn_command}")
    if rrd is not None:
        print_to_stderr(f"Wrote {rrd}; open it with `rerun {rrd}`.")
    return report


def _write_recording(path: Path, name: str, scenario: Scenario, motion: Motion) -> None:
    """Writes the Rerun recording of a simulated flight, which shows the vehicle's pose in 3D.

    Args:
        path: Path of the .rrd file.
        name: Name of the scenario.
        scenario: The scenario, whose vehicle has the rotors to show.
        motion: The true motion of the vehicle.
    """
    # Rerun takes a second to import.
    from mavdem.view import pose_from_motion, write_pose

    rotors = rotor_frame(scenario.vehicle.frame, airframe(scenario.vehicle).arm)
    write_pose(path, name, pose_from_motion(motion, (rotors.forward, rotors.right)))


def _fly_live(name: str, scenario: Scenario, udp: str, speed: float) -> JsonValues:
    """Flies a scenario in real time, or a multiple of it, and sends MAVLink to a ground station.

    Args:
        name: Name of the scenario, for messages.
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.
        udp: HOST:PORT of the ground station.
        speed: Speed of the simulation, as a multiple of real time.

    Returns:
        Values of the command's document: frames sent, commands received, simulated and real time in s, and whether the
        user has stopped the flight.

    Raises:
        click.BadParameter: ``udp`` is no host and port.
        click.UsageError: Nothing can be sent there.
    """
    match = HOST_AND_PORT.fullmatch(udp)
    if match is None or not 1 <= int(match["port"]) <= MAX_PORT:
        raise click.BadParameter(
            f"{udp} must be HOST:PORT, such as 127.0.0.1:14550.", param_hint="--udp"
        )
    duration = total_seconds(scenario)
    with _usage_errors(), closing(Ground(match["host"], int(match["port"]))) as ground:
        print_to_stderr(f"Flying {name} for {duration:g} s, sending to {udp}; Ctrl-C ends it.")
        with progress(f"Flying {name}") as show_fraction:

            def show_time(time: float) -> None:
                show_fraction(min(time / duration, 1.0))

            outcome = fly_live(scenario, simulation_of(scenario), ground, speed, show_time)
    verb = "Stopped after" if outcome.stopped else "Flew"
    print_to_stderr(
        f"{verb} {outcome.flown:.1f} s in {outcome.took:.1f} s: sent {outcome.sent} frames."
    )
    reached_speed = outcome.flown / outcome.took if outcome.took else speed
    if reached_speed < MIN_SPEED_RATIO * speed:
        print_to_stderr(
            f"This machine is too slow: it ran at {reached_speed:.2g} times real time, not {speed:g}."
        )
    return {
        "udp": udp,
        "frames": outcome.sent,
        "commands": outcome.commands,
        "flown": round(outcome.flown, 3),
        "took": round(outcome.took, 3),
        "stopped": outcome.stopped,
    }
