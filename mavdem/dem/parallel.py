"""Many calls of one function: on this machine's cores, on threads, or on a cluster.

The processes started here end with their work, also when a signal ends this process.
"""

import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import chain, islice
from multiprocessing import active_children, current_process, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Lock, Thread, current_thread, main_thread
from typing import Any, TypeVar

from mavdem.facts import Fact
from mavdem.facts.model import Workers

Job = TypeVar("Job")
Result = TypeVar("Result")

# up to this many jobs are sooner done in this process than by workers, which take about a second to start
MAX_SERIAL_JOBS = 8

JOBS_AHEAD = 256  # jobs that are sent ahead of the result that is waited for: a given executor may have many workers
# niceness, 0 to 19, of a process that learns beside samples: they do not wait for a core
LOW_PRIORITY = 10
TERMINATION_SIGNALS = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
)  # signals that end a program from outside

_starting = Lock()  # of one pool after the other: new processes are its own
_alone = False  # whether this process starts no others, because others like it have the other cores
_stop_pipe: Connection | None = None
"""In a worker: the end of a pipe that becomes readable when its results are no longer wanted."""


def parallel_map(
    work: Callable[[Job], Result], jobs: Iterable[Job], executor: Executor | None = None
) -> Generator[Result, None, None]:
    """Yields ``work`` of each of many jobs, in their order, as :func:`mavdem.dem.learn_many` does.

    For other processes ``work`` is a function of a module, or a ``partial`` of one, whose jobs and results pickle.
    """
    jobs = iter(jobs)
    if executor is not None:
        yield from _map_on(executor, work, jobs)
        return
    first = list(islice(jobs, MAX_SERIAL_JOBS + 1))
    workers = available_workers() if len(first) > MAX_SERIAL_JOBS else 1
    if workers == 1:
        yield from map(work, chain(first, jobs))
        return
    with process_pool(workers) as executor:
        yield from _map_on(executor, work, chain(first, jobs))


def _map_on(
    executor: Executor,
    work: Callable[[Job], Result],
    jobs: Iterable[Job],
) -> Generator[Result, None, None]:
    """At most ``JOBS_AHEAD`` jobs are on their way."""
    sent: deque[Future[Result]] = deque()
    try:
        for job in jobs:
            sent.append(executor.submit(partial(_unless_stopped, work), job))
            while sent and (len(sent) >= JOBS_AHEAD or sent[0].done()):
                yield sent[0].result()
                sent.popleft()
        while sent:
            yield sent[0].result()
            sent.popleft()
    except BrokenExecutor as error:
        # A broken pool breaks these off itself, and before Python 3.13 it cannot where they are cancelled.
        sent.clear()
        raise type(error)(str(Fact(Workers.WORKER_DIED))) from error
    finally:
        # Workers that a signal to the whole group has ended break a pool, which before Python 3.13 waits for ever
        # where jobs are cancelled.
        if not isinstance(executor, ProcessPool):
            for future in sent:
                future.cancel()


def _unless_stopped(work: Callable[[Job], Result], job: Job) -> Result:
    """``work`` of a job; nothing in a worker whose results nobody waits for, so that it ends soon."""
    # true once the other end is closed: nothing is ever sent
    if _stop_pipe is not None and _stop_pipe.poll():
        raise CancelledError
    return work(job)


def available_workers() -> int:
    """Returns how many workers are worth starting: the cores this process may use, or 1 where it is a worker itself."""
    if _alone or (parent_process() is not None and not _importing_main()):
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def forbid_child_processes() -> None:
    """Lets nothing here start processes from now on: this one is a worker, of whatever kind."""
    global _alone
    _alone = True


class ProcessPool(ProcessPoolExecutor):
    """An executor of :func:`process_pool`: its jobs stop when its block is left, and need not be cancelled."""

    processes: list[BaseProcess]


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPool]:
    """Yields an executor of ``workers`` processes that have ended when its block is left.

    Processes are started afresh ("spawn"): a fork of a process with threads may wait for one of their locks for ever.
    """
    if _importing_main():
        sys.exit(str(Fact(Workers.SCRIPT_IMPORTED_BY_WORKER)))
    context = get_context("spawn")
    stop_pipe, parents_end = context.Pipe(duplex=False)
    # Ctrl-C, and a terminal that closes, reach every process of it, but not those begun in here, Python's own for
    # semaphores among them: the parent decides what it means. Nor may a signal interrupt the start of a process.
    with blocked_signals(*TERMINATION_SIGNALS):
        executor = ProcessPool(workers, context, initializer=_begin, initargs=(stop_pipe,))
    try:
        with blocked_signals(*TERMINATION_SIGNALS), _starting:
            others = active_children()
            for _ in range(workers):
                executor.submit(os.getpid)
            executor.processes = [child for child in active_children() if child not in others]
        yield executor
    finally:
        # The parent's end is closed first, which stops the workers; then they are waited for. A wait for a thread that
        # an exception interrupts takes the thread for ended (bpo-45274): of the executor's own, that leaves the workers
        # running, and Python waits for them for ever. So signals are handled after it.
        with stop_pipe, blocked_signals(*TERMINATION_SIGNALS):
            parents_end.close()
            executor.shutdown()


class LearningProcess(Executor):
    """An executor with one process of low priority; if that is killed, the next job runs in a new one."""

    def __init__(self) -> None:
        self._exits = ExitStack()
        self._start()

    def submit(self, job: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Runs a job; see ``concurrent.futures.Executor``."""
        try:
            return self._pool.submit(job, *args, **kwargs)
        except BrokenExecutor:
            self._start()
            return self._pool.submit(job, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Kills the process, whatever it computes."""
        for process in self._pool.processes:
            process.kill()
        self._exits.close()

    def _start(self) -> None:
        self._exits.close()
        self._pool = self._exits.enter_context(process_pool(1))
        self._pool.submit(os.nice, LOW_PRIORITY)


@contextmanager
def blocked_signals(*numbers: signal.Signals) -> Iterator[None]:
    """Lets signals of these ``numbers`` wait until the block is left; processes started in it inherit the mask.

    The mask holds for this thread only, and Python handles here what another thread has received.
    """
    waiting = []
    handlers = {}
    if current_thread() is main_thread():
        for number in numbers:
            if signal.getsignal(number) not in (None, signal.SIG_IGN):
                handlers[number] = signal.signal(number, lambda came, _: waiting.append(came))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for came in waiting:
            signal.raise_signal(came)


def _importing_main() -> bool:
    """Whether this is a process that another has started, which still imports the other's script."""
    # There is no public name for it; multiprocessing itself uses this to refuse what is refused here.
    return getattr(current_process(), "_inheriting", False)


def _begin(stop_pipe: Connection) -> None:
    global _stop_pipe
    _stop_pipe = stop_pipe
    # Blocked while it began; a worker alone may be ended, and a pool that broke ends its others so.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker waits for its next job for ever, also when the parent was killed."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
