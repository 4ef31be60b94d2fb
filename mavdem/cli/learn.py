"""``mavdem learn``: from a log to a model, its forecasts and plots."""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter

import click
from click.core import ParameterSource

from mavdem import evaluate
from mavdem.alignment.drive import AXES
from mavdem.alignment.inventory import inventory
from mavdem.alignment.read import learnable_flight
from mavdem.cli.options import chosen_settings, model_options, source_options, window_options
from mavdem.cli.output import print_blocks, print_json, printable, progress, say, say_aside
from mavdem.cli.output_files import RECORDING, check_folder, folder_named, result_files, write_results
from mavdem.cli.sources import read_source
from mavdem.dem import Learned, Settings
from mavdem.dem import learn as learn_model
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.errors import NotLearnable
from mavdem.evaluate import training_length
from mavdem.evaluate.flight_windows import TEST_SECONDS, TRAIN_SECONDS, fewer_samples, samples_in
from mavdem.evaluate.vehicle_figures import ALL, VehicleFigures, vehicle_of_log
from mavdem.extras import advice
from mavdem.flight import Flight
from mavdem.ingest import Log
from mavdem.page.learned_page import learned_page
from mavdem.report.learned import learned_report
from mavdem.report.vehicle import vehicle_blocks


@click.command("learn")
@source_options
@click.option("--out", type=click.Path(), required=True, callback=folder_named, help="Folder for the results.")
@model_options
@window_options("as many before the test samples as help")
@click.option(
    "--start",
    type=click.FloatRange(0),
    default=0.0,
    show_default=True,
    help="Nothing before it is used: seconds into the settled flight.",
)
def learn_command(
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
    """Learns a linear model and tests it on held-out data.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. Of its longest settled flight the
    last --test samples are held out: the model forecasts them. It is trained on as much of the flight before them as
    helps: 7, 14, 35 or 70 s, or all of it, by forecasts of parts that a model has not seen. With --train it is trained
    on so many samples from --start on, and forecasts those after them.

    \b
    The report has, in this order:
      RMSE and error ratio on the held-out test set, beside forecasts
        without a model (an error ratio below 1 is better than a constant)
      cautions: read them before you use the model
      how far ahead predictions are worth something without the motors
      the model dx/dt = A x + B u with 90 % intervals, and its poles
      the physical parameters (motor effect, damping, lag), or why they
        are not identifiable, and the wind's torque
      how hard each motor works; with --axis all a row for each axis

    \b
    The folder --out receives:
      model.json   the model, with all it needs to forecast
      report.json  the figures
      report.html  the report as one page, to read in a browser and to mail
      flight.rrd   the plots: open them with `rerun flight.rrd`
      flight.mcap  the same time series, for Foxglove or PlotJuggler

    \b
    Examples:
      mavdem learn flight.tlog --out result
      mavdem learn flight.tlog --out result --axis pitch --start 20
      mavdem learn flight.tlog --out result --axis all
      mavdem learn flight.tlog --out result --preset paper --order 2
    """
    settings = chosen_settings(preset, order)
    check_folder(out)
    began = perf_counter()
    log = read_source(source)
    flight, verdict = learnable_flight(log, "roll" if axis == ALL else axis, vehicle, inputs)
    available, following = _cut(flight, start, train, test or samples_in(TEST_SECONDS, flight.dt))
    training = available if train else _latest(available, settings)
    learned = _learn(training, settings)
    learned = replace(learned, cautions=(*verdict.cautions, *learned.cautions))
    figures = _vehicle(log, axis, vehicle, inputs)
    report = {
        **evaluate.report(training, following, learned),
        **figures.as_dict(),
        "available_samples": len(available),
        "settings": asdict(learned.settings),
        "verdict": verdict.as_dict(),
        "seconds": round(perf_counter() - began, 3),
        "files": {name: str(out / name) for name in result_files()},
    }
    blocks = [*learned_report(report, training, following, learned), *vehicle_blocks(figures)]
    page = learned_page(training, blocks, learned.settings, inventory(log, flight.provenance["axis"], vehicle, inputs))
    write_results(out, report, page, training, following, learned)
    if hint := advice(f"{RECORDING} was not written, since it", "view"):
        say_aside(hint)
    if as_json:
        print_json(report)
    else:
        print_blocks(blocks)
        say(f"Took {report['seconds']:.1f} s. Written: {', '.join(map(printable, report['files'].values()))}")
        if RECORDING in report["files"]:
            say(f"Open the plots with `{shlex.join(['rerun', printable(out / RECORDING)])}`.")


def _vehicle(log: Log, axis: str, vehicle: str | None, inputs: str | None) -> VehicleFigures:
    """The figures of all settled flight: of every axis, or of this one's motors only, whose model has the rest."""
    if axis != ALL:
        return vehicle_of_log(log, (), vehicle, inputs)
    with progress("Estimating the physical parameters") as done:
        return vehicle_of_log(log, AXES, vehicle, inputs, done)


def _cut(flight: Flight, start: float, train: int | None, test: int) -> tuple[Flight, Flight]:
    """What may be learnt from, and the test samples after it: at the end of the flight, unless ``train`` is given."""
    if not math.isfinite(start):
        raise click.BadParameter("it must be a number of seconds.", param_hint="--start")
    first = round(min(start / flight.dt, len(flight)))
    left = len(flight) - first
    least = train or samples_in(TRAIN_SECONDS, flight.dt)
    if left >= least + test:
        end = first + train if train else len(flight) - test
        return flight[first:end], flight[end : end + test]
    reason = (
        f"The settled flight has {len(flight)} samples ({flight.duration:.1f} s), {left} of them from {start:g} s on, "
        f"but {least} training and {test} test samples were asked for."
    )
    fewer_train, fewer_test = fewer_samples(left, least, test)
    if fewer_train < FEWEST_SAMPLES:
        raise NotLearnable(reason, "Start earlier, with a smaller --start.")
    raise NotLearnable(reason, f"Ask for fewer: `{_again(fewer_train, fewer_test)}`.")


def _again(train: int, test: int) -> str:
    """The same command with other numbers of samples."""
    context = click.get_current_context()
    kept = [
        word
        for name in ("out", "axis", "vehicle", "inputs", "preset", "order", "start")
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        for word in (f"--{name}", str(context.params[name]))
    ]
    return shlex.join(["mavdem", "learn", context.params["source"], *kept, "--train", str(train), "--test", str(test)])


def _latest(available: Flight, settings: Settings) -> Flight:
    """As much of the end of the flight as helps; with the paper's settings, which have no noise model, always 7 s."""
    if settings.prior == "uniform":
        return available[-samples_in(TRAIN_SECONDS, available.dt) :]
    with progress("Choosing the length of the training data") as done:
        return available[-training_length(available, settings, done) :]


def _learn(training: Flight, settings: Settings) -> Learned:
    try:
        with progress("Learning", measured=False):
            return learn_model(training, settings)
    except ValueError as error:
        raise NotLearnable(
            f"No model could be learnt: {error}.",
            "Choose another part of the flight with --start, or more of it with --train.",
        ) from error
