#!/usr/bin/env python
"""Draws cross-sections of F̄ᵒ along A and along B at each round, from η = (−8, 8).

Usage: tools/demonstrations/cross_sections.py [FOLDER]

Writes FOLDER/cross_sections.png (default: docs) and prints where each climb ends as a Markdown table: with λʷ
learnt, with λ known, and with the paper's settings. A cross-section passes through the estimate of its round, with the
states x̃ and λ as that round left them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import matplotlib.pyplot as plt
import numpy as np
from manifold import height_at
from matplotlib.axes import Axes
from picture import save
from scalar_system import PAPER, PAPER_WORLD, A, B, Settings, World, truth_within

from mavdem.dem.ascent import plain_rounds
from mavdem.dem.free_energy import Belief
from mavdem.dem.generative import GenerativeModel, Samples

ROUNDS = 12
DRAWN = (0, 1, 2, 3, 4, 5, 12)
THOUSAND = 1e3

CASES = (
    ("λʷ learnt", World(), Settings()),
    ("λ known", World(), replace(Settings(), lambda_mean=(6.0, 3.0), lambda_precision=PAPER.lambda_precision)),
    ("The paper's settings", PAPER_WORLD, PAPER),
)
"""The peak rises and narrows; rises without narrowing, since only x̃ changes; is there after one step."""


def draw(path: Path) -> None:
    figure, rows = plt.subplots(len(CASES), 2, figsize=(12, 11), layout="constrained")
    print("| settings | A ± sd | B ± sd | truth in the 95 % region |\n|---|---|---|---|")
    for (name, world, settings), row in zip(CASES, rows, strict=True):
        model, samples = settings.model(), settings.samples(world, seed=0)
        beliefs = plain_rounds(model, samples, ROUNDS)
        end = beliefs[-1]
        (a, b), (sd_a, sd_b) = end.theta[:2], np.sqrt(np.diag(end.theta_covariance)[:2])
        within = truth_within(end.theta, end.theta_covariance)
        for axes, place in zip(row, (0, 1), strict=True):
            cross_sections(axes, model, samples, beliefs, place)
            if settings is PAPER:
                axes.text(0.5, 0.05, f"rounds 1 to {ROUNDS} coincide", transform=axes.transAxes, ha="center")
        row[0].set_title(f"{name}, along A: end at {a:.3f} ± {sd_a:.3f}")
        row[1].set_title(f"{name}, along B: end at {b:.3f} ± {sd_b:.3f}")
        print(f"| {name} | {a:.3f} ± {sd_a:.3f} | {b:.3f} ± {sd_b:.3f} | {'yes' if within else 'no'} |")
    figure.legend(*rows[0, 0].get_legend_handles_labels(), title="round", loc="outside right center")
    figure.suptitle("Cross-sections of $\\bar F^o$ by round; circles: estimates, dashed: truth")
    save(figure, path)


def cross_sections(axes: Axes, model: GenerativeModel, samples: Samples, beliefs: list[Belief], place: int) -> None:
    """Curves of F̄ᵒ along A (``place`` 0) or B (1), each with a circle where its round stands."""
    grid = np.linspace(-10, 1, 221) if place == 0 else np.linspace(-1, 10, 221)
    colours = plt.get_cmap("viridis")(np.linspace(0.95, 0, len(DRAWN)))
    tops = []
    for i, colour in zip(DRAWN, colours, strict=True):
        a, b = beliefs[i].theta[:2]
        along = [(value, b) if place == 0 else (a, value) for value in grid]
        curve = [height_at(model, samples, beliefs[i], *at) / THOUSAND for at in along]
        top = height_at(model, samples, beliefs[i], a, b) / THOUSAND
        axes.plot(grid, curve, color=colour, label=f"{i}")
        axes.plot(beliefs[i].theta[place], top, "o", color=colour, markeredgecolor="black", zorder=3)
        tops.append(top)
    axes.axvline((A, B)[place], color="crimson", linestyle="--", linewidth=1)
    room = max(tops) - min(tops)
    axes.set(xlabel="AB"[place], ylabel=r"$\bar F^o$, thousand nats", ylim=(min(tops) - room, max(tops) + 0.15 * room))


@click.command(help=__doc__)
@click.argument("folder", default="docs", type=click.Path(file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    draw(folder / "cross_sections.png")


if __name__ == "__main__":
    main()
