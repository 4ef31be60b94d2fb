"""``mavdem tune``: margins of the rate and attitude loops with intervals, and gains to set; ``mavdem twin``."""

from __future__ import annotations

from pathlib import Path

import click

from mavdem.alignment.drive import AXES
from mavdem.alignment.read import choose_vehicle, usable_segments
from mavdem.alignment.signals import Signals
from mavdem.analysis.analysis import flown_after
from mavdem.analysis.figures import ALL
from mavdem.analysis.overrides import overrides_of
from mavdem.cli.learn import start_option
from mavdem.cli.options import folder_named, read_source, source_options
from mavdem.cli.output import check_folder, files_in, print_result, printable, progress, say_aside
from mavdem.condition import condition_of
from mavdem.condition.loop import TARGETS, Advice, Loop, advise, loop_of
from mavdem.dem import Physical, physical
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts.assessment import Override
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Telemetry
from mavdem.report.loops import tune_blocks
from mavdem.report.page import tune_page

REAL32 = 9  # MAV_PARAM_TYPE_REAL32
OF_FLIGHT = (
    Override.OSCILLATION,
    Override.SATURATION,
)  # what overrides all findings, and gains too


@click.command("tune")
@source_options((*AXES, ALL), "Axis of the loops; all: roll, pitch and yaw.")
@click.option(
    "--margins",
    type=click.Choice(list(TARGETS)),
    default="default",
    show_default=True,
    help="; ".join(
        f"{name}: phase {a:g}°, gain {b:g} dB, Ms {c:g}" for name, (a, b, c) in TARGETS.items()
    )
    + ".",
)
@start_option
@click.option(
    "--out",
    type=click.Path(),
    callback=folder_named,
    help="Folder for tune.html and the parameter files.",
)
def tune_command(
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    margins: str,
    start: float,
    out: Path | None,
) -> None:
    """Reports the margins of the rate and attitude loops, and gains to set.

    SOURCE is a log with the autopilot's parameters. The plant is identified from the flight, with its posterior, and
    the controller is that of the gains and filters in the parameters. The gains that are advised have the --margins in
    95 % of the plants that fit the flight, and no gain changes by more than a factor of 1.5. Nothing is ever sent to a
    vehicle: --out writes the gains for QGroundControl (.params) and Mission Planner (.param). Exit code: 1 if no gains
    are advised, with the reason.
    """
    log = read_source(source)
    telemetry = choose_vehicle(log.vehicles, vehicle)
    names = [
        "tune.html",
        "gains.params",
        *(["gains.param"] if telemetry.autopilot == "ARDUPILOTMEGA" else []),
    ]
    if out is not None:
        check_folder(out, names)
    signals = Signals(telemetry)
    found = dict[str, Advice | str]()
    overrides = overrides_of(condition_of(signals), ())
    doubts = [str(override) for override in overrides if override.code in OF_FLIGHT]
    for one in AXES if axis == ALL else (axis,):
        try:
            with progress(f"Identifying {one}", measured=False):
                found[one] = advise(
                    axis_loop(signals.about(one, inputs), log, start), margins, doubts
                )
        except NotLearnable as error:
            if axis != ALL and not doubts:
                raise
            found[one] = " ".join([*doubts, str(error)])
    known = [one for one in found.values() if isinstance(one, Advice)]
    if not known:
        raise NotLearnable(" ".join(map(str, found.values())))
    gains = {name: value for one in known for name, value in one.parameters.items()}
    refusal = "" if any(one.gains for one in known) else known[0].sentence
    axes = {
        name: {"refusal": one} if isinstance(one, str) else one.as_dict()
        for name, one in found.items()
    }
    document = {"source": source, "margins": margins, "axes": axes, "parameters": gains}
    document |= {"error": {"reason": refusal, "remedy": ""}} if refusal else {}
    print_result(document, tune_blocks(found), as_json)
    if out is not None:
        texts = tune_page(Path(source).name, found), *parameter_files(gains, telemetry)
        with files_in(out, names) as paths:
            for path, text in zip(paths, texts, strict=False):
                path.write_text(text, "utf-8", "replace")
        say_aside(
            f"Written to {printable(out)}: {', '.join(names)}. Nothing was sent to the vehicle."
        )
    if refusal:
        raise click.exceptions.Exit(1)


def axis_loop(signals: Signals, log: Log, start: float = 0.0) -> Loop:
    """Returns the loops of the axis of ``signals``; raises ``NotLearnable``: why there are none."""
    segments, verdict = usable_segments(signals, log.components)
    if not segments:
        raise NotLearnable(verdict.reason, verdict.remedy)
    boot = max(segments, key=len).provenance["segment"]["boot"]
    flights = flown_after(
        [one for one in segments if one.provenance["segment"]["boot"] == boot], start
    )
    plant = physical(flights)
    if not isinstance(plant, Physical):
        raise NotLearnable(plant.reason)
    return loop_of(plant, Record.of(flights))


def parameter_files(gains: dict[str, float], telemetry: Telemetry) -> tuple[str, str]:
    """Returns ``gains`` as QGroundControl loads them, and as Mission Planner does.

    The former has a line of vehicle id, component id, name, value and type, by tabs; the latter of name and value.
    """
    who = f"{telemetry.system}\t{telemetry.component}"
    head = "# Gains by mavdem tune\n"
    ground = "".join(f"{who}\t{name}\t{value:.9g}\t{REAL32}\n" for name, value in gains.items())
    return head + ground, head + "".join(f"{name},{value:.9g}\n" for name, value in gains.items())
