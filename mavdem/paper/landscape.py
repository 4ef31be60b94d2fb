"""Section IV: the manifold of F̄ᵒ over A and B as it is maximised, ascents from a circle of priors, cross-sections.

At each iteration the states x̃ and λ are held as that iteration left them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.dem.engine.free_energy import Belief
from mavdem.dem.engine.generative import GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import Array
from mavdem.paper.runner import Check, Result, Runner
from mavdem.paper.scalar_system import (
    PAPER,
    PAPER_WORLD,
    A,
    B,
    ScalarSettings,
    ScalarWorld,
    curvature,
    peak,
    truth_within,
    value_at,
)
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.figures.style import picture
from mavdem.report.numbers import rounded
from mavdem.report.page import Picture
from mavdem.report.palette import INK_ON_LIGHT, TRUTH, distinct

SAME_POINT = 0.1  # posterior standard deviations: ascents whose ends scatter less end at one point
DRAWN = (0, 1, 2, 3, 10)  # iterations
AXIS_A, AXIS_B = np.linspace(-10, 4, 71), np.linspace(-4, 10, 71)
LEVELS = [1e3, 1e4, 1e5, 1e6]  # contours, nats below the peak

PRIORS, RADIUS, ROUNDS = 50, 5.0, 40  # of the circle; iterations from each
CENTRE = np.array([-3.0, 3.0])  # not the truth, or the mean of the priors would be the solution

SECTION_ITERATIONS = 12
LAMBDA_KNOWN = replace(ScalarSettings(), lambda_mean=(6.0, 3.0), lambda_precision=PAPER.lambda_precision)
SECTIONS = {
    "λʷ learned": (ScalarSettings(), ScalarWorld()),
    "λ known": (LAMBDA_KNOWN, ScalarWorld()),
    "the paper’s settings": (PAPER, PAPER_WORLD),
}
"""The peak rises and narrows; rises without narrowing, since only x̃ changes; is reached after one iteration."""


def run(runner: Runner) -> Result:
    """Maximises F̄ᵒ of the scalar system and draws it; the runner is not needed."""
    settings = ScalarSettings()
    samples, model = settings.samples(ScalarWorld(), seed=0), settings.model()
    beliefs = [plain_rounds(model, samples, max(DRAWN))[iteration] for iteration in DRAWN]
    peaks = [peak(model, samples, belief) for belief in beliefs]
    sharpness = [curvature(belief) for belief in beliefs]
    paths = {"our": ascents(settings, samples), "the paper’s": ascents(PAPER, PAPER.samples(PAPER_WORLD, seed=0))}
    reached = {name: ends(path) for name, path in paths.items()}
    scatter = {name: float((points.std(axis=0) / sd).max()) for name, (points, sd) in reached.items()}
    return Result(
        checks=(
            Check(
                "the peak of F̄ᵒ rises and sharpens from iteration to iteration",
                bool((np.diff(peaks) > 0).all() and (np.diff(sharpness) > 0).all()),
                f"the peak rises from {rounded(peaks[0], 3)} to {rounded(peaks[-1], 3)} nats, and its curvature along "
                f"A from {rounded(sharpness[0], 3)} to {rounded(sharpness[-1], 3)}",
            ),
            *(
                Check(
                    f"with {name} settings, ascents from fifty priors on a circle end within {SAME_POINT:g} posterior "
                    "standard deviations of each other",
                    deviations < SAME_POINT,
                    f"with {name} settings, the ends from fifty priors scatter by {rounded(deviations, 3)} posterior "
                    "standard deviations",
                )
                for name, deviations in scatter.items()
            ),
        ),
        numbers={"peak": peaks, "curvature_along_A": sharpness, "ends_over_posterior_sd": scatter},
        tables=tables(beliefs, peaks),
        pictures=(
            Picture(
                "The manifold",
                "F̄ᵒ over A and B by iteration, from above; cross: the truth, dot: the estimate.",
                partial(manifold, model, samples, beliefs),
                large=True,
            ),
            Picture(
                "Fifty priors on a circle",
                "Their ascents, each iteration on its own manifold; and where they end, with 95 % regions.",
                partial(circle, model, samples, paths),
            ),
            Picture(
                "Cross-sections",
                "F̄ᵒ along A and along B, thousand nats, through the estimate of each iteration, from η = (−8, 8); "
                "dots: the estimates.",
                cross_sections,
                large=True,
            ),
        ),
        remarks=(
            "Our settings here differ from the paper’s in the precision of the prior and in the use of the highest "
            "derivative; docs/tried.md has which of them are needed.",
        ),
    )


def ascents(settings: ScalarSettings, samples: SufficientStatistics) -> list[list[Belief]]:
    """Returns the beliefs after each iteration, from each prior of the circle."""
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, PRIORS)
    priors = CENTRE + RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    models = [replace(settings, theta_mean=(a, b, 1.0)).model() for a, b in priors.tolist()]
    return [plain_rounds(model, samples, ROUNDS) for model in models]


def ends(paths: list[list[Belief]]) -> tuple[Array, Array]:
    """Returns (priors, 2) the A and B at which ascents end, and (2,) the posterior standard deviation of one."""
    return np.array([beliefs[-1].theta[:2] for beliefs in paths]), np.sqrt(np.diag(paths[0][-1].theta_covariance)[:2])


def tables(beliefs: list[Belief], peaks: list[float]) -> tuple[Block, ...]:
    """Returns estimates by iteration, and where the ascents of the cross-sections end."""
    by_iteration = [
        [str(number), *(f"{value:.2f}" for value in belief.theta[:2]), f"{height:,.0f}", f"{curvature(belief):,.0f}"]
        for number, belief, height in zip(DRAWN, beliefs, peaks, strict=True)
    ]
    sections = []
    for name, (settings, world) in SECTIONS.items():
        end = plain_rounds(settings.model(), settings.samples(world, seed=0), SECTION_ITERATIONS)[-1]
        sd = np.sqrt(np.diag(end.theta_covariance))
        cells = [f"{value:.3f} ± {deviation:.3f}" for value, deviation in zip(end.theta[:2], sd[:2], strict=True)]
        sections.append([name, *cells, "yes" if truth_within(end.theta, end.theta_covariance) else "no"])
    return (
        Sentence("", "The estimate and F̄ᵒ there, by iteration."),
        Table(["iteration", "A", "B", "F̄ᵒ, nats", "curvature along A"], by_iteration),
        Sentence("", "Where the ascents from η = (−8, 8) end."),
        Table(["settings", "A ± sd", "B ± sd", "truth in the 95 % region"], sections),
    )


def _from_above(axes: Axes, model: GenerativeModel, samples: SufficientStatistics, belief: Belief) -> None:
    """Shades F̄ᵒ by its distance from the peak, with contours at ``LEVELS``, the truth and the estimate."""
    values = np.array([[value_at(model, samples, belief, a, b) for a in AXIS_A] for b in AXIS_B])
    # Half a nat keeps the peak's own grid point on the logarithmic scale.
    depth = np.maximum(values.max() - values, 0.5)
    filled = axes.contourf(AXIS_A, AXIS_B, depth, [0.4, *LEVELS, 1e8], cmap="viridis_r", norm=LogNorm(1e2, 1e7))
    filled.set_rasterized(True)
    axes.plot(A, B, "+", color=TRUTH, markersize=9)
    axes.plot(*belief.theta[:2], "o", color="white", markeredgecolor=INK_ON_LIGHT, markersize=4)
    axes.set(xlabel="A", aspect="equal")


def manifold(model: GenerativeModel, samples: SufficientStatistics, beliefs: list[Belief]) -> Figure:
    """Draws the manifold at each of the ``DRAWN`` iterations."""
    with picture(1.8) as figure:
        panels = figure.subplots(1, len(beliefs), sharey=True)
        for axes, number, belief in zip(panels, DRAWN, beliefs, strict=True):
            _from_above(axes, model, samples, belief)
            axes.set_title(f"iteration {number}" if number else "prior")
        panels[0].set_ylabel("B")
        return figure


def circle(model: GenerativeModel, samples: SufficientStatistics, paths: dict[str, list[list[Belief]]]) -> Figure:
    """Draws our ascents on the last manifold of one, and the ends of all."""
    ours = paths["our"]
    with picture(2.8) as figure:
        above, near = figure.subplots(1, 2)
        _from_above(above, model, samples, ours[0][-1])
        for beliefs in ours:
            theta = np.array([belief.theta[:2] for belief in beliefs])
            above.plot(*theta.T, ".-", color="white", linewidth=0.5, markersize=2)
        above.set_ylabel("B")
        for number, (name, beliefs_of) in enumerate(paths.items()):
            reached, _ = ends(beliefs_of)
            values, vectors = np.linalg.eigh(beliefs_of[0][-1].theta_covariance[:2, :2])
            # The 95 % quantile of χ² with two degrees of freedom is −2 ln 0.05.
            width, height = 2 * np.sqrt(-2 * np.log(0.05) * values)
            angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
            centre = (float(reached[:, 0].mean()), float(reached[:, 1].mean()))
            near.add_patch(Ellipse(centre, width, height, angle=angle, fill=False, edgecolor=distinct(number)))
            near.plot(*reached.T, ".", color=distinct(number), label=f"{name} settings")
        near.plot(A, B, "+", color=TRUTH, markersize=9, label="truth")
        near.set(xlabel="A")
        near.legend()
        return figure


def cross_sections() -> Figure:
    """Draws F̄ᵒ along A and along B for each case of ``SECTIONS`` at several iterations, with a dot at each estimate."""
    grids = np.linspace(-10, 1, 221), np.linspace(-1, 10, 221)
    with picture(1.8 * len(SECTIONS)) as figure:
        rows = figure.subplots(len(SECTIONS), 2)
        for (name, (settings, world)), row in zip(SECTIONS.items(), rows, strict=True):
            model, samples = settings.model(), settings.samples(world, seed=0)
            rounds = plain_rounds(model, samples, SECTION_ITERATIONS)
            beliefs = {iteration: rounds[iteration] for iteration in (0, 1, 2, 3, 5, SECTION_ITERATIONS)}
            heights = [peak(model, samples, belief) / 1e3 for belief in beliefs.values()]
            low, high = min(heights), max(heights)
            for parameter, (axes, grid) in enumerate(zip(row, grids, strict=True)):
                for number, (iteration, belief) in enumerate(beliefs.items()):
                    a, b = belief.theta[:2]
                    along = [(value, b) if parameter == 0 else (a, value) for value in grid]
                    curve = [value_at(model, samples, belief, *at) / 1e3 for at in along]
                    axes.plot(grid, curve, color=distinct(number), label=f"{iteration}")
                    axes.plot(belief.theta[parameter], heights[number], "o", markersize=3, color=distinct(number))
                axes.axvline((A, B)[parameter], color=TRUTH, linestyle="--", linewidth=1)
                axes.set_ylim(2 * low - high, high + 0.15 * (high - low))
                axes.set_title(f"{name}, along {'AB'[parameter]}")
        rows[0, 0].legend(title="iteration", fontsize=7)
        return figure
