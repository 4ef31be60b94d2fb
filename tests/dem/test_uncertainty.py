"""Half widths of intervals, and where there are none."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark, raises
from simulated import simulated

from mavdem import Settings, learn
from mavdem.confidence import coverage_factor, half_width, require_probability


@mark.slow
def test_without_a_simulation_error_fit_no_interval_is_reported():
    assert np.isnan(learn(simulated(wind=0.5)[:700], Settings.paper()).model_interval().A).all()


@mark.parametrize("level", [0, 1, np.nan, "x", True])
def test_a_level_that_is_no_probability_is_named(level):
    with raises(ValueError, match="^level must"):
        require_probability(level)


def test_half_widths_are_those_of_normal_deviations_or_of_students():
    widths = half_width(np.array([1.0, 4.0, 4.0]), 0.9, [np.inf, np.inf, 3.0])
    assert_allclose(widths, [1.645, 3.290, 4.707], rtol=1e-3)
    assert coverage_factor() == approx(float(half_width(1.0)))
