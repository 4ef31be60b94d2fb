"""V.E: one-step and 150-step prediction with DEM, its parameters and F̄ by iteration."""

from __future__ import annotations

from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from paper.drawing import DEM, MEASURED, ONE_STEP, unseen
from paper.item import Cell, Found, Item, Picture, Table
from paper.laboratory import OURS, PAPER, WITH, Laboratory
from paper.published import PREDICTION
from paper.verdict import Check
from paper.words import listed, number, percent

import mavdem
from mavdem.dem import Learned, Settings
from mavdem.evaluate import mspe, relative_mspe
from mavdem.windows import Window

Array = NDArray[np.float64]

COINCIDES = 0.99
"""Share of each output's variance that a one-step prediction must explain for its curve to coincide with the data's."""

FEW = 10
"""Iterations within which parameters must have come to rest."""

AT_REST = 0.05
"""Of the farthest that any parameter has moved: closer to its end a parameter is at rest."""

ALIKE = 2.0
"""Between the 10th and the 90th of a hundred priors errors of forecasts may differ by this factor."""


def run(laboratory: Laboratory) -> Found:
    window = laboratory.sample
    learned, ours = mavdem.learn(window.train, PAPER), mavdem.learn(window.train, Settings())
    draws = laboratory.draws[WITH][laboratory.extent.sample]
    return Found(
        checks=checks(window, learned, [float(draw.mspe.sum()) for draw in draws]),
        numbers={WITH: _numbers(window, learned), OURS: _numbers(window, ours)},
        tables=(_table(window, {"the paper’s settings": learned, "default settings": ours}),),
        pictures=(
            Picture(
                "prediction-outputs",
                "Measured (red), predicted one step ahead on training data (blue), and 150 steps ahead on test data "
                "(green, grey background), by DEM with the paper’s settings. Solid: begun from the data; dotted: from "
                "state 0, as the authors’ code does.",
                partial(_outputs, window, learned),
            ),
            Picture(
                "prediction-learning",
                "All parameters, A, B and C, and the free energy action gained, F̄(i) − F̄(0), by iteration.",
                partial(_learning, learned),
            ),
        ),
        remarks=(
            "With random priors on C too, a state has no unit: priors lead to other parameters of the same forecasts, "
            "so it is forecasts that are compared and not parameters.",
        ),
    )


def checks(window: Window, learned: Learned, errors: list[float]) -> tuple[Check, ...]:
    """What makes the figure: the curves coincide, the forecast follows, parameters settle, F̄ rises, priors agree.

    Args:
        window: what was learnt from and forecast.
        learned: the model.
        errors: MSPE of the forecasts from several random priors.
    """
    train, test = window.train, window.test
    one_step = learned.one_step()[1:]
    explained = 1 - mspe(train.outputs[1:], one_step).per_output / train.outputs.var(axis=0)
    held = mspe(train.outputs[1:], train.outputs[:-1]).per_output
    better = mspe(train.outputs[1:], one_step).per_output / held
    ahead = relative_mspe(train, test, learned.forecast(test.inputs))
    rest = rests_at(learned.learning.theta)
    gains = np.diff(learned.free_energy.total)
    least, most = np.percentile(errors, [10, 90])
    return (
        Check(
            f"one step ahead over {percent(COINCIDES)} of each output’s training variance are explained",
            bool((explained > COINCIDES).all()),
            f"one step ahead {listed(map(percent, explained))} of the variance of {listed(train.output_names)} are "
            f"explained",
        ),
        Check(
            "one step ahead each output is predicted with less error than by holding its last sample",
            bool((better < 1).all()),
            f"one step ahead it errs {listed(map(number, better))} times as much as holding the last sample",
        ),
        Check(
            "150 steps ahead, from the data, it errs less than the constant mean",
            ahead < 1,
            f"150 steps ahead it has {number(ahead)} times the error of the constant mean",
        ),
        Check(
            f"every parameter stays within {percent(AT_REST)} of the farthest way from its end after {FEW} iterations",
            rest <= FEW,
            f"parameters are at rest from iteration {rest} on",
        ),
        Check(
            "F̄ falls in no iteration",
            bool((gains >= 0).all()),
            f"F̄ {'rises' if (gains >= 0).all() else 'does not always rise'} over {len(gains)} iterations",
        ),
        Check(
            f"the 10th and the 90th of a hundred random priors lead to forecasts whose errors differ by less than a "
            f"factor of {ALIKE:g}",
            bool(most < ALIKE * least),
            f"forecasts from {len(errors)} random priors err between {number(least)} and {number(most)} (10th and 90th "
            f"of a hundred)",
        ),
    )


def rests_at(theta: Array) -> int:
    """The first iteration from which no parameter (columns) is far from where it ends, by iteration (rows)."""
    away = np.abs(theta - theta[-1]).max(axis=1)
    far = np.flatnonzero(away > AT_REST * away.max())
    return int(far[-1]) + 1 if len(far) else 0


def _numbers(window: Window, learned: Learned) -> dict[str, object]:
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
        "settled": learned.settled,
        "rests_at": rests_at(learned.learning.theta),
    }


def _table(window: Window, models: dict[str, Learned]) -> Table:
    train, test = window.train, window.test
    rows = []
    for name, learned in models.items():
        forecasts = [learned.forecast(test.inputs, from_zero=start) for start in (False, True)]
        errors = [mspe(test.outputs, forecast).total for forecast in forecasts]
        relative = [relative_mspe(train, test, forecast) for forecast in forecasts]
        rest = str(rests_at(learned.learning.theta))
        rows.append((Cell(name), *(Cell(number(error)) for error in (*errors, *relative)), Cell(rest)))
    return Table(
        f"150 steps ahead on {window.flight}, from the data and from state 0",
        ("DEM", "MSPE", "MSPE from 0", "over constant mean", "over it, from 0", "at rest from iteration"),
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
    """Keeps a forecast that begins far off from flattening all else."""
    low, high = min(map(np.min, series)), max(map(np.max, series))
    axes.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low))


def _learning(learned: Learned) -> Figure:
    figure, (parameters, climb) = plt.subplots(1, 2, figsize=(11, 3))
    theta = learned.learning.theta
    n, r, m = len(learned.model.A), learned.model.B.shape[1], len(learned.model.C)
    scale = np.abs(theta).max(axis=0)
    places = np.split(np.arange(theta.shape[1]), [n * n, n * n + n * r])
    for name, own, colour in zip("ABC", places, (ONE_STEP, MEASURED, DEM), strict=True):
        # Motors come in µs: entries of B are a hundredth of the others.
        lines = parameters.plot(theta[:, own] / scale[own], color=colour, linewidth=1)
        lines[0].set_label(f"{name}, {m}×{n}" if name == "C" else f"{name}, {n}×{n if name == 'A' else r}")
    parameters.set(xlabel="iteration", ylabel="parameter / its largest size", title="Parameters")
    parameters.legend()
    gained = learned.free_energy.total - learned.free_energy.total[0]
    climb.plot(gained, ".-", color=DEM)
    climb.set(xlabel="iteration", ylabel="F̄(i) − F̄(0), nats", title="Free energy action")
    climb.set_yscale("symlog", linthresh=max(1.0, float(gained[1:].min(initial=1.0)) / 10))
    return figure


ITEM = Item("prediction", "Output prediction with DEM", PREDICTION, run)
