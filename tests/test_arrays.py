"""Functions of arrays in place of those of SciPy that are slow to import, against theirs."""

import subprocess
import sys

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark
from recorded_flights import LOGS
from scipy.integrate import cumulative_trapezoid
from scipy.stats import t as student_t

from mavdem.arrays import cumulative_integral
from mavdem.confidence import CONFIDENCE_LEVEL, coverage_factor, student_t_log_density


@mark.parametrize("shape", [(1,), (7,), (7, 3)])
def test_the_cumulative_integral_is_that_of_scipy(shape):
    rng = default_rng(0)
    values = rng.standard_normal(shape)
    time = np.cumsum(rng.uniform(0.1, 1.0, len(values)))
    expected = cumulative_trapezoid(values, time, axis=0, initial=0)
    assert_array_equal(cumulative_integral(values, np.diff(time)), expected)


def test_the_density_of_student_s_distribution_is_that_of_scipy():
    values = np.array([-30.0, -1.0, 0.0, 2.5])
    for freedom in (1.0, 4.5, 200.0):
        expected = student_t.logpdf(values, freedom)
        assert_allclose(student_t_log_density(values, freedom), expected, rtol=1e-9)


@mark.parametrize("freedom", [1, 2, 3, 4, 32, 100, 4.5, np.inf])
@mark.parametrize("level", [0.5, CONFIDENCE_LEVEL, 0.999])
def test_the_quantiles_of_student_s_distribution_are_those_of_scipy(level, freedom):
    expected = student_t.ppf(0.5 + level / 2, freedom)
    assert_allclose(coverage_factor(level, freedom), expected, rtol=1e-10)
    assert_allclose(coverage_factor(level, np.array([freedom])), [expected], rtol=1e-10)


@mark.slow
def test_a_log_from_which_nothing_is_learned_is_reviewed_without_the_slow_parts_of_scipy(tmp_path):
    slow_parts = {
        f"scipy.{name}"
        for name in (
            "fft",
            "integrate",
            "linalg",
            "ndimage",
            "optimize",
            "signal",
            "special",
            "stats",
        )
    }
    program = f"""
import sys
from mavdem.cli.commands import main
sys.argv[1:] = {["review", str(LOGS / "ardupilot_default_rates.tlog"), "--out", str(tmp_path / "out")]}
assert main() == 0
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "mavdem.cli.review" in done.stdout and not slow_parts & set(done.stdout.split())
