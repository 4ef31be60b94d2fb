"""Parallel execution: many calls of one function in worker processes, on threads or on a cluster.

Worker processes end with their work, also when a signal ends this process, or when this process is killed.
"""

import _thread
import gc
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from itertools import chain, islice
from multiprocessing import active_children, current_process, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Lock, Thread, active_count, current_thread, main_thread
from types import FrameType
from typing import Any, Generic, Literal, Protocol, TypeVar

from mavdem.facts import Fact
from mavdem.facts.model import WorkerFact
from mavdem.processes import TERMINATION_SIGNALS, lower_priority

Job = TypeVar("Job")
Result = TypeVar("Result")


class ReceivingEnd(Protocol):
    """The receiving end of a pipe between processes, of which each system has its own class."""

    def poll(self) -> bool:
        """Returns whether the end is readable."""

    def recv_bytes(self) -> bytes:
        """Waits for a message and returns it; raises EOFError when the other end is closed."""


MAX_SERIAL_JOBS = 8
"""Most jobs that are done in this process: workers take about a second to start."""

JOBS_AHEAD = 256
"""Most jobs that are sent ahead of the result that is waited for; a given executor may have as many workers."""

NORMAL_PRIORITY = 0
"""Niceness of a process that competes with others on equal terms: the default of operating systems."""

LOW_PRIORITY = 10
"""Niceness, 0 to 19, of a process that learns while samples arrive: the samples do not wait for a core."""

PAUSE, RESUME = b"\1", b"\0"
"""Messages to a process that learns: whether it must pause or continue."""

PAUSE_SIGNAL = signal.SIGINT
"""Signal whose handler pauses the process that learns. A worker takes no Ctrl-C itself, so that it is free for this."""

PAUSE_CHECK_INTERVAL = 0.05
"""Time, s, after which a paused process checks again whether it may continue; learning takes seconds."""

_pool_start_lock = Lock()
"""Held while a pool starts, so that the processes that appear meanwhile are its own."""

_child_processes_forbidden = False
"""Whether this process starts no workers, because it is one of several that share the cores."""

_is_paused = False
"""In the process that learns: whether it waits, so that the analysis of a stream has its time."""

_stop_pipe: ReceivingEnd | None = None
"""In a worker: the end of a pipe that becomes readable when its results are no longer needed."""


def parallel_map(
    function: Callable[[Job], Result], jobs: Iterable[Job], executor: Executor | None = None
) -> Generator[Result, None, None]:
    """Calls a function for each of many jobs, and yields the results in the order of the jobs.

    If there are at most ``MAX_SERIAL_JOBS`` jobs, this process does them. For more, a pool with one process for each
    core is started, which ends with the generator. See :func:`mavdem.dem.learn_many`.

    Args:
        function: The function. Other processes can only call a function of a module, or a ``partial`` of one.
        jobs: Arguments of the calls, possibly endless. For other processes jobs and results must pickle.
        executor: Executor that does the work in place of a pool; it is not shut down.

    Yields:
        The result of each job.

    Raises:
        concurrent.futures.BrokenExecutor: A worker died.
        Exception: Any error that ``function`` or ``jobs`` raises.
    """
    jobs = iter(jobs)
    if executor is not None:
        yield from _map_on_executor(executor, function, jobs)
        return
    first_jobs = list(islice(jobs, MAX_SERIAL_JOBS + 1))
    workers = workers_for(len(first_jobs))
    if workers == 1:
        yield from map(function, chain(first_jobs, jobs))
        return
    with process_pool(workers) as executor:
        yield from _map_on_executor(executor, function, chain(first_jobs, jobs))


def _map_on_executor(
    executor: Executor, function: Callable[[Job], Result], jobs: Iterable[Job]
) -> Generator[Result, None, None]:
    """Yields the result of each job in order, while at most ``JOBS_AHEAD`` jobs are with the executor.

    Args:
        executor: Executor that does the work.
        function: Function to call.
        jobs: Arguments of the calls; they may be endless, since each is taken only when fewer than ``JOBS_AHEAD`` are
            with the executor.

    Yields:
        The results, in the order of the jobs.

    Raises:
        concurrent.futures.BrokenExecutor: A worker died.
    """
    # Jobs that are with the executor, the earliest first.
    futures: deque[Future[Result]] = deque()
    try:
        for job in jobs:
            futures.append(executor.submit(partial(_work_unless_stopped, function), job))
            # Finished results are yielded at once. If JOBS_AHEAD jobs are with the executor, the first is waited for. A
            # future is only removed after its result was taken, so that a failed one is among those that end below.
            while futures and (len(futures) >= JOBS_AHEAD or futures[0].done()):
                yield futures[0].result()
                futures.popleft()
        while futures:
            yield futures[0].result()
            futures.popleft()
    except BrokenExecutor as error:
        # A broken pool ends its jobs itself. Before Python 3.13 it fails to do so for jobs that have been cancelled.
        futures.clear()
        raise type(error)(str(Fact(WorkerFact.WORKER_DIED))) from error
    finally:
        # The jobs of a ProcessPool end with its block and are not cancelled. Before Python 3.13, a pool with cancelled
        # jobs waits forever if a signal to the whole process group has ended its workers.
        if not isinstance(executor, ProcessPool):
            for future in futures:
                future.cancel()


def _work_unless_stopped(function: Callable[[Job], Result], job: Job) -> Result:
    """Does a job in a worker, or raises an error if its result is no longer needed; the worker then ends soon."""
    # The parent sends nothing, so that the pipe is readable only after the parent has closed its end.
    if _stop_pipe is not None and _stop_pipe.poll():
        raise CancelledError
    return function(job)


def workers_for(job_count: int) -> int:
    """Returns the number of processes that :func:`parallel_map` uses for a number of jobs: 1 for few, else all."""
    return available_workers() if job_count > MAX_SERIAL_JOBS else 1


def available_workers() -> int:
    """Returns the number of worker processes that this process can use at the same time.

    It is the number of processor cores that this process may run on. If this process is itself a worker of a pool, it
    is 1, which means that no further processes are started: the other workers occupy the cores.
    """
    # A process that still imports the script of its parent is not counted as a worker here: if the script starts a pool
    # while it is imported, :func:`process_pool` stops it with an error that explains what to change.
    is_worker = parent_process() is not None and not _is_importing_main()
    if is_worker or _child_processes_forbidden:
        return 1
    # Not all platforms tell which of the cores a process may run on.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def forbid_child_processes() -> None:
    """Makes :func:`available_workers` return 1 from now on, for a worker of a cluster or of another kind of pool."""
    global _child_processes_forbidden
    _child_processes_forbidden = True


class ProcessPool(ProcessPoolExecutor):
    """An executor of :func:`process_pool`: its jobs stop when its block is left, and need not be cancelled.

    Attributes:
        processes: Its worker processes.
    """

    processes: list[BaseProcess]


@contextmanager
def process_pool(
    workers: int,
    prepare: Callable[[], None] | None = None,
    start_method: Literal["spawn", "fork"] = "spawn",
) -> Iterator[ProcessPool]:
    """Starts worker processes for a block, and waits for their end when the block is left.

    By default the processes are started anew ("spawn"), since a fork of a process with threads may wait forever for a
    lock that one of the threads held.

    Args:
        workers: Number of processes.
        prepare: Function that is called in the main thread of each process before its first job, while signals are
            still blocked.
        start_method: Start method of the processes. Forked ones keep open all files of this process.

    Yields:
        An executor whose processes have started.

    Raises:
        SystemExit: The running script starts workers while a worker imports it, which would start workers without end.
    """
    if _is_importing_main():
        sys.exit(str(Fact(WorkerFact.SCRIPT_IMPORTED_BY_WORKER)))
    context = get_context(start_method)
    stop_pipe, parent_end = context.Pipe(duplex=False)
    # Ctrl-C and a closed terminal send signals to all processes of the terminal. The processes that are started here,
    # including Python's own process for semaphores, inherit the blocked signals, so that only the parent responds to a
    # signal. The start of a process must not be interrupted by a signal either.
    with blocked_signals(*TERMINATION_SIGNALS):
        executor = ProcessPool(
            workers, context, initializer=_initialize_worker, initargs=(stop_pipe, prepare)
        )
    try:
        with blocked_signals(*TERMINATION_SIGNALS), _pool_start_lock:
            earlier_processes = active_children()
            # An executor starts its processes one by one, when jobs are submitted. So it gets as many short jobs.
            for _ in range(workers):
                executor.submit(os.getpid)
            executor.processes = [
                process for process in active_children() if process not in earlier_processes
            ]
        _close_writing_end_of_results(executor)
        yield executor
    finally:
        # The parent's end of the pipe is closed first, which stops the workers, and then their end is awaited. If an
        # exception from a signal interrupted the wait, Python would assume that the executor's thread has ended
        # (bpo-45274). The workers would continue, and Python would wait for them forever. So signals are handled after
        # the wait.
        with stop_pipe, blocked_signals(*TERMINATION_SIGNALS):
            parent_end.close()
            executor.shutdown()


def _close_writing_end_of_results(executor: ProcessPool) -> None:
    """Closes this process's own copy of the end of the pipe into which the workers write their results.

    Python keeps it open. If the last worker is killed while it writes a result, the executor's thread would then wait
    for the rest of that result forever, and the end of the pool would wait for the thread. Without the copy the pipe
    ends with the worker, and the executor is broken, as by any other death of a worker.

    Args:
        executor: executor whose workers have all started: each has a copy of its own.
    """
    # No public attribute gives access to the pipe.
    executor._result_queue._writer.close()  # type: ignore[attr-defined]


class LearningProcess(Executor):
    """An executor with one process of low priority; if the process is killed, the next job runs in a new one.

    If that is safe the first process is forked, and so shares the modules of this one: on a small computer that saves a
    third of the memory and the time of importing them. Sockets and files that are open then stay open in it. So a
    further one is started afresh: a lost link could not be opened again while it holds the socket or serial port.

    Attributes:
        is_suspended: whether the process is paused.
    """

    def __init__(self, niceness: int = LOW_PRIORITY) -> None:
        """Starts the process.

        Args:
            niceness: its priority: 0 is normal, 19 the lowest.
        """
        self.is_suspended = False
        self._niceness = niceness
        self._exits = ExitStack()
        self._start_process(may_fork=True)

    def suspend(self, is_suspended: bool) -> None:
        """Pauses the process within some milliseconds, or lets it continue, at any point of its computation.

        Low priority alone is not enough on a small computer: if a quota limits all processes together, the process uses
        part of the time that the samples need. The process pauses itself (:func:`_prepare_learning`) instead of being
        stopped by the system, so it still ends when this process is killed.

        Args:
            is_suspended: whether the process is paused.
        """
        if is_suspended == self.is_suspended:
            return
        self.is_suspended = is_suspended
        # A process that has been killed needs no pause.
        with suppress(OSError):
            # This is called in the middle of a flight, and bytes are sent faster than an object, which is pickled.
            self._pause_sender.send_bytes(PAUSE if is_suspended else RESUME)

    def submit(self, job: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Runs a job in the process; if that has been killed, in a new process.

        Args:
            job: Function of a module, which can be pickled.
            *args: Its arguments.
            **kwargs: Its named arguments.

        Returns:
            The future of its result, as of ``concurrent.futures.Executor.submit``.
        """
        try:
            return self._pool.submit(job, *args, **kwargs)
        except BrokenExecutor:
            self._start_process(may_fork=False)
            return self._pool.submit(job, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Kills the process in any state; the arguments of ``concurrent.futures.Executor`` are not used."""
        for process in self._pool.processes:
            process.kill()
        self._exits.close()

    def _start_process(self, *, may_fork: bool) -> None:
        """Ends the process, if there is one, and starts a new one.

        Args:
            may_fork: whether the new process is forked, if that is safe.
        """
        self._exits.close()
        self.is_suspended = False
        pause_receiver, self._pause_sender = get_context("spawn").Pipe(duplex=False)
        self._exits.enter_context(self._pause_sender)
        # The started process has its own copy of the receiving end, so this one is closed.
        with pause_receiver:
            prepare = partial(_prepare_learning, self._niceness, pause_receiver)
            start_method: Literal["spawn", "fork"] = "spawn"
            if may_fork and _is_fork_safe():
                start_method = "fork"
                # The libraries are loaded before the fork, so that the process does not have to load them before it
                # learns the first model.
                from mavdem.dem.engine.linalg import load_libraries

                load_libraries()
                # A garbage collection writes to each object, and would so copy the memory that both processes share.
                gc.collect()
                gc.freeze()
            self._pool = self._exits.enter_context(process_pool(1, prepare, start_method))


class ForkedCall(Generic[Result]):
    """A function that runs in a second process, a copy of this one, while this one continues.

    The function may be any: the copy has all that this process has. Only its result is pickled. Where the second
    process fails or is ended, :meth:`result` is None, and the caller does the work itself.
    """

    _process: BaseProcess
    _receiver: "Connection[Any, Any]"

    def __init__(self, function: Callable[[], Result]) -> None:
        """Starts the process.

        Raises:
            NotImplementedError: this is Windows, where a process cannot be copied.
        """
        if sys.platform == "win32":
            raise NotImplementedError
        context = get_context("fork")
        self._receiver, sender = context.Pipe(duplex=False)
        # Ctrl-C reaches both processes: this one decides what it means, and ends the other.
        with blocked_signals(*TERMINATION_SIGNALS):
            self._process = context.Process(
                target=_send_result, args=(function, sender, self._receiver), daemon=True
            )
            self._process.start()
        # The pipe ends with the process, which alone has this end then.
        sender.close()

    def result(self) -> Result | None:
        """Waits for the result and returns it; None if the function raised an error, or the process was ended."""
        try:
            outcome: tuple[Result] | None = self._receiver.recv()
        except (EOFError, OSError):
            return None
        return None if outcome is None else outcome[0]

    def close(self) -> None:
        """Ends the process, whether it has finished or not."""
        with blocked_signals(*TERMINATION_SIGNALS), self._receiver:
            self._process.kill()
            self._process.join()


@contextmanager
def in_second_process(function: Callable[[], Result]) -> Iterator[Callable[[], Result | None]]:
    """Starts a function in a second process if there is a core for it, and ends that process with the block.

    Args:
        function: the function to call, without arguments.

    Yields:
        A function that waits for the result and returns it. It returns None if there is only one core, or if this
        process cannot be forked; the caller must then do the work.
    """
    if available_workers() == 1 or not _is_fork_safe():
        yield lambda: None
        return
    from mavdem.dem.engine.linalg import load_libraries

    # Both processes need the libraries, and share their memory if they are loaded before the fork.
    load_libraries()
    try:
        call = ForkedCall(function)
    except OSError:
        # The system has no memory or no process number for another process.
        yield lambda: None
        return
    with closing(call):
        yield call.result


def _send_result(
    function: Callable[[], Result],
    sender: "Connection[Any, Any]",
    receiver: "Connection[Any, Any]",
) -> None:
    """Calls a function in the process of a :class:`ForkedCall`, and sends its result, or None if that fails.

    Args:
        function: the function to call, without arguments.
        sender: sending end of the pipe, through which the result is sent as a tuple of one.
        receiver: receiving end of the pipe, which only the parent process uses.
    """
    receiver.close()
    # Garbage collection writes to every object, and would so copy the memory that this process shares with its parent.
    gc.freeze()
    Thread(target=_exit_with_parent, daemon=True).start()
    outcome = None
    # If the work fails, the caller does it again, and the same error is raised there.
    with suppress(Exception):
        outcome = (function(),)
    try:
        sender.send(outcome)
    except Exception:
        # What cannot be pickled cannot be sent.
        sender.send(None)


@contextmanager
def blocked_signals(*numbers: signal.Signals) -> Iterator[None]:
    """Postpones operating-system signals, such as SIGINT, until the block of the ``with`` statement is left.

    Processes that are started in the block inherit the mask, so that they too are not interrupted while they start. The
    mask holds for this thread only. If another thread receives a signal, Python calls its handler in the main thread,
    so that the handlers are replaced as well: they only note the signal, which is raised again at the end of the block.
    Windows has no mask, and no signals to other threads.

    Args:
        *numbers: The signals.
    """
    # Signals that were received in the block, in their order.
    postponed_signals = list[int]()
    original_handlers = {}

    def postpone(signal_number: int, _frame: FrameType | None) -> None:
        """Notes a signal instead of handling it."""
        postponed_signals.append(signal_number)

    # Only the main thread may set handlers.
    if current_thread() is main_thread():
        for number in numbers:
            # An ignored signal remains ignored, and a handler that Python did not install cannot be replaced.
            if signal.getsignal(number) not in (None, signal.SIG_IGN):
                original_handlers[number] = signal.signal(number, postpone)
    if sys.platform != "win32":
        original_mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        for number, handler in original_handlers.items():
            signal.signal(number, handler)
        if sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, original_mask)
        for signal_number in postponed_signals:
            signal.raise_signal(signal_number)


def _is_fork_safe() -> bool:
    """Returns whether this process may be forked: only on Linux, and while it has no thread that could hold a lock.

    OpenBLAS itself ends its threads before a fork. The libraries of macOS do not survive one.
    """
    return sys.platform == "linux" and active_count() == 1


def _is_importing_main() -> bool:
    """Returns whether this process was started by another and is still importing the other's script."""
    # There is no public name for it; multiprocessing itself uses this attribute to detect the same case.
    return getattr(current_process(), "_inheriting", False)


def _initialize_worker(stop_pipe: ReceivingEnd, prepare: Callable[[], None] | None) -> None:
    """Prepares a worker process, so that it ends with its parent and can be stopped.

    Args:
        stop_pipe: Receiving end of a pipe that becomes readable when the results are no longer needed.
        prepare: Function that is called before the first job.
    """
    global _stop_pipe
    _stop_pipe = stop_pipe
    # Objects that a forked process has from its parent are never collected, since a collection writes to them and so
    # copies their memory.
    gc.freeze()
    if sys.platform == "win32":
        # Ctrl-C is sent to all processes of a console. Only the parent responds to it.
        for number in TERMINATION_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    # This thread is started before ``prepare`` is called, since the worker may be paused as soon as it is prepared.
    Thread(target=_exit_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()
    if sys.platform != "win32":
        # The signal was blocked while the process started. A broken pool ends its remaining workers with this signal.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})


def _prepare_learning(niceness: int, pause_receiver: ReceivingEnd) -> None:
    """Sets the priority of a worker, lets its parent pause it, and makes it ignore SIGTERM.

    A service manager sends SIGTERM to the whole process group. It would end the worker before the parent process has
    learned the final model.

    Args:
        niceness: the priority, 0 to 19; with 0 the worker keeps its parent's.
        pause_receiver: receiving end of a pipe through which the parent pauses the worker and lets it continue.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(PAUSE_SIGNAL, _wait_while_paused)
    # On Linux a thread keeps the priority with which it starts. This one starts before the priority is lowered, so that
    # it pauses the worker at once.
    Thread(target=_receive_pauses, args=(pause_receiver,), daemon=True).start()
    if niceness > 0:
        lower_priority(niceness)


def _receive_pauses(pause_receiver: ReceivingEnd) -> None:
    """Pauses the main thread, which learns, and lets it continue, when the parent process sends that.

    The handler of a signal runs in the main thread between any two of its instructions, on every operating system. No
    signal is sent: Python only calls the handler.

    Args:
        pause_receiver: receiving end of the pipe through which the parent process sends that it pauses or continues.
    """
    global _is_paused
    # The pipe is closed when the parent ends.
    with suppress(EOFError, OSError):
        while True:
            _is_paused = pause_receiver.recv_bytes() == PAUSE
            if _is_paused:
                _thread.interrupt_main(PAUSE_SIGNAL)


def _wait_while_paused(*_: object) -> None:
    """Handler of ``PAUSE_SIGNAL``: keeps the main thread from computing as long as the process is paused."""
    # A lock or an event could be held by this same thread, if a second pause comes while the first one ends.
    while _is_paused:
        time.sleep(PAUSE_CHECK_INTERVAL)


def _exit_with_parent() -> None:
    """Ends the process when its parent has ended; else a worker of a killed parent would wait for jobs forever."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
