"""What mavdem does to the machine that it runs on."""

import subprocess
import sys


def test_scipy_is_imported_without_the_modules_of_numpy_that_nobody_needs():
    program = (
        "import sys; from mavdem.machine import import_scipy; import_scipy(); import numpy;"
        "print('scipy.ndimage' in sys.modules, 'numpy.f2py' in sys.modules, numpy.ma.masked,"
        " numpy.testing.assert_allclose(1, 1))"
    )
    printed = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    assert printed == "True False -- None\n"
