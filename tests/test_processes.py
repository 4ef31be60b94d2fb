"""What processes do on every operating system."""

import platform
import resource

import numpy as np
from pytest import mark

from mavdem.processes import keep_freed_memory


@mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no such setting")
def test_freed_memory_is_kept_for_the_next_arrays():
    keep_freed_memory()
    np.ones(10**6)
    faults_before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(100):
        np.ones(10**6)
    # Memory that is taken from the system anew has 2,000 page faults for each array.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_minflt - faults_before < 10_000
