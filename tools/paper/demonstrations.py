"""IV: the manifold of F̄, climbs from a circle of priors, and cross-sections, as tools/demonstrations draws them."""

from __future__ import annotations

import circle
import cross_sections
import manifold
import numpy as np
from paper.item import Found, Item, Print
from paper.laboratory import Laboratory
from paper.published import MANIFOLD
from paper.verdict import Check
from paper.words import number
from scalar_system import PAPER, PAPER_WORLD, Settings, World

from mavdem.dem.ascent import plain_rounds
from mavdem.dem.free_energy import Belief

TOGETHER = 0.1
"""Of a posterior standard deviation: climbs whose ends lie closer end at one point."""


def run(laboratory: Laboratory) -> Found:
    samples, model = Settings().samples(World(), seed=0), Settings().model()
    beliefs = plain_rounds(model, samples, max(manifold.ROUNDS))
    drawn = [beliefs[i] for i in manifold.ROUNDS]
    heights = [manifold.height_at(model, samples, belief, *belief.theta[:2]) for belief in drawn]
    sharpness = [manifold.curvature(belief) for belief in drawn]
    apart = {
        name: _apart(circle.climbs(settings, settings.samples(world, seed=0)))
        for name, settings, world in (("our", Settings(), World()), ("the paper’s", PAPER, PAPER_WORLD))
    }
    return Found(
        checks=(
            Check(
                "the peak of F̄ᵒ rises and sharpens from round to round",
                bool((np.diff(heights) > 0).all() and (np.diff(sharpness) > 0).all()),
                f"the peak rises from {number(heights[0])} to {number(heights[-1])} nats, and its curvature along A "
                f"from {number(sharpness[0])} to {number(sharpness[-1])}",
            ),
            *(
                Check(
                    f"fifty priors on a circle end within {TOGETHER:g} posterior standard deviations of each other, "
                    f"{name} settings",
                    scatter < TOGETHER,
                    f"with {name} settings fifty priors end {number(scatter)} posterior standard deviations apart",
                )
                for name, scatter in apart.items()
            ),
        ),
        numbers={"peak": heights, "curvature_along_A": sharpness, "ends_over_posterior_sd": apart},
        pictures=(
            Print(
                "manifold",
                "F̄ᵒ over A and B as it is climbed, round by round.",
                lambda path: manifold.draw(Settings(), samples, path),
            ),
            Print("circle", "Fifty priors on a circle climb to one peak.", circle.draw),
            Print("cross_sections", "Cross-sections of F̄ᵒ along A and B.", cross_sections.draw),
        ),
        remarks=(
            "Our settings here differ from the paper’s in the prior’s precision and in what is made of the highest "
            "derivative; tools/demonstrations/outcomes.py says which of them are needed.",
        ),
    )


def _apart(paths: list[list[Belief]]) -> float:
    """How far the ends of climbs scatter, in posterior standard deviations, along A or B, whichever is more."""
    ends = np.array([beliefs[-1].theta[:2] for beliefs in paths])
    deviation = np.sqrt(np.diag(paths[0][-1].theta_covariance)[:2])
    return float((ends.std(axis=0) / deviation).max())


ITEM = Item("demonstrations", "The manifold of the free energy", MANIFOLD, run)
