"""Processes beside this one: the one that learns beside a stream, and pools that start at once."""

import os
import signal
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor

from pytest import mark, raises

from mavdem.dem.parallel import LOW_PRIORITY, LearningProcess, process_pool

pytestmark = mark.slow


def test_a_process_that_is_killed_is_replaced():
    with LearningProcess() as executor:
        first = executor.submit(os.getpid).result()
        lost = executor.submit(time.sleep, 3600)
        os.kill(first, signal.SIGKILL)
        with raises(BrokenExecutor):
            lost.result(timeout=300)
        second = executor.submit(os.getpid).result()
        assert second not in (first, os.getpid())
        assert executor.submit(os.nice, 0).result() - os.nice(0) == min(
            LOW_PRIORITY, 19 - os.nice(0)
        )
        executor.submit(time.sleep, 3600)  # which is not waited for
    with raises(ProcessLookupError):
        os.kill(second, 0)


def test_a_suspended_process_goes_on_where_it_was():
    with LearningProcess() as executor:
        executor.submit(os.getpid).result()
        executor.suspend(True)
        waiting = executor.submit(os.getpid)
        with raises(TimeoutError):
            waiting.result(timeout=0.3)
        executor.suspend(False)
        assert waiting.result(timeout=300) != os.getpid()


def test_pools_that_are_started_at_once_know_their_own_processes():
    def pids(_):
        with process_pool(1) as executor:
            (process,) = executor.processes
            return process.pid, executor.submit(os.getpid).result()

    with ThreadPoolExecutor(2) as threads:
        assert all(known == own for known, own in threads.map(pids, range(2)))
