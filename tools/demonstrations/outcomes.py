#!/usr/bin/env python
"""Which settings lead from η = (−8, 8) to A = −2, B = 2, and which do not; prints a Markdown table.

Usage: tools/demonstrations/outcomes.py

Each row is climbed with twenty noises: the mean of where they end, its scatter, what the posterior takes that to be,
how often its 95 % region holds the truth, and the rounds until A stays within a posterior deviation of its end.
"""

from __future__ import annotations

from dataclasses import replace
from math import e
from typing import NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from scalar_system import CERTAIN, PAPER, PAPER_WORLD, Settings, World, truth_within

from mavdem.dem.ascent import plain_rounds

NOISES, ROUNDS = 20, 200


class Case(NamedTuple):
    """A row of the table, and why it ends where it does."""

    name: str
    world: World
    settings: Settings
    why: str


OURS = Settings()
WEAK = OURS.theta_precision
LAMBDA_FIRM = PAPER.lambda_precision
LONGER = replace(PAPER_WORLD, duration=128.0, amplitude=3.0)
SPACED = replace(PAPER, theta_precision=WEAK, q=1, spacing=0.4)
SMOOTHER_WORLD, SMOOTHER = replace(PAPER_WORLD, smoothness=0.5), replace(PAPER, theta_precision=WEAK, smoothness=0.5)
SAMPLED_AS_FLOWN = replace(PAPER_WORLD, duration=700 / 120, step=1 / 120, smoothness=1 / 120)
AUTHORS_WORLD = replace(SMOOTHER_WORLD, lambda_z=6.0)
AUTHORS = replace(
    PAPER,
    p=6,
    d=2,
    q=6,
    smoothness=0.5,
    lambda_mean=(0.0, 0.0),
    lambda_precision=(e**3, e**3),
    theta_precision=(e**6, e**6, CERTAIN),
)
"""The priors of their published example."""

CASES = [
    Case(
        "these settings",
        World(),
        OURS,
        "sensor known, process noise learnt, D's last row left out, independent samples, a strong input; a little too "
        "sure, since q takes x̃ and θ for independent",
    ),
    Case(
        "… λ known, (6, 3)",
        World(),
        replace(OURS, lambda_mean=(6.0, 3.0), lambda_precision=LAMBDA_FIRM),
        "only x̃ and θ learn of each other: the peak wanders and rises, but its cross-sections do not narrow",
    ),
    Case(
        "… λ known, (20, 3)",
        World(lambda_z=20.0),
        replace(OURS, lambda_mean=(20.0, 3.0), lambda_precision=LAMBDA_FIRM),
        "x̃ is pinned to ỹ: one regression, one round, and an honest posterior; nothing to see of a climb",
    ),
    Case(
        "… λᶻ = 20 believed, 6 true",
        World(),
        replace(OURS, lambda_mean=(20.0, 1.0)),
        "as before: the sensor's noise is small against the motion, and λʷ takes it up",
    ),
    Case(
        "… λᶻ = 20 believed, 3 true",
        World(lambda_z=3.0),
        replace(OURS, lambda_mean=(20.0, 1.0)),
        "the sensor's noise sits in the regressors and draws A and B towards 0 (errors in variables)",
    ),
    Case(
        "… λᶻ = 3 known and true",
        World(lambda_z=3.0),
        replace(OURS, lambda_mean=(3.0, 1.0)),
        "x̃ is uncertain, and the mean field leaves its correlation with θ out of the posterior: too sure",
    ),
    Case(
        "… λʷ = 0 believed",
        World(),
        replace(OURS, lambda_mean=(6.0, 0.0), lambda_precision=LAMBDA_FIRM),
        "too modest by e^1.5; the mean is a regression's and does not mind",
    ),
    Case(
        "… λʷ = 6 believed",
        World(),
        replace(OURS, lambda_mean=(6.0, 6.0), lambda_precision=LAMBDA_FIRM),
        "too sure by e^1.5, and slow: x̃ believes θ as much as ỹ",
    ),
    Case(
        "… both λ learnt, η = 0",
        World(),
        replace(OURS, lambda_mean=(0.0, 0.0), lambda_precision=(1.0, 1.0)),
        "right but slow; the prior moves part of the sensor's noise to the process",
    ),
    Case(
        "… P^θ = e⁴",
        World(),
        replace(OURS, theta_precision=PAPER.theta_precision),
        "the prior says ± 0.14 and lies 6 off: its pull is several posterior deviations",
    ),
    Case(
        "… q = p",
        World(),
        replace(OURS, q=2),
        "with D's last row zero, A x″ has to pass for noise: that draws A to 0, B after it, and λʷ down",
    ),
    Case(
        "… s = dt believed",
        World(),
        replace(OURS, smoothness=0.1),
        "rough derivatives are expected and so hardly count: x̃ takes up the noise, λʷ ends at 4.9: too sure",
    ),
    Case(
        "… every sample used",
        World(),
        replace(OURS, spacing=0.1),
        "18 times the samples, but not the information: smooth noise repeats itself. Too sure by √18",
    ),
    Case(
        "… a third of the input",
        World(amplitude=1.0),
        OURS,
        "coloured w goes with the state it has driven, which the regression takes for A",
    ),
    Case("… dt = 0.3", World(step=0.3), OURS, "embedding error: differences miss part of the derivatives"),
    Case(
        "… dt = 0.3, exact derivatives",
        World(step=0.3),
        replace(OURS, exact_derivatives=True),
        "as with dt = 0.1: it was the embedding",
    ),
    Case(
        "… p = 4, d = 3, q = 3",
        World(),
        replace(OURS, p=4, d=3, q=3),
        "embedding error again: S trusts smooth noise's high derivatives, samples give them badly",
    ),
    Case(
        "… p = 4, d = 3, q = 3, exact derivatives",
        World(),
        replace(OURS, p=4, d=3, q=3, exact_derivatives=True),
        "the mean is back where it was; more orders, each taken for new evidence, make it surer than it may be",
    ),
    Case("… p = 1, d = 0, q = 0", World(), replace(OURS, p=1, d=0, q=0), "x′ lies half a sample from x and v"),
    Case(
        "… input precision e³²",
        World(),
        replace(OURS, input_precision=e**32),
        "the input was known well enough at e¹⁶",
    ),
    Case(
        "… C not known, P^C = e⁻⁴, η = 0.5",
        World(),
        replace(OURS, theta_mean=(-8.0, 8.0, 0.5), theta_precision=(e**-4, e**-4, e**-4)),
        "the unit of x is free: y tells A and C·B, the priors share C·B out",
    ),
    Case(
        "the paper's settings",
        PAPER_WORLD,
        PAPER,
        "the prior's pull, D's last row, and consecutive samples taken for independent; one round",
    ),
    Case("… 700 samples at 120 Hz", SAMPLED_AS_FLOWN, replace(PAPER, smoothness=1 / 120, spacing=1 / 120), "likewise"),
    Case(
        "… three times the input",
        replace(PAPER_WORLD, amplitude=3.0),
        PAPER,
        "nearer, since data outweigh the prior; still outside its own interval",
    ),
    Case(
        "… P^θ = e⁻⁴",
        PAPER_WORLD,
        replace(PAPER, theta_precision=WEAK),
        "the pull is gone, and the overconfidence left; at s = dt, D's last row weighs little",
    ),
    Case(
        "… P^θ = e⁻⁴, s = 0.5 believed and true",
        SMOOTHER_WORLD,
        SMOOTHER,
        "at s = 5 dt, D's last row does its full damage",
    ),
    Case(
        "… P^θ = e⁻⁴, s = 0.5, q = p − 1",
        SMOOTHER_WORLD,
        replace(SMOOTHER, q=1),
        "and leaving it out mends the mean, though not the overconfidence",
    ),
    Case(
        "… P^θ = e⁻⁴, q = p − 1, three times the input, a sample every 0.4 s of 128 s",
        LONGER,
        SPACED,
        "what is left is embedding error: noise as rough as the samples are apart",
    ),
    Case(
        "… and exact derivatives",
        LONGER,
        replace(SPACED, exact_derivatives=True),
        "right and honest, in one round",
    ),
    Case(
        "the authors' priors: λ from 0 with P^λ = e³, P^θ = e⁶, p = 6, d = 2, s = 0.5",
        AUTHORS_WORLD,
        AUTHORS,
        "at λʷ = 0 the firm prior outweighs the data, the misfit is then learnt as noise: it stays at the prior",
    ),
    Case(
        "… P^θ = e⁻⁴",
        AUTHORS_WORLD,
        replace(AUTHORS, theta_precision=WEAK),
        "leaves the prior; D's last row draws A and B towards 0 again, and six orders make it very sure",
    ),
]


class Outcome(NamedTuple):
    """Where the climbs of one case ended."""

    mean: NDArray[np.float64]  # (2,) of A and B
    scatter: NDArray[np.float64]  # (2,)
    posterior: NDArray[np.float64]  # (2,) mean posterior standard deviation
    within: int  # climbs whose 95 % region holds the truth
    rounds: float  # median


def outcome(case: Case, rounds: int = ROUNDS) -> Outcome:
    """Climbs the case once for each noise, for so many rounds."""
    model = case.settings.model()
    theta, deviations, within, needed = [], [], 0, []
    for seed in range(NOISES):
        beliefs = plain_rounds(model, case.settings.samples(case.world, seed), rounds)
        end = beliefs[-1]
        theta.append(end.theta[:2])
        deviations.append(np.sqrt(np.diag(end.theta_covariance)[:2]))
        within += truth_within(end.theta, end.theta_covariance)
        away = [abs(belief.theta[0] - end.theta[0]) > deviations[-1][0] for belief in beliefs]
        needed.append(np.flatnonzero(away).max(initial=-1) + 1)
    return Outcome(
        np.mean(theta, axis=0), np.std(theta, axis=0), np.mean(deviations, axis=0), within, float(np.median(needed))
    )


@click.command(help=__doc__)
def main() -> None:
    print("| settings | A, scatter | B, scatter | posterior sd of A, B | truth within | rounds | why |")
    print("|---|---|---|---|---|---|---|")
    for case in CASES:
        end = outcome(case)
        a, b = (f"{mean:.3f} ± {scatter:.3f}" for mean, scatter in zip(end.mean, end.scatter, strict=True))
        posterior = "{:.3f}, {:.3f}".format(*end.posterior)
        # One that still moves at the end has come within a deviation of it only just before.
        rounds = f"{end.rounds:.0f}" if end.rounds < ROUNDS / 2 else f"not settled in {ROUNDS}"
        print(f"| {case.name} | {a} | {b} | {posterior} | {end.within} of {NOISES} | {rounds} | {case.why} |")


if __name__ == "__main__":
    main()
