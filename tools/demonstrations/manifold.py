#!/usr/bin/env python
"""Draws the free energy manifold F̄ᵒ over A and B at several rounds of the climb: it rises and sharpens.

Usage: tools/demonstrations/manifold.py [FOLDER]

Writes FOLDER/manifold.png (default: docs) and prints, for each round drawn, where the climb stands and how sharply
F̄ᵒ is curved there, as a Markdown table. At each round the states x̃ and λ are held as that round left them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.contour import ContourSet
from numpy.typing import NDArray
from picture import save
from scalar_system import A, B, Settings, World

from mavdem.dem.ascent import plain_rounds
from mavdem.dem.free_energy import Belief, optimal_terms
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.steps import with_optimal_precisions

ROUNDS = (0, 1, 2, 3, 10)
AXIS_A, AXIS_B = np.linspace(-10, 4, 71), np.linspace(-4, 10, 71)
LEVELS = [1e3, 1e4, 1e5, 1e6]
"""Nats below the peak."""
SOLID: dict[str, Any] = {"rcount": 71, "ccount": 71, "linewidth": 0, "antialiased": False, "zorder": 1}
MILLION = 1e6
FLOOR = -0.5 * MILLION
"""Nats; surfaces are cut off below, where they would hide what happens at the peak."""


def height_at(model: GenerativeModel, samples: Samples, belief: Belief, a: float, b: float) -> float:
    """F̄ᵒ at A = a, B = b with the belief's states, λ and C held, and every covariance at its optimum there."""
    there = belief._replace(theta=np.array([a, b, belief.theta[2]]))
    return sum(optimal_terms(model, samples, with_optimal_precisions(model, there)).values())


def surface(model: GenerativeModel, samples: Samples, belief: Belief) -> NDArray[np.float64]:
    """F̄ᵒ on the grid, (len(AXIS_B), len(AXIS_A)), nats."""
    return np.array([[height_at(model, samples, belief, a, b) for a in AXIS_A] for b in AXIS_B])


def view_from_above(axes: Axes, height: NDArray[np.float64]) -> ContourSet:
    """Shades F̄ᵒ on the grid by how far it lies below its peak, with lines at ``LEVELS``; dotted lines at the truth."""
    # Half a nat is the least that matters; it also keeps the peak's own grid point on the logarithmic scale.
    depth = np.maximum(height.max() - height, 0.5)
    shades = axes.contourf(AXIS_A, AXIS_B, depth, [0.4, *LEVELS, 1e8], cmap="viridis_r", norm=LogNorm(1e2, 1e7))
    axes.contour(AXIS_A, AXIS_B, depth, LEVELS, colors="white", linewidths=0.8)
    axes.axvline(A, color="white", linestyle=":")
    axes.axhline(B, color="white", linestyle=":")
    return shades


def draw(settings: Settings, samples: Samples, path: Path) -> None:
    model = settings.model()
    beliefs = plain_rounds(model, samples, max(ROUNDS))
    heights = [surface(model, samples, beliefs[i]) for i in ROUNDS]
    figure = plt.figure(figsize=(16, 7), layout="constrained")
    figure.suptitle(
        r"The manifold $\bar F^o(A, B)$ changes with each round, as states and noise precision are learnt with the"
        " parameters: its peak rises, sharpens and comes to the truth (dotted)"
    )
    for column, (i, height) in enumerate(zip(ROUNDS, heights, strict=True), 1):
        belief = beliefs[i]
        a, b = belief.theta[:2]
        solid = figure.add_subplot(2, len(ROUNDS), column, projection="3d", computed_zorder=False)
        solid.set_box_aspect(None, zoom=0.88)
        grid = np.meshgrid(AXIS_A, AXIS_B)
        cut = np.maximum(height, FLOOR) / MILLION
        solid.plot_surface(*grid, cut, cmap="viridis", vmin=FLOOR / MILLION, vmax=0, **SOLID)
        top = height_at(model, samples, belief, a, b) / MILLION
        solid.plot([a], [b], [top], "o", color="magenta", markersize=7, zorder=10)
        solid.set(xlabel="A", ylabel="B", zlim=(FLOOR / MILLION, 0.05), title=f"round {i}: A = {a:.2f}, B = {b:.2f}")
        if column == 1:
            solid.set_title(f"prior: A = {a:.2f}, B = {b:.2f}")
        solid.set_zlabel(r"$\bar F^o$, million nats")
        solid.view_init(28, -115)
        flat = figure.add_subplot(2, len(ROUNDS), len(ROUNDS) + column, aspect="equal")
        shades = view_from_above(flat, height)
        flat.plot(a, b, "o", color="magenta", markeredgecolor="white", markersize=8)
        flat.set(xlabel="A", title=rf"from above: $\Pi^\theta_{{AA}}$ = {curvature(belief):,.0f}")
        if column == 1:
            flat.set_ylabel("B")
    bar = figure.colorbar(shades, ax=figure.axes[1::2], shrink=0.9, ticks=LEVELS)
    bar.set_label("nats below the peak")
    save(figure, path)
    print("| round | A | B | F̄ᵒ, nats | curvature along A |\n|---|---|---|---|---|")
    for i in ROUNDS:
        a, b = beliefs[i].theta[:2]
        top = height_at(model, samples, beliefs[i], a, b)
        print(f"| {i} | {a:.2f} | {b:.2f} | {top:,.0f} | {curvature(beliefs[i]):,.0f} |")


def curvature(belief: Belief) -> float:
    """Of F̄ᵒ along A where the climb stands: the A entry of Π^θ, Eq. ``Picurvature``."""
    return float(np.linalg.inv(belief.theta_covariance[:2, :2])[0, 0])


@click.command(help=__doc__)
@click.argument("folder", default="docs", type=click.Path(file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    draw(Settings(), Settings().samples(World(), seed=0), folder / "manifold.png")


if __name__ == "__main__":
    main()
