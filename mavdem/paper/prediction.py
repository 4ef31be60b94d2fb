"""Section V.E: one-step and 150-step prediction with DEM, its parameters and F̄ by iteration."""

from __future__ import annotations

from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.dem import Learned, Settings, learn
from mavdem.evaluate import mspe, relative_mspe
from mavdem.evaluate.windows import Window
from mavdem.paper.checks import Check
from mavdem.paper.claims import PREDICTION
from mavdem.paper.drawing import DEM, MEASURED, ONE_STEP, unseen
from mavdem.paper.item import Cell, Item, ItemResult, PageTable, Picture
from mavdem.paper.runner import OURS, PAPER, WITH, Runner
from mavdem.paper.words import number, percent
from mavdem.report.numbers import listed

Array = NDArray[np.float64]

MIN_EXPLAINED = 0.99  # least share of each output's variance that one-step predictions must explain
MAX_ITERATIONS = 10  # iterations within which the parameters must converge
CONVERGED_SHARE = 0.05  # distance from its end, of the largest of any, within which a parameter has converged
MAX_PRIOR_RATIO = 2.0  # allowed ratio of the 90 % to the 10 % quantile of the forecasts' errors over priors


def run(runner: Runner) -> ItemResult:
    """Learns from the sample experiment and forecasts its test data."""
    window = runner.sample
    learned = learn(window.train, PAPER)
    papers, defaults = _numbers(window, learned), _numbers(window, learn(window.train, Settings()))
    draws = runner.draws[WITH][runner.extent.sample]
    return ItemResult(
        checks=checks(window, learned, [float(draw.mspe().sum()) for draw in draws]),
        numbers={WITH: papers, OURS: defaults},
        tables=(_table(window.flight, {"the paper’s settings": papers, "default settings": defaults}),),
        pictures=(
            Picture(
                "prediction-outputs",
                "Measured (red), predicted one step ahead on training data (blue), and 150 steps ahead on test data "
                "(green, grey background), by DEM with the paper’s settings. Solid: from the data; dotted: from state "
                "0, as in the authors’ code.",
                partial(_outputs, window, learned),
            ),
            Picture(
                "prediction-learning",
                "All parameters, A, B and C, and the free energy action gained, F̄(i) − F̄(0), by iteration.",
                partial(_learning, learned),
            ),
        ),
        remarks=(
            "Priors on C are random too, so a state has no unit: different parameters give the same forecasts. "
            "Therefore forecasts are compared and not parameters.",
        ),
    )


def checks(window: Window, learned: Learned, errors: list[float]) -> tuple[Check, ...]:
    """The claims of the figure; ``errors`` are the MSPE of the forecasts from several random priors."""
    train, test = window.train, window.test
    one_step = mspe(train.outputs[1:], learned.one_step()[1:]).per_output
    explained = 1 - one_step / train.outputs.var(axis=0)
    held = mspe(train.outputs[1:], train.outputs[:-1]).per_output
    better = one_step / held
    ahead = relative_mspe(train, test, learned.forecast(test.inputs))
    rest = converged_at(learned.learning.theta)
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
            f"the one-step MSPE is {listed(map(number, better))} times that of holding the last sample",
        ),
        Check(
            "150 steps ahead, from the data, the error is less than that of the constant mean",
            ahead < 1,
            f"150 steps ahead the error is {number(ahead)} times that of the constant mean",
        ),
        Check(
            f"after {MAX_ITERATIONS} iterations every parameter is within {percent(CONVERGED_SHARE)} of the largest "
            "distance from its end",
            rest <= MAX_ITERATIONS,
            f"the parameters have converged at iteration {rest}",
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
            f"forecasts from {len(errors)} random priors have an MSPE from {number(least)} to {number(most)} (10 % and "
            f"90 % quantiles)",
        ),
    )


def converged_at(theta: Array) -> int:
    """The first iteration from which no parameter (columns) is far from where it ends, by iteration (rows)."""
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
        "over_constant_mean": relative_mspe(train, test, ahead),
        "over_constant_mean_from_zero": relative_mspe(train, test, from_zero),
        "free_energy": learned.free_energy.total.tolist(),
        "theta": learned.learning.theta.tolist(),
        "model": {name: value.tolist() for name, value in learned.model._asdict().items()},
        "settled": learned.converged,
        "rests_at": converged_at(learned.learning.theta),
    }


def _table(flight: str, models: dict[str, dict[str, Any]]) -> PageTable:
    shown = ("mspe", "mspe_from_zero", "over_constant_mean", "over_constant_mean_from_zero")
    rows = [
        (Cell(name), *(Cell(number(own[error])) for error in shown), Cell(str(own["rests_at"])))
        for name, own in models.items()
    ]
    return PageTable(
        f"150 steps ahead on {flight}, from the data and from state 0",
        ("DEM", "MSPE", "MSPE from 0", "over constant mean", "over it, from 0", "converged at iteration"),
        tuple(rows),
    )


def _outputs(window: Window, learned: Learned) -> Figure:
    train, test = window.train, window.test
    ahead, from_zero = (learned.forecast(test.inputs, from_zero=start) for start in (False, True))
    one_step, count = learned.one_step(), train.outputs.shape[1]
    figure, panels = plt.subplots(count, 1, figsize=(11, 2.2 * count), sharex=True, squeeze=False)
    axes, start = panels[:, 0], train.time[0]
    for place, row in enumerate(axes):
        name, unit = train.output_names[place], train.output_units[place]
        unseen(row, test.time[0] - start, test.time[-1] - start)
        row.plot(train.time - start, train.outputs[:, place], color=MEASURED, linewidth=2.2, label="measured")
        row.plot(test.time - start, test.outputs[:, place], color=MEASURED, linewidth=2.2)
        row.plot(train.time[1:] - start, one_step[1:, place], color=ONE_STEP, linewidth=0.9, label="one step ahead")
        row.plot(test.time - start, ahead[:, place], color=DEM, label="150 steps ahead")
        row.plot(test.time - start, from_zero[:, place], color=DEM, linestyle=":", label="150 steps ahead, from 0")
        _frame(row, [window.train.outputs[:, place], window.test.outputs[:, place], ahead[:, place]])
        row.set_ylabel(f"{name}, {unit}")
    axes[-1].set_xlabel("time, s")
    axes[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1))
    return figure


def _frame(axes: Axes, series: list[Array]) -> None:
    """Limits the axis, so that a forecast that starts far off does not flatten the rest."""
    low, high = min(map(np.min, series)), max(map(np.max, series))
    axes.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low))


def _learning(learned: Learned) -> Figure:
    figure, (parameters, energy) = plt.subplots(1, 2, figsize=(11, 3))
    theta = learned.learning.theta
    n, r, m = len(learned.model.A), learned.model.B.shape[1], len(learned.model.C)
    scale = np.abs(theta).max(axis=0)
    places = np.split(np.arange(theta.shape[1]), [n * n, n * n + n * r])
    for name, own, colour in zip("ABC", places, (ONE_STEP, MEASURED, DEM), strict=True):
        # With motors in µs, entries of B are a hundredth of the others.
        lines = parameters.plot(theta[:, own] / scale[own], color=colour, linewidth=1)
        lines[0].set_label(f"{name}, {m}×{n}" if name == "C" else f"{name}, {n}×{n if name == 'A' else r}")
    parameters.set(xlabel="iteration", ylabel="parameter / its largest absolute value", title="Parameters")
    parameters.legend()
    gained = learned.free_energy.total - learned.free_energy.total[0]
    energy.plot(gained, ".-", color=DEM)
    energy.set(xlabel="iteration", ylabel="F̄(i) − F̄(0), nats", title="Free energy action")
    energy.set_yscale("symlog", linthresh=max(1.0, float(gained[1:].min(initial=1.0)) / 10))
    return figure


ITEM = Item(PREDICTION, run)
