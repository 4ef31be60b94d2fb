#!/usr/bin/env python
"""Draws fifty priors η^θ on a circle that climb F̄ᵒ to one point, and where they would end under the paper's settings.

Usage: tools/demonstrations/circle.py [FOLDER]

Writes FOLDER/circle.png (default: docs) and prints where the climbs end, and how far apart, as a Markdown table.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import matplotlib.pyplot as plt
import numpy as np
from manifold import AXIS_A, AXIS_B, FLOOR, MILLION, SOLID, height_at, surface, view_from_above
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from picture import save
from scalar_system import PAPER, PAPER_WORLD, A, B, Settings, World

from mavdem.dem.ascent import plain_rounds
from mavdem.dem.free_energy import Belief
from mavdem.dem.generative import Samples

PRIORS, RADIUS, ROUNDS = 50, 5.0, 40
CENTRE = np.array([-3.0, 3.0])
"""Not the truth, or a mean of the priors would be the answer."""


def climbs(settings: Settings, samples: Samples) -> list[list[Belief]]:
    """The climb from each prior."""
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, PRIORS)
    priors = CENTRE + RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    return [
        plain_rounds(replace(settings, theta_mean=(a, b, 1.0)).model(), samples, ROUNDS) for a, b in priors.tolist()
    ]


def draw(path: Path) -> None:
    settings, samples = Settings(), Settings().samples(World(), seed=0)
    paths = climbs(settings, samples)
    paper_paths = climbs(PAPER, PAPER.samples(PAPER_WORLD, seed=0))
    model, end = settings.model(), paths[0][-1]
    height = surface(model, samples, end)
    cut = np.maximum(height, FLOOR) / MILLION
    figure = plt.figure(figsize=(15, 5), layout="constrained")
    solid = figure.add_subplot(1, 3, 1, projection="3d", computed_zorder=False)
    solid.set_box_aspect(None, zoom=0.85)
    solid.plot_surface(*np.meshgrid(AXIS_A, AXIS_B), cut, cmap="viridis", **SOLID)
    top = figure.add_subplot(1, 3, 2, aspect="equal")
    view_from_above(top, height)
    for beliefs in paths:
        # The climb itself, each round on its own manifold; the surface drawn is the last round's.
        theta = np.array([belief.theta[:2] for belief in beliefs])
        climbed = [height_at(model, samples, belief, *belief.theta[:2]) / MILLION for belief in beliefs]
        solid.plot(*theta.T, climbed, color="black", linewidth=0.6, zorder=5)
        solid.plot(*theta[:1].T, climbed[:1], "o", color="limegreen", markeredgecolor="black", markersize=4, zorder=6)
        top.plot(*theta.T, ".-", color="white", linewidth=0.6, markersize=2)
        top.plot(*theta[0], "o", color="limegreen", markeredgecolor="black", markersize=5)
    a, b = end.theta[:2]
    solid.plot([a], [b], [height_at(model, samples, end, a, b) / MILLION], "o", color="magenta", zorder=10)
    solid.set(xlabel="A", ylabel="B", title=f"{PRIORS} priors climb to one peak")
    solid.set_zlabel(r"$\bar F^o$, million nats")
    solid.view_init(35, -115)
    top.plot(a, b, "o", color="magenta", markeredgecolor="white", markersize=9)
    top.set(xlabel="A", ylabel="B", title=f"From above: all end at A = {a:.3f}, B = {b:.3f}")
    near = figure.add_subplot(1, 3, 3)
    _ends(near, paper_paths, "tab:orange", r"the paper's settings, $P^\theta = e^4$")
    _ends(near, paths, "magenta", r"these settings, $P^\theta = e^{-4}$")
    near.plot(A, B, "k+", markersize=14, label="truth")
    near.set(xlabel="A", ylabel="B", title="The ends, with their 95 % regions")
    near.legend(loc="upper right", fontsize=8)
    save(figure, path)
    print("| settings | A | B | sd of the ends | posterior sd |\n|---|---|---|---|---|")
    for name, those in (("these", paths), ("the paper's", paper_paths)):
        ends = np.array([beliefs[-1].theta[:2] for beliefs in those])
        sd = np.sqrt(np.diag(those[0][-1].theta_covariance))
        (a, b), (spread_a, spread_b) = ends.mean(axis=0), ends.std(axis=0)
        print(f"| {name} | {a:.3f} | {b:.3f} | {spread_a:.1e}, {spread_b:.1e} | {sd[0]:.4f}, {sd[1]:.4f} |")


def _ends(axes: Axes, paths: list[list[Belief]], color: str, label: str) -> None:
    """Where the climbs end, and the 95 % region of one of them about their mean."""
    ends = np.array([beliefs[-1].theta[:2] for beliefs in paths])
    values, vectors = np.linalg.eigh(paths[0][-1].theta_covariance[:2, :2])
    # The 95 % quantile of χ² with two degrees of freedom is −2 ln 0.05.
    width, height = 2 * np.sqrt(-2 * np.log(0.05) * values)
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    axes.add_patch(Ellipse(ends.mean(axis=0), width, height, angle=angle, fill=False, edgecolor=color))
    axes.plot(*ends.T, "o", color=color, markersize=4, label=label)


@click.command(help=__doc__)
@click.argument("folder", default="docs", type=click.Path(file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    draw(folder / "circle.png")


if __name__ == "__main__":
    main()
