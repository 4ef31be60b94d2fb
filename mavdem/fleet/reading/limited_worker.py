"""LimitedWorker: a process that reads logs, killed at a log's limit and replaced, so that no log stops a run."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict, replace
from tempfile import TemporaryDirectory

from mavdem.errors import Unreadable
from mavdem.fleet.reading.outcome import READ_LOG, READY, Job, Limits, ReadOutcome, failed

SECONDS_TO_START = 120.0
SECONDS_TO_END = 10.0  # of a process that was killed
ATTEMPTS = 2
"""How often a log is read whose reading killed the process: something else may have killed it once."""


class LimitedWorker:
    """One process at a time, started when it is needed. It keeps to ``limits``, a log at a time.

    Args:
        limits: of each log.
        read: the function that makes rows of a log, as ``package.module:function``.
    """

    def __init__(self, limits: Limits, read: str = READ_LOG) -> None:
        self.limits = limits
        self._read = read
        self._process: subprocess.Popen[bytes] | None = None
        self._scratch: TemporaryDirectory[str] | None = None  # what it fetches is removed also where it was killed
        self._received = b""
        self._stopped = False

    def run(self, job: Job) -> ReadOutcome:
        """Reads one log; what it does to the process is part of the outcome.

        Raises:
            Unreadable: no process can be started.
        """
        began = time.perf_counter()
        outcome = self._attempt(job)
        for _ in range(ATTEMPTS - 1):
            if outcome.ended == "died" and not self._stopped:
                outcome = self._attempt(job)
        if outcome.ended in ("time", "memory", "died"):
            self._end()
        return outcome if outcome.seconds else replace(outcome, seconds=time.perf_counter() - began)

    def stop(self) -> None:
        """Kills the process, also while another thread waits for its answer: then the log counts as not read.

        What is left of the process is removed by :meth:`close`, in the thread that reads.
        """
        self._stopped = True
        process = self._process
        if process is not None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)

    def close(self) -> None:
        """Ends the process, and removes what it leaves."""
        self.stop()
        self._end()

    def _attempt(self, job: Job) -> ReadOutcome:
        process = self._running()
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(asdict(job)).encode() + b"\n")
            process.stdin.flush()
            answer = self._line(self.limits.seconds)
        except OSError:  # it has died, or was just stopped
            answer = b""
        if answer is None:
            self._end()
            return failed(job, "time", f"It takes longer than its time limit of {self.limits.seconds:g} s.")
        try:
            return ReadOutcome.from_json(answer)
        except (ValueError, TypeError, KeyError):
            return failed(job, "died", f"The process that read it died{self._cause()}, each of {ATTEMPTS} times.")

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._end()
        if self._stopped:
            raise Unreadable("The run has ended.")
        threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self._received = b""
        limit, module = str(self.limits.megabytes), "mavdem.fleet.reading.worker"
        try:
            self._scratch = TemporaryDirectory(prefix="mavdem-", ignore_cleanup_errors=True)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", module, limit, self._read, self._scratch.name],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=None if os.environ.get("MAVDEM_TRACEBACK") else subprocess.DEVNULL,
                # It finds what this process finds; and Ctrl-C reaches this process only, which decides what it means.
                env={
                    **os.environ,
                    **threads,
                    "MPLBACKEND": "agg",
                    "TMPDIR": self._scratch.name,
                    "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
                },
                start_new_session=True,
            )
        except OSError as error:
            if self._scratch is not None:
                self._scratch.cleanup()
            raise Unreadable(
                f"No process that reads logs can be started ({error.strerror or error}): what was read is kept; once "
                "that is put right, the same command goes on."
            ) from None
        if self._stopped:  # meanwhile, when there was nothing to kill
            self.stop()
        if self._line(SECONDS_TO_START) != READY.encode() and not self._stopped:
            cause = self._cause()
            self._end()
            raise Unreadable(f"No process that reads logs can be started{cause}: see why with MAVDEM_TRACEBACK=1.")
        return self._process

    def _line(self, seconds: float) -> bytes | None:
        """The next line of the answer; None if it does not come in time, empty if the process has ended."""
        process = self._process
        if process is None or process.stdout is None:
            return b""
        deadline = time.monotonic() + seconds
        while b"\n" not in self._received:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([process.stdout], [], [], left)[0]:
                return None
            if not (more := os.read(process.stdout.fileno(), 1 << 16)):
                return b""
            self._received += more
        line, _, self._received = self._received.partition(b"\n")
        return line

    def _cause(self) -> str:
        """How the process ended, for a sentence."""
        code = self._end()
        if code is None:
            return ""
        return f" ({signal.Signals(-code).name})" if code < 0 else f" (exit code {code})"

    def _end(self) -> int | None:
        """Makes sure that the process has ended; its exit code, None if there was none."""
        process, self._process = self._process, None
        if process is None:
            return None
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.2 if process.poll() is None and not self._stopped else 0)
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        code = None
        with suppress(subprocess.TimeoutExpired):  # it waits for a disk that does not answer
            code = process.wait(SECONDS_TO_END)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        if self._scratch is not None:
            self._scratch.cleanup()
        return code
