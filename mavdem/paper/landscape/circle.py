"""Fifty priors η^θ on a circle: where F̄ᵒ is maximised from each of them, and under the paper's settings."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.dem.engine.free_energy import Belief
from mavdem.dem.engine.generative import SufficientStatistics
from mavdem.paper.item import Cell, PageTable
from mavdem.paper.landscape.manifold import (
    AXIS_A,
    AXIS_B,
    LOWEST_NATS,
    MILLION,
    SURFACE,
    draw_from_above,
    peak,
    surface,
)
from mavdem.paper.landscape.scalar_system import A, B, ScalarSettings

PRIORS, RADIUS, ITERATIONS = 50, 5.0, 40
CENTRE = np.array([-3.0, 3.0])  # not the truth, or the mean of the priors would be the solution


def ascents(settings: ScalarSettings, samples: SufficientStatistics) -> list[list[Belief]]:
    """The beliefs after each iteration, from each prior."""
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, PRIORS)
    priors = CENTRE + RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    return [
        plain_rounds(replace(settings, theta_mean=(a, b, 1.0)).model(), samples, ITERATIONS) for a, b in priors.tolist()
    ]


def ends(paths: list[list[Belief]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(priors, 2) the A and B at which the ascents end, and (2,) the posterior standard deviation of one of them."""
    return np.array([beliefs[-1].theta[:2] for beliefs in paths]), np.sqrt(np.diag(paths[0][-1].theta_covariance)[:2])


def table(paths: dict[str, list[list[Belief]]]) -> PageTable:
    """Where the ascents end, and how far apart, by the name of the settings."""
    rows = []
    for name, own in paths.items():
        reached, sd = ends(own)
        (a, b), spread = reached.mean(axis=0), reached.std(axis=0)
        texts = (f"{a:.3f}", f"{b:.3f}", "{:.1e}, {:.1e}".format(*spread), "{:.4f}, {:.4f}".format(*sd))
        rows.append((Cell(name), *map(Cell, texts)))
    columns = ("settings", "A", "B", "sd of the ends", "posterior sd")
    return PageTable("Where the ascents from fifty priors end, and how far apart", columns, tuple(rows))


def draw(
    settings: ScalarSettings, samples: SufficientStatistics, paths: list[list[Belief]], paper: list[list[Belief]]
) -> Figure:
    """The ascents with our ``settings`` on the manifold, and where they and those with the paper's settings end."""
    model, end = settings.model(), paths[0][-1]
    values = surface(model, samples, end)
    figure = plt.figure(figsize=(15, 5), layout="constrained")
    solid = figure.add_subplot(1, 3, 1, projection="3d", computed_zorder=False)
    solid.set_box_aspect(None, zoom=0.85)
    cut = np.maximum(values, LOWEST_NATS) / MILLION
    solid.plot_surface(*np.meshgrid(AXIS_A, AXIS_B), cut, cmap="viridis", **SURFACE)
    top = figure.add_subplot(1, 3, 2, aspect="equal")
    draw_from_above(top, values)
    for beliefs in paths:
        # Each iteration on its own manifold; the surface drawn is the last one's.
        theta = np.array([belief.theta[:2] for belief in beliefs])
        reached = [peak(model, samples, belief) / MILLION for belief in beliefs]
        solid.plot(*theta.T, reached, color="black", linewidth=0.6, zorder=5)
        solid.plot(*theta[:1].T, reached[:1], "o", color="limegreen", markeredgecolor="black", markersize=4, zorder=6)
        top.plot(*theta.T, ".-", color="white", linewidth=0.6, markersize=2)
        top.plot(*theta[0], "o", color="limegreen", markeredgecolor="black", markersize=5)
    a, b = end.theta[:2]
    solid.plot([a], [b], [peak(model, samples, end) / MILLION], "o", color="magenta", zorder=10)
    solid.set(xlabel="A", ylabel="B", title=f"{PRIORS} priors lead to one peak")
    solid.set_zlabel(r"$\bar F^o$, million nats")
    solid.view_init(35, -115)
    top.plot(a, b, "o", color="magenta", markeredgecolor="white", markersize=9)
    top.set(xlabel="A", ylabel="B", title=f"From above: all end at A = {a:.3f}, B = {b:.3f}")
    near = figure.add_subplot(1, 3, 3)
    _draw_ends(near, paper, "tab:orange", r"the paper's settings, $P^\theta = e^4$")
    _draw_ends(near, paths, "magenta", r"these settings, $P^\theta = e^{-4}$")
    near.plot(A, B, "k+", markersize=14, label="truth")
    near.set(xlabel="A", ylabel="B", title="The ends, with their 95 % regions")
    near.legend(loc="upper right", fontsize=8)
    return figure


def _draw_ends(axes: Axes, paths: list[list[Belief]], color: str, label: str) -> None:
    """Where the ascents end, and the 95 % region of one of them about their mean."""
    reached, _ = ends(paths)
    values, vectors = np.linalg.eigh(paths[0][-1].theta_covariance[:2, :2])
    # The 95 % quantile of χ² with two degrees of freedom is −2 ln 0.05.
    width, height = 2 * np.sqrt(-2 * np.log(0.05) * values)
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    centre = (float(reached[:, 0].mean()), float(reached[:, 1].mean()))
    axes.add_patch(Ellipse(centre, width, height, angle=angle, fill=False, edgecolor=color))
    axes.plot(*reached.T, "o", color=color, markersize=4, label=label)
