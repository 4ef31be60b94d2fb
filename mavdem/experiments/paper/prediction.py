"""Section V.E of the paper: DEM predicts the outputs one step ahead, and 150 steps ahead on unseen data."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from mavdem.arrays import Array
from mavdem.dem import Learned, learn
from mavdem.evaluate import mspe, relative_mspe
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.checks import Check, ExperimentResult, percent
from mavdem.experiments.paper.error_tables import RANGE_PERCENTILES
from mavdem.experiments.paper.runner import (
    DATA_START,
    DEM_P2,
    FORECAST_KIND_BY_START,
    PAPER_SETTINGS,
    ZERO_START,
    Runner,
    forecast_errors,
)
from mavdem.experiments.window import Window
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import listed, rounded

MIN_EXPLAINED_VARIANCE = 0.99
"""Share of each output's training variance that one-step predictions must explain at least; a choice."""

MAX_ITERATIONS = 10
"""Iterations within which the parameters must converge: what the check takes for the paper's "few"."""

CONVERGED_FRACTION = 0.05
"""Parameters have converged when none is further from its end than this fraction of the largest such distance."""

MAX_PRIOR_RATIO = 2.0
"""Highest ratio of the 90 % to the 10 % quantile of the forecasts' errors over random priors; a choice."""


def run(runner: Runner) -> ExperimentResult:
    """Checks the paper's claims on DEM's predictions, by the experiment that its figures show.

    A model is learned with the paper's settings from the training part of the experiment. It predicts that part one
    step ahead, and the test part as a whole, from the filtered state and from state 0. How much the forecast depends on
    the prior is shown by fits from many random priors.

    Args:
        runner: holds the experiment and the fits from random priors.

    Returns:
        Checks of the claims and a figure; ``numbers`` has the free energy F̄ (nats) and the parameters θ in each
        iteration of the fit.
    """
    window = runner.figure_window
    learned = learn(window.train, PAPER_SETTINGS)
    forecasts = {}
    for start in FORECAST_KIND_BY_START:
        forecasts[f"from {start}"] = learned.forecast(
            window.test.inputs, from_zero=start == ZERO_START
        )
    picture = Picture(
        "Outputs, measured and predicted",
        "By DEM with the paper’s settings: one step ahead on training data, and 150 steps ahead on test data "
        "(grey background), from the data and from state 0, as in the authors’ code.",
        # The figure has one panel, which needs no title.
        partial(figures.draw_forecasts, window, {"": forecasts}, learned.one_step()),
    )
    fits_from_random_priors = runner.random_prior_outcomes[DEM_P2, runner.figure_experiment]
    errors_over_priors = forecast_errors(fits_from_random_priors, DATA_START)
    return ExperimentResult(
        checks=prediction_checks(window, learned, errors_over_priors),
        numbers={
            "free_energy": learned.free_energy.total.tolist(),
            "theta": learned.learning.theta.tolist(),
        },
        pictures=(picture,),
    )


def prediction_checks(
    window: Window, learned: Learned, prior_errors: Sequence[float] | Array
) -> tuple[Check, ...]:
    """Checks the claims on prediction, convergence and free energy.

    Args:
        window: window with training and test data.
        learned: the model that was learned from the training data.
        prior_errors: (priors,) MSPE of the forecasts of models that were learned from several random priors.

    Returns:
        Checks of one-step predictions, of the forecast, of convergence, and of the influence of the prior.
    """
    return (
        *_one_step_checks(window, learned),
        _forecast_check(window, learned),
        *_convergence_checks(learned),
        _prior_check(prior_errors),
    )


def _one_step_checks(window: Window, learned: Learned) -> tuple[Check, Check]:
    """Checks that one-step predictions explain the training outputs and are better than holding the last sample.

    Args:
        window: T training samples of m outputs.
        learned: the model of the training part.

    Returns:
        Two checks. In the first, the explained fraction of each output's variance must be above
        ``MIN_EXPLAINED_VARIANCE``; in the second, the ratio of squared errors (MSPE) must be below 1 for each output.
    """
    train = window.train
    # The first sample has no sample before it, by which it could be predicted.
    predicted_samples = train.outputs[1:]
    samples_before = train.outputs[:-1]
    one_step_errors = mspe(predicted_samples, learned.one_step()[1:]).per_output
    hold_errors = mspe(predicted_samples, samples_before).per_output
    explained_fractions = 1 - one_step_errors / train.outputs.var(axis=0)
    error_ratios = one_step_errors / hold_errors
    return (
        Check(
            rule=f"one-step predictions explain over {percent(MIN_EXPLAINED_VARIANCE)} of each output’s training "
            "variance",
            holds=bool((explained_fractions > MIN_EXPLAINED_VARIANCE).all()),
            finding=f"one-step predictions explain {listed(map(percent, explained_fractions))} of the variance of "
            f"{listed(train.output_names)}",
        ),
        Check(
            rule="one-step predictions of each output have a lower MSPE than holding its last sample",
            holds=bool((error_ratios < 1).all()),
            finding=f"the one-step MSPE is {listed(rounded(ratio, 3) for ratio in error_ratios)} times that of "
            "holding the last sample",
        ),
    )


def _forecast_check(window: Window, learned: Learned) -> Check:
    """Checks that the forecast of the whole test part is better than the mean of the training data.

    Args:
        window: window with training and test data.
        learned: model that was learned from the training data.

    Returns:
        The check, with the ratio of both errors.
    """
    error_ratio = relative_mspe(window.train, window.test, learned.forecast(window.test.inputs))
    return Check(
        rule="150 steps ahead, from the data, the error is less than that of the constant mean",
        holds=error_ratio < 1,
        finding=f"150 steps ahead the error is {rounded(error_ratio, 3)} times that of the constant mean",
    )


def _convergence_checks(learned: Learned) -> tuple[Check, Check]:
    """Checks two claims of the paper: DEM converges within few iterations, and no iteration lowers the free energy F̄.

    DEM maximises F̄, so that a decrease would show an error of the optimisation.

    Args:
        learned: the model, with its parameters (iterations + 1, parameters) at the start and after each iteration, and
            F̄ of the iterations, nats.

    Returns:
        The check of convergence within ``MAX_ITERATIONS``, and the check of F̄.
    """
    iteration = first_converged_iteration(learned.learning.theta)
    free_energy_steps = np.diff(learned.free_energy.total)
    never_decreases = bool((free_energy_steps >= 0).all())
    trend = "increases" if never_decreases else "does not always increase"
    return (
        Check(
            rule=f"after {MAX_ITERATIONS} iterations every parameter is within {percent(CONVERGED_FRACTION)} of the "
            "largest distance from its end",
            holds=iteration <= MAX_ITERATIONS,
            finding=f"the parameters have converged at iteration {iteration}",
        ),
        Check(
            rule="F̄ decreases in no iteration",
            holds=never_decreases,
            finding=f"F̄ {trend} over {len(free_energy_steps)} iterations",
        ),
    )


def _prior_check(prior_errors: Sequence[float] | Array) -> Check:
    """Checks that the forecast errors hardly depend on the random prior from which a model was learned.

    Args:
        prior_errors: (priors,) MSPE of the forecast of the test part.

    Returns:
        The check, with the range of the errors.
    """
    low_quantile, high_quantile = np.percentile(prior_errors, RANGE_PERCENTILES)
    return Check(
        rule="over random priors, the 10 % and 90 % quantiles of the forecasts’ errors differ by less than a "
        f"factor of {MAX_PRIOR_RATIO:g}",
        holds=bool(high_quantile < MAX_PRIOR_RATIO * low_quantile),
        finding=f"forecasts from {len(prior_errors)} random priors have an MSPE from {rounded(low_quantile, 3)} to "
        f"{rounded(high_quantile, 3)} (10 % and 90 % quantiles)",
    )


def first_converged_iteration(theta: Array) -> int:
    """Returns the first iteration from which on all parameters stay close to their final values.

    The distance of an iteration is the largest difference of any parameter from its final value. It is close if it is
    at most ``CONVERGED_FRACTION`` of the largest distance of all iterations.

    Args:
        theta: (iterations + 1, k) parameters at the start and after each iteration.

    Returns:
        The number of the iteration; 0 if the start is already close.
    """
    final_values = theta[-1]
    distances = abs(theta - final_values).max(axis=1)
    distant_iterations = np.flatnonzero(distances > CONVERGED_FRACTION * distances.max())
    if len(distant_iterations) == 0:
        return 0
    last_distant_iteration = int(distant_iterations[-1])
    return last_distant_iteration + 1
