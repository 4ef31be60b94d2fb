"""``mavdem learn``: from a log to a model, its forecasts and pictures."""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter

import click
from click.core import ParameterSource

from mavdem import evaluate
from mavdem.cli.model_options import chosen_settings, model_options
from mavdem.cli.output import print_json, progress
from mavdem.cli.results import NAMES, check_folder, folder_named, write_results
from mavdem.cli.source import read_source, source_options
from mavdem.cli.summary import print_summary
from mavdem.dem import Learned, Settings
from mavdem.dem import learn as learn_model
from mavdem.dem.learn import FEWEST_SAMPLES
from mavdem.errors import NotLearnable
from mavdem.flight import Flight
from mavdem.read import learnable_flight
from mavdem.windows import FAST, TEST, TRAIN, USUAL_RATE, usual_samples


@click.command()
@source_options
@click.option("--out", type=click.Path(), required=True, callback=folder_named, help="Folder for the results.")
@model_options
@click.option(
    "--train",
    type=click.IntRange(FEWEST_SAMPLES),
    help=f"Samples to learn from. [default: {TRAIN}; {TRAIN / USUAL_RATE:g} s of them where they come faster than "
    f"{FAST:.0f} Hz]",
)
@click.option(
    "--test",
    type=click.IntRange(1),
    help=f"Samples after them to forecast. [default: {TEST}; {TEST / USUAL_RATE:g} s likewise]",
)
@click.option(
    "--start", type=click.FloatRange(0), default=0.0, show_default=True, help="Seconds into the settled flight."
)
def learn(
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    out: Path,
    preset: str,
    order: int | None,
    train: int | None,
    test: int | None,
    start: float,
) -> None:
    """Learns a linear model from a log and forecasts with it.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. Of the longest stretch of settled
    flight, --train samples are learnt from and the --test samples after them forecast. The folder --out receives
    model.json (the model with all it needs to forecast), report.json (the figures), flight.rrd (pictures, to be opened
    with `rerun flight.rrd`) and flight.mcap (the same series of numbers, for Foxglove or PlotJuggler).

    \b
    Examples:
      mavdem learn flight.tlog --out result
      mavdem learn flight.tlog --out result --preset paper --order 2
    """
    settings = chosen_settings(preset, order)
    check_folder(out)
    began = perf_counter()
    flight, verdict = learnable_flight(read_source(source), axis, vehicle, inputs)
    samples = (given or usual_samples(usual, flight.dt) for given, usual in ((train, TRAIN), (test, TEST)))
    training, following = _cut(flight, start, *samples)
    learned = _learn(training, settings)
    learned = replace(learned, cautions=(*verdict.cautions, *learned.cautions))
    report = {
        **evaluate.report(training, following, learned),
        "settings": asdict(learned.settings),
        "verdict": asdict(verdict),
        "seconds": round(perf_counter() - began, 3),
        "files": {name: str(out / name) for name in NAMES},
    }
    write_results(out, report, training, following, learned)
    if as_json:
        print_json(report)
    else:
        print_summary(report, training, following, learned)


def _cut(flight: Flight, start: float, train: int, test: int) -> tuple[Flight, Flight]:
    """The samples to learn from and those to forecast."""
    if not math.isfinite(start):
        raise click.BadParameter("it must be a number of seconds.", param_hint="--start")
    first = round(min(start / flight.dt, len(flight)))
    left = len(flight) - first
    if left >= train + test:
        return flight[first : first + train], flight[first + train : first + train + test]
    reason = (
        f"The settled flight has {len(flight)} samples ({flight.duration:.1f} s), {left} of them from {start:g} s on, "
        f"and {train} to learn from with {test} to forecast are more."
    )
    fewer_test = min(test, max(left // 6, 1))
    fewer_train = min(train, left - fewer_test)
    if fewer_train < FEWEST_SAMPLES:
        raise NotLearnable(reason, "Start earlier, with a smaller --start.")
    raise NotLearnable(reason, f"Ask for fewer: `{_again(fewer_train, fewer_test)}`.")


def _again(train: int, test: int) -> str:
    """The command that was given, with other numbers of samples."""
    context = click.get_current_context()
    kept = [
        word
        for name in ("out", "axis", "vehicle", "inputs", "preset", "order", "start")
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        for word in (f"--{name}", str(context.params[name]))
    ]
    return shlex.join(["mavdem", "learn", context.params["source"], *kept, "--train", str(train), "--test", str(test)])


def _learn(training: Flight, settings: Settings) -> Learned:
    try:
        with progress("Learning", measured=False):
            return learn_model(training, settings)
    except ValueError as error:
        raise NotLearnable(
            f"No model could be learnt: {error}.", "Choose another part of the flight with --start, or more of it."
        ) from error
