"""``mavdem learn``: from a log to a model, what it is good for, and plots."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import numpy as np
from click.core import ParameterSource

from mavdem import evaluate
from mavdem.alignment.drive import AXES, TILT_AXES
from mavdem.alignment.inventory import inventory
from mavdem.alignment.read import learnable_segments
from mavdem.cli.options import Length, chosen_settings, file_option, model_options, source_options, window_options
from mavdem.cli.output import print_blocks, print_json, printable, progress, say_aside
from mavdem.cli.output_files import RECORDING, check_folder, folder_named, result_files, write_results
from mavdem.cli.sources import read_source
from mavdem.dem import Learned, Settings
from mavdem.dem import learn as learn_model
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.errors import NotLearnable
from mavdem.evaluate import HeldOut, held_out_test, held_out_windows
from mavdem.evaluate.findings import findings
from mavdem.evaluate.flight_windows import TEST_SECONDS, fewer_samples, samples_in
from mavdem.evaluate.held_out import FOLDS
from mavdem.evaluate.truth import compare_with_truth, truth_of
from mavdem.evaluate.vehicle_figures import ALL, AxisFigures, VehicleFigures, vehicle_of_log
from mavdem.extras import advice
from mavdem.flight import Flight
from mavdem.ingest import Log
from mavdem.page.learned_page import learned_page
from mavdem.report.blocks import Sentence
from mavdem.report.details import detail_blocks
from mavdem.report.screen import screen, title
from mavdem.report.truth import truth_blocks
from mavdem.report.vehicle import vehicle_blocks


def _seconds(context: click.Context, parameter: click.Parameter, value: str) -> float:
    """A number of seconds, with or without their unit."""
    try:
        seconds = float(value.removesuffix("s"))
    except ValueError:
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds >= 0):
        raise click.BadParameter(f"{value!r} is no number of seconds.", context, parameter)
    return seconds


@click.command("learn")
@source_options(
    (*TILT_AXES, ALL), "Axis to model; all: a model of roll, and the physical parameters of roll, pitch and yaw."
)
@click.option(
    "--out", type=click.Path(), callback=folder_named, help="Folder for the results. [default: named after the log]"
)
@model_options
@window_options(
    "the whole settled flight", "A held-out window; with --train the one after it: seconds (1.5s) or samples (150)."
)
@click.option(
    "--start",
    metavar="SECONDS",
    default="0",
    show_default=True,
    callback=_seconds,
    help="Nothing before it is used: seconds into the settled flight.",
)
@file_option("--truth", "Truth of a simulated flight, flight.truth.npz: it is put beside the estimates.")
@click.option("--verbose", is_flag=True, help="Also print cautions, the model A, B and C, and how it was learnt.")
def learn_command(
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    out: Path | None,
    preset: str,
    order: int | None,
    train: Length | None,
    test: Length | None,
    start: float,
    truth: Path | None,
    verbose: bool,
) -> None:
    """Learns a linear model, and reports what the vehicle does in wind.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. The model is learnt from its whole
    settled flight. It is judged by windows of --test: five further models, each learnt from four fifths of the flight,
    forecast every window of the fifth that they have not seen.

    \b
    The screen has, in this order:
      what the model is good for, purpose by purpose, and why
      the vehicle: effect and trim of each motor, damping and lag
      the wind's torque on this axis, its steady part and gusts
      the poles of the attitude loop as flown
      errors of forecasts beside those without a model
      warnings, where there are any
    With --axis all also a row for each of roll, pitch and yaw.

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
    settings = chosen_settings(preset, order)
    folder = out or named_after(source)
    check_folder(folder)
    began = perf_counter()
    log = read_source(source)
    segments, verdict = learnable_segments(log, "roll" if axis == ALL else axis, vehicle, inputs)
    if train is None:
        flights = _from(_of_one_boot(segments), start)
    else:
        training, following = _cut(max(segments, key=len), start, train, test)
        flights = (training,)
    known = None if truth is None else truth_of(flights, truth)
    if train is None:
        held_out = _judge(flights, settings, test)
        learned = _learn(flights, settings)
    else:
        learned = _learn(flights, settings)
        held_out = held_out_test(training, following, learned)
    learned = replace(learned, cautions=(*flights[0].provenance["cautions"], *learned.cautions))
    figures = _vehicle(log, axis, vehicle, inputs, flights, learned)
    found = findings(learned, held_out)
    compared = None if known is None else compare_with_truth(learned, flights, known)
    report = {
        **evaluate.report(flights, learned, held_out),
        **figures.as_dict(),
        "findings": [finding._asdict() for finding in found],
        "truth": None if compared is None else compared.as_dict(),
        "settings": asdict(learned.settings),
        "verdict": verdict.as_dict(),
        "seconds": round(perf_counter() - began, 3),
        "files": {name: str(folder / name) for name in result_files()},
    }
    heading = Sentence(*map(printable, title(flights)))
    blocks = screen(learned, held_out, figures.hover)
    if axis == ALL:
        blocks += vehicle_blocks(figures)
    if compared is not None:
        blocks += truth_blocks(compared)
    details = detail_blocks(learned, report)
    held = inventory(log, verdict.axis, vehicle, inputs)
    page = learned_page(heading, blocks, details, learned, held_out, figures.hover, held)
    write_results(folder, report, page, flights, learned, held_out)
    if hint := advice(f"{RECORDING} was not written, since it", "view"):
        say_aside(hint)
    if hint := advice("Drawing the pictures of report.html", "plot"):
        say_aside(hint)
    if as_json:
        print_json(report)
        return
    print_blocks([heading, *blocks, *(details if verbose else [])])
    _say_what_is_written(folder, report)


def named_after(source: str) -> Path:
    """The folder named after a log, in the current one; another name where that is no name or the log itself."""
    name = Path(source).name
    stem = name.removesuffix(".xz")
    stem = stem.removesuffix(Path(stem).suffix)
    return Path(stem if stem.strip(".") and stem != name else f"{name}-learnt")


def _say_what_is_written(folder: Path, report: dict[str, Any]) -> None:
    """On standard error: what was written, and what to open."""
    place = printable(folder)
    say_aside(f"Took {report['seconds']:.1f} s. Written to {place}: {', '.join(map(printable, report['files']))}.")
    say_aside(f"Read or mail: {place}/report.html")
    if RECORDING in report["files"]:
        say_aside(f"Look: {shlex.join(['rerun', f'{place}/{RECORDING}'])}")


def _vehicle(
    log: Log, axis: str, vehicle: str | None, inputs: str | None, flights: tuple[Flight, ...], learned: Learned
) -> VehicleFigures:
    """How hard each motor works and, for ``all``, the physical parameters of each axis, of which roll's are known."""
    if axis != ALL:
        return vehicle_of_log(log, (), vehicle, inputs)
    with progress("Estimating the physical parameters") as done:
        figures = vehicle_of_log(log, AXES[1:], vehicle, inputs, done)
    reason = "" if learned.physical else "No physical parameters can be fitted."
    return figures._replace(
        axes={AXES[0]: AxisFigures(flights, learned.physical, learned.wind, reason), **figures.axes}
    )


def _of_one_boot(segments: Sequence[Flight]) -> tuple[Flight, ...]:
    """Those of the longest segment's boot: times of another cannot be compared."""
    boot = max(segments, key=len).provenance["segment"]["boot"]
    return tuple(flight for flight in segments if flight.provenance["segment"]["boot"] == boot)


def _from(flights: Sequence[Flight], start: float) -> tuple[Flight, ...]:
    """What is flown ``start`` seconds after the first sample and later."""
    late = [
        (flight, round(np.clip(flights[0].time[0] + start - flight.time[0], 0, len(flight) * flight.dt) / flight.dt))
        for flight in flights
    ]
    left = tuple(flight[first:] for flight, first in late if len(flight) - first >= FEWEST_SAMPLES)
    if not left:
        raise NotLearnable(
            f"Less than {FEWEST_SAMPLES} samples of settled flight are left after {start:g} s.",
            "Start earlier, with a smaller --start.",
        )
    return left


def _judge(flights: tuple[Flight, ...], settings: Settings, test: Length | None) -> HeldOut:
    dt = flights[0].dt
    steps = test.samples(dt) if test else samples_in(TEST_SECONDS, dt)
    try:
        with progress("Judging by held-out windows") as done:
            return held_out_windows(flights, settings, steps, done)
    except ValueError as error:
        samples = sum(map(len, flights))
        fewer = max(1, samples // (FOLDS + 1))
        shorter = fewer < steps and samples >= 2 * samples_in(TEST_SECONDS, dt)
        raise NotLearnable(
            f"The settled flight has {samples} samples ({samples * dt:.1f} s), too few for test windows of {steps}.",
            f"Ask for shorter ones: `{_again('--test', str(fewer))}`."
            if shorter
            else "Fly longer, or give a smaller --start.",
        ) from error


def _cut(flight: Flight, start: float, train: Length, test: Length | None) -> tuple[Flight, Flight]:
    """The training data from ``start`` on, and the test samples after it."""
    first = round(min(start / flight.dt, len(flight)))
    left = len(flight) - first
    length = train.samples(flight.dt)
    ahead = test.samples(flight.dt) if test else samples_in(TEST_SECONDS, flight.dt)
    if left >= length + ahead:
        end = first + length
        return flight[first:end], flight[end : end + ahead]
    reason = (
        f"The settled flight has {len(flight)} samples ({flight.duration:.1f} s), {left} of them from {start:g} s on, "
        f"but {length} training and {ahead} test samples were asked for."
    )
    fewer_train, fewer_test = fewer_samples(left, length, ahead)
    if fewer_train < FEWEST_SAMPLES:
        raise NotLearnable(reason, "Start earlier, with a smaller --start.")
    raise NotLearnable(reason, f"Ask for fewer: `{_again('--train', str(fewer_train), '--test', str(fewer_test))}`.")


def _again(*lengths: str) -> str:
    """The same command with other lengths."""
    context = click.get_current_context()
    kept = [
        word
        for name in ("out", "axis", "vehicle", "inputs", "preset", "order", "start", "truth")
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        for word in (f"--{name}", str(context.params[name]))
    ]
    return shlex.join(["mavdem", "learn", context.params["source"], *kept, *lengths])


def _learn(flights: tuple[Flight, ...], settings: Settings) -> Learned:
    try:
        with progress("Learning", measured=False):
            return learn_model(flights, settings)
    except ValueError as error:
        raise NotLearnable(
            f"No model could be learnt: {error}.",
            "Choose another part of the flight with --start, or a longer --train.",
        ) from error
