"""``mavdem learn``: from a log to a model, what it is good for, and plots."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from mavdem.alignment.drive import TILT_AXES, Signal
from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.analysis import LogAnalysis, Options, analyse
from mavdem.analysis.figures import ALL
from mavdem.analysis.findings import known_wind
from mavdem.cli.options import (
    file_option,
    folder_named,
    model_options,
    read_source,
    source_options,
    window_options,
)
from mavdem.cli.output import (
    check_folder,
    complain,
    ending_at_once,
    files_in,
    json_text,
    print_blocks,
    print_json,
    printable,
    progress,
    say_aside,
)
from mavdem.condition.inventory import inventory
from mavdem.condition.wind_of_log import Air, air_of
from mavdem.condition.wind_velocity import WindVelocity, torque_explained
from mavdem.dem import Settings
from mavdem.evaluate.window import Length
from mavdem.export.conversion import write_channels
from mavdem.extras import lacking, missing
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Sentence
from mavdem.report.condition import wind_blocks
from mavdem.report.page import log_page
from mavdem.report.screen import analysis_blocks, detail_blocks, title, vehicle_blocks
from mavdem.report.truth import truth_blocks

if TYPE_CHECKING:
    from mavdem.view import Target

RECORDING = "flight.rrd"
RESULT_FILES = ("model.json", "report.json", "report.html", RECORDING, "flight.mcap")


def _seconds(context: click.Context, parameter: click.Parameter, value: str) -> float:
    try:
        seconds = float(value.removesuffix("s"))
    except ValueError:
        seconds = math.nan
    if not 0 <= seconds < math.inf:
        raise click.BadParameter(f"{value!r} is no number of seconds.", context, parameter)
    return seconds


start_option = click.option(
    "--start",
    metavar="SECONDS",
    default="0",
    show_default=True,
    callback=_seconds,
    help="Nothing before it is used: seconds into the settled flight.",
)


@click.command("learn")
@source_options(
    (*TILT_AXES, ALL),
    "Axis to model; all: a model of roll, and the physical parameters of roll, pitch and yaw.",
)
@click.option(
    "--out",
    type=click.Path(),
    callback=folder_named,
    help="Folder for the results. [default: named after the log]",
)
@model_options
@window_options(
    "the whole settled flight",
    "A held-out window; with --train the one after it: seconds (1.5s) or samples (150).",
)
@start_option
@file_option(
    "--truth", "Truth of a simulated flight, flight.truth.npz: it is put beside the estimates."
)
@click.option("--no-files", is_flag=True, help="Only print the screen; write no files.")
@click.option(
    "--verbose",
    is_flag=True,
    help="Also print cautions, the model A, B and C, and how it was learned.",
)
def learn_command(
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    out: Path | None,
    settings: Settings,
    train: Length | None,
    test: Length | None,
    start: float,
    truth: Path | None,
    no_files: bool,
    verbose: bool,
) -> None:
    """Learns a linear model, and reports what the vehicle does in wind.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. The model is trained on its whole
    settled flight. It is judged by windows of --test: five further models, each trained on four fifths of the flight,
    forecast every window of the fifth that they have not seen.

    The screen says what the model is good for and why, then what vehicle and wind do; with --axis all also a row for
    each of roll, pitch and yaw.

    A log whose rates allow less gives that: at 8 to 40 Hz (tier b) a model of the slow motion, if it predicts better
    than none; at any rate from 1 Hz (tier c) balance, limits, lean, vibration and battery. Without a model the folder
    receives report.html and report.json only, and the exit code is 1.

    \b
    The folder --out receives:
      report.html  all of it with pictures, in one file to mail
      model.json   the model, with all it needs to forecast
      report.json  the figures
      flight.rrd   the plots: open them with `rerun flight.rrd`
      flight.mcap  the same time series, for Foxglove or PlotJuggler

    The paper's protocol instead, one model tested once: --train trains on so much from --start on, and forecasts the
    --test after it.

    \b
    Examples:
      mavdem learn flight.tlog
      mavdem learn flight.tlog --axis pitch --start 20 --out pitch
      mavdem learn flight.tlog --axis all --verbose
      mavdem learn flight.tlog --train 7s --preset paper --order 2
      mavdem learn simulated.tlog --truth simulated.truth.npz
    """
    folder = out or named_after(source)
    if not no_files:
        check_folder(folder, RESULT_FILES)
    began = perf_counter()
    log = read_source(source)
    telemetry = choose_vehicle(log.vehicles, vehicle)
    signals = Signals(telemetry)
    air = air_of(signals)  # first: what it reads of the signals the analysis need not read again
    options = Options(vehicle, inputs, settings, start, train, test, truth)
    analysis = analyse(log, axis, options, progress=progress, signals=signals)
    learned = analysis.learned
    verdict = analysis.verdict
    condition = analysis.condition
    if learned is None and analysis.tier.name is None:
        raise analysis.refusal
    report: dict[str, Any] = {
        **analysis.as_dict(),
        "wind_velocity": air[0] and air[0].as_dict(),
        "seconds": round(perf_counter() - began, 3),
        "files": {}
        if no_files
        else {name: str(folder / name) for name in result_files(with_model=learned is not None)},
    }
    blocks = analysis_blocks(analysis)
    details = list[Block]()
    if learned is None:
        text = f"{verdict.axis}, {condition.settled:.0f} s of settled flight, no model."
        heading = Sentence(text, f"{printable(Path(source).name)}:")
        report["error"] = {"reason": analysis.refusal.reason, "remedy": analysis.refusal.remedy}
    else:
        text, lead, _ = title(analysis.flights)
        heading = Sentence(printable(text), printable(lead))
        blocks += (
            vehicle_blocks(analysis.vehicle, bool(analysis.findings.overrides))
            if axis == ALL
            else []
        )
        blocks += [] if analysis.truth is None else truth_blocks(analysis.truth)
        details = detail_blocks(learned, analysis.findings)
    explained = _torque_blocks(analysis, air, report)
    blocks[-1:-1] = [*wind_blocks(air), *explained]  # what to do next stays last
    if not as_json:
        print_blocks([heading, *blocks, *(details if verbose else [])])
    if not no_files:
        known = {(telemetry.system, telemetry.component): (verdict, condition, analysis.identity)}
        held = inventory(log, verdict.axis, vehicle, inputs, known)
        held["vehicles"][0] |= analysis.findings.as_dict() | {"model": analysis.model}
        with progress("Drawing and writing the files", measured=False):
            page = log_page(heading, {verdict.axis: analysis}, air, held, said=explained)
            write_results(folder, report, page, analysis, air, signals.position)
        if learned is not None and (
            hint := lacking("view", f"{RECORDING} was not written, since it")
        ):
            say_aside(str(hint))
    if as_json:
        print_json(report)
        if learned is None:  # else the screen has said it
            complain(analysis.refusal.fact, as_json=False)
    else:
        place = printable(folder)
        files = report["files"]
        written = f" Written to {place}: {', '.join(map(printable, files))}." if files else ""
        say_aside(f"Took {perf_counter() - began:.1f} s.{written}")
        if files:
            say_aside(f"Read or mail: {place}/report.html")
        if RECORDING in files:
            say_aside(f"Look: {shlex.join(['rerun', f'{place}/{RECORDING}'])}")
    if learned is None:
        raise click.exceptions.Exit(1)  # no model


def named_after(source: str) -> Path:
    """Returns the folder named after a log, the ``source``, in the current one; not the log's own name."""
    name = Path(source).name
    stem = name.removesuffix(".xz")
    stem = stem.removesuffix(Path(stem).suffix)
    return Path(stem if stem.strip(".") and stem != name else f"{name}-learnt")


def result_files(with_model: bool = True) -> tuple[str, ...]:
    """Returns the ``RESULT_FILES`` that can be written: most need a model, and the recording needs Rerun."""
    if not with_model:
        return ("report.json", "report.html")
    return tuple(name for name in RESULT_FILES if name != RECORDING or not missing("view"))


def write_results(
    folder: Path,
    report: dict[str, Any],
    page: str,
    analysis: LogAnalysis,
    air: Air,
    position: Signal | None,
) -> None:
    """Writes the :func:`result_files`, as :func:`files_in` does; ``page`` is the HTML. Those of a run before go."""
    learned = analysis.learned
    held_out = analysis.held_out
    flights = analysis.flights
    names = result_files(with_model=learned is not None)
    with files_in(folder, names) as paths:
        place = dict(zip(names, paths, strict=True))
        place["report.json"].write_text(json_text(report) + "\n")
        place["report.html"].write_text(page, "utf-8", "replace")
        if learned is not None and held_out is not None:
            place["model.json"].write_text(learned.to_json() + "\n")
            if RECORDING in names:
                write_dashboard(place[RECORDING], analysis, air, position)
            write_channels(
                place["flight.mcap"], flights, learned, held_out, same_clock(air, flights)
            )
    for name in set(RESULT_FILES) - set(names):
        (folder / name).unlink(missing_ok=True)


def write_dashboard(
    target: Target, analysis: LogAnalysis, air: Air, position: Signal | None
) -> None:
    """Writes an ``analysis`` with a model, and the wind, as an .rrd file, or to a stream."""
    assert analysis.learned is not None and analysis.held_out is not None
    # Rerun takes a second to load, and a flight that cannot be learned needs none of it.
    with ending_at_once():
        from mavdem.view import write_recording

    known = analysis.findings, analysis.changes, same_clock(air, analysis.flights), position
    write_recording(target, analysis.flights, analysis.learned, analysis.held_out, *known)


def _torque_blocks(analysis: LogAnalysis, air: Air, report: dict[str, Any]) -> list[Sentence]:
    """What share of a known wind torque the mean wind explains, which goes into the report too."""
    learned = analysis.learned
    flights = analysis.flights
    torque = None if learned is None else known_wind(learned.wind_torque, learned.physical)
    if torque is None or (wind := same_clock(air, flights)) is None:
        return []
    time = np.concatenate([flight.time for flight in flights])
    explained = torque_explained(wind, time, torque.torque)
    report["wind"]["explained_by_mean_wind"] = explained.figures["share"]
    return [Sentence(str(explained), "Wind torque:")]


def same_clock(air: Air, flights: Sequence[Flight]) -> WindVelocity | None:
    """Returns the wind where it is of the boot of ``flights``, and so on one clock with them."""
    return (
        air[0]
        if air[0] is not None and air[0].boot == flights[0].provenance["segment"]["boot"]
        else None
    )
