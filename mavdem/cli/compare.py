"""``mavdem compare``: DEM and other methods tried on the same windows of one or several logs."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import Any

import click

from mavdem.cli.output import json_text, print_json, printable, progress, say, say_aside
from mavdem.cli.results import check_folder, files_in, folder_named
from mavdem.cli.several import Refused, check_sources, names_of, nothing_left
from mavdem.cli.source import motion_options, read_source
from mavdem.cli.summary import print_account
from mavdem.comparison import METHODS, Comparison, account, outcomes
from mavdem.dem.learn import FEWEST_SAMPLES
from mavdem.errors import NotLearnable, Unreadable
from mavdem.flight import Flight
from mavdem.read import learnable_flight
from mavdem.windows import FAST, TEST, TRAIN, USUAL_RATE, Window, usual_samples, windows

NAMES = ("comparison.json", "windows.csv")

UNREADABLE, UNSUPPORTED = 2, 1
"""Exit codes."""


@click.command()
@motion_options
@click.argument("sources", metavar="SOURCE...", type=click.Path(), nargs=-1, required=True)
@click.option(
    "--train",
    type=click.IntRange(FEWEST_SAMPLES),
    help=f"Samples to learn from in each window. [default: {TRAIN}; {TRAIN / USUAL_RATE:g} s of them where they come "
    f"faster than {FAST:.0f} Hz]",
)
@click.option(
    "--test",
    type=click.IntRange(1),
    help=f"Samples after them to forecast. [default: {TEST}; {TEST / USUAL_RATE:g} s likewise]",
)
@click.option(
    "--hop", type=click.IntRange(1), help="Samples from one window to the next. [default: half of --train and --test]"
)
@click.option(
    "--from-zero",
    is_flag=True,
    help="Begin forecasts with state 0, as the paper's figures do, and not with the state at the end of training.",
)
@click.option("--out", type=click.Path(), callback=folder_named, help="Folder for the results as files.")
@click.pass_context
def compare(
    context: click.Context,
    sources: tuple[str, ...],
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    train: int | None,
    test: int | None,
    hop: int | None,
    from_zero: bool,
    out: Path | None,
) -> None:
    """Compares DEM with other methods, window by window.

    Each SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. Its longest stretch of settled
    flight is cut into windows; in each of them every method learns from --train samples and forecasts the --test
    samples after them. Told are, where DEM loses first: the error over the constant mean's, at horizons from one step
    to all of the test part, and whether DEM errs less than each other method by more than chance.

    The methods: DEM; DEM without generalized coordinates (p=1); both with the paper's settings; subspace
    identification, prediction error minimisation (PEM) and expectation maximisation (EM); ARX; and what needs no model.

    --out receives comparison.json, the document of --json, and windows.csv, a line for each window, method and horizon.
    --json is one document; an error that is beyond all numbers, or of no forecast, is null in it.

    \b
    Examples:
      mavdem compare flight.tlog
      mavdem compare one.tlog two.ulg --out compared
      mavdem compare flight.tlog --from-zero --json

    A SOURCE of which nothing can be compared is told, and the others stand. Ends with 0 when a flight was compared,
    with 1 when none was, and with 2 when a SOURCE cannot be read.
    """
    check_sources(sources)
    if out is not None:
        check_folder(out, NAMES)
    began = perf_counter()
    found, refused = _cut(sources, (axis, vehicle, inputs), (train, test, hop))
    if not found:
        raise nothing_left(refused, "compared")
    compared = _compare([window for one in found.values() for window in one])
    report = {
        **compared.to_dict(from_zero),
        "axis": axis,
        "sources": {name: source for name, source in zip(names_of(sources), sources, strict=True) if name in found},
        "refused": [one.values for one in refused],
        "files": {} if out is None else {name: str(out / name) for name in NAMES},
        "seconds": round(perf_counter() - began, 3),
    }
    if out is not None:
        _write(out, report, compared)
    if as_json:
        print_json(report)
        for one in refused:
            say_aside(printable(f"mavdem: {one.source} is not compared: {one.error}"))
    else:
        _print(report, compared, refused, from_zero)
    if any(isinstance(one.error, Unreadable) for one in refused):
        context.exit(UNREADABLE)


def _cut(
    sources: Sequence[str], of_flight: tuple[str, str | None, str | None], samples: tuple[int | None, ...]
) -> tuple[dict[str, tuple[Window, ...]], list[Refused]]:
    """Windows by the flight's name, and what has none."""
    found, refused = {}, []
    for name, source in zip(names_of(sources), sources, strict=True):
        try:
            flight, _ = learnable_flight(read_source(source), *of_flight)
            found[name] = _windows(name, flight, *samples)
        except (NotLearnable, Unreadable) as error:
            refused.append(Refused(name, source, error))
    return found, refused


def _windows(name: str, flight: Flight, train: int | None, test: int | None, hop: int | None) -> tuple[Window, ...]:
    cut = windows(name, flight, train, test, hop)
    if cut:
        return cut
    given, ahead = train or usual_samples(TRAIN, flight.dt), test or usual_samples(TEST, flight.dt)
    fewer_test = min(ahead, max(len(flight) // 6, 1))
    fewer_train = min(given, len(flight) - fewer_test)
    fits = fewer_train >= FEWEST_SAMPLES
    raise NotLearnable(
        f"The settled flight has {len(flight)} samples ({flight.duration:.1f} s), and {given} to learn from with "
        f"{ahead} to forecast are more.",
        f"Ask for fewer: `--train {fewer_train} --test {fewer_test}`." if fits else "Record a longer flight.",
    )


def _compare(cut: Sequence[Window]) -> Comparison:
    total = len(cut) * len(METHODS)
    with (
        progress(f"Comparing {len(METHODS)} methods on {len(cut)} windows") as done,
        closing(outcomes(cut, METHODS)) as coming,
    ):
        found = []
        for outcome in coming:
            found.append(outcome)
            done(len(found) / total)
    return Comparison.of(cut, found)


def _write(out: Path, report: dict[str, Any], compared: Comparison) -> None:
    with files_in(out, NAMES) as (document, table):
        document.write_text(json_text(report) + "\n")
        rows = compared.rows()
        with table.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def _print(report: dict[str, Any], compared: Comparison, refused: Sequence[Refused], from_zero: bool) -> None:
    print_account(account(compared, from_zero))
    for one in refused:
        say(f"{one.name}: not compared. {one.error}\n")
    written = f" Written: {', '.join(map(printable, report['files'].values()))}" if report["files"] else ""
    say(f"Took {report['seconds']:.1f} s.{written}")
