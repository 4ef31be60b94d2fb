"""The process that learns stands back behind the others, and is replaced when it is killed."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures import BrokenExecutor

import pytest

from mavdem.live.session import LOW_PRIORITY, LearningProcess


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
        assert executor.submit(os.nice, 0).result() - os.nice(0) == min(LOW_PRIORITY, 19 - os.nice(0))
    with pytest.raises(ProcessLookupError):
        os.kill(second, 0)
