"""The process that learns beside a stream."""

import os
import signal
import time
from concurrent.futures import BrokenExecutor

import pytest

from mavdem.dem.parallel import LOW_PRIORITY, LearningProcess


@pytest.mark.slow
def test_a_process_that_is_killed_is_replaced():
    with LearningProcess() as executor:
        first = executor.submit(os.getpid).result()
        lost = executor.submit(time.sleep, 3600)
        os.kill(first, signal.SIGKILL)
        with pytest.raises(BrokenExecutor):
            lost.result(timeout=300)
        second = executor.submit(os.getpid).result()
        assert second not in (first, os.getpid())
        assert executor.submit(os.nice, 0).result() - os.nice(0) == min(
            LOW_PRIORITY, 19 - os.nice(0)
        )
        executor.submit(time.sleep, 3600)  # which is not waited for
    with pytest.raises(ProcessLookupError):
        os.kill(second, 0)
