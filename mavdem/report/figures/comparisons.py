"""Comparisons: the errors of every method in every window, and the free energy by model order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mavdem.dem.order_choice import STRONG_EVIDENCE_NATS, OrderChoice
from mavdem.evaluate.comparison import Comparison
from mavdem.evaluate.scores import FROM_ZERO, KNOWN, ratio
from mavdem.report.figures.style import HAIRLINE, legend_above, picture, plain
from mavdem.report.palette import BASELINE, DISTINCT, HELD_OUT_OPACITY, MEASURED, PREDICTED, distinct

SHOWN_RATIOS = 1e-3, 1e3  # error ratios beyond these are drawn at the edge
HELD = "hold last"
# Of the errors by horizon: 1 by definition, without a horizon, or not comparable.
LEFT_OUT = {"constant mean", "zero", "DEM p=1", "DEM paper", "DEM paper p=1"}
PEERS = tuple(colour for colour in DISTINCT if colour not in (PREDICTED, BASELINE))


def error_ratios(comparison: Comparison, from_zero: bool = False) -> Figure:
    """Draws the error ratio of each method in each window over the whole test part, the lowest median first."""
    question = FROM_ZERO if from_zero else KNOWN
    columns = zip(comparison.methods, zip(*comparison.outcomes, strict=True), strict=True)
    ratios = {method: [float(ratio(one.of(question))[-1]) for one in column] for method, column in columns}
    medians = {method: float(np.median(values)) for method, values in ratios.items()}
    ranked = sorted(medians, key=medians.__getitem__)
    with picture(0.75 + 0.21 * len(ranked)) as figure:
        axes = figure.subplots()
        axes.axvline(1, **HAIRLINE)
        for place, method in enumerate(ranked):
            colour = PREDICTED if method == comparison.methods[0] else MEASURED
            values, median = np.clip(ratios[method], *SHOWN_RATIOS), np.clip(medians[method], *SHOWN_RATIOS)
            rows = np.full(len(values), place)
            axes.plot(values, rows, "o", color=colour, markersize=3.5, alpha=0.5, markeredgewidth=0)
            axes.plot(median, place, "|", color=colour, markersize=11, markeredgewidth=2.2)
        axes.set_xscale("log")
        axes.set_yticks(range(len(ranked)), ranked)
        axes.set_ylim(len(ranked) - 0.4, -0.6)
        axes.grid(axis="y", visible=False)
        axes.margins(x=0.03)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(xlabel="error ratio in each window, and the median (1: the constant mean)")
    return figure


def error_growth(comparison: Comparison) -> Figure:
    """Draws the error ratio by horizon, median and geometric mean: DEM, the best of each family, held samples."""
    steps = [at["steps"] for at in comparison.summaries(comparison.flights[0])[0]["horizons"]]
    first, drawn = comparison.methods[0], set[str]()
    with picture() as figure:
        axes = figure.subplots()
        axes.axhline(1, **HAIRLINE)
        for summary in comparison.over_flights():
            method, family = summary["method"], summary["method"].split("(")[0]
            if family in drawn or family in LEFT_OUT:
                continue
            drawn.add(family)
            colour = PEERS[len(drawn - {first, HELD}) % len(PEERS)]
            style: dict[str, Any] = {"color": colour, "linewidth": 1.3, "linestyle": "-", "zorder": 2}
            if method == first:
                style |= {"color": PREDICTED, "linewidth": 2.6, "zorder": 3}
            elif method == HELD:
                style |= {"color": BASELINE, "linestyle": "--"}
            shown = steps[: len(summary["horizons"]) - 1] + steps[-1:]
            axes.plot(shown, summary["horizons"], marker="o", markersize=3, label=method, **style)
        axes.set(xscale="log", yscale="log", xlabel="steps ahead", ylabel="error ratio (1: the constant mean)")
        axes.set_xticks(steps, map(str, steps))
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:g}")
        axes.margins(x=0.03)
        axes.set_ylim(top=min(axes.get_ylim()[1], 30.0))
        legend_above(axes, 4)
    return figure


def free_energy_by_order(choice: OrderChoice, names: Sequence[str]) -> Figure:
    """Draws F̄ by the number of states, below its highest value, of flights of these ``names`` and on average."""
    below = np.nanmax(choice.free_energy, axis=1, keepdims=True) - choice.free_energy
    mean, few = np.nanmax(choice.mean) - choice.mean, len(names) < 6  # more are not named
    with picture() as figure:
        axes = figure.subplots()
        axes.axhspan(0, STRONG_EVIDENCE_NATS, color=MEASURED, alpha=HELD_OUT_OPACITY, linewidth=0)
        for number, (name, values) in enumerate(zip(names, below, strict=True), 1):
            colour, opacity = (distinct(number), 1.0) if few else (MEASURED, 0.4)
            label = plain(name) if few else ""
            axes.plot(choice.orders, values, "o-", color=colour, markersize=4, alpha=opacity, label=label)
        if len(names) > 1:
            axes.plot(choice.orders, mean, "o-", color=PREDICTED, linewidth=2.5, label="mean")
        axes.axvline(choice.chosen, color=BASELINE, linewidth=1.4, zorder=1, label="chosen")
        axes.set_yscale("symlog", linthresh=10, linscale=0.6)
        axes.yaxis.set_major_formatter("{x:,g}")
        axes.set_ylim(1.15 * max(float(np.nanmax(below)), 20.0), 0)
        axes.set_xticks(choice.orders)
        axes.margins(x=0.04)
        axes.set(xlabel="states", ylabel="F̄ below its highest (nats)")
        legend_above(axes)
    return figure
