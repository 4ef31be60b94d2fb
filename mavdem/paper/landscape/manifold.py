"""The free energy manifold F̄ᵒ over A and B at several iterations: its peak rises and sharpens.

At each iteration the states x̃ and λ are held as that iteration left them.
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.dem.engine.free_energy import Belief, optimal_terms
from mavdem.dem.engine.generative import GenerativeModel, SufficientStatistics
from mavdem.dem.engine.steps import with_optimal_precisions
from mavdem.paper.item import Cell, PageTable
from mavdem.paper.landscape.scalar_system import A, B

ITERATIONS = (0, 1, 2, 3, 10)  # those that are drawn

AXIS_A, AXIS_B = np.linspace(-10, 4, 71), np.linspace(-4, 10, 71)
LEVELS = [1e3, 1e4, 1e5, 1e6]  # contours, nats below the peak

SURFACE: dict[str, Any] = {"rcount": 71, "ccount": 71, "linewidth": 0, "antialiased": False, "zorder": 1}

MILLION = 1e6
LOWEST_NATS = -0.5 * MILLION  # surfaces are cut off below, where they would hide the peak


def value_at(model: GenerativeModel, samples: SufficientStatistics, belief: Belief, a: float, b: float) -> float:
    """F̄ᵒ (nats) at A = a, B = b with the belief's states, λ and C held, and every covariance optimal there."""
    there = belief._replace(theta=np.array([a, b, belief.theta[2]]))
    return sum(optimal_terms(model, samples, with_optimal_precisions(model, there)).values())


def peak(model: GenerativeModel, samples: SufficientStatistics, belief: Belief) -> float:
    """F̄ᵒ (nats) at the belief's own A and B."""
    return value_at(model, samples, belief, *belief.theta[:2])


def curvature(belief: Belief) -> float:
    """Curvature of F̄ᵒ along A at the belief: the A entry of Π^θ, Eq. ``Picurvature``."""
    return float(np.linalg.inv(belief.theta_covariance[:2, :2])[0, 0])


def surface(model: GenerativeModel, samples: SufficientStatistics, belief: Belief) -> NDArray[np.float64]:
    """F̄ᵒ on the grid, (len(AXIS_B), len(AXIS_A)), nats."""
    return np.array([[value_at(model, samples, belief, a, b) for a in AXIS_A] for b in AXIS_B])


def draw_from_above(axes: Axes, values: NDArray[np.float64]) -> ContourSet:
    """Shades F̄ᵒ on the grid by its distance from the peak, with contours at ``LEVELS``; dotted lines at the truth."""
    # Half a nat keeps the peak's own grid point on the logarithmic scale.
    depth = np.maximum(values.max() - values, 0.5)
    shades = axes.contourf(AXIS_A, AXIS_B, depth, [0.4, *LEVELS, 1e8], cmap="viridis_r", norm=LogNorm(1e2, 1e7))
    axes.contour(AXIS_A, AXIS_B, depth, LEVELS, colors="white", linewidths=0.8)
    axes.axvline(A, color="white", linestyle=":")
    axes.axhline(B, color="white", linestyle=":")
    return shades


def table(model: GenerativeModel, samples: SufficientStatistics, beliefs: list[Belief]) -> PageTable:
    """A and B, F̄ᵒ there and its curvature along A, by iteration; the first belief is that of the prior."""
    rows = []
    for i in ITERATIONS:
        a, b = beliefs[i].theta[:2]
        texts = (f"{a:.2f}", f"{b:.2f}", f"{peak(model, samples, beliefs[i]):,.0f}", f"{curvature(beliefs[i]):,.0f}")
        rows.append((Cell(str(i)), *map(Cell, texts)))
    columns = ("iteration", "A", "B", "F̄ᵒ, nats", "curvature along A")
    return PageTable("The estimate and F̄ᵒ there, by iteration", columns, tuple(rows))


def draw(model: GenerativeModel, samples: SufficientStatistics) -> Figure:
    """The manifold at each of ``ITERATIONS``, as a surface and from above."""
    beliefs = plain_rounds(model, samples, max(ITERATIONS))
    figure = plt.figure(figsize=(16, 7), layout="constrained")
    figure.suptitle(
        r"The manifold $\bar F^o(A, B)$ changes with each iteration, as states and noise precision are estimated with "
        "the parameters: its peak rises, sharpens and approaches the truth (dotted)"
    )
    for column, i in enumerate(ITERATIONS, 1):
        belief = beliefs[i]
        (a, b), values = belief.theta[:2], surface(model, samples, belief)
        solid = figure.add_subplot(2, len(ITERATIONS), column, projection="3d", computed_zorder=False)
        solid.set_box_aspect(None, zoom=0.88)
        cut = np.maximum(values, LOWEST_NATS) / MILLION
        solid.plot_surface(
            *np.meshgrid(AXIS_A, AXIS_B), cut, cmap="viridis", vmin=LOWEST_NATS / MILLION, vmax=0, **SURFACE
        )
        solid.plot([a], [b], [peak(model, samples, belief) / MILLION], "o", color="magenta", markersize=7, zorder=10)
        name = f"iteration {i}" if i else "prior"
        solid.set(xlabel="A", ylabel="B", zlim=(LOWEST_NATS / MILLION, 0.05), title=f"{name}: A = {a:.2f}, B = {b:.2f}")
        solid.set_zlabel(r"$\bar F^o$, million nats")
        solid.view_init(28, -115)
        flat = figure.add_subplot(2, len(ITERATIONS), len(ITERATIONS) + column, aspect="equal")
        shades = draw_from_above(flat, values)
        flat.plot(a, b, "o", color="magenta", markeredgecolor="white", markersize=8)
        flat.set(xlabel="A", title=rf"from above: $\Pi^\theta_{{AA}}$ = {curvature(belief):,.0f}")
        if column == 1:
            flat.set_ylabel("B")
    bar = figure.colorbar(shades, ax=figure.axes[1::2], shrink=0.9, ticks=LEVELS)
    bar.set_label("nats below the peak")
    return figure
