"""Tests of coverage factors."""

import sys
from subprocess import run

import numpy as np
import scipy
from numpy.testing import assert_allclose
from pytest import mark

from mavdem.confidence import coverage_factor


@mark.parametrize("level", [0.5, 0.9, 0.99, 0.999])
def test_coverage_factors_are_the_quantiles_of_scipy(level):
    freedoms = np.array([[1.0, 1.5, 2.0, 4.0], [11.5, 1e3, 1e5, np.inf]])
    expected = scipy.special.stdtrit(freedoms, 0.5 + level / 2)
    expected[1, 3] = scipy.special.ndtri(0.5 + level / 2)
    assert_allclose(coverage_factor(level, freedoms), expected, rtol=1e-7)
    assert coverage_factor(level, 4) == coverage_factor(level, freedoms)[0, 3]


def test_modules_of_a_review_and_its_intervals_load_no_part_of_scipy():
    program = """
import sys
import mavdem.cli.review
from mavdem.confidence import coverage_factor
coverage_factor(freedom=12)
print([part for part in ("fft", "linalg", "ndimage", "special") if f"scipy.{part}" in sys.modules])
"""
    result = run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout == "[]\n"
