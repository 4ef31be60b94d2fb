"""Anil Meera and Lanillos on noise variances: DEM's M step beside standard estimators, for white and coloured noise.

A. Anil Meera and P. Lanillos, "Adaptive Noise Covariance Estimation under Colored Noise using Dynamic Expectation
Maximization", 2023 (arXiv:2308.07797). Their article is known here by its abstract, and by the code that they publish
(github.com/ajitham123/DEM_NCM), whose sampling, input and prior are used. The random systems, the noises, the choice of
other estimators and the criterion are this project's.

The criterion is the factor by which estimated variances are wrong: the exponential of the mean of |ln(estimate/truth)|.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.experiments.paper.checks import Check, ExperimentResult
from mavdem.experiments.paper.error_tables import table_by_estimator
from mavdem.experiments.paper.estimation.covariance_estimators import (
    RecursiveEstimates,
    covariance_matching,
    expectation_maximization,
    innovation_correlation,
    kalman_states_with_variances,
    measurement_difference,
    sage_husa,
    variational_bayes,
)
from mavdem.experiments.paper.estimation.dem_covariance import dem_variances, online_dem_variances
from mavdem.experiments.paper.estimation.noisy_records import (
    SIMULATED_DT,
    NoisyRecord,
    flight_records,
    random_record,
)
from mavdem.experiments.paper.estimation.roll_windows import missing_flights_sentence
from mavdem.experiments.paper.runner import Runner
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import rounded

DEM = "DEM"
ONLINE_DEM = "DEM, online"
VARIATIONAL_BAYES = "variational Bayes"
TRUE_VARIANCES = "Kalman filter, true variances"
"""Names of estimators that checks speak of."""

BATCH_ESTIMATORS = {
    "innovation correlation (ALS)": innovation_correlation,
    "measurement difference": measurement_difference,
    "maximum likelihood (EM)": expectation_maximization,
}
"""Estimators of a whole record, by name."""

RECURSIVE_ESTIMATORS = {
    "covariance matching": covariance_matching,
    "Sage–Husa": sage_husa,
    VARIATIONAL_BAYES: variational_bayes,
}
"""Estimators that go from sample to sample, by name."""

BASELINES = (*BATCH_ESTIMATORS, *RECURSIVE_ESTIMATORS)
"""Names of the estimators that DEM is compared with."""

SMOOTHNESS_IN_STEPS = {
    "white noise": 0.0,
    "s = 1 step": 1.0,
    "s = 2 steps": 2.0,
    "s = 4 steps": 4.0,
}
"""Width s of the noises' kernel in sampling steps, by its name; DEM knows it, and takes white noise for s = 1 step."""

SMOOTHEST = "s = 4 steps"
"""The noise of highest colour."""

RANDOM_RECORDS = 10
"""Random systems for each smoothness; a choice, with which the run takes less than a minute."""

VARIANCE_STEP = float(np.exp(2.0))
"""Factor by which the variances change in the middle of the records of the online estimators; a choice."""

STEP_NOISE = "s = 2 steps"
"""Noise of these records."""

FINAL_SHARE = 1 / 4
"""Last share of a record, over which recursive estimates are averaged.

A step of the variances in the middle of the record is long past there, in terms of the estimators' memory.
"""


class RecordErrors(NamedTuple):
    """Errors of one estimator on one record; the fields are keys of documents."""

    log_variance_error: float
    """Mean over the outputs of |ln(estimated variance / true variance)|; infinite where there is no estimate."""

    state_error: float
    """Mean squared error of the states over that of the measured ones, in the second half of the record."""


def record_errors(record: NoisyRecord) -> dict[str, RecordErrors]:
    """Estimates noise variances and states of one record with every estimator, and returns the errors of each.

    Args:
        record: T samples of a system, with its true states and the true variances of its measurement noise.

    Returns:
        Errors by name of the estimator. ``TRUE_VARIANCES`` is a Kalman filter with the true variances: it shows the
        error of the states that perfect variances would leave.
    """
    errors = {}
    for name, estimate in BATCH_ESTIMATORS.items():
        errors[name] = _batch_errors(record, estimate)
    for name, estimate_recursively in RECURSIVE_ESTIMATORS.items():
        errors[name] = _recursive_errors(record, estimate_recursively(record))
    errors[DEM] = _recursive_errors(record, dem_variances(record))
    online_variances = final_variances(online_dem_variances(record))
    errors[ONLINE_DEM] = _record_errors(record, online_variances, _no_states(record))
    optimal_states = kalman_states_with_variances(record, record.noise_variances)
    errors[TRUE_VARIANCES] = _record_errors(record, record.noise_variances, optimal_states)
    return errors


def _batch_errors(record: NoisyRecord, estimate: Callable[[NoisyRecord], Array]) -> RecordErrors:
    """Returns the errors of an estimator that takes a whole record and gives one variance for each output.

    Its states come from a Kalman filter with these variances.

    Args:
        record: T samples with true states and variances.
        estimate: the estimator, which returns the variances (n,) of the measurement noise.

    Returns:
        Errors of variances and states; infinite if the estimator failed.
    """
    try:
        variances = estimate(record)
    except LinAlgError:
        return RecordErrors(np.inf, np.inf)
    return _record_errors(record, variances, kalman_states_with_variances(record, variances))


def _recursive_errors(record: NoisyRecord, estimates: RecursiveEstimates) -> RecordErrors:
    """Returns the errors of an estimator that gives variances and states at every sample.

    Args:
        record: T samples with true states and variances.
        estimates: variances and states after each of the T samples; DEM's states use two later samples, too.

    Returns:
        Error of the variances at the end of the record, and error of the states.
    """
    return _record_errors(record, final_variances(estimates.variances), estimates.states)


def _no_states(record: NoisyRecord) -> Array:
    """Returns NaN (T, n) in the place of states, for estimators of variances only: the states' error is then NaN."""
    return np.full_like(record.states, np.nan)


def final_variances(history: Array) -> Array:
    """Returns the geometric mean of estimated variances (T, n) over the end of a record, (n,)."""
    last_part = history[-int(FINAL_SHARE * len(history)) :]
    return np.asarray(np.exp(np.log(last_part).mean(axis=0)), float)


def _record_errors(record: NoisyRecord, variances: Array, states: Array) -> RecordErrors:
    """Returns the errors of estimated variances and states.

    Args:
        record: T samples with true states and variances.
        variances: (n,) estimated variances of the measurement noise.
        states: (T, n) estimated states; NaN where there is no estimate.

    Returns:
        Mean absolute logarithm of the ratio of the variances; and the squared error of the states in the second half of
        the record, where recursive estimators have converged, relative to the measurement's. The latter is NaN
        without estimates of the states.
    """
    log_error = np.abs(np.log(variances / record.noise_variances)).mean()
    second_half = slice(len(states) // 2, None)
    state_squares = (states[second_half] - record.states[second_half]) ** 2
    measurement_squares = (record.outputs[second_half] - record.states[second_half]) ** 2
    has_estimate = np.isfinite(state_squares).all(axis=1)
    state_error = np.nan
    if has_estimate.any():
        # Each state in units of its own measurement error.
        ratios = state_squares[has_estimate].mean(axis=0) / measurement_squares.mean(axis=0)
        state_error = float(ratios.mean())
    return RecordErrors(float(log_error), state_error)


def online_errors(record: NoisyRecord) -> dict[str, float]:
    """Returns the log variance errors of the recursive estimators.

    Args:
        record: T samples with true variances.

    Returns:
        By name of the estimator, the mean over the outputs of |ln(estimated variance / true variance)|.
    """
    variance_histories = {}
    for name, estimate in RECURSIVE_ESTIMATORS.items():
        variance_histories[name] = estimate(record).variances
    variance_histories[ONLINE_DEM] = online_dem_variances(record)
    log_errors = {}
    for name, history in variance_histories.items():
        errors = _record_errors(record, final_variances(history), _no_states(record))
        log_errors[name] = errors.log_variance_error
    return log_errors


class MeanErrors(NamedTuple):
    """Errors of one estimator over several records; the fields are keys of documents."""

    variance_factor: float
    """Factor by which variances are wrong, 1 being perfect."""

    state_error: float
    """Median over records of the squared error of the states over that of the measured ones."""


def mean_errors(records: Sequence[Mapping[str, RecordErrors]]) -> dict[str, MeanErrors]:
    """Averages the errors of each estimator over several records.

    Args:
        records: errors by name of the estimator, for each record.

    Returns:
        Geometric mean of the variance error as a factor, and median of the state error, by name.
    """
    means = {}
    for name in records[0]:
        log_error = np.mean([errors[name].log_variance_error for errors in records])
        state_error = np.median([errors[name].state_error for errors in records])
        means[name] = MeanErrors(float(np.exp(log_error)), float(state_error))
    return means


def run(runner: Runner) -> ExperimentResult:
    """Compares estimates of the variances of measurement noise by DEM and by standard estimators.

    Args:
        runner: runner that has the recorded flights, if there are any, and runs the records in several processes.

    Returns:
        Checks, tables, and the errors of all estimators as ``numbers``.
    """
    # Both are mean errors of all estimators, by the smoothness of the noise.
    simulated_errors = {}
    recorded_errors = {}
    for name, steps in SMOOTHNESS_IN_STEPS.items():
        records = [random_record(seed, steps * SIMULATED_DT) for seed in range(RANDOM_RECORDS)]
        simulated_errors[name] = mean_errors(runner.map_jobs(record_errors, records))
        flights_with_noise = _flight_records(runner, steps)
        if flights_with_noise:
            recorded_errors[name] = mean_errors(runner.map_jobs(record_errors, flights_with_noise))
    online_factors = _errors_after_variance_step(runner)
    checks = covariance_checks(simulated_errors, "simulated")
    checks.append(state_check(simulated_errors[SMOOTHEST]))
    checks.append(online_check(online_factors))
    tables = [*error_tables(simulated_errors, "Simulated"), *online_table(online_factors)]
    remarks = []
    if recorded_errors:
        checks = [*covariance_checks(recorded_errors, "flights with added noise"), *checks]
        tables = [*error_tables(recorded_errors, "Flights with added noise"), *tables]
    else:
        remarks.append(missing_flights_sentence(runner.recorded_flights))
    numbers = {
        "simulated": _nested_values(simulated_errors),
        "flights with added noise": _nested_values(recorded_errors),
        "online, factor": online_factors,
    }
    return ExperimentResult(tuple(checks), numbers, tuple(tables), remarks=tuple(remarks))


def _errors_after_variance_step(runner: Runner) -> dict[str, float]:
    """Returns by which factor the recursive estimators are wrong after a sudden step of the noise variances.

    Args:
        runner: runner of the jobs.

    Returns:
        Factors by name of the estimator, means over random records whose variances change in the middle.
    """
    smoothness = SMOOTHNESS_IN_STEPS[STEP_NOISE] * SIMULATED_DT
    records = [random_record(seed, smoothness, VARIANCE_STEP) for seed in range(RANDOM_RECORDS)]
    return _online_factors(runner.map_jobs(online_errors, records))


def _flight_records(runner: Runner, smoothness_in_steps: float) -> list[NoisyRecord]:
    """Returns the recorded flights with smooth noise of known variances added to their outputs.

    Args:
        runner: runner that has the recorded flights, by name; perhaps none.
        smoothness_in_steps: width of the noise's Gaussian kernel, in sampling steps of each flight.
    """
    records = []
    for name, flight in runner.recorded_flights.items():
        records += flight_records({name: flight}, smoothness_in_steps * float(flight.dt))
    return records


def _online_factors(records: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Returns the factor by which the variances of each recursive estimator are wrong on average, by name.

    Args:
        records: log errors of the variances by estimator, for each record.

    Returns:
        Geometric means over the records, 1 for right variances.
    """
    factors = {}
    for name in records[0]:
        mean_log_error = np.mean([errors[name] for errors in records])
        factors[name] = float(np.exp(mean_log_error))
    return factors


def _nested_values(
    errors: Mapping[str, Mapping[str, MeanErrors]],
) -> dict[str, dict[str, dict[str, float]]]:
    """Converts errors to nested dictionaries, as a JSON document needs them.

    Args:
        errors: errors by noise and estimator.

    Returns:
        Errors by noise, estimator and name of the error.
    """
    values = {}
    for noise, means in errors.items():
        values[noise] = {name: mean._asdict() for name, mean in means.items()}
    return values


def covariance_checks(errors: Mapping[str, Mapping[str, MeanErrors]], data: str) -> list[Check]:
    """Checks for each coloured noise that DEM estimates the noise variances better than every other estimator.

    An estimate is better if the factor by which it differs from the truth is smaller (``MeanErrors.variance_factor``).

    Args:
        errors: errors by noise and estimator.
        data: name of the simulated or recorded data, for the text.

    Returns:
        A check for each coloured noise; white noise is left out.
    """
    checks = []
    for noise, means in errors.items():
        is_white = SMOOTHNESS_IN_STEPS[noise] == 0
        if is_white:
            continue
        best_baseline = min(BASELINES, key=lambda name: means[name].variance_factor)
        dem_factor = means[DEM].variance_factor
        best_factor = means[best_baseline].variance_factor
        checks.append(
            Check(
                rule=f"{data}, {noise}: the variances of DEM are wrong by a smaller factor than those of every other "
                "estimator",
                holds=dem_factor < best_factor,
                finding=f"{data}, {noise}: the variances are wrong by a factor of {rounded(dem_factor, 3)} by DEM and "
                f"{rounded(best_factor, 3)} by {best_baseline}",
            )
        )
    return checks


def state_check(means: Mapping[str, MeanErrors]) -> Check:
    """Checks for the smoothest noise that DEM's states have a lower error than the states of variational Bayes.

    Args:
        means: errors with that noise, means over the records, by estimator.

    Returns:
        The check.
    """
    dem_error = means[DEM].state_error
    bayes_error = means[VARIATIONAL_BAYES].state_error
    return Check(
        rule=f"simulated, {SMOOTHEST}: the states of DEM have a lower squared error than those of {VARIATIONAL_BAYES}",
        holds=dem_error < bayes_error,
        finding=f"simulated, {SMOOTHEST}: the squared error of the states is {rounded(dem_error, 3)} of the "
        f"measurement’s by DEM and {rounded(bayes_error, 3)} by {VARIATIONAL_BAYES}",
    )


def online_check(factors: Mapping[str, float]) -> Check:
    """Checks that after a step of the true variances DEM's online estimates are closer than all others.

    Args:
        factors: factor by which the variances are wrong after the step, by name of the recursive estimator.

    Returns:
        The check.
    """
    best_estimator = min(RECURSIVE_ESTIMATORS, key=lambda name: factors[name])
    return Check(
        rule=f"simulated, {STEP_NOISE}, after a step of the variances: those of {ONLINE_DEM} are wrong by a smaller "
        "factor than those of every recursive estimator",
        holds=factors[ONLINE_DEM] < factors[best_estimator],
        finding=f"after a step of the variances they are wrong by a factor of {rounded(factors[ONLINE_DEM], 3)} by "
        f"{ONLINE_DEM} and {rounded(factors[best_estimator], 3)} by {best_estimator}",
    )


def error_tables(errors: Mapping[str, Mapping[str, MeanErrors]], records_name: str) -> list[Block]:
    """Returns two tables: by which factor estimated noise variances are wrong, and the errors of estimated states.

    Each has a row for every estimator and a column for every noise; the best estimator in white noise comes first.

    Args:
        errors: errors by noise and estimator.
        records_name: which records these are, such as "Simulated", as both sentences begin.

    Returns:
        A sentence and the table of variances, then a sentence and the table of states.
    """
    # DEM as an online estimator has no states, and the filter with the true variances estimates none.
    estimators_of_variances = (*BASELINES, DEM, ONLINE_DEM)
    estimators_of_states = (*BASELINES, DEM, TRUE_VARIANCES)
    variance_factors = {}
    state_errors = {}
    for noise, errors_by_estimator in errors.items():
        variance_factors[noise] = {
            name: errors_by_estimator[name].variance_factor for name in estimators_of_variances
        }
        state_errors[noise] = {
            name: errors_by_estimator[name].state_error for name in estimators_of_states
        }
    return [
        Sentence("factor by which estimated variances of the noise are wrong.", f"{records_name}:"),
        _table_by_noise(variance_factors),
        Sentence(
            "squared error of the states over that of the measured ones, median. DEM uses two later samples.",
            f"{records_name}:",
        ),
        _table_by_noise(state_errors),
    ]


def _table_by_noise(errors: Mapping[str, Mapping[str, float]]) -> Table:
    """Returns a table with a row for each estimator and a column for each noise, the best in the first noise on top.

    Args:
        errors: one error by name of the noise and of the estimator; the lower, the better.

    Returns:
        The table, with errors of three significant digits.
    """
    first_noise = next(iter(errors))
    errors_in_first_noise = errors[first_noise]
    best_first = sorted(errors_in_first_noise, key=lambda name: errors_in_first_noise[name])
    return table_by_estimator(errors, best_first)


def online_table(factors: Mapping[str, float]) -> list[Block]:
    """Returns the table of the recursive estimators after a step of the variances, the best first.

    Args:
        factors: factor by which the variances are wrong, by estimator.

    Returns:
        A sentence and the table.
    """
    rows = []
    for name in sorted(factors, key=lambda name: factors[name]):
        rows.append([name, rounded(factors[name], 3)])
    return [
        Sentence(
            "factor by which the variances are wrong some time after they rose by a factor of "
            f"{rounded(VARIANCE_STEP, 2)}, {STEP_NOISE}.",
            "Online:",
        ),
        Table(["estimator", "factor"], rows),
    ]
