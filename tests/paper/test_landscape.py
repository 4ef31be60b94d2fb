"""What the page on section IV shows of the algorithm is so."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pytest

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.paper.landscape import cases, circle, cross_sections, manifold
from mavdem.paper.landscape.manifold import value_at
from mavdem.paper.landscape.scalar_system import PAPER, PAPER_WORLD, A, B, ScalarSettings, ScalarWorld

ITERATIONS = 20
"""These cases converge in at most six."""
NAMED = {case.name: case for case in cases.CASES}


@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_system_obeys_its_equation(order):
    # Without noise worth the name, derivatives of every order obey it exactly.
    outputs, inputs = ScalarWorld(lambda_z=100.0, lambda_w=100.0).generalized(order + 1, seed=0)
    expected = A * outputs[:, order] + B * inputs[:, order]
    np.testing.assert_allclose(outputs[:, order + 1], expected, atol=1e-9 * np.abs(expected).max())


def test_the_noise_has_its_size_and_colour():
    # The state shows w without the input; its equation gives w back.
    world = ScalarWorld(duration=20_000.0, lambda_z=100.0, amplitude=0.0)
    outputs, _ = world.generalized(1, seed=0)
    w = outputs[:, 1] - A * outputs[:, 0]
    independent = world.duration / (3.5 * world.smoothness)
    lag = round(2 * world.smoothness / world.step)
    deviation = np.exp(-world.lambda_w / 2)
    # A variance of N independent samples is known to √(2/N), a correlation to √(1/N): four of each.
    assert w.std() == pytest.approx(deviation, rel=4 * np.sqrt(2 / independent) / 2)
    assert np.mean(w[lag:] * w[:-lag]) / w.var() == pytest.approx(np.exp(-1), abs=4 / np.sqrt(independent))


@pytest.mark.slow
def test_fifty_priors_end_at_one_point():
    paths = circle.ascents(ScalarSettings(), ScalarSettings().samples(ScalarWorld(), seed=0))
    ends = np.array([beliefs[-1].theta[:2] for beliefs in paths])
    deviation = np.sqrt(np.diag(paths[0][-1].theta_covariance)[:2])
    starts = np.array([beliefs[0].theta[:2] for beliefs in paths])
    np.testing.assert_allclose(np.linalg.norm(starts - circle.CENTRE, axis=1), circle.RADIUS)
    assert (ends.std(axis=0) < deviation / 100).all()


@pytest.mark.slow
def test_fifty_priors_do_not_under_the_papers_settings():
    paths = circle.ascents(PAPER, PAPER.samples(PAPER_WORLD, seed=0))
    ends = np.array([beliefs[-1].theta[:2] for beliefs in paths])
    assert (ends.std(axis=0) > np.sqrt(np.diag(paths[0][-1].theta_covariance)[:2])).all()


def test_the_peak_rises_and_sharpens_from_round_to_round():
    model, samples = ScalarSettings().model(), ScalarSettings().samples(ScalarWorld(), seed=0)
    drawn = [plain_rounds(model, samples, max(manifold.ITERATIONS))[i] for i in manifold.ITERATIONS]
    assert (np.diff([value_at(model, samples, belief, *belief.theta[:2]) for belief in drawn]) > 0).all()
    assert (np.diff([manifold.curvature(belief) for belief in drawn]) > 0).all()
    assert (np.diff([-np.linalg.slogdet(belief.theta_covariance)[1] for belief in drawn]) > 0).all()


def test_where_the_precision_is_known_the_peak_rises_but_its_cross_section_does_not_narrow():
    _, world, settings = cross_sections.CASES[1]
    model, samples = settings.model(), settings.samples(world, seed=0)
    first, *_, last = plain_rounds(model, samples, cross_sections.ITERATIONS)
    heights = [value_at(model, samples, belief, *belief.theta[:2]) for belief in (first, last)]
    assert heights[1] > heights[0]
    assert manifold.curvature(last) < manifold.curvature(first)


def test_the_curvature_is_that_of_the_drawn_manifold():
    # With the precisions known; where λ's uncertainty depends on θ, F̄ᵒ curves with ln|Σ^λ| too.
    _, world, settings = cross_sections.CASES[1]
    model, samples = settings.model(), settings.samples(world, seed=0)
    belief = plain_rounds(model, samples, cross_sections.ITERATIONS)[-1]
    a, b = belief.theta[:2]
    step = 0.1
    left, middle, right = (value_at(model, samples, belief, a + k * step, b) for k in (-1, 0, 1))
    # The state entropy, which the posterior precision leaves out, adds some nats of T = 320.
    assert -(left - 2 * middle + right) / step**2 == pytest.approx(manifold.curvature(belief), rel=0.01)


def test_these_settings_end_at_the_truth():
    end = cases.run_case(NAMED["these settings"], ITERATIONS)
    assert end.within > cases.NOISES / 2
    assert (np.abs(end.mean - [A, B]) < end.posterior).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["the paper's settings", "… q = p", "… P^θ = e⁴", "… every sample used"])
def test_these_settings_are_needed(name):
    end = cases.run_case(NAMED[name], ITERATIONS)
    assert end.within < cases.NOISES / 2


def test_the_papers_settings_end_in_one_round_outside_their_own_interval():
    beliefs = plain_rounds(PAPER.model(), PAPER.samples(PAPER_WORLD, seed=0), cross_sections.ITERATIONS)
    end = beliefs[-1]
    deviation = np.sqrt(np.diag(end.theta_covariance)[:2])
    assert (np.abs(end.theta[:2] - [A, B]) > 3 * deviation).all()
    for belief in beliefs[1:]:
        assert (np.abs(belief.theta[:2] - end.theta[:2]) < deviation).all()
        assert manifold.curvature(belief) == pytest.approx(manifold.curvature(end), rel=0.01)


def test_cross_sections_pass_through_their_estimates():
    settings, world = ScalarSettings(), ScalarWorld()
    model, samples = settings.model(), settings.samples(world, seed=0)
    beliefs = plain_rounds(model, samples, cross_sections.ITERATIONS)
    figure, axes = plt.subplots()
    cross_sections.draw_cross_sections(axes, model, samples, beliefs, 0)
    curve, circle_ = axes.lines[:2]
    x, y = (float(value[0]) for value in (circle_.get_xdata(), circle_.get_ydata()))
    # Between the grid's points a curve is drawn straight, and so below a concave one by step² / 8 of its curvature.
    slack = manifold.curvature(beliefs[0]) * 0.05**2 / 8 / cross_sections.THOUSAND
    assert np.interp(x, curve.get_xdata(), curve.get_ydata()) == pytest.approx(y, abs=2 * slack)
    plt.close(figure)
