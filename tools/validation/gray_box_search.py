#!/usr/bin/env python
"""Cost and evidence of the search that fits gray-box models, compared with Fisher scoring from the prior mean.

The form of the model is chosen on each axis of each log, as in ``mavdem.plant.physical``, once with each search. The
logs are split into two halves by a hash of their names. What is chosen is chosen on half A; half B only tests.

Usage: tools/validation/gray_box_search.py FOLDER of telemetry logs ...
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import click
import numpy as np
import pandas as pd
from flights import print_table

from mavdem.arrays import Array
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.signals import Signals
from mavdem.dem.engine.gauss_newton import QuadraticExpansion, gauss_newton
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.ingest import read_log
from mavdem.plant import estimation, fitting
from mavdem.plant.fitting import LogPosterior
from mavdem.plant.windows import FlightWindows, cut_windows


class Search(NamedTuple):
    """Cost and result of one search for the gray-box model of an axis."""

    evaluations: float
    """How often the prediction errors of all windows were computed."""
    evidence: float
    """Log evidence of the chosen model, nats."""


def counted_search(windows: FlightWindows, directions: Array | None) -> Search:
    """Fits the gray-box model of an axis, and counts how often that computes the prediction errors of all windows.

    During the fit, the two methods of ``LogPosterior`` that compute prediction errors are replaced by ones that count.

    Args:
        windows: Fourier transforms of inputs and body rate in windows of the flight.
        directions: relative effect of each motor about the axis by the mixer (r,), or None where not known.

    Returns:
        The number of evaluations, and the log evidence of the chosen model.
    """
    evaluations = 0
    original_value = LogPosterior.value
    original_expansion = LogPosterior.full_expansion

    def counted_value(posterior: LogPosterior, theta: Array) -> float:
        """Computes ``LogPosterior.value``, which computes the prediction errors once."""
        nonlocal evaluations
        evaluations += 1
        return original_value(posterior, theta)

    def counted_expansion(posterior: LogPosterior, theta: Array) -> QuadraticExpansion:
        """Computes ``LogPosterior.full_expansion``, whose derivatives are finite differences of the errors."""
        nonlocal evaluations
        # Forward differences: the errors are computed at θ, and once more for a step of each of its k entries.
        evaluations += 1 + len(theta)
        return original_expansion(posterior, theta)

    with (
        patch.object(LogPosterior, "value", counted_value),
        patch.object(LogPosterior, "full_expansion", counted_expansion),
        one_thread(),
        np.errstate(all="ignore"),
    ):
        selected = estimation._select_model(windows, directions)
    return Search(evaluations, selected.fit.evidence)


def plain_search(windows: FlightWindows, directions: Array | None) -> Search:
    """Fits the model as :func:`counted_search` does, but by Fisher scoring alone, from the prior mean.

    mavdem's own search begins at the best of several starts, and corrects the curvature that Fisher scoring
    approximates. The functions that do both are replaced during the fit.

    Args:
        windows: Fourier transforms of inputs and body rate in windows of the flight.
        directions: relative effect of each motor about the axis by the mixer (r,), or None where not known.

    Returns:
        The number of evaluations, and the log evidence of the chosen model.
    """
    with (
        patch.object(fitting, "gauss_newton", _fisher_scoring),
        patch.object(estimation, "best_start", _prior_mean),
    ):
        return counted_search(windows, directions)


def _fisher_scoring(*arguments: Any, corrects_curvature: bool) -> Any:
    """Stands in for ``gauss_newton``: calls it without the correction of the curvature, whatever is asked for."""
    return gauss_newton(*arguments)


def _prior_mean(_: object, start: Array, __: FlightWindows) -> Array:
    """Stands in for ``best_start``: returns the first start that it would try, the prior mean."""
    return start


def rows_of_log(path: Path) -> Iterator[dict[str, object]]:
    """Compares mavdem's search with Fisher scoring alone on each axis of a log, as far as it can be fitted.

    Args:
        path: a telemetry log.

    Yields:
        A row for each axis: the "half" of the logs that this one belongs to; the evaluations of prediction errors by
        Fisher scoring ("before") and by the search ("now"); and the "gain", by how much the log evidence of the
        search's model is larger, nats.
    """
    # A digest of the name assigns each log to one half, A or B, whatever other logs there are.
    first_byte = hashlib.sha256(path.name.encode()).digest()[0]
    half = "A" if first_byte % 2 == 0 else "B"
    log = read_log(path)
    signals = Signals(log.vehicles[0])
    for axis in AXES:
        flights, _ = usable_segments(signals.for_axis(axis, None), log.components)
        if not flights:
            continue
        record = Record.from_flights(flights)
        try:
            windows = cut_windows(record)
        except NotLearnable:
            continue
        directions = estimation._mixer_directions(record)
        fisher_scoring = plain_search(windows, directions)
        search = counted_search(windows, directions)
        yield {
            "half": half,
            "before": fisher_scoring.evaluations,
            "now": search.evaluations,
            "gain": search.evidence - fisher_scoring.evidence,
        }


@click.command(help=__doc__)
@click.argument("folders", nargs=-1, type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folders: tuple[Path, ...]) -> None:
    """Fits all axes of the logs by both searches, and prints a row for each half of the logs.

    The row has the evaluations of prediction errors by mavdem's search relative to those by Fisher scoring, and how
    much log evidence the search gains over it.

    Args:
        folders: folders with telemetry logs; a log at less than 40 Hz cannot be fitted and has no rows.
    """
    rows_of_axes: list[dict[str, object]] = []
    for folder in folders:
        for path in sorted(folder.glob("*.tlog")):
            rows_of_axes += rows_of_log(path)
    rows = pd.DataFrame(rows_of_axes)
    table = []
    for half, axes in rows.groupby("half"):
        evaluation_ratio = axes["now"].sum() / axes["before"].sum()
        evidence_gain = axes["gain"]
        cells = {
            "half": half,
            "axes": len(axes),
            "evaluations, ratio": f"{evaluation_ratio:.2f}",
            "evidence gained, nats: median": f"{evidence_gain.median():+.2f}",
            "mean": f"{evidence_gain.mean():+.1f}",
            "by more than 1": int((evidence_gain > 1).sum()),
            "lost, by more than 1": int((evidence_gain < -1).sum()),
        }
        table.append(cells)
    print_table("**Search of the gray-box fit**", table)


if __name__ == "__main__":
    main()
