"""Sections V.E, V.G and V.H: what DEM predicts, what generalized coordinates do for it, and other methods beside it."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.dem import Learned, learn
from mavdem.evaluate import mspe, paired, relative_mspe
from mavdem.experiments.comparison import Outcome
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.runner import (
    DATA,
    MEAN,
    PAPER,
    PEERS,
    REAL,
    STARTS,
    WITH,
    WITHOUT,
    ZERO,
    Check,
    ExperimentResult,
    Runner,
    errors_of,
    median_draw,
    percent,
    plain,
)
from mavdem.experiments.scores import KNOWN
from mavdem.experiments.window import Window
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.figures.style import Picture
from mavdem.report.numbers import listed, rounded

MIN_EXPLAINED = 0.99  # least share of each output's variance that one-step predictions must explain
MAX_ITERATIONS = 10  # iterations within which the parameters must converge
# distance from its end, of the largest of any, within which a parameter has converged
CONVERGED_SHARE = 0.05
# allowed ratio of the 90 % to the 10 % quantile of the forecasts' errors over priors
MAX_PRIOR_RATIO = 2.0


def prediction(runner: Runner) -> ExperimentResult:
    """Learns from the sample experiment and forecasts its test data."""
    window = runner.sample
    learned = learn(window.train, PAPER)
    draws = runner.draws[WITH, runner.shown]
    ahead = {
        f"from {start}": learned.forecast(window.test.inputs, from_zero=start == ZERO)
        for start in STARTS
    }
    return ExperimentResult(
        checks=prediction_checks(window, learned, errors_of(draws, DATA)),
        numbers={
            "free_energy": learned.free_energy.total.tolist(),
            "theta": learned.learning.theta.tolist(),
        },
        pictures=(
            Picture(
                "Outputs, measured and predicted",
                "By DEM with the paper’s settings: one step ahead on training data, and 150 steps ahead on test data "
                "(grey background), from the data and from state 0, as in the authors’ code.",
                partial(figures.forecasts, window, {"": ahead}, learned.one_step()),
            ),
        ),
    )


def prediction_checks(
    window: Window, learned: Learned, errors: list[float] | Array
) -> tuple[Check, ...]:
    """Returns the claims of the figure; ``errors`` are the MSPE of the forecasts from several random priors."""
    train = window.train
    test = window.test
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
    away = abs(theta - theta[-1]).max(axis=1)
    far = np.flatnonzero(away > CONVERGED_SHARE * away.max())
    return int(far[-1]) + 1 if len(far) else 0


MSPE_WITH_COORDINATES = (0.0521, 0.0133, 0.0583, 0.0458, 0.1172)
MSPE_WITHOUT_COORDINATES = (0.1197, 0.0640, 0.1647, 0.0518, 0.0951)
"""Table II (SSE_GC), p = 2 and p = 1: MSPE of experiments 1 to 5, summed over outputs; 0.2867 and 0.4953 in total."""
# share of the experiments on which p = 2 must have the lower error, as on four of the paper's five
MIN_SHARE = 0.8


def coordinates(runner: Runner) -> ExperimentResult:
    """Tries DEM with p = 2 and p = 1 on the five experiments, from many random priors, and on the real flight."""
    errors = {
        f"paper’s settings, from {start}": (
            _errors(runner, WITH, start),
            _errors(runner, WITHOUT, start),
        )
        for start in STARTS
    }
    middle = {
        f"p = {p}": median_draw(runner.draws[name, runner.shown], DATA)
        for p, name in ((2, WITH), (1, WITHOUT))
    }
    ahead = {
        f"from {start}": {
            p: trial.forecasts[STARTS[start]] for p, trial in middle.items() if trial.forecasts
        }
        for start in STARTS
    }
    real = []
    if runner.recorded:
        with_, without = (errors_of(runner.trials[REAL, name], DATA) for name in (WITH, WITHOUT))
        real = [paired(with_, without)]
    return ExperimentResult(
        checks=(
            *(coordinates_check(pair, data) for data, pair in errors.items()),
            *(
                Check(
                    f"{REAL}, from {DATA}: the median over windows of the error with p = 2 over that with p = 1 is "
                    "less than 1",
                    each.ratio < 1,
                    f"on {REAL} the error ratio of p = 2 to p = 1 is {rounded(each.ratio, 3)}",
                )
                for each in real
            ),
        ),
        numbers={
            "paper": {"with": MSPE_WITH_COORDINATES, "without": MSPE_WITHOUT_COORDINATES},
            **{
                name: {"with": with_.tolist(), "without": without.tolist()}
                for name, (with_, without) in errors.items()
            },
            "recorded_flights": [each._asdict() for each in real],
        },
        tables=_coordinates_table(runner, errors),
        pictures=(
            Picture(
                "Forecasts of the test data",
                "With generalized coordinates (p = 2) and without, each from the random prior with the median error.",
                partial(figures.forecasts, runner.sample, ahead),
            ),
        ),
    )


def _errors(runner: Runner, name: str, start: str) -> Array:
    """The errors of a method's trials, (experiments, priors)."""
    return np.array([errors_of(runner.draws[name, i], start) for i in runner.experiments])


def coordinates_check(errors: ArrayPair, data: str) -> Check:
    """Returns whether p = 2 has the lower error in total, and on most experiments; ``data`` names the settings."""
    with_, without = (np.median(priors, axis=1) for priors in errors)
    less = int((with_ < without).sum())
    return Check(
        f"{data}: the total MSPE over experiments is lower with p = 2 than with p = 1, and also on at least "
        f"{percent(MIN_SHARE)} of them (median over random priors)",
        bool(with_.sum() < without.sum() and less >= MIN_SHARE * len(with_)),
        f"{data}: the total MSPE is {rounded(with_.sum(), 3)} with p = 2 and {rounded(without.sum(), 3)} with p = 1, "
        f"lower with p = 2 on {less} of {len(with_)}",
    )


def _coordinates_table(runner: Runner, errors: dict[str, ArrayPair]) -> tuple[Block, ...]:
    numbers = list(runner.experiments)
    theirs = np.array([MSPE_WITH_COORDINATES, MSPE_WITHOUT_COORDINATES])[
        :, [number - 1 for number in numbers], None
    ]
    pairs = {"the paper, its flights": (theirs[0], theirs[1]), **errors}
    rows = {f"{name}, p = {p}": pair[2 - p] for name, pair in pairs.items() for p in (1, 2)}
    title = Sentence(
        "over random priors the median and, in brackets, the 10 % and 90 % quantiles.",
        "Influence of generalized coordinates on MSPE:",
    )
    return title, _by_experiment("DEM", rows, numbers)


def _by_experiment(heading: str, errors: Mapping[str, Array], numbers: list[int]) -> Table:
    """A row of each (experiments, priors): medians with, of several priors, their range; and the sum of the medians."""
    rows = []
    for name, by_prior in errors.items():
        medians = np.median(by_prior, axis=1)
        cells = [
            f"{rounded(middle, 3)}{_range(row)}"
            for middle, row in zip(medians, by_prior, strict=True)
        ]
        rows.append([name, *cells, rounded(medians.sum(), 3)])
    return Table([heading, *(f"expt {number}" for number in numbers), "total"], rows)


def _range(priors: Array) -> str:
    return (
        f" ({'–'.join(rounded(end, 3) for end in np.percentile(priors, [10, 90]))})"
        if len(priors) > 1
        else ""
    )


# Methods in the order of tables and legends
SHOWN = (WITH, *PEERS, MEAN)

Errors = dict[str, Array]  # The error (flights,) of each method


def benchmark(runner: Runner) -> ExperimentResult:
    """Tries each method on the five experiments, and on the windows of the real flight."""
    numbers = list(runner.experiments)
    experiments = {
        start: {
            name: errors_of((_trial(runner, name, i, start) for i in numbers), start)
            for name in SHOWN
        }
        for start in STARTS
    }
    sample = {name: _trial(runner, name, runner.shown, DATA).forecasts for name in SHOWN}
    ahead = {name: forecasts[KNOWN] for name, forecasts in sample.items() if forecasts}
    outputs = runner.sample.test.outputs
    squares = {name: ((forecast - outputs) ** 2).sum(axis=1) for name, forecast in ahead.items()}
    real = {name: errors_of(runner.trials[REAL, name], DATA) for name in SHOWN if runner.recorded}
    medians = {name: np.median(errors, keepdims=True) for name, errors in real.items()}
    return ExperimentResult(
        checks=(
            *(least(experiments[start], f"from {start}") for start in STARTS),
            _most_steps(squares, runner.sample.flight),
            *([least(medians, f"on {REAL}")] if medians else []),
        ),
        numbers={
            **{f"mspe, from {start}": plain(errors) for start, errors in experiments.items()},
            "squared_errors_by_step": plain(squares),
            f"mspe, windows of {REAL}": plain(real),
        },
        tables=tuple(
            block
            for start, errors in experiments.items()
            for block in (
                Sentence("", f"MSPE of the five experiments, from {start}."),
                _by_experiment(
                    "method", {name: values[:, None] for name, values in errors.items()}, numbers
                ),
            )
        ),
        pictures=(
            Picture(
                "Forecasts of the test data",
                f"Of {runner.sample.flight}, from the data.",
                partial(figures.forecasts, runner.sample, {"": ahead}),
            ),
            Picture(
                "Squared error by step",
                f"n steps ahead on {runner.sample.flight}, summed over outputs.",
                partial(figures.lines, {"": squares}, "steps ahead, n", first=1, scale="log"),
            ),
        ),
        remarks=()
        if runner.recorded
        else ("The recorded flights are not on this machine and are left out.",),
    )


def _trial(runner: Runner, name: str, number: int, start: str) -> Outcome:
    return (
        median_draw(runner.draws[WITH, number], start)
        if name == WITH
        else runner.trials[runner.experiments[number].flight, name][0]
    )


def least(errors: Errors, where: str) -> Check:
    """Returns whether DEM has a lower error than each of its peers on all flights, ``where`` for the sentences."""
    best = np.min([errors[name] for name in PEERS], axis=0)
    less = int((errors[WITH] < best).sum())
    ratio = float(np.exp(np.mean(np.log(errors[WITH] / best))))
    return Check(
        f"{WITH}, {where}: its error is lower than that of {listed(PEERS)} on every flight",
        less == len(best),
        f"{WITH}, {where}, has a lower error than the paper’s peers on {less} of {len(best)}; its error is "
        f"{rounded(ratio, 3)} times that of the best of them",
    )


def _most_steps(squares: dict[str, Array], flight: str) -> Check:
    errors = np.array(
        [squares.get(name, np.full_like(squares[MEAN], np.inf)) for name in (WITH, *PEERS)]
    )
    share = float((errors.argmin(axis=0) == 0).mean())
    return Check(
        f"{WITH}, {flight}: of the paper’s four methods it has the least squared error at over half of the steps",
        share > 0.5,
        f"{WITH} has the least squared error of the four at {percent(share)} of the steps of {flight}",
    )
