"""Processes beside this one: the one that learns beside a stream, and pools that start at once."""

import os
import signal
import socket
import sys
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from subprocess import PIPE, run

from patience import until
from pytest import fixture, mark, raises, skip

from mavdem.dem import parallel
from mavdem.dem.parallel import LOW_PRIORITY, LearningProcess, in_second_process, process_pool
from mavdem.processes import resource_use

pytestmark = mark.slow


def test_a_process_that_is_killed_is_replaced():
    """The job of a killed process fails; the next one runs in a new process."""
    with LearningProcess() as executor:
        first_process_id = executor.submit(os.getpid).result()
        udp_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        udp_socket.bind(("127.0.0.1", 0))
        address = udp_socket.getsockname()
        endless_job = executor.submit(time.sleep, 3600)
        os.kill(first_process_id, signal.SIGKILL)
        with raises(BrokenExecutor):
            endless_job.result(timeout=300)
        second_process_id = executor.submit(os.getpid).result()
        assert second_process_id not in (first_process_id, os.getpid())
        # A link that is opened again, while the process lives, is not held open by it.
        udp_socket.close()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reopened:
            reopened.bind(address)
        # Tests that are run with a still lower priority, as beside other work, have processes of that.
        assert executor.submit(os.nice, 0).result() == max(LOW_PRIORITY, os.nice(0))
        executor.submit(time.sleep, 3600)  # Nobody waits for this job.
    with raises(ProcessLookupError):
        os.kill(second_process_id, 0)


KILLED_WHILE_IT_WRITES = """
import os, signal, struct, sys
from concurrent.futures import BrokenExecutor
from mavdem.dem.parallel import LearningProcess

def write_half_a_result():
    frame = sys._getframe()
    while "result_queue" not in frame.f_locals:
        frame = frame.f_back
    os.write(frame.f_locals["result_queue"]._writer.fileno(), struct.pack("!i", 1000) + b"half")
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    executor = LearningProcess(niceness=0)
    try:
        executor.submit(write_half_a_result).result(20)
    except BrokenExecutor:
        print("broken", executor.submit(abs, -3).result(20))
    executor.shutdown()
"""


@mark.in_full
def test_a_process_that_is_killed_while_it_writes_its_result_is_not_waited_for(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(KILLED_WHILE_IT_WRITES)
    ended = run([sys.executable, script], stdout=PIPE, timeout=60, check=True)
    assert ended.stdout.split() == [b"broken", b"3"]


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


@mark.in_full
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


@fixture
def two_cores(monkeypatch):
    """A machine with two cores, and a test that no other thread runs beside."""
    if sys.platform != "linux":
        skip("processes are copied on Linux only")
    monkeypatch.setattr(parallel, "available_workers", lambda: 2)
    monkeypatch.setattr(parallel, "_is_fork_safe", lambda: True)


def test_a_second_process_returns_what_the_function_returns(two_cores):
    with in_second_process(lambda: (os.getpid(), "result")) as result:
        pid, text = result()
    assert (text, pid != os.getpid()) == ("result", True)


def test_an_error_in_a_second_process_and_its_end_leave_the_work_to_the_caller(two_cores):
    """The function fails, its process is killed, or its result cannot be sent back: the result is None."""
    with in_second_process(lambda: 1 / 0) as result:
        assert result() is None
    with in_second_process(lambda: os.kill(os.getpid(), signal.SIGKILL)) as result:
        assert result() is None
    # A function cannot be pickled.
    with in_second_process(lambda: lambda: None) as result:
        assert result() is None


def test_a_second_process_ends_with_its_block_and_takes_no_interrupt(two_cores, tmp_path):
    """The second process would sleep for an hour.

    It must ignore an interrupt of its own and end as soon as the block is left.
    """
    number = tmp_path / "pid"

    def work():
        number.write_text(f"{os.getpid()}\n", encoding="utf-8")
        time.sleep(3600)

    began = time.monotonic()
    with raises(KeyboardInterrupt), in_second_process(work):
        until(lambda: number.exists() and number.read_text(encoding="utf-8").endswith("\n"))
        pid = int(number.read_text(encoding="utf-8"))
        os.kill(pid, signal.SIGINT)
        time.sleep(0.1)
        os.kill(pid, 0)
        raise KeyboardInterrupt
    with raises(ProcessLookupError):
        os.kill(pid, 0)
    assert time.monotonic() - began < 600


def test_there_is_no_second_process_without_a_second_core(monkeypatch):
    monkeypatch.setattr(parallel, "available_workers", lambda: 1)
    with in_second_process(os.getpid) as result:
        assert result() is None
