"""What the page on section IV shows of the algorithm is so."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark

from mavdem.experiments.paper import landscape
from mavdem.experiments.paper.landscape import A, B


@mark.slow
def test_fifty_priors_end_at_one_point_but_not_under_the_papers_settings(monkeypatch):
    for axis in ("AXIS_A", "AXIS_B"):
        monkeypatch.setattr(landscape, axis, getattr(landscape, axis)[::14])
    result = landscape.run(None)
    assert [check.holds for check in result.checks] == [True, True, False]
    assert result.numbers["peak"] == approx([-143579.0, -43661.0, -529.97, 355.35, 409.02], 1e-3)
    sharpness = [14332.7, 26663.4, 60605.2, 77665.6, 93184.8]
    assert result.numbers["curvature_along_A"] == approx(sharpness, 1e-3)
    assert result.numbers["ends_over_posterior_sd"]["the paper’s"] == approx(4.34, 0.05)
    _, (axes,) = (picture.draw().axes for picture in result.pictures)
    assert (axes.get_xlim(), axes.get_ylim()) == ((-10, 4), (-4, 10))
    truth, estimate, *paths = (line.get_xydata() for line in axes.lines)
    assert truth.tolist() == [[A, B]]
    starts, ends = np.moveaxis([path[[0, -1]] for path in paths], 1, 0)
    assert len(paths) == 50
    assert_allclose(np.linalg.norm(starts - landscape.CENTRE, axis=1), 5.0)
    assert_allclose(ends, np.broadcast_to(estimate, ends.shape), rtol=1e-4)
