"""Cross-sections of F̄ᵒ along A and along B at each iteration, from η = (−8, 8).

A cross-section passes through the estimate of its iteration, with the states x̃ and λ as that iteration left them.
"""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.dem.engine.free_energy import Belief
from mavdem.dem.engine.generative import GenerativeModel, SufficientStatistics
from mavdem.paper.item import Cell, PageTable
from mavdem.paper.landscape.manifold import peak, value_at
from mavdem.paper.landscape.scalar_system import PAPER, PAPER_WORLD, A, B, ScalarSettings, ScalarWorld, truth_within

ITERATIONS = 12
DRAWN = (0, 1, 2, 3, 4, 5, 12)
THOUSAND = 1e3

LAMBDA_KNOWN = replace(ScalarSettings(), lambda_mean=(6.0, 3.0), lambda_precision=PAPER.lambda_precision)

CASES = (
    ("λʷ learnt", ScalarWorld(), ScalarSettings()),
    ("λ known", ScalarWorld(), LAMBDA_KNOWN),
    ("The paper's settings", PAPER_WORLD, PAPER),
)
"""The peak rises and narrows; rises without narrowing, since only x̃ changes; is reached after one iteration."""


def table() -> PageTable:
    """Where the ascent of each case ends."""
    rows = []
    for name, world, settings in CASES:
        end = plain_rounds(settings.model(), settings.samples(world, seed=0), ITERATIONS)[-1]
        (a, b), (sd_a, sd_b) = end.theta[:2], np.sqrt(np.diag(end.theta_covariance)[:2])
        within = "yes" if truth_within(end.theta, end.theta_covariance) else "no"
        rows.append((Cell(name), *map(Cell, (f"{a:.3f} ± {sd_a:.3f}", f"{b:.3f} ± {sd_b:.3f}", within))))
    columns = ("settings", "A ± sd", "B ± sd", "truth in the 95 % region")
    return PageTable("Where the ascents from η = (−8, 8) end", columns, tuple(rows))


def draw() -> Figure:
    """The cross-sections of each case."""
    figure, rows = plt.subplots(len(CASES), 2, figsize=(12, 11), layout="constrained")
    for (name, world, settings), row in zip(CASES, rows, strict=True):
        model, samples = settings.model(), settings.samples(world, seed=0)
        beliefs = plain_rounds(model, samples, ITERATIONS)
        end, sd = beliefs[-1].theta, np.sqrt(np.diag(beliefs[-1].theta_covariance))
        for index, axes in enumerate(row):
            draw_cross_sections(axes, model, samples, beliefs, index)
            axes.set_title(f"{name}, along {'AB'[index]}: end at {end[index]:.3f} ± {sd[index]:.3f}")
            if settings is PAPER:
                axes.text(0.5, 0.05, f"iterations 1 to {ITERATIONS} coincide", transform=axes.transAxes, ha="center")
    figure.legend(*rows[0, 0].get_legend_handles_labels(), title="iteration", loc="outside right center")
    figure.suptitle("Cross-sections of $\\bar F^o$ by iteration; circles: estimates, dashed: truth")
    return figure


def draw_cross_sections(
    axes: Axes, model: GenerativeModel, samples: SufficientStatistics, beliefs: list[Belief], index: int
) -> None:
    """Curves of F̄ᵒ along A (``index`` 0) or B (1), each with a circle at the estimate of its iteration."""
    grid = np.linspace(-10, 1, 221) if index == 0 else np.linspace(-1, 10, 221)
    colours = plt.get_cmap("viridis")(np.linspace(0.95, 0, len(DRAWN)))
    tops = []
    for i, colour in zip(DRAWN, colours, strict=True):
        a, b = beliefs[i].theta[:2]
        along = [(value, b) if index == 0 else (a, value) for value in grid]
        curve = [value_at(model, samples, beliefs[i], *at) / THOUSAND for at in along]
        tops.append(peak(model, samples, beliefs[i]) / THOUSAND)
        axes.plot(grid, curve, color=colour, label=f"{i}")
        axes.plot(beliefs[i].theta[index], tops[-1], "o", color=colour, markeredgecolor="black", zorder=3)
    axes.axvline((A, B)[index], color="crimson", linestyle="--", linewidth=1)
    room = max(tops) - min(tops)
    axes.set(xlabel="AB"[index], ylabel=r"$\bar F^o$, thousand nats", ylim=(min(tops) - room, max(tops) + 0.15 * room))
