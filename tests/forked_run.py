"""Runs the tests in several processes, all of them copies of the one that has collected the tests.

To import and collect all tests takes ten seconds of a processor. A process that is a copy (``os.fork``) need not do it
again, and shares the memory of what was imported. The first process runs no test itself: it gives out the tests, and
reports the results as if it had run them.
"""

import os
import signal
import sys
import traceback
from contextlib import suppress
from dataclasses import dataclass
from io import StringIO
from multiprocessing.connection import Connection, Pipe, wait
from types import ModuleType
from typing import Any
from warnings import WarningMessage

from pytest import TerminalReporter, TestReport, hookimpl

CHUNKS_PER_PROCESS = 4
"""A process gets this fraction of its share of the remaining tests at a time, so that all end at nearly the same time.

The tests of a chunk follow each other in the order of collection: most tests of a file have its fixtures in common.
"""


@dataclass
class TestProcess:
    """A process that runs tests, as the first process knows it."""

    number: int
    """Its process number."""

    connection: Connection
    """This end of the pipe to it."""

    running: tuple[str, Any] | None = None
    """Name and location of the test that it runs; None between two tests."""

    has_ended: bool = False
    """Whether it has ended, and its number may be that of another process."""


@dataclass(frozen=True)
class TestsWanted:
    """Message of a process that has no tests left."""


@dataclass(frozen=True)
class TestStarted:
    """Message of a process that begins a test."""

    nodeid: str
    location: Any


@dataclass(frozen=True)
class TestFinished:
    """Message of a process with the reports of a test, each as pytest makes it serializable."""

    nodeid: str
    location: Any
    reports: list[dict]


@dataclass(frozen=True)
class WarningRecorded:
    """Message of a process with a warning that a test has caused."""

    nodeid: str
    text: str
    category: type[Warning]
    filename: str
    line_number: int


class ReportSender(TerminalReporter):
    """Takes the place of the reporter in a process that runs tests: it prints nothing, and sends all to the first."""

    def __init__(self, config, connection):
        super().__init__(config, StringIO())
        self._connection = connection
        self._reports = []

    def pytest_runtest_logstart(self, nodeid, location):
        self._connection.send(TestStarted(nodeid, location))

    def pytest_runtest_logreport(self, report):
        to_serializable = self.config.hook.pytest_report_to_serializable
        self._reports.append(to_serializable(config=self.config, report=report))

    def pytest_runtest_logfinish(self, nodeid, location):
        self._connection.send(TestFinished(nodeid, location, self._reports))
        self._reports = []

    def pytest_warning_recorded(self, warning_message, when, nodeid):
        # The first process knows the warnings of the collection, which pytest repeats to each new reporter.
        if when == "runtest":
            warning = warning_message
            self._connection.send(
                WarningRecorded(
                    nodeid,
                    str(warning.message),
                    warning.category,
                    warning.filename,
                    warning.lineno,
                )
            )


def pytest_addoption(parser):
    parser.addoption(
        "--processes",
        type=int,
        default=1,
        help="processes that run the tests, where processes can be copied (not on Windows)",
    )


@hookimpl(tryfirst=True)
def pytest_runtestloop(session):
    """Runs the collected tests in several processes; returns None if pytest is to run them in this one."""
    process_count = session.config.getoption("--processes")
    if process_count < 2 or session.testsfailed or session.config.option.collectonly:
        return None
    # The folder of temporary files is made before the processes start, so that it is the same for all.
    session.config._tmp_path_factory.getbasetemp()
    processes = [start_process(session) for _ in range(process_count)]
    try:
        Distribution(session, processes).run()
    finally:
        for process in processes:
            if not process.has_ended:
                os.kill(process.number, signal.SIGKILL)
    if session.shouldfail:
        raise session.Failed(session.shouldfail)
    if session.shouldstop:
        raise session.Interrupted(session.shouldstop)
    return True


def start_process(session):
    """Starts a process that runs tests, a copy of this one.

    Threads are not copied. No test has run yet, so that there are only those that Arrow and Rerun start when they are
    imported, which wait for work.
    """
    connection, connection_of_process = Pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    process_number = os.fork()
    if process_number:
        # The pipe ends with the process, which alone has that end then.
        connection_of_process.close()
        return TestProcess(process_number, connection)
    connection.close()
    exit_code = 1
    try:
        run_tests(session, connection_of_process)
        exit_code = 0
    except BaseException:
        traceback.print_exc(file=sys.__stderr__)
    # What is to be done at the exit of the first process is not done at that of its copies.
    os._exit(exit_code)


def run_tests(session, connection):
    """Runs tests in a process of its own, as long as the first process gives it some."""
    plugins = session.config.pluginmanager
    plugins.unregister(name="terminalreporter")
    plugins.register(ReportSender(session.config, connection), "terminalreporter")
    # What tests print is captured in files, which the first process has open too.
    capture = plugins.getplugin("capturemanager")
    capture.stop_global_capturing()
    capture.start_global_capturing()
    # Python's processes import the main module of the one that starts them: here that would be all of pytest.
    sys.modules["__main__"] = ModuleType("__main__")
    numbers = received_numbers(connection)
    number = next(numbers, None)
    while number is not None:
        # Which fixtures end with a test depends on the next test.
        next_number = next(numbers, None)
        next_item = None if next_number is None else session.items[next_number]
        item = session.items[number]
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=next_item)
        if session.shouldfail or session.shouldstop:
            # The first process stops the run too, when it has the report. All fixtures of this process have ended.
            break
        number = next_number
    capture.stop_global_capturing()


def received_numbers(connection):
    """Yields the numbers of the tests that a process runs, until the first process has no more, or stops the run."""
    while True:
        connection.send(TestsWanted())
        numbers = connection.recv()
        if not numbers:
            return
        for number in numbers:
            # Without a request the first process sends something only to stop the run.
            if connection.poll():
                return
            yield number


class Distribution:
    """Gives out the tests of a session to processes, and reports what they send about them."""

    def __init__(self, session, processes):
        self._session = session
        self._processes = processes
        self._tests_left = range(len(session.items))
        self._is_stopped = False

    def run(self):
        """Answers and reports all messages of the processes, until all processes have ended."""
        running = {process.connection: process for process in self._processes}
        while running:
            for connection in wait(list(running)):
                process = running[connection]
                try:
                    self._process_message(process, connection.recv())
                except (EOFError, ConnectionResetError):
                    report_end(self._session, process)
                    del running[connection]
            if self._session.shouldfail or self._session.shouldstop:
                self._stop(running)

    def _process_message(self, process, message):
        """Answers a process that wants tests, and reports what it sends else."""
        if isinstance(message, TestsWanted):
            send_numbers(process, self._next_tests())
        elif isinstance(message, TestStarted):
            process.running = (message.nodeid, message.location)
        elif isinstance(message, TestFinished):
            process.running = None
            report_test(self._session.config, message)
        else:
            report_warning(self._session.config, message)

    def _next_tests(self):
        """Returns the numbers of the tests that a process runs next, none if none are left or the run is stopped."""
        if self._is_stopped:
            return range(0)
        count = max(len(self._tests_left) // (CHUNKS_PER_PROCESS * len(self._processes)), 1)
        numbers, self._tests_left = self._tests_left[:count], self._tests_left[count:]
        return numbers

    def _stop(self, running):
        """Tells all running processes, once, to end after the test that they run and the next one."""
        if not self._is_stopped:
            self._is_stopped = True
            for process in running.values():
                send_numbers(process, range(0))


def send_numbers(process, numbers):
    """Sends the numbers of tests to a process, which may have ended."""
    with suppress(OSError):
        process.connection.send(numbers)


def report_test(config, finished):
    """Reports a test as if it had run in this process."""
    hook = config.hook
    hook.pytest_runtest_logstart(nodeid=finished.nodeid, location=finished.location)
    for data in finished.reports:
        report = hook.pytest_report_from_serializable(config=config, data=data)
        hook.pytest_runtest_logreport(report=report)
    hook.pytest_runtest_logfinish(nodeid=finished.nodeid, location=finished.location)


def report_warning(config, recorded):
    """Reports a warning as if a test had caused it in this process."""
    config.hook.pytest_warning_recorded.call_historic(
        kwargs={
            "warning_message": WarningMessage(
                recorded.text, recorded.category, recorded.filename, recorded.line_number
            ),
            "when": "runtest",
            "nodeid": recorded.nodeid,
            "location": None,
        }
    )


def report_end(session, process):
    """Waits for the end of a process, and reports the test that has ended it, if it did not end by itself."""
    _, status = os.waitpid(process.number, 0)
    process.has_ended = True
    exit_code = os.waitstatus_to_exitcode(status)
    if exit_code == 0:
        return
    nodeid, location = process.running or ("no test", ("", None, ""))
    reason = f"The process of {nodeid} has ended with code {exit_code}; the tests that it was to run next are not run."
    session.config.hook.pytest_runtest_logreport(
        report=TestReport(nodeid, location, {}, "failed", reason, "call")
    )
