"""Which settings lead from η = (−8, 8) to A = −2, B = 2, and which do not.

``python -m mavdem.paper.landscape.cases`` prints a Markdown table. Each row is run with twenty noises: the mean of the
ends of the ascents, its scatter, the posterior standard deviation, how often the 95 % region contains the truth, and
the iterations until A stays within a posterior standard deviation of its end.
"""

from __future__ import annotations

from dataclasses import replace
from math import e
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.paper.landscape.scalar_system import CERTAIN, PAPER, PAPER_WORLD, ScalarSettings, ScalarWorld, truth_within

NOISES, ITERATIONS = 20, 200


class SettingsCase(NamedTuple):
    """A row of the table, and why it ends where it does."""

    name: str
    settings: ScalarSettings
    why: str
    world: ScalarWorld = ScalarWorld()


OURS = ScalarSettings()
AUTHORS_WORLD = replace(PAPER_WORLD, smoothness=0.5, lambda_z=6.0)
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
    SettingsCase(
        "these settings",
        OURS,
        "sensor known, process noise learnt, D's last row left out, independent samples, a strong input; a little too "
        "sure, since q takes x̃ and θ for independent",
    ),
    SettingsCase(
        "… P^θ = e⁴",
        replace(OURS, theta_precision=PAPER.theta_precision),
        "the prior's sd is 0.14 and it is 6 off: its bias is several posterior deviations",
    ),
    SettingsCase(
        "… q = p",
        replace(OURS, q=2),
        "with D's last row zero, A x″ counts as noise: that draws A to 0, B after it, and λʷ down",
    ),
    SettingsCase(
        "… every sample used",
        replace(OURS, spacing=0.1),
        "18 times the samples, but not the information: smooth noise is autocorrelated. Too sure by √18",
    ),
    SettingsCase("… p = 1, d = 0, q = 0", replace(OURS, p=1, d=0, q=0), "x′ lies half a sample from x and v"),
    SettingsCase(
        "the paper's settings",
        PAPER,
        "the prior's bias, D's last row, and consecutive samples taken for independent; one iteration",
        PAPER_WORLD,
    ),
    SettingsCase(
        "the authors' priors: λ from 0 with P^λ = e³, P^θ = e⁶, p = 6, d = 2, s = 0.5",
        AUTHORS,
        "at λʷ = 0 the tight prior outweighs the data, then the misfit counts as noise: it stays at the prior",
        AUTHORS_WORLD,
    ),
]


class CaseResult(NamedTuple):
    """Where the ascents of one case ended."""

    mean: NDArray[np.float64]  # (2,) of A and B
    scatter: NDArray[np.float64]  # (2,)
    posterior: NDArray[np.float64]  # (2,) mean posterior standard deviation
    within: int  # ascents whose 95 % region holds the truth
    iterations: float  # median


def run_case(case: SettingsCase, iterations: int = ITERATIONS) -> CaseResult:
    """Runs the case once for each noise, for so many iterations."""
    model = case.settings.model()
    theta, deviations, within, needed = [], [], 0, []
    for seed in range(NOISES):
        beliefs = plain_rounds(model, case.settings.samples(case.world, seed), iterations)
        end = beliefs[-1]
        theta.append(end.theta[:2])
        deviations.append(np.sqrt(np.diag(end.theta_covariance)[:2]))
        within += truth_within(end.theta, end.theta_covariance)
        away = [abs(belief.theta[0] - end.theta[0]) > deviations[-1][0] for belief in beliefs]
        needed.append(np.flatnonzero(away).max(initial=-1) + 1)
    return CaseResult(
        np.mean(theta, axis=0), np.std(theta, axis=0), np.mean(deviations, axis=0), within, float(np.median(needed))
    )


def main() -> None:
    """Prints the table."""
    print("| settings | A, scatter | B, scatter | posterior sd of A, B | truth within | iterations | why |")
    print("|---|---|---|---|---|---|---|")
    for case in CASES:
        end = run_case(case)
        a, b = (f"{mean:.3f} ± {scatter:.3f}" for mean, scatter in zip(end.mean, end.scatter, strict=True))
        posterior = "{:.3f}, {:.3f}".format(*end.posterior)
        # One that still moves at the end has come within a deviation of it only just before.
        iterations = f"{end.iterations:.0f}" if end.iterations < ITERATIONS / 2 else f"not converged in {ITERATIONS}"
        print(f"| {case.name} | {a} | {b} | {posterior} | {end.within} of {NOISES} | {iterations} | {case.why} |")


if __name__ == "__main__":
    main()
