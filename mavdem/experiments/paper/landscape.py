"""Section IV of the paper: the free energy F̄ᵒ over the parameters A and B, and ascents from a circle of priors.

At each iteration of DEM the states x̃ and the hyperparameters λ are held as that iteration left them, so F̄ᵒ is another
function of A and B at every iteration. The system is in :mod:`~mavdem.experiments.paper.scalar_system`.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.random import default_rng

from mavdem.dem.engine.ascent import posterior_after_each_round
from mavdem.dem.engine.free_energy import Posterior, free_energy_terms
from mavdem.dem.engine.generative import GenerativeModel
from mavdem.dem.engine.moments import SufficientStatistics
from mavdem.dem.engine.steps import with_optimal_covariances
from mavdem.experiments.paper.checks import Check, ExperimentResult
from mavdem.experiments.paper.runner import Runner
from mavdem.experiments.paper.scalar_system import (
    PAPER_SCALAR_SETTINGS,
    PAPER_SYSTEM,
    TRUE_A,
    TRUE_B,
    ScalarSettings,
    ScalarSystem,
)
from mavdem.report.figures.style import Picture, new_figure
from mavdem.report.numbers import rounded
from mavdem.report.palette import INK_ON_LIGHT, TRUTH

MAX_END_SPREAD = 0.1
"""Posterior standard deviations: ascents whose ends spread less end at one point; a choice."""

ITERATIONS_SHOWN = (0, 1, 2, 3, 10)
"""Iterations whose manifold is drawn; 0 is the prior."""

GRID_A = np.linspace(-10, 4, 71)
"""1/s, values of A at which F̄ᵒ is drawn."""

GRID_B = np.linspace(-4, 10, 71)
"""1/s, values of B at which F̄ᵒ is drawn."""

CONTOUR_LEVELS = [1e3, 1e4, 1e5, 1e6]
"""Nats below the peak at which contours are drawn."""

MIN_NATS_BELOW_PEAK = 0.5
"""Nats: what the grid point of the peak itself, at 0, is drawn as, because the scale is logarithmic."""

OUTER_CONTOUR_LEVELS = (0.4, 1e8)
"""Nats below the peak that enclose all values, so that nothing of the plane is left blank."""

PRIOR_COUNT = 50
"""Priors on the circle, as in the paper (Fig. 2, ``FreeE_curves``)."""

CIRCLE_RADIUS = 5.0
"""1/s, the distance of the priors' means from the centre of the circle."""

CIRCLE_CENTRE = np.array([-3.0, 3.0])
"""1/s, A and B at the centre of the circle.

It is not the truth, because the solution would then be the mean of the priors.
"""

CIRCLE_ITERATIONS = 40
"""Iterations of the ascent from each prior of the circle; a choice."""

COLOUR_RANGE = (1e2, 1e7)
"""Distances below the peak, nats, that the ends of the colour scale stand for; a choice."""


def run(runner: Runner) -> ExperimentResult:
    """Checks the paper's claims on the free energy F̄ᵒ of a scalar system as a function of its parameters A and B.

    1. The peak of F̄ᵒ, at the estimate, rises and sharpens from iteration to iteration: its curvature along A grows.
    2. Ascents from a circle of priors end at one point: their spread, in posterior standard deviations, is small. This
       is tried with our settings and with the paper's.

    Args:
        runner: not needed; all experiments take one.

    Returns:
        Checks, pictures of F̄ᵒ over A and B, and the values that the checks compare as ``numbers``.
    """
    settings = ScalarSettings()
    model = settings.model()
    samples = settings.sufficient_statistics(ScalarSystem(), seed=0)
    # One posterior of A, B and the hyperparameters for each iteration of DEM; the first one is the prior.
    all_posteriors = posterior_after_each_round(model, samples, max(ITERATIONS_SHOWN))
    posteriors = [all_posteriors[iteration] for iteration in ITERATIONS_SHOWN]
    peaks = [free_energy_at_estimate(model, posterior) for posterior in posteriors]
    curvatures = [curvature_along_a(posterior) for posterior in posteriors]
    our_ascents = circle_ascents(settings, samples)
    paper_samples = PAPER_SCALAR_SETTINGS.sufficient_statistics(PAPER_SYSTEM, seed=0)
    end_spreads = {
        "our": end_spread(our_ascents),
        "the paper’s": end_spread(circle_ascents(PAPER_SCALAR_SETTINGS, paper_samples)),
    }
    checks = [_peak_check(peaks, curvatures)]
    for settings_name, spread in end_spreads.items():
        checks.append(_end_check(settings_name, spread))
    return ExperimentResult(
        checks=tuple(checks),
        numbers={
            "peak": peaks,
            "curvature_along_A": curvatures,
            "ends_over_posterior_sd": end_spreads,
        },
        pictures=(
            Picture(
                "The manifold",
                "F̄ᵒ over A and B by iteration, from above; cross: the truth, dot: the estimate.",
                partial(draw_manifolds, model, posteriors),
            ),
            Picture(
                "Fifty priors on a circle",
                "Their ascents, each iteration on its own manifold.",
                partial(draw_ascents, model, our_ascents),
            ),
        ),
    )


def _peak_check(peaks: list[float], curvatures: list[float]) -> Check:
    """Checks that the peak of the objective F̄ᵒ becomes higher and sharper with every iteration.

    A higher peak is a better fit, and a sharper one a more precise estimate of the parameters.

    Args:
        peaks: height of the peak at each iteration, nats.
        curvatures: curvature of the peak along the parameter A at each iteration, nats s².

    Returns:
        The check, with the first and the last peak.
    """
    rises = (np.diff(peaks) > 0).all()
    sharpens = (np.diff(curvatures) > 0).all()
    return Check(
        rule="the peak of F̄ᵒ rises and sharpens from iteration to iteration",
        holds=bool(rises and sharpens),
        finding=f"the peak rises from {rounded(peaks[0], 3)} to {rounded(peaks[-1], 3)} nats, and its curvature along "
        f"A from {rounded(curvatures[0], 3)} to {rounded(curvatures[-1], 3)}",
    )


def _end_check(settings_name: str, spread: float) -> Check:
    """Checks that all ascents from the circle end at one point.

    Args:
        settings_name: whose settings they are, for the text: "our" or "the paper’s".
        spread: spread of the end points, in posterior standard deviations.

    Returns:
        The check.
    """
    return Check(
        rule=f"with {settings_name} settings, ascents from fifty priors on a circle end within {MAX_END_SPREAD:g} "
        "posterior standard deviations of each other",
        holds=spread < MAX_END_SPREAD,
        finding=f"with {settings_name} settings, the ends from fifty priors scatter by {rounded(spread, 3)} posterior "
        "standard deviations",
    )


def free_energy_at(model: GenerativeModel, posterior: Posterior, a: float, b: float) -> float:
    """Returns F̄ᵒ at other values of A and B, with every covariance optimal there.

    Args:
        model: the generative model; its prior counts.
        posterior: posterior whose states, λ and C are kept.
        a: parameter A, 1/s.
        b: parameter B, 1/s.

    Returns:
        F̄ᵒ, nats.
    """
    moments = replace(posterior.moments, model=model)
    # θ is A, B and C.
    theta = np.array([a, b, posterior.theta[2]])
    moved_posterior = posterior._replace(moments=moments, theta=theta)
    return sum(free_energy_terms(with_optimal_covariances(moved_posterior)).values())


def free_energy_at_estimate(model: GenerativeModel, posterior: Posterior) -> float:
    """Returns F̄ᵒ, nats, at the posterior means of A and B: the height of the peak."""
    a, b = posterior.theta[:2]
    return free_energy_at(model, posterior, a, b)


def curvature_along_a(posterior: Posterior) -> float:
    """Returns the curvature of F̄ᵒ along A at the posterior means: the A entry of Π^θ, Eq. ``Pi_curvature``."""
    covariance_of_a_and_b = posterior.theta_covariance[:2, :2]
    return float(np.linalg.inv(covariance_of_a_and_b)[0, 0])


def circle_ascents(
    settings: ScalarSettings, samples: SufficientStatistics
) -> list[list[Posterior]]:
    """Maximises F̄ᵒ from each of ``PRIOR_COUNT`` priors, whose means of A and B lie at random places on a circle.

    The paper shows by such ascents that all of them end at the same peak.

    Args:
        settings: settings of DEM except the prior means.
        samples: the data.

    Returns:
        For each prior, the posterior at the start and after each iteration.
    """
    angles = default_rng(0).uniform(0, 2 * np.pi, PRIOR_COUNT)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    prior_means = CIRCLE_CENTRE + CIRCLE_RADIUS * directions
    ascents = []
    for mean_of_A, mean_of_B in prior_means.tolist():
        # The third parameter is C, which is 1 in the true system.
        settings_with_prior = replace(settings, theta_mean=(mean_of_A, mean_of_B, 1.0))
        ascent = posterior_after_each_round(settings_with_prior.model(), samples, CIRCLE_ITERATIONS)
        ascents.append(ascent)
    return ascents


def end_spread(ascents: list[list[Posterior]]) -> float:
    """Returns by how much the parameters at the ends of ascents differ, in units of their posterior uncertainty.

    Args:
        ascents: posterior after each iteration, for each prior. The first ascent gives the posterior standard
            deviation.

    Returns:
        The standard deviation over the ends, relative to the posterior's: that of A or of B, whichever is larger.
    """
    # The first two of the three parameters are A and B.
    end_points = np.array([posteriors[-1].theta[:2] for posteriors in ascents])
    first_end = ascents[0][-1]
    posterior_sd = np.sqrt(np.diag(first_end.theta_covariance)[:2])
    relative_sd = end_points.std(axis=0) / posterior_sd
    return float(relative_sd.max())


def draw_manifolds(model: GenerativeModel, posteriors: list[Posterior]) -> Figure:
    """Draws F̄ᵒ over A and B at the iterations ``ITERATIONS_SHOWN``, side by side.

    Args:
        model: model of the scalar system.
        posteriors: posterior after each of these iterations.

    Returns:
        The figure.
    """
    with new_figure(height=1.8) as figure:
        panels = figure.subplots(1, len(posteriors), sharey=True)
        for axes, iteration, posterior in zip(panels, ITERATIONS_SHOWN, posteriors, strict=True):
            _draw_manifold(axes, model, posterior)
            axes.set_title(f"iteration {iteration}" if iteration else "prior")
        panels[0].set_ylabel("B")
        return figure


def draw_ascents(model: GenerativeModel, ascents: list[list[Posterior]]) -> Figure:
    """Draws the paths of ascents over A and B, on F̄ᵒ as it is after the last iteration of the first ascent.

    Args:
        model: model of the scalar system.
        ascents: posterior after each iteration, for each prior of the circle.

    Returns:
        The figure.
    """
    with new_figure(height=2.8) as figure:
        axes = figure.subplots()
        _draw_manifold(axes, model, ascents[0][-1])
        for posteriors in ascents:
            # The first two parameters are A and B.
            path = np.array([posterior.theta[:2] for posterior in posteriors])
            axes.plot(path[:, 0], path[:, 1], ".-", color="white", linewidth=0.5, markersize=2)
        axes.set_ylabel("B")
        return figure


def _draw_manifold(axes: Axes, model: GenerativeModel, posterior: Posterior) -> None:
    """Draws F̄ᵒ over A and B as contours, with the true parameters and the posterior means.

    The colour is the distance below the peak, with contours at ``CONTOUR_LEVELS``.

    Args:
        axes: axes to draw into.
        model: model of the scalar system.
        posterior: posterior, whose states and covariances F̄ᵒ is computed with.
    """
    # Contours need an array (B, A): rows are values of B, columns values of A.
    rows = []
    for b in GRID_B:
        rows.append([free_energy_at(model, posterior, a, b) for a in GRID_A])
    free_energy = np.array(rows)
    nats_below_peak = np.maximum(free_energy.max() - free_energy, MIN_NATS_BELOW_PEAK)
    lowest_level, highest_level = OUTER_CONTOUR_LEVELS
    contours = axes.contourf(
        GRID_A,
        GRID_B,
        nats_below_peak,
        [lowest_level, *CONTOUR_LEVELS, highest_level],
        cmap="viridis_r",
        norm=LogNorm(*COLOUR_RANGE),
    )
    # As vectors, the filled contours would make the page large.
    contours.set_rasterized(True)
    axes.plot(TRUE_A, TRUE_B, "+", color=TRUTH, markersize=9)
    a, b = posterior.theta[:2]
    axes.plot(a, b, "o", color="white", markeredgecolor=INK_ON_LIGHT, markersize=4)
    axes.set(xlabel="A", aspect="equal")
