#!/usr/bin/env python
"""Cost and result of the search in the gray-box fit, compared with Fisher scoring from the prior mean; prints a table.

The form of the model is chosen on each axis of each log, as in ``mavdem.plant.physical``, once with each search. The
logs are split into two halves by a hash of their names. What is chosen is chosen on half A; half B only tests.

Usage: tools/validation/gray_box_search.py FOLDER...   # of the telemetry logs in them
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
    """What one search of an axis cost and found."""

    evaluations: float
    """Prediction errors that were computed, in passes through all windows."""
    evidence: float
    """Log evidence of the chosen model, nats."""


def counted_search(windows: FlightWindows, directions: Array | None) -> Search:
    """Chooses the model of an axis, and counts how often the prediction errors of all windows were computed for it.

    While the model is chosen, the two methods of ``LogPosterior`` that compute them are replaced by ones that count.

    Args:
        windows: windows of the flight.
        directions: relative effect of each input (r,), or None.

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
    """Does the same as :func:`counted_search` by Fisher scoring alone, from the prior mean, for comparison.

    Two functions of the search are replaced meanwhile: the one that corrects the curvature of Fisher scoring, and the
    one that chooses the best of several starts.

    Args:
        windows: windows of the flight.
        directions: relative effect of each input (r,), or None.

    Returns:
        The number of evaluations, and the log evidence of the chosen model.
    """

    def fisher_scoring(*arguments: Any, corrects_curvature: bool) -> Any:
        """Calls ``gauss_newton`` without the correction of the curvature, whatever the caller passes."""
        return gauss_newton(*arguments)

    def prior_mean(_: object, start: Array, __: FlightWindows) -> Array:
        """Returns the start that is tried first, the prior mean, in the place of ``best_start``."""
        return start

    with (
        patch.object(fitting, "gauss_newton", fisher_scoring),
        patch.object(estimation, "best_start", prior_mean),
    ):
        return counted_search(windows, directions)


def rows_of_log(path: Path) -> Iterator[dict[str, object]]:
    """Compares the two searches on each axis of a log of which parameters can be estimated.

    Args:
        path: a telemetry log, whose name decides to which half of all logs it belongs.

    Yields:
        A row for each axis: the half, the evaluations before (Fisher scoring alone) and now, and the log evidence that
        was gained, nats.
    """
    log = read_log(path)
    # A digest of the name assigns each log to one half, A or B, whatever other logs there are.
    first_byte = hashlib.sha256(path.name.encode()).digest()[0]
    half = "A" if first_byte % 2 == 0 else "B"
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
        plain = plain_search(windows, directions)
        current = counted_search(windows, directions)
        yield {
            "half": half,
            "before": plain.evaluations,
            "now": current.evaluations,
            "gain": current.evidence - plain.evidence,
        }


@click.command(help=__doc__)
@click.argument("folders", nargs=-1, type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folders: tuple[Path, ...]) -> None:
    """Prints the table.

    Args:
        folders: folders with telemetry logs; those at less than 40 Hz have no rows.
    """
    logs = [path for folder in folders for path in sorted(folder.glob("*.tlog"))]
    rows = pd.DataFrame([row for path in logs for row in rows_of_log(path)])
    table = []
    for half, axes in rows.groupby("half"):
        gain = axes["gain"]
        table.append(
            {
                "half": half,
                "axes": len(axes),
                "evaluations, ratio": f"{axes['now'].sum() / axes['before'].sum():.2f}",
                "evidence gained, nats: median": f"{gain.median():+.2f}",
                "mean": f"{gain.mean():+.1f}",
                "by more than 1": int((gain > 1).sum()),
                "lost, by more than 1": int((gain < -1).sum()),
            }
        )
    print_table("**Search of the gray-box fit**", table)


if __name__ == "__main__":
    main()
