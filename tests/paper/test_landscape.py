"""What the page on section IV shows of the algorithm is so."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import mark

from mavdem.dem.engine.ascent import plain_rounds
from mavdem.paper import landscape
from mavdem.paper.landscape import (
    PAPER,
    PAPER_WORLD,
    A,
    B,
    ScalarSettings,
    ScalarWorld,
    curvature,
    peak,
)


@mark.slow
@mark.parametrize("settings, world", [(ScalarSettings(), ScalarWorld()), (PAPER, PAPER_WORLD)])
def test_fifty_priors_end_at_one_point_but_not_under_the_papers_settings(settings, world):
    paths = landscape.ascents(settings, settings.samples(world, seed=0))
    ends, deviation = landscape.ends(paths)
    starts = np.array([beliefs[0].theta[:2] for beliefs in paths])
    assert_allclose(np.linalg.norm(starts - landscape.CENTRE, axis=1), landscape.RADIUS)
    scatter = ends.std(axis=0) / deviation
    assert (scatter > 1).all() if settings is PAPER else (scatter < 0.01).all()


def test_the_peak_rises_and_sharpens_from_round_to_round():
    model = ScalarSettings().model()
    samples = ScalarSettings().samples(ScalarWorld(), seed=0)
    drawn = [plain_rounds(model, samples, max(landscape.DRAWN))[i] for i in landscape.DRAWN]
    assert (np.diff([peak(model, samples, belief) for belief in drawn]) > 0).all()
    assert (np.diff([curvature(belief) for belief in drawn]) > 0).all()
    assert (np.diff([-np.linalg.slogdet(belief.theta_covariance)[1] for belief in drawn]) > 0).all()


def test_these_settings_end_at_the_truth():
    """Within a posterior standard deviation in the mean over noises, and mostly within the 95 % region."""
    model = ScalarSettings().model()
    ends = [
        plain_rounds(model, ScalarSettings().samples(ScalarWorld(), seed), 20)[-1]
        for seed in range(8)
    ]
    errors = np.array([end.theta[:2] - [A, B] for end in ends])
    precisions = [np.linalg.inv(end.theta_covariance[:2, :2]) for end in ends]
    distances = np.einsum("ni,nij,nj->n", errors, precisions, errors)
    assert (distances < -2 * np.log(0.05)).sum() > len(ends) / 2
    deviation = np.sqrt(np.diag(ends[0].theta_covariance)[:2])
    assert (abs(errors.mean(axis=0)) < deviation).all()
