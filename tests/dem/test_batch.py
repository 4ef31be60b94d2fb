import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.random import default_rng
from pytest import fixture, mark, raises

from mavdem import Flight, Learned, Settings, learn, learn_many
from mavdem.dem.parallel import JOBS_AHEAD, MAX_SERIAL_JOBS
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.model import WorkerFact

pytestmark = mark.slow


def walk(seed):
    """Random walks: there is something to fit, quickly; what it is does not matter here."""
    rng = default_rng(seed)
    motors, motion = (rng.standard_normal((100, columns)).cumsum(axis=0) for columns in (2, 2))
    return Flight(0.01 * np.arange(100), motors, motion)


STILL = Flight(0.01 * np.arange(100), walk(0).inputs, np.zeros((100, 2)))
PATH = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
FLIGHTS = [walk(seed) for seed in range(3)]
JOBS = [
    (
        FLIGHTS[k % 3],
        Settings(order=2 + k % 2, window=3 + 2 * (k % 4), parameter_precision=1.0, iterations=5),
    )
    for k in range(2 * MAX_SERIAL_JOBS)
]
JOBS[5] = (STILL, None)


def as_texts(answers):
    """JSON keeps every bit of a number."""
    return [
        str(answer) if isinstance(answer, ValueError) else answer.to_json() for answer in answers
    ]


def answer(train, settings):
    try:
        return learn(train, settings)
    except ValueError as error:
        return error


@fixture(scope="module")
def expected():
    return as_texts(answer(*job) for job in JOBS)


@fixture
def two_workers(monkeypatch):
    monkeypatch.setattr("mavdem.dem.parallel.available_workers", lambda: 2)


def test_the_machines_cores_answer_as_learn_does_and_in_order(two_workers, expected):
    answers = learn_many(JOBS)
    first = next(answers)
    assert len(multiprocessing.active_children()) == 2
    assert as_texts([first, *answers]) == expected
    assert len(set(expected)) > len(JOBS) / 2  # Otherwise another order would not show.
    assert not multiprocessing.active_children()


def test_a_job_without_an_answer_is_answered_by_its_error():
    answers = list(learn_many(JOBS[4:7]))  # For so few jobs no process starts.
    assert [type(each) for each in answers] == [Learned, NotLearnable, Learned]
    assert str(answers[1]) == str(answer(STILL, None))
    wrong = list(learn_many([(FLIGHTS[0], "none"), (FLIGHTS[0], {}), JOBS[0]]))
    assert [str(each).startswith("settings must be") for each in wrong] == [True, True, False]


@mark.in_full
def test_a_given_executor_does_the_work_and_is_left_open(expected):
    with ThreadPoolExecutor(3) as executor:
        assert list(learn_many([], executor)) == list(learn_many([])) == []
        assert as_texts(learn_many(JOBS, executor)) == expected
        assert executor.submit(int, "3").result() == 3


@mark.in_full
def test_a_killed_worker_is_reported(two_workers):
    answers = learn_many(repeat(JOBS[0]))
    next(answers)
    os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)
    with raises(BrokenProcessPool, match="a worker died"):
        for _ in answers:
            pass
    assert not multiprocessing.active_children()


class Postponing(Executor):
    """Does a job when its result is asked for."""

    def __init__(self):
        self.futures = []

    def submit(self, function, /, *arguments):
        future = Future()
        future.result = lambda timeout=None: function(*arguments)
        self.futures.append(future)
        return future


def test_a_bounded_number_is_on_its_way_and_cancelled_at_the_end():
    executor = Postponing()
    answers = learn_many(repeat(JOBS[0]), executor)
    for taken in range(3):
        assert isinstance(next(answers), Learned)
        assert len(executor.futures) == JOBS_AHEAD + taken
    answers.close()
    # The first two jobs are over, and the third has been asked for.
    assert all(future.cancelled() for future in executor.futures[3:])


def test_workers_start_no_workers_of_their_own_and_end_with_a_killed_parent(tmp_path):
    """The script ends when all processes have that hold its output."""
    script = tmp_path / "script.py"
    script.write_text(
        "import os, signal\nfrom mavdem.dem.parallel import process_pool, available_workers\n"
        "if __name__ == '__main__':\n"
        "    with process_pool(2) as executor:\n"
        "        print(executor.submit(available_workers).result(), flush=True)\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run(
        [sys.executable, script], env=PATH, capture_output=True, text=True, timeout=300
    )
    assert ended.returncode == -signal.SIGKILL and ended.stdout == "1\n"


def test_a_script_that_its_workers_import_anew_starts_no_others(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from mavdem.dem.parallel import process_pool\nwith process_pool(1):\n    pass\n"
    )
    words = [sys.executable, script]
    ended = subprocess.run(words, env=PATH, stderr=subprocess.PIPE, text=True, timeout=300)
    assert str(Fact(WorkerFact.SCRIPT_IMPORTED_BY_WORKER)) in ended.stderr


def test_threads_that_learn_take_turns(monkeypatch):
    """Six threads learn the same model: no two may be in the fit at a time, and all get the same result."""

    def slow_complete_settings(*arguments):
        assert turn.acquire(blocking=False)
        time.sleep(0.01)  # The other threads run meanwhile.
        turn.release()
        return fit_them(*arguments)

    turn = threading.Lock()
    fit_them = sys.modules["mavdem.dem.learning"].complete_settings
    monkeypatch.setattr(
        sys.modules["mavdem.dem.learning"], "complete_settings", slow_complete_settings
    )
    with ThreadPoolExecutor(3) as executor:
        answers = list(executor.map(learn, [FLIGHTS[0]] * 6, [JOBS[0][1]] * 6))
    assert len({answer.to_json() for answer in answers}) == 1
