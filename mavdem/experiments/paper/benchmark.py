"""Section V.H of the paper: forecasts of DEM compared with forecasts by PEM, subspace identification and EM."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from mavdem.arrays import Array
from mavdem.experiments.outcomes import Outcome
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.checks import Check, ExperimentResult, lists_by_name, percent
from mavdem.experiments.paper.error_tables import errors_by_experiment
from mavdem.experiments.paper.flights import ARDRONE_NAME
from mavdem.experiments.paper.runner import (
    CONSTANT_MEAN,
    DATA_START,
    DEM_P1,
    DEM_P2,
    FORECAST_KIND_BY_START,
    PEER_METHODS,
    Runner,
    forecast_errors,
    median_outcome,
)
from mavdem.experiments.scores import KNOWN_INPUTS
from mavdem.report.blocks import Block, Sentence, Table, headline_sentence
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import listed, rounded

COMPARED_METHODS = (DEM_P2, *PEER_METHODS, CONSTANT_MEAN)
"""Names of the methods in the order of tables and legends."""

ErrorsByMethod = dict[str, Array]
"""MSPE (flights,) of each method on the same flights, by name of the method."""


def run(runner: Runner) -> ExperimentResult:
    """Compares the forecast errors of DEM, PEM, subspace identification, EM and the constant mean.

    Three comparisons, each with a check that DEM has the lowest error: forecasts of the test data of the five simulated
    experiments, from the filtered state and from state 0; the squared error by step on the experiment of the paper's
    figure; and the median error ratio over windows of the recorded flights, if there are any.

    Args:
        runner: holds the windows of training and test data, and runs the fits, whose results it keeps.

    Returns:
        Checks, tables, figures, and MSPE (mean squared prediction errors) as ``numbers``, by data and method.
    """
    checks = []
    numbers = {}
    experiment_errors = {}
    for start in FORECAST_KIND_BY_START:
        experiment_errors[start] = _experiment_errors(runner, start)
        checks.append(lowest_error_check(experiment_errors[start], f"from {start}"))
        numbers[f"mspe, from {start}"] = lists_by_name(experiment_errors[start])
    tables = _error_tables(experiment_errors, list(runner.experiment_windows))

    forecasts = _figure_forecasts(runner)
    squared_errors = _squared_errors_by_step(runner, forecasts)
    checks.append(_steps_check(squared_errors, runner.figure_window.flight))
    numbers["squared_errors_by_step"] = lists_by_name(squared_errors)

    recorded_ratios: ErrorsByMethod = {}
    remarks = []
    if runner.recorded_windows:
        recorded_ratios = _recorded_error_ratios(runner)
        # The check takes arrays of errors over flights; here the median over the windows is the only entry.
        medians = {
            name: np.median(ratios, keepdims=True) for name, ratios in recorded_ratios.items()
        }
        checks.append(lowest_error_check(medians, f"on {ARDRONE_NAME}"))
        tables = (*recorded_table(recorded_ratios), *tables)
    else:
        remarks.append("Recorded flights are left out: --flights names their folder.")
    numbers[f"error ratio, windows of {ARDRONE_NAME}"] = lists_by_name(recorded_ratios)
    return ExperimentResult(
        checks=tuple(checks),
        numbers=numbers,
        tables=tables,
        pictures=_pictures(runner, forecasts, squared_errors),
        remarks=tuple(remarks),
    )


def _experiment_errors(runner: Runner, start: str) -> ErrorsByMethod:
    """Returns the error of every compared method on each of the five simulated experiments.

    Args:
        runner: runner that has the outcomes of all methods, that is, their forecasts of each experiment's test data.
        start: start of the forecasts: ``DATA_START``, the state that is estimated at the end of training, or
            ``ZERO_START``, state 0.

    Returns:
        Mean squared prediction errors (experiments,), summed over the outputs, by name of the method. An error is
        infinite where a method has made no forecast.
    """
    errors = {}
    for method in COMPARED_METHODS:
        outcomes = []
        for number in runner.experiment_windows:
            outcomes.append(_experiment_outcome(runner, method, number, start))
        errors[method] = forecast_errors(outcomes, start)
    return errors


def _experiment_outcome(runner: Runner, method: str, number: int, start: str) -> Outcome:
    """Returns the outcome of a method on one experiment: its forecasts of the test data, and their errors.

    DEM was trained from many random priors, and has an outcome for each. The one with the median error represents them,
    so that neither a lucky nor an unlucky prior decides the comparison.

    Args:
        runner: runner that has the outcomes.
        method: name of the method.
        number: number of the experiment.
        start: start of the forecasts whose errors decide which prior is the median, ``DATA_START`` or ``ZERO_START``.

    Returns:
        The outcome on the experiment's single window.
    """
    if method == DEM_P2:
        return median_outcome(runner.random_prior_outcomes[DEM_P2, number], start)
    # The first window of the flight is the experiment.
    return runner.outcomes[number, method][0]


def _figure_forecasts(runner: Runner) -> dict[str, Array]:
    """Returns the forecasts that the figures of a single experiment show.

    They start from the state that is estimated at the end of training. A method that failed has no forecast and is left
    out.

    Args:
        runner: runs the experiments, and has their outcomes.

    Returns:
        By name of the method, forecasts (H, m) of H steps of the test data and m outputs.
    """
    forecasts = {}
    for method in COMPARED_METHODS:
        outcome = _experiment_outcome(runner, method, runner.figure_experiment, DATA_START)
        if outcome.forecasts:
            forecasts[method] = outcome.forecasts[KNOWN_INPUTS]
    return forecasts


def _squared_errors_by_step(runner: Runner, forecasts: Mapping[str, Array]) -> dict[str, Array]:
    """Returns the squared errors of forecasts of the experiment of the figures, against the number of steps ahead.

    Args:
        runner: runner that has the window of that experiment.
        forecasts: forecasts (H, m) of its H test samples, by name of the method.

    Returns:
        By name of the method, squared errors (H,), each summed over the m outputs.
    """
    test_outputs = runner.figure_window.test.outputs
    squared_errors = {}
    for name, forecast in forecasts.items():
        squared_errors[name] = ((forecast - test_outputs) ** 2).sum(axis=1)
    return squared_errors


def _recorded_error_ratios(runner: Runner) -> ErrorsByMethod:
    """Returns the error ratios of the methods on all windows of the recorded flights.

    The ratio of a window is the squared error of the forecast from the data over the constant mean's error, with each
    output in units of its variance in training.

    Args:
        runner: runs the experiments, and has the outcomes on the recorded flights.

    Returns:
        By name of the method, ratios (W,) in W windows; infinite where it has no forecast.
    """
    ratios = {}
    for method, outcomes in runner.recorded_outcomes.items():
        # The last horizon is the whole test part.
        ratios[method] = np.array([outcome.scores[KNOWN_INPUTS].ratio[-1] for outcome in outcomes])
    return ratios


def recorded_table(ratios: ErrorsByMethod) -> tuple[Block, ...]:
    """Returns the table of the error ratios on the recorded flights, the lowest median first, after an introduction.

    Args:
        ratios: (W,) squared errors relative to the constant mean, by name of the method.

    Returns:
        A sentence and the table.
    """
    # Errors are relative to the constant mean's, whose own row would be 1.
    methods = [name for name in ratios if name != CONSTANT_MEAN]
    methods.sort(key=lambda name: np.median(ratios[name]))
    rows = []
    for name in methods:
        worse_count = int((ratios[name] > 1).sum())
        rows.append([name, rounded(np.median(ratios[name]), 2), str(worse_count)])
    window_count = len(ratios[CONSTANT_MEAN])
    p2_ratios, p1_ratios = ratios[DEM_P2], ratios[DEM_P1]
    lower_count = int((p2_ratios < p1_ratios).sum())
    introduction = (
        f"150 steps of {ARDRONE_NAME}, forecast after 700 of training, in {window_count} windows. {DEM_P2} has a lower "
        f"error than {DEM_P1} in {lower_count} of them."
    )
    return (
        Sentence(introduction),
        Table(["method", "error over the constant mean’s, median", "windows worse than it"], rows),
    )


def lowest_error_check(errors: ErrorsByMethod, conditions: str) -> Check:
    """Checks that DEM has a lower error than each of the paper's other methods on every flight.

    On each flight DEM is compared with the one of the others that has the lowest error there. The finding states the
    ratio of DEM's error to this lowest error, as the geometric mean over the flights.

    Args:
        errors: mean squared prediction errors (MSPE) on the same flights, by name of the method.
        conditions: start of the forecasts, or the flight, for the text.

    Returns:
        The check, which holds if DEM is best on all flights.
    """
    lowest_peer_errors = np.min([errors[name] for name in PEER_METHODS], axis=0)
    flight_count = len(lowest_peer_errors)
    lower_count = int((errors[DEM_P2] < lowest_peer_errors).sum())
    log_ratios = np.log(errors[DEM_P2] / lowest_peer_errors)
    geometric_mean_ratio = float(np.exp(np.mean(log_ratios)))
    return Check(
        rule=f"{DEM_P2}, {conditions}: its error is lower than that of {listed(PEER_METHODS)} on every flight",
        holds=lower_count == flight_count,
        finding=f"{DEM_P2}, {conditions}, has a lower error than the paper’s peers on {lower_count} of "
        f"{flight_count}; its error is {rounded(geometric_mean_ratio, 3)} times that of the best of them",
    )


def _steps_check(squared_errors: Mapping[str, Array], flight: str) -> Check:
    """Checks that DEM has the lowest squared error of the paper's methods at more than half of the steps.

    Args:
        squared_errors: (H,) squared errors summed over the outputs, by method. The constant mean is always among them;
            a method without a forecast is not.
        flight: name of the flight, for the text.

    Returns:
        The check, whose finding states the fraction of the steps at which DEM is best.
    """
    no_forecast = np.full_like(squared_errors[CONSTANT_MEAN], np.inf)
    dem_errors = squared_errors.get(DEM_P2, no_forecast)
    peer_errors = [squared_errors.get(name, no_forecast) for name in PEER_METHODS]
    # At each step, the row of the method with the lowest error. DEM has row 0, and argmin takes the first of equal
    # errors, so that DEM also counts as best where another method is as good.
    best_row = np.array([dem_errors, *peer_errors]).argmin(axis=0)
    fraction_best = float((best_row == 0).mean())
    return Check(
        rule=f"{DEM_P2}, {flight}: of the paper’s four methods it has the least squared error at over half of the "
        "steps",
        holds=fraction_best > 0.5,
        finding=f"{DEM_P2} has the least squared error of the four at {percent(fraction_best)} of the steps of "
        f"{flight}",
    )


def _error_tables(
    experiment_errors: Mapping[str, ErrorsByMethod], numbers: list[int]
) -> tuple[Block, ...]:
    """Returns a table of the errors by method and experiment for each start of the forecasts.

    Args:
        experiment_errors: errors on the experiments, by start of the forecasts.
        numbers: numbers of the experiments.

    Returns:
        For each start a sentence and a table.
    """
    blocks: list[Block] = []
    for start, errors in experiment_errors.items():
        # The function for the table takes errors of several random priors, (experiments, priors). Here each method has
        # one error for each experiment.
        errors_of_one_prior = {name: values[:, None] for name, values in errors.items()}
        blocks.append(headline_sentence(f"MSPE of the five experiments, from {start}."))
        blocks.append(errors_by_experiment("method", errors_of_one_prior, numbers))
    return tuple(blocks)


def _pictures(
    runner: Runner, forecasts: Mapping[str, Array], squared_errors: Mapping[str, Array]
) -> tuple[Picture, ...]:
    """Returns two figures of one experiment: the forecasts, and their errors against the number of steps ahead.

    A picture has a title, a caption, and the function that draws it, which is called when the report is written.

    Args:
        runner: runner that has the window of that experiment.
        forecasts: by name of the method, its forecasts (H, m) of H steps and m outputs.
        squared_errors: by name of the method, the squared errors (H,) of its forecasts, summed over the outputs.

    Returns:
        The picture of the forecasts and the picture of the errors, each with a line for every method.
    """
    window = runner.figure_window
    # Both functions draw a panel for each entry of a dictionary by heading. There is one panel here, without a heading.
    draw_forecasts = partial(figures.draw_forecasts, window, {"": forecasts})
    draw_errors = partial(
        figures.draw_lines, {"": squared_errors}, "steps ahead, n", first_x=1, scale="log"
    )
    return (
        Picture(
            "Forecasts of the test data", f"Of {window.flight}, from the data.", draw_forecasts
        ),
        Picture(
            "Squared error by step",
            f"n steps ahead on {window.flight}, summed over outputs.",
            draw_errors,
        ),
    )
