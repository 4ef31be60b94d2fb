"""``mavdem compare``: forecasts of DEM and of other methods on the same windows of one or several logs."""

from functools import partial
from time import perf_counter

import click

from mavdem.cli.options import (
    WholeNumberRange,
    motion_options,
    sources_argument,
    window_options,
)
from mavdem.cli.output import print_result, progress
from mavdem.cli.sources import map_flights, sources_by_flight_name
from mavdem.cli.streams import print_to_stderr
from mavdem.containers import Names
from mavdem.experiments.compared_methods import METHODS
from mavdem.experiments.comparison import compare
from mavdem.experiments.window import TRAIN_SECONDS, Length, Window, required_windows
from mavdem.report.comparison import comparison_report


@click.command("compare")
@motion_options()
@sources_argument
@window_options(f"{TRAIN_SECONDS:g}s", "Held-out test data after them: seconds or samples.")
@click.option(
    "--hop",
    type=WholeNumberRange(1),
    help="Samples from one window to the next. [default: half of --train and --test]",
)
def compare_command(
    sources: Names,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    train: Length | None,
    test: Length | None,
    hop: int | None,
) -> None:
    """Compares DEM with other methods, window by window.

    Each SOURCE is a log. Its longest settled flight is cut into windows. In each window every method is trained on
    --train and forecasts the --test samples after them, with the inputs of that time known, and without them by the
    methods that can. The report begins with what a paired test of DEM against each method says, and has the error ratio
    (mean squared error over that of a constant forecast) by horizon.

    In --json an error that is infinite, or of a missing forecast, is null; it has each flight and window.

    \b
    Examples:
      mavdem compare flight.tlog
      mavdem compare one.tlog two.ulg --json > comparison.json

    A SOURCE that cannot be compared is reported, and the others are compared. Exit code: 0 if a flight was compared,
    1 if none was, 2 if no SOURCE can be read.
    """
    start_time = perf_counter()
    windows_by_flight = map_flights(
        sources,
        axis,
        vehicle,
        inputs,
        partial(required_windows, train=train, test=test, hop=hop),
    )
    windows: list[Window] = []
    for windows_of_flight in windows_by_flight.values():
        windows += windows_of_flight
    title = f"Comparing {len(METHODS)} methods on {len(windows)} windows"
    with progress(title) as show_fraction:
        comparison = compare(windows, METHODS, show_fraction)
    seconds = round(perf_counter() - start_time, 3)
    compared_sources = {
        name: source
        for name, source in sources_by_flight_name(sources).items()
        if name in windows_by_flight
    }
    document = {
        **comparison.to_dict(),
        "axis": axis,
        "sources": compared_sources,
        "seconds": seconds,
    }
    print_result(document, comparison_report(comparison), as_json=as_json)
    print_to_stderr(f"Took {seconds:.1f} s.")
