"""Tables of errors: of forecasts (MSPE) by experiment of the paper, and of estimators by set of data."""

from collections.abc import Mapping, Sequence

import numpy as np

from mavdem.arrays import Array
from mavdem.report.blocks import Table
from mavdem.report.numbers import rounded

RANGE_PERCENTILES = (10, 90)
"""Percentiles over random priors that are shown as the range of the errors: four fifths of them lie between."""


def errors_by_experiment(heading: str, errors: Mapping[str, Array], numbers: list[int]) -> Table:
    """Returns a table with a row for each method and a column for each experiment.

    A cell has the median error and, of several priors, their range in brackets. The last column has the sum of the
    medians.

    Args:
        heading: heading of the column with the names of the methods.
        errors: MSPE (experiments, priors) by name of the method.
        numbers: numbers of the experiments.

    Returns:
        The table.
    """
    rows = []
    for name, method_errors in errors.items():
        medians = np.median(method_errors, axis=1)
        cells = []
        for median, prior_errors in zip(medians, method_errors, strict=True):
            cell = rounded(median, 3)
            if len(prior_errors) > 1:
                low, high = np.percentile(prior_errors, RANGE_PERCENTILES)
                cell += f" ({rounded(low, 3)}–{rounded(high, 3)})"
            cells.append(cell)
        rows.append([name, *cells, rounded(medians.sum(), 3)])
    experiment_headings = [f"expt {number}" for number in numbers]
    return Table([heading, *experiment_headings, "total"], rows)


def table_by_estimator(
    errors: Mapping[str, Mapping[str, float]], estimators: Sequence[str]
) -> Table:
    """Returns a table with a row for each estimator and a column for each set of data, such as a window or a noise.

    Args:
        errors: one error by name of the data and of the estimator.
        estimators: names of the estimators, in the order of the rows.

    Returns:
        The table, with errors of three significant digits.
    """
    rows = []
    for estimator in estimators:
        row = [estimator]
        for errors_of_data in errors.values():
            row.append(rounded(errors_of_data[estimator], 3))
        rows.append(row)
    return Table(["estimator", *errors], rows)
