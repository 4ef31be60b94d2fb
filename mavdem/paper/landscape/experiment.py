"""Section IV: the manifold of F̄, ascents from a circle of priors, and cross-sections."""

from __future__ import annotations

from functools import partial

import numpy as np

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.paper.checks import Check
from mavdem.paper.claims import MANIFOLD
from mavdem.paper.item import Item, ItemResult, PngPicture
from mavdem.paper.landscape import circle, cross_sections, manifold
from mavdem.paper.landscape.scalar_system import PAPER, PAPER_WORLD, ScalarSettings, ScalarWorld
from mavdem.paper.runner import Runner
from mavdem.paper.words import number

SAME_POINT = 0.1  # posterior standard deviations: ascents whose ends scatter less end at one point


def run(runner: Runner) -> ItemResult:
    """Maximises F̄ᵒ of the scalar system and draws it; the runner is not needed."""
    settings = ScalarSettings()
    samples, model = settings.samples(ScalarWorld(), seed=0), settings.model()
    beliefs = plain_rounds(model, samples, max(manifold.ITERATIONS))
    drawn = [beliefs[i] for i in manifold.ITERATIONS]
    peaks = [manifold.peak(model, samples, belief) for belief in drawn]
    sharpness = [manifold.curvature(belief) for belief in drawn]
    ours, papers = circle.ascents(settings, samples), circle.ascents(PAPER, PAPER.samples(PAPER_WORLD, seed=0))
    paths = {"our": ours, "the paper’s": papers}
    scatter = {}
    for name, own in paths.items():
        reached, deviation = circle.ends(own)
        scatter[name] = float((reached.std(axis=0) / deviation).max())
    return ItemResult(
        checks=(
            Check(
                "the peak of F̄ᵒ rises and sharpens from iteration to iteration",
                bool((np.diff(peaks) > 0).all() and (np.diff(sharpness) > 0).all()),
                f"the peak rises from {number(peaks[0])} to {number(peaks[-1])} nats, and its curvature along A "
                f"from {number(sharpness[0])} to {number(sharpness[-1])}",
            ),
            *(
                Check(
                    f"with {name} settings, ascents from fifty priors on a circle end within {SAME_POINT:g} posterior "
                    "standard deviations of each other",
                    one < SAME_POINT,
                    f"with {name} settings, the ends from fifty priors scatter by {number(one)} posterior standard "
                    "deviations",
                )
                for name, one in scatter.items()
            ),
        ),
        numbers={"peak": peaks, "curvature_along_A": sharpness, "ends_over_posterior_sd": scatter},
        tables=(manifold.table(model, samples, beliefs), circle.table(paths), cross_sections.table()),
        pictures=(
            PngPicture("manifold", "F̄ᵒ over A and B, by iteration.", partial(manifold.draw, model, samples)),
            PngPicture(
                "circle",
                "Ascents of F̄ᵒ from fifty priors on a circle.",
                partial(circle.draw, settings, samples, ours, papers),
            ),
            PngPicture("cross_sections", "Cross-sections of F̄ᵒ along A and B.", cross_sections.draw),
        ),
        remarks=(
            "Our settings here differ from the paper’s in the precision of the prior and in the use of the highest "
            "derivative; `python -m mavdem.paper.landscape.cases` prints which of them are needed.",
        ),
    )


ITEM = Item(MANIFOLD, run)
