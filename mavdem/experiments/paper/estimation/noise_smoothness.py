"""Anil Meera and Wisse on the smoothness of noise: s learned by F̄, its coverage, and forecasts of real flights with it.

A. Anil Meera and M. Wisse, "Free Energy Principle for the Noise Smoothness Estimation of Linear Systems with Colored
Noise", 2022 (arXiv:2204.01796), known here by its abstract. The simulated systems and the criteria are this project's.

For simulated noise of known smoothness the system and the variances are known, and s is learned with the states. On
recorded flights everything is learned, and the forecasts are compared with the default's, s = dt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import norm, t

from mavdem.arrays import Array
from mavdem.dem import Settings, learn
from mavdem.dem.engine.linalg import one_thread, raise_on_overflow
from mavdem.dem.engine.moments import SufficientStatistics
from mavdem.dem.fitting import generalized_data as flight_data
from mavdem.dem.fitting import generative_model as flight_model
from mavdem.dem.learning import prepared_training
from mavdem.dem.scaling import Scaling
from mavdem.experiments.compared_methods import PLANT, Method
from mavdem.experiments.outcomes import run_trial
from mavdem.experiments.paired_test import Paired, paired
from mavdem.experiments.paper.checks import Check, ExperimentResult, percent
from mavdem.experiments.paper.estimation.dem_covariance import (
    KNOWN_PRECISION,
    generalized_data,
    generative_model,
)
from mavdem.experiments.paper.estimation.noisy_records import (
    SIMULATED_DT,
    NoisyRecord,
    random_record,
)
from mavdem.experiments.paper.estimation.smoothness_learning import (
    FitAt,
    fit_all,
    fit_states,
    learn_smoothness,
    smoothness_uncertainty,
)
from mavdem.experiments.paper.flights import ARDRONE_NAME
from mavdem.experiments.paper.runner import DATA_START, Runner, forecast_errors
from mavdem.experiments.window import Window
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import rounded

TRUE_WIDTHS = (2, 3, 4, 6)
"""True smoothness of the simulated noises, in sampling steps."""

RECORD_COUNT = 50
"""Simulated records of each smoothness; a choice."""

COVERAGE = 0.9
"""Probability of the interval of ln s whose coverage is counted."""

MAX_COVERAGE_ERROR = 0.1
"""Largest difference of the counted coverage from ``COVERAGE``; two standard errors of 50 records are 0.085."""

CANDIDATE_WIDTHS = tuple(2.0**power for power in range(-2, 6))
"""Grid of s in sampling steps, from which the search by the gradient starts."""

WINDOW_STEP = 9
"""Every ninth window of the recorded flights is used, four windows of the six published flights.

A choice that bounds the time: each takes some thirty fits by F̄ and four by ``learn``, and windows overlap by half.
"""

MIN_GAIN = 0.05
"""Share by which the forecast error must fall on unseen data for s to be learned by default."""

FLIGHT_SETTINGS = {
    "DEM alone": replace(PLANT, horizon=None),
    "with simulation fit": PLANT,
}
"""Settings of DEM whose forecasts are compared, by name: without and with the simulation-error fit of θ."""


class SimulatedResult(NamedTuple):
    """The smoothness learned from one simulated record, with the true one."""

    log_ratio: float
    """ln of the learned over the true smoothness."""

    laplace_covers: bool
    """Whether the interval by the curvature of F̄ alone contains the true one."""

    sandwich_covers: bool
    """Whether the interval by the sandwich contains it."""


class WindowResult(NamedTuple):
    """The smoothness learned on one window of a flight, and errors of forecasts."""

    width: float
    """Learned smoothness in sampling steps."""

    is_inside: bool
    """Whether it lies inside the grid."""

    default_error: float
    """MSPE of the forecast with s = dt."""

    learned_error: float
    """MSPE of the forecast with the learned s; infinite where it fails."""


def run(runner: Runner) -> ExperimentResult:
    """Learns the smoothness of simulated noise and, if there are any, of recorded flights.

    Args:
        runner: runner that has the windows of recorded flights, and runs the fits in several processes.

    Returns:
        Checks and tables; ``numbers`` has the results of all records and windows.
    """
    simulated_results = {}
    for width in TRUE_WIDTHS:
        jobs = [(width, seed) for seed in range(RECORD_COUNT)]
        simulated_results[width] = runner.map_jobs(_learn_simulated, jobs)
    checks = [coverage_check(simulated_results)]
    tables = _simulated_table(simulated_results)

    recorded_results: dict[str, list[WindowResult]] = {}
    remarks = []
    windows = runner.recorded_windows[::WINDOW_STEP]
    if windows:
        comparisons = {}
        for name, settings in FLIGHT_SETTINGS.items():
            learn_window = partial(_learn_window, settings=settings)
            recorded_results[name] = runner.map_jobs(learn_window, windows)
            comparisons[name] = _comparison(recorded_results[name], windows)
        checks.append(learned_smoothness_check(comparisons))
        tables += _recorded_table(recorded_results, comparisons)
    else:
        remarks.append("Recorded flights are left out: --flights names their folder.")

    simulated_numbers = {}
    for width, simulated in simulated_results.items():
        simulated_numbers[str(width)] = [result._asdict() for result in simulated]
    recorded_numbers = {}
    for name, recorded in recorded_results.items():
        recorded_numbers[name] = [result._asdict() for result in recorded]
    return ExperimentResult(
        checks=tuple(checks),
        numbers={"simulated": simulated_numbers, "recorded": recorded_numbers},
        tables=tables,
        remarks=tuple(remarks),
    )


def fit_with_known_variances(record: NoisyRecord, data: Array) -> FitAt:
    """Returns a function that fits DEM's states for a given smoothness s; the system and its noise variances are known.

    Args:
        record: the samples, with the variances of both noises.
        data: (T, dim [ỹ; η̃]) the same samples in generalized coordinates: outputs ỹ, inputs η̃.

    Returns:
        The function, which takes s in seconds and returns the fit with its free energy F̄.
    """
    model = generative_model(record)
    # The noise of the continuous model has the unit of the states per second.
    variances = np.append(record.noise_variances, record.process_variances / record.dt**2)
    prior = model.prior._replace(
        lambda_mean=-np.log(variances), lambda_precision=KNOWN_PRECISION * np.eye(len(variances))
    )
    statistics = SufficientStatistics.from_segments(data)
    return partial(fit_states, replace(model, prior=prior), statistics)


def _learn_simulated(job: tuple[int, int]) -> SimulatedResult:
    """Simulates a record of a random system, and learns the smoothness s of its noise; all else of the system is known.

    Args:
        job: true smoothness in sampling steps, and seed of the random record.

    Returns:
        Error of ln s, and whether two intervals of ln s cover the true value. One has the standard deviation by the
        curvature of the free energy F̄ (Laplace's approximation), the other that by a sandwich covariance.
    """
    true_width, seed = job
    record = random_record(seed, true_width * SIMULATED_DT)
    data = generalized_data(record)
    fit_at = fit_with_known_variances(record, data)
    with one_thread():
        learned = learn_smoothness(fit_at, [width * SIMULATED_DT for width in CANDIDATE_WIDTHS])
        uncertainty = smoothness_uncertainty(learned, fit_at, data, record.dt)
    log_ratio = float(np.log(learned.smoothness / record.smoothness))
    # Each interval is symmetric about the learned ln s. Its half width is the standard deviation times the quantile
    # that leaves the same probability outside at either end.
    upper_probability = (1 + COVERAGE) / 2
    laplace_half_width = norm.ppf(upper_probability) * uncertainty.laplace
    # The variance of the sandwich is estimated from a few blocks of the record. Student's t distribution allows for it.
    degrees_of_freedom = uncertainty.blocks - 1
    sandwich_half_width = t.ppf(upper_probability, degrees_of_freedom) * uncertainty.sandwich
    return SimulatedResult(
        log_ratio,
        laplace_covers=bool(abs(log_ratio) < laplace_half_width),
        sandwich_covers=bool(abs(log_ratio) < sandwich_half_width),
    )


def _learn_window(window: Window, settings: Settings) -> WindowResult:
    """Learns the smoothness on the training part of a window, and forecasts the test part with it and with the default.

    Args:
        window: training samples of a recorded flight, and the test samples after them.
        settings: settings of DEM; their smoothness is replaced.

    Returns:
        The learned smoothness in sampling steps, whether it is inside the grid of candidates, and both forecast errors.
    """
    with one_thread(), raise_on_overflow():
        record, complete = prepared_training(window.train, settings)
        scaling = Scaling.from_record(record, complete)
        model = flight_model(complete, scaling, record)
        statistics = SufficientStatistics.from_segments(*flight_data(complete, scaling, record))
        learned = learn_smoothness(
            partial(fit_all, model, statistics), [width * record.dt for width in CANDIDATE_WIDTHS]
        )
    return WindowResult(
        width=learned.smoothness / record.dt,
        is_inside=learned.is_inside,
        # Without a smoothness DEM takes its default, one sampling step.
        default_error=_forecast_error(window, replace(settings, smoothness=None)),
        learned_error=_forecast_error(window, replace(settings, smoothness=learned.smoothness)),
    )


def _forecast_error(window: Window, settings: Settings) -> float:
    """Trains DEM on the training part of a window, and returns the error of its forecast of the test part.

    Args:
        window: training samples of a recorded flight, and the test samples after them.
        settings: settings of DEM, with the smoothness to use.

    Returns:
        Mean squared error of the forecast, summed over the outputs; infinite if there is no forecast.
    """
    method = Method("DEM", partial(learn, settings=settings))
    outcome = run_trial((method, window))
    return float(forecast_errors([outcome], DATA_START)[0])


def _comparison(results: Sequence[WindowResult], windows: Sequence[Window]) -> Paired:
    """Compares forecast errors with the learned noise smoothness to errors with the default one, in a paired test.

    Args:
        results: results of the windows, with both errors.
        windows: the same windows, of which the test uses those that do not overlap.

    Returns:
        The median ratio of learned to default, and the p-value of the difference.
    """
    learned_errors = [result.learned_error for result in results]
    default_errors = [result.default_error for result in results]
    return paired(learned_errors, default_errors, windows)


def coverage_check(results_by_width: Mapping[int, Sequence[SimulatedResult]]) -> Check:
    """Checks that the interval of the learned smoothness covers the true one as often as it should, at every width.

    Args:
        results_by_width: results by true smoothness in sampling steps.

    Returns:
        The check, with the coverage at each width.
    """
    coverage_texts = []
    coverage_errors = []
    for width, results in results_by_width.items():
        coverage = float(np.mean([result.sandwich_covers for result in results]))
        coverage_texts.append(f"{percent(coverage)} at {width} dt")
        coverage_errors.append(abs(coverage - COVERAGE))
    return Check(
        rule=f"the {percent(COVERAGE)} interval of s, by the sandwich, covers the true s within "
        f"{percent(MAX_COVERAGE_ERROR)} at every smoothness",
        holds=max(coverage_errors) <= MAX_COVERAGE_ERROR,
        finding=f"the {percent(COVERAGE)} interval of s covers the true one in {', '.join(coverage_texts)}",
    )


def learned_smoothness_check(comparisons: Mapping[str, Paired]) -> Check:
    """Checks that a learned smoothness lowers the forecast error by ``MIN_GAIN`` on the median window.

    Args:
        comparisons: forecast errors with the learned smoothness (ours) compared with those of the default smoothness
            (theirs), by the name of the model's settings.

    Returns:
        The check, with the ratio of the errors for each of the settings.
    """
    findings = []
    for name, comparison in comparisons.items():
        findings.append(
            f"{rounded(comparison.ratio, 3)} {name}, lower in {comparison.less} of "
            f"{comparison.windows} windows"
        )
    return Check(
        rule=f"on {ARDRONE_NAME} the median of the error with s learned over that with s = dt is at most "
        f"{1 - MIN_GAIN:g}",
        holds=all(comparison.ratio <= 1 - MIN_GAIN for comparison in comparisons.values()),
        finding=f"on {ARDRONE_NAME} the error with s learned over that with s = dt is {'; '.join(findings)}",
    )


def _simulated_table(
    results_by_width: Mapping[int, Sequence[SimulatedResult]],
) -> tuple[Block, ...]:
    """Returns the table of the learned smoothness s of simulated noise, with a row for each true smoothness.

    A row shows the median ratio of the learned to the true s over the records, the spread of this ratio, and for two
    kinds of intervals in which part of the records they contain the true s.

    Args:
        results_by_width: results of all records by true smoothness, in sampling steps dt.

    Returns:
        A sentence and the table.
    """
    rows = []
    for width, results in results_by_width.items():
        log_ratios = np.array([result.log_ratio for result in results])
        median_ratio = float(np.exp(np.median(log_ratios)))
        # The standard deviation of the logarithm of the ratio is the ratio's relative spread.
        relative_spread = float(log_ratios.std())
        sandwich_coverage = float(np.mean([result.sandwich_covers for result in results]))
        laplace_coverage = float(np.mean([result.laplace_covers for result in results]))
        rows.append(
            [
                f"{width} dt",
                rounded(median_ratio, 3),
                percent(relative_spread),
                percent(sandwich_coverage),
                percent(laplace_coverage),
            ]
        )
    introduction = Sentence(
        f"{RECORD_COUNT} random systems for each smoothness, with known matrices and variances.",
        "Simulated noise:",
    )
    header = ["true s", "learned over true, median", "spread", "sandwich covers", "F̄ alone covers"]
    return introduction, Table(header, rows)


def _recorded_table(
    results_by_settings: Mapping[str, Sequence[WindowResult]], comparisons: Mapping[str, Paired]
) -> tuple[Block, ...]:
    """Returns the table of the learned smoothness on recorded flights.

    A row has the smoothness s that was learned with some settings of DEM, in time steps dt, and the error of forecasts
    with this s relative to the error with the default s = dt. It also has the number of windows in which the learned s
    has the lower error, and the result of a paired test of the two.

    Args:
        results_by_settings: results of all windows of the flights, by name of the settings.
        comparisons: paired comparison of the errors with learned and with default smoothness, by the same names.

    Returns:
        A sentence and the table.
    """
    rows = []
    for name, results in results_by_settings.items():
        learned_steps = np.array([result.width for result in results])
        # Where F̄ is largest at the end of the grid of candidates, the true maximum may be beyond it.
        inside_grid_count = sum(result.is_inside for result in results)
        comparison = comparisons[name]
        rows.append(
            [
                name,
                f"{rounded(float(np.median(learned_steps)), 3)} dt",
                f"{inside_grid_count} of {len(results)}",
                rounded(comparison.ratio, 3),
                f"{comparison.less} of {comparison.windows}",
                comparison.result.value,
            ]
        )
    header = ["settings", "learned s, median", "inside the grid", "error ratio", "lower in", "test"]
    return Sentence(f"every {WINDOW_STEP}th window.", f"{ARDRONE_NAME}:"), Table(header, rows)
