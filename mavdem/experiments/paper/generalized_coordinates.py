"""Section V.G of the paper: DEM forecasts with generalized coordinates (p = 2) and without (p = 1)."""

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.evaluate import paired
from mavdem.experiments.paired_test import Paired
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.checks import Check, ExperimentResult, percent
from mavdem.experiments.paper.error_tables import errors_by_experiment
from mavdem.experiments.paper.flights import ARDRONE_NAME
from mavdem.experiments.paper.runner import (
    DATA_START,
    DEM_P1,
    DEM_P2,
    FORECAST_KIND_BY_START,
    Runner,
    forecast_errors,
    median_outcome,
)
from mavdem.report.blocks import Block, Sentence
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import rounded

PAPER_MSPE_P2 = (0.0521, 0.0133, 0.0583, 0.0458, 0.1172)
"""MSPE with p = 2 of experiments 1 to 5, summed over outputs (Table II, ``SSE_GC``); 0.2867 in total."""

PAPER_MSPE_P1 = (0.1197, 0.0640, 0.1647, 0.0518, 0.0951)
"""MSPE with p = 1 of the same experiments (Table II, ``SSE_GC``); 0.4953 in total."""

MIN_SHARE_OF_EXPERIMENTS = 0.8
"""Share of the experiments on which p = 2 must have the lower error: it has on four of the paper's five."""


class ErrorsByOrder(NamedTuple):
    """MSPE of DEM's forecasts, summed over the outputs, by embedding order p."""

    p2: Array
    """(experiments, priors) errors with generalized coordinates."""

    p1: Array
    """(experiments, priors) errors without them."""


def run(runner: Runner) -> ExperimentResult:
    """Compares DEM with generalized coordinates (p = 2) and without (p = 1).

    p is the embedding order: the number of derivatives of the outputs that DEM uses, and with them the smoothness of
    the noise. On the simulated experiments both are fitted from many random priors, because the result of one fit
    depends on its prior; on the recorded AR.Drone they are compared window by window.

    Args:
        runner: holds the windows of training and test data, and runs the fits, whose results it keeps.

    Returns:
        Checks, a table and a figure; ``numbers`` has the MSPE with and without generalized coordinates by data.
    """
    errors = {}
    for start in FORECAST_KIND_BY_START:
        errors[f"paper’s settings, from {start}"] = ErrorsByOrder(
            p2=_errors_over_priors(runner, DEM_P2, start),
            p1=_errors_over_priors(runner, DEM_P1, start),
        )
    checks = [lower_error_check(errors_by_order, data) for data, errors_by_order in errors.items()]
    recorded_comparisons = []
    if runner.recorded_windows:
        comparison = _compare_on_ardrone(runner)
        recorded_comparisons.append(comparison)
        checks.append(_ardrone_check(comparison))
    numbers = {"paper": {"with": PAPER_MSPE_P2, "without": PAPER_MSPE_P1}}
    for data, errors_by_order in errors.items():
        numbers[data] = {
            "with": errors_by_order.p2.tolist(),
            "without": errors_by_order.p1.tolist(),
        }
    return ExperimentResult(
        checks=tuple(checks),
        numbers={
            **numbers,
            "recorded_flights": [comparison._asdict() for comparison in recorded_comparisons],
        },
        tables=_error_table(runner, errors),
        pictures=(_forecast_picture(runner),),
    )


def _errors_over_priors(runner: Runner, method: str, start: str) -> Array:
    """Returns the MSPE of DEM's forecasts on the simulated flights.

    Args:
        runner: runner that has the outcomes of the methods.
        method: ``DEM_P2`` or ``DEM_P1``.
        start: start of the forecasts, ``DATA_START`` or ``ZERO_START``.

    Returns:
        (experiments, priors) errors.
    """
    errors_by_experiment = []
    for number in runner.experiment_windows:
        errors_by_experiment.append(
            forecast_errors(runner.random_prior_outcomes[method, number], start)
        )
    return np.array(errors_by_experiment)


def lower_error_check(errors: ErrorsByOrder, data: str) -> Check:
    """Checks that DEM with p = 2 has the lower error than with p = 1 in total, and on most experiments.

    The error of an experiment is the median over random priors, since a single prior may be a bad one.

    Args:
        errors: (experiments, priors) mean squared prediction errors (MSPE), by embedding order.
        data: settings and start of the forecasts, for the text.

    Returns:
        The check, with both total errors.
    """
    medians_p2 = np.median(errors.p2, axis=1)
    medians_p1 = np.median(errors.p1, axis=1)
    lower_count = int((medians_p2 < medians_p1).sum())
    is_lower_in_total = medians_p2.sum() < medians_p1.sum()
    is_lower_on_most = lower_count >= MIN_SHARE_OF_EXPERIMENTS * len(medians_p2)
    return Check(
        rule=f"{data}: the total MSPE over experiments is lower with p = 2 than with p = 1, and also on at least "
        f"{percent(MIN_SHARE_OF_EXPERIMENTS)} of them (median over random priors)",
        holds=bool(is_lower_in_total and is_lower_on_most),
        finding=f"{data}: the total MSPE is {rounded(medians_p2.sum(), 3)} with p = 2 and "
        f"{rounded(medians_p1.sum(), 3)} with p = 1, lower with p = 2 on {lower_count} of {len(medians_p2)}",
    )


def _compare_on_ardrone(runner: Runner) -> Paired:
    """Compares the errors with p = 2 and with p = 1 on the windows of the recorded flights."""
    errors_p2 = forecast_errors(runner.recorded_outcomes[DEM_P2], DATA_START)
    errors_p1 = forecast_errors(runner.recorded_outcomes[DEM_P1], DATA_START)
    return paired(errors_p2, errors_p1, runner.recorded_windows)


def _ardrone_check(comparison: Paired) -> Check:
    """Checks that the error with p = 2 is lower than with p = 1 on the median window of the AR.Drone.

    Args:
        comparison: errors of both orders on the same windows.

    Returns:
        The check.
    """
    return Check(
        rule=f"{ARDRONE_NAME}, from {DATA_START}: the median over windows of the error with p = 2 over that with p "
        "= 1 is less than 1",
        holds=comparison.ratio < 1,
        finding=f"on {ARDRONE_NAME} the error ratio of p = 2 to p = 1 is {rounded(comparison.ratio, 3)}, below 1 in "
        f"{comparison.less} of {comparison.windows} windows",
    )


def _error_table(runner: Runner, errors: Mapping[str, ErrorsByOrder]) -> tuple[Block, ...]:
    """Returns the table of DEM's errors by experiment, with and without generalized coordinates.

    It has two rows, p = 1 and p = 2, for the errors in the paper, and two for each of the given errors.

    Args:
        runner: runner that has the numbers of the experiments.
        errors: mean squared prediction errors (MSPE) by embedding order, (experiments, priors) each. The key names the
            settings and the state from which the forecasts start.

    Returns:
        A sentence and the table.
    """
    numbers = list(runner.experiment_windows)
    # The paper's experiments are numbered from 1.
    indices = [number - 1 for number in numbers]
    # The paper reports one error for each experiment: the axis of the priors has length 1.
    paper_errors = ErrorsByOrder(
        p2=np.array(PAPER_MSPE_P2)[indices, None],
        p1=np.array(PAPER_MSPE_P1)[indices, None],
    )
    errors_by_name = {"the paper, its flights": paper_errors, **errors}
    errors_by_row_name = {}
    for name, errors_by_order in errors_by_name.items():
        errors_by_row_name[f"{name}, p = 1"] = errors_by_order.p1
        errors_by_row_name[f"{name}, p = 2"] = errors_by_order.p2
    title = Sentence(
        "over random priors the median and, in brackets, the 10 % and 90 % quantiles.",
        "Influence of generalized coordinates on MSPE:",
    )
    return title, errors_by_experiment("DEM", errors_by_row_name, numbers)


def _forecast_picture(runner: Runner) -> Picture:
    """Returns the figure of the forecasts with p = 2 and p = 1, with the measured test data.

    It has a column for each start of the forecasts: the filtered state, and state 0. Of the many random priors, each
    order shows the one whose error from the filtered state is the median.

    Args:
        runner: runs the experiments, and has their outcomes.
    """
    outcomes = {}
    for label, method in (("p = 2", DEM_P2), ("p = 1", DEM_P1)):
        prior_outcomes = runner.random_prior_outcomes[method, runner.figure_experiment]
        outcomes[label] = median_outcome(prior_outcomes, DATA_START)
    panels = {}
    for start, kind in FORECAST_KIND_BY_START.items():
        forecasts_by_order = {}
        for label, outcome in outcomes.items():
            # An outcome without forecasts failed.
            if outcome.forecasts:
                forecasts_by_order[label] = outcome.forecasts[kind]
        panels[f"from {start}"] = forecasts_by_order
    return Picture(
        "Forecasts of the test data",
        "With generalized coordinates (p = 2) and without, each from the random prior with the median error.",
        partial(figures.draw_forecasts, runner.figure_window, panels),
    )
