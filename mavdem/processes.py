"""Processes on every operating system: the signals that end them, their priority, and the time and memory they take.

Windows has neither process groups nor limits for single processes, and few signals. Where the standard library has
something for POSIX only, ``psutil`` has it for every system. It is imported when it is needed, since every command
imports this module first.
"""

import signal
import sys
from contextlib import suppress
from typing import NamedTuple

if sys.platform != "win32":
    import resource

TERMINATION_SIGNALS: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
)
"""Signals that end a program from outside: Ctrl-C, a request to terminate, and a closed terminal.

POSIX has SIGHUP for a closed terminal; Windows has SIGBREAK, for Ctrl-Break.
"""

MEBIBYTE = 1 << 20
"""Bytes of a MiB."""

KEPT_FREE_BYTES = 128 * MEBIBYTE
"""Freed memory at the end of the heap that is not returned to the system: a choice, several times a review's arrays."""

MAX_HEAP_BLOCK_BYTES = 32 * MEBIBYTE
"""Size from which a block of memory is mapped by itself: the largest that glibc allows."""


class ResourceUse(NamedTuple):
    """The resources that a process has taken."""

    processor_seconds: float
    """s of processor time since the process started"""
    megabytes: float
    """MiB of memory that the process has now"""


def resource_use(process_id: int) -> ResourceUse:
    """Returns the processor time and memory that a process of this machine has taken.

    The memory is that which the process has allocated, on systems that count it: Windows as "private", Linux as "data".
    On other systems it is the resident memory.

    Args:
        process_id: number of the process.

    Returns:
        Processor time and memory; empty if the process has ended.
    """
    import psutil

    with suppress(psutil.Error):
        process = psutil.Process(process_id)
        times = process.cpu_times()
        memory = process.memory_info()
        allocated_bytes = getattr(memory, "private", getattr(memory, "data", memory.rss))
        return ResourceUse(times.user + times.system, allocated_bytes / MEBIBYTE)
    return ResourceUse(0.0, 0.0)


def peak_mebibytes() -> float:
    """Returns the largest memory that this process has had, MiB."""
    if sys.platform == "win32":
        import psutil

        memory = psutil.Process().memory_info()
        return float(getattr(memory, "peak_wset", memory.rss)) / MEBIBYTE
    else:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        # The unit is bytes on macOS, KiB elsewhere.
        return peak / MEBIBYTE if sys.platform == "darwin" else peak / 1024


def limit_memory(megabytes: int) -> None:
    """Makes allocations of this process beyond a limit fail; only Linux supports this, elsewhere nothing is limited.

    The data segment is limited and not the address space, which also contains mapped files and the reserved stacks of
    threads, which take no memory.

    Args:
        megabytes: limit of the memory that is allocated, MiB.
    """
    if sys.platform != "win32":
        _, hard_limit = resource.getrlimit(resource.RLIMIT_DATA)
        soft_limit = megabytes * MEBIBYTE
        if hard_limit != resource.RLIM_INFINITY:
            # The system refuses a soft limit above the hard one.
            soft_limit = min(soft_limit, hard_limit)
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_DATA, (soft_limit, hard_limit))


def keep_freed_memory() -> None:
    """Makes glibc keep freed memory for the next arrays, instead of returning it to the system.

    By default each array of some hundred kB is requested from the system anew, page by page: one step of the search for
    an identified loop took 2.2 ms in this way, and 1.4 ms with kept memory. A review then takes 0.93 to 0.96 of the
    processor time, and up to 13 % more memory. With other C libraries nothing changes.
    """
    if sys.platform != "linux":
        return
    # Most commands do not need it.
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    # Other C libraries have no such function. The numbers are from malloc.h.
    if mallopt is not None:
        trim_threshold, mmap_threshold = -1, -3
        mallopt(trim_threshold, KEPT_FREE_BYTES)
        mallopt(mmap_threshold, MAX_HEAP_BLOCK_BYTES)


def max_open_files() -> int:
    """Returns how many files and connections this process may have open; Windows has no such limit."""
    if sys.platform == "win32":
        return sys.maxsize
    else:
        return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def lower_priority(niceness: int) -> None:
    """Lowers the priority of this process, unless it was started with a still lower one.

    Args:
        niceness: 0 is normal, 19 the lowest priority. Windows has only one class below the normal priority.
    """
    import psutil

    process = psutil.Process()
    # This class of psutil exists on Windows alone.
    below_normal = getattr(psutil, "BELOW_NORMAL_PRIORITY_CLASS", None)
    if below_normal is not None:
        process.nice(below_normal)
    # Only an administrator may raise a priority.
    elif process.nice() < niceness:
        process.nice(niceness)


def kill_with_children(process_id: int) -> None:
    """Kills a process and all its descendants, even if they hang; it is no error if they have ended already.

    Args:
        process_id: number of the process.
    """
    import psutil

    with suppress(psutil.NoSuchProcess):
        process = psutil.Process(process_id)
        descendants = process.children(recursive=True)
        for running_process in (*descendants, process):
            with suppress(psutil.NoSuchProcess):
                running_process.kill()


def signal_name(number: int) -> str:
    """Returns the name of a signal, such as "SIGSEGV", or its number where it has none."""
    with suppress(ValueError):
        return signal.Signals(number).name
    return f"signal {number}"
