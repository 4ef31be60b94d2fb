"""The landscape of the free energy: the peak rises and sharpens, and ascents from a circle of priors end at it."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark

from mavdem.experiments.paper import landscape
from mavdem.experiments.paper.scalar_system import TRUE_A, TRUE_B

pytestmark = mark.slow


@mark.in_full
def test_priors_end_at_one_point_but_not_under_the_papers_settings(monkeypatch):
    """Ten priors on a circle converge to the maximum of the free energy, which has the numbers of the paper."""
    for grid in ("GRID_A", "GRID_B"):
        monkeypatch.setattr(landscape, grid, getattr(landscape, grid)[::14])
    monkeypatch.setattr(landscape, "PRIOR_COUNT", 10)
    result = landscape.run(None)
    assert [check.holds for check in result.checks] == [True, True, False]
    assert result.numbers["peak"] == approx([-143579.0, -43661.0, -529.97, 355.35, 409.02], 1e-3)
    curvatures = [14332.7, 26663.4, 60605.2, 77665.6, 93184.8]
    assert result.numbers["curvature_along_A"] == approx(curvatures, 1e-3)
    assert result.numbers["ends_over_posterior_sd"]["the paper’s"] == approx(3.91, 0.05)
    _, ascent_picture = result.pictures
    (axes,) = ascent_picture.draw().axes
    assert (axes.get_xlim(), axes.get_ylim()) == ((-10, 4), (-4, 10))
    lines = [line.get_xydata() for line in axes.lines]
    truth = lines[0]
    estimate = lines[1]
    paths = lines[2:]
    assert truth.tolist() == [[TRUE_A, TRUE_B]]
    assert len(paths) == 10
    starts = np.array([path[0] for path in paths])
    ends = np.array([path[-1] for path in paths])
    assert_allclose(np.linalg.norm(starts - landscape.CIRCLE_CENTRE, axis=1), 5.0)
    assert_allclose(ends, np.broadcast_to(estimate, ends.shape), rtol=1e-4)
