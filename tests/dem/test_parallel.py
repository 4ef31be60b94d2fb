"""Processes beside this one: the one that learns beside a stream, and pools that start at once."""

import os
import signal
import socket
import sys
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from subprocess import PIPE, run

from pytest import mark, raises

from mavdem.dem.parallel import LOW_PRIORITY, LearningProcess, process_pool
from mavdem.processes import resource_use

pytestmark = mark.slow


def test_a_process_that_is_killed_is_replaced():
    with LearningProcess() as executor:
        first = executor.submit(os.getpid).result()
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.bind(("127.0.0.1", 0))
        address = link.getsockname()
        lost = executor.submit(time.sleep, 3600)
        os.kill(first, signal.SIGKILL)
        with raises(BrokenExecutor):
            lost.result(timeout=300)
        second = executor.submit(os.getpid).result()
        assert second not in (first, os.getpid())
        # A link that is opened again, while the process lives, is not held open by it.
        link.close()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reopened:
            reopened.bind(address)
        assert executor.submit(os.nice, 0).result() - os.nice(0) == min(
            LOW_PRIORITY, 19 - os.nice(0)
        )
        executor.submit(time.sleep, 3600)  # which is not waited for
    with raises(ProcessLookupError):
        os.kill(second, 0)


def test_a_suspended_process_takes_no_time_and_goes_on_where_it_was():
    with LearningProcess() as executor:
        pid = executor.submit(os.getpid).result()
        counting = executor.submit(exec, "for _ in range(3_000_000): pass")
        executor.suspend(True)
        # The process pauses soon, not at once.
        time.sleep(0.3)
        before = resource_use(pid).processor_seconds
        waiting = executor.submit(os.getpid)
        with raises(TimeoutError):
            waiting.result(timeout=0.5)
        assert resource_use(pid).processor_seconds - before < 0.1
        executor.suspend(False)
        counting.result(timeout=300)
        assert waiting.result(timeout=300) == pid


def test_a_suspended_process_ends_when_its_parent_is_killed():
    script = (
        "import os, signal, time\nfrom mavdem.dem.parallel import LearningProcess\n"
        "learner = LearningProcess()\n"
        "learner.submit(exec, 'while True: pass')\n"
        "learner.suspend(True)\n"
        "time.sleep(0.3)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    # In a session of its own, as a service is, no terminal ends the processes that are left. All of them have the
    # output, so that this waits for their end.
    command = [sys.executable, "-c", script]
    ended = run(command, stdout=PIPE, start_new_session=True, timeout=60)
    assert ended.returncode == -signal.SIGKILL


def test_pools_that_are_started_at_once_know_their_own_processes():
    def pids(_):
        with process_pool(1) as executor:
            (process,) = executor.processes
            return process.pid, executor.submit(os.getpid).result()

    with ThreadPoolExecutor(2) as threads:
        assert all(known == own for known, own in threads.map(pids, range(2)))
