"""Section V.E: one-step and 150-step prediction with DEM, its parameters and F̄ by iteration."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from mavdem.dem import Learned, Settings, learn
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate import mspe, relative_mspe
from mavdem.evaluate.windows import Window
from mavdem.paper import figures
from mavdem.paper.runner import OURS, PAPER, STARTS, WITH, Check, Result, Runner, percent
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import listed, rounded
from mavdem.report.page import Picture

MIN_EXPLAINED = 0.99  # least share of each output's variance that one-step predictions must explain
MAX_ITERATIONS = 10  # iterations within which the parameters must converge
CONVERGED_SHARE = 0.05  # distance from its end, of the largest of any, within which a parameter has converged
MAX_PRIOR_RATIO = 2.0  # allowed ratio of the 90 % to the 10 % quantile of the forecasts' errors over priors


def run(runner: Runner) -> Result:
    """Learns from the sample experiment and forecasts its test data."""
    window = runner.sample
    learned = learn(window.train, PAPER)
    papers, defaults = _numbers(window, learned), _numbers(window, learn(window.train, Settings()))
    draws = runner.draws[WITH][runner.extent.sample]
    ahead = {f"from {start}": learned.forecast(window.test.inputs, from_zero=start == STARTS[1]) for start in STARTS}
    scaled = learned.learning.theta / np.abs(learned.learning.theta).max(axis=0)
    theta = {f"θ{number}": column for number, column in enumerate(scaled.T, 1)}
    gained = learned.free_energy.total - learned.free_energy.total[0]
    return Result(
        checks=checks(window, learned, [draw.errors[STARTS[0]] for draw in draws]),
        numbers={WITH: papers, OURS: defaults},
        tables=_table(window.flight, {"the paper’s settings": papers, "default settings": defaults}),
        pictures=(
            Picture(
                "Outputs, measured and predicted",
                "By DEM with the paper’s settings: one step ahead on training data, and 150 steps ahead on test data "
                "(grey background), from the data and from state 0, as in the authors’ code.",
                partial(figures.forecasts, window, {"": ahead}, learned.one_step()),
                large=True,
            ),
            Picture(
                "Learning",
                "All parameters, A, B and C, over their largest values, and the free energy action gained, "
                "F̄(i) − F̄(0), by iteration.",
                partial(figures.lines, {"parameters": theta, "F̄(i) − F̄(0), nats": {"": gained}}, "iteration"),
            ),
        ),
        remarks=(
            "Priors on C are random too, so a state has no unit: different parameters give the same forecasts. "
            "Therefore forecasts are compared and not parameters.",
        ),
    )


def checks(window: Window, learned: Learned, errors: list[float]) -> tuple[Check, ...]:
    """Returns the claims of the figure; ``errors`` are the MSPE of the forecasts from several random priors."""
    train, test = window.train, window.test
    one_step = mspe(train.outputs[1:], learned.one_step()[1:]).per_output
    explained = 1 - one_step / train.outputs.var(axis=0)
    better = one_step / mspe(train.outputs[1:], train.outputs[:-1]).per_output
    ahead = relative_mspe(train, test, learned.forecast(test.inputs))
    iteration = converged_at(learned.learning.theta)
    gains = np.diff(learned.free_energy.total)
    least, most = np.percentile(errors, [10, 90])
    return (
        Check(
            f"one-step predictions explain over {percent(MIN_EXPLAINED)} of each output’s training variance",
            bool((explained > MIN_EXPLAINED).all()),
            f"one-step predictions explain {listed(map(percent, explained))} of the variance of "
            f"{listed(train.output_names)}",
        ),
        Check(
            "one-step predictions of each output have a lower MSPE than holding its last sample",
            bool((better < 1).all()),
            f"the one-step MSPE is {listed(rounded(ratio, 3) for ratio in better)} times that of holding the last "
            "sample",
        ),
        Check(
            "150 steps ahead, from the data, the error is less than that of the constant mean",
            ahead < 1,
            f"150 steps ahead the error is {rounded(ahead, 3)} times that of the constant mean",
        ),
        Check(
            f"after {MAX_ITERATIONS} iterations every parameter is within {percent(CONVERGED_SHARE)} of the largest "
            "distance from its end",
            iteration <= MAX_ITERATIONS,
            f"the parameters have converged at iteration {iteration}",
        ),
        Check(
            "F̄ decreases in no iteration",
            bool((gains >= 0).all()),
            f"F̄ {'increases' if (gains >= 0).all() else 'does not always increase'} over {len(gains)} iterations",
        ),
        Check(
            f"over random priors, the 10 % and 90 % quantiles of the forecasts’ errors differ by less than a factor of "
            f"{MAX_PRIOR_RATIO:g}",
            bool(most < MAX_PRIOR_RATIO * least),
            f"forecasts from {len(errors)} random priors have an MSPE from {rounded(least, 3)} to {rounded(most, 3)} "
            "(10 % and 90 % quantiles)",
        ),
    )


def converged_at(theta: Array) -> int:
    """Returns the first iteration from which no parameter (columns) is far from where it ends, by iteration (rows)."""
    away = np.abs(theta - theta[-1]).max(axis=1)
    far = np.flatnonzero(away > CONVERGED_SHARE * away.max())
    return int(far[-1]) + 1 if len(far) else 0


def _numbers(window: Window, learned: Learned) -> dict[str, Any]:
    train, test = window.train, window.test
    ahead, from_zero = (learned.forecast(test.inputs, from_zero=start) for start in (False, True))
    return {
        "one_step_mspe": mspe(train.outputs[1:], learned.one_step()[1:]).per_output.tolist(),
        "hold_last_one_step_mspe": mspe(train.outputs[1:], train.outputs[:-1]).per_output.tolist(),
        "training_variance": train.outputs.var(axis=0).tolist(),
        "mspe": mspe(test.outputs, ahead).total,
        "mspe_from_zero": mspe(test.outputs, from_zero).total,
        "over_constant_mean": float(relative_mspe(train, test, ahead)),
        "over_constant_mean_from_zero": float(relative_mspe(train, test, from_zero)),
        "free_energy": learned.free_energy.total.tolist(),
        "theta": learned.learning.theta.tolist(),
        "model": {name: value.tolist() for name, value in learned.model._asdict().items()},
        "settled": learned.converged,
        "rests_at": converged_at(learned.learning.theta),
    }


def _table(flight: str, models: dict[str, dict[str, Any]]) -> tuple[Block, ...]:
    shown = ("mspe", "mspe_from_zero", "over_constant_mean", "over_constant_mean_from_zero", "rests_at")
    rows = [[name, *(rounded(numbers[error], 3) for error in shown)] for name, numbers in models.items()]
    header = ["DEM", "MSPE", "MSPE from 0", "over constant mean", "over it, from 0", "converged at iteration"]
    return Sentence(f"on {flight}, from the data and from state 0.", "150 steps ahead"), Table(header, rows)
