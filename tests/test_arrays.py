"""Functions of arrays in place of those of SciPy that are slow to import, against theirs."""

import subprocess
import sys

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter
from scipy.stats import t as student_t

from mavdem.arrays import cumulative_integral
from mavdem.confidence import student_t_log_density
from sitl_scenarios.turbulence import dryden_longitudinal


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


@mark.slow
def test_commands_import_no_slow_part_of_scipy_and_a_fleet_s_supervisor_none_that_reads_logs():
    """A new process imports two commands and lists the loaded modules after each; then it draws turbulence."""
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
    program = (
        "import sys, mavdem.cli.track; print(*sys.modules)\n"
        "import mavdem.cli.review; print(*sys.modules)\n"
        "from numpy.random import default_rng\n"
        "from sitl_scenarios.turbulence import dryden_longitudinal\n"
        "dryden_longitudinal(2.0, 0.5, 9, default_rng(1)); print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    modules_of_track, modules_of_review, modules_of_flight = done.stdout.splitlines()
    # What reads logs takes a second to import, for which the process that supervises the readers does not wait.
    assert "mavdem.fleet.workers" in modules_of_track.split()
    slow_readers = {"mavdem.assessment", "mavdem.dem.engine.linalg"}
    assert not slow_readers & set(modules_of_track.split())
    assert not slow_parts & set(modules_of_review.split())
    assert "scipy.signal" not in modules_of_flight.split()


def test_dryden_s_turbulence_is_the_recursion_of_scipy():
    speeds = dryden_longitudinal(2.0, 0.5, 9, default_rng(1))
    decay = np.exp(-0.5 / 2.0)
    drive = default_rng(1).standard_normal(9)
    drive[1:] *= np.sqrt(1 - decay**2)
    assert_allclose(speeds, lfilter([1.0], [1.0, -decay], drive), rtol=1e-12)
