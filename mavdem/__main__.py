"""Entry points of the process: the command ``mavdem``, ``python -m mavdem``, and the loader of the Rerun Viewer.

Signals are handled before anything is imported that takes time, so that Ctrl-C always ends the process at once.
"""

import atexit
import gc
import os
import sys

from mavdem.cli.termination import default_interrupt_action, raise_on_termination_signals

GARBAGE_THRESHOLD = 200_000
"""Allocations between two searches for cyclic garbage.

Python's own value is 700. The frequent searches took an eighth of the time of ``mavdem learn``.
"""


def run() -> int:
    """Runs the command that the process was called with, and returns its exit code."""
    _configure_process()
    with default_interrupt_action():
        from mavdem.cli.commands import main
    raise_on_termination_signals()
    return main()


def load() -> int:
    """Runs as a loader of the Rerun Viewer, ``rerun-loader-mavdem``, and returns the exit code."""
    _configure_process()
    with default_interrupt_action():
        from mavdem.cli.open import load
    raise_on_termination_signals()
    return load(sys.argv[1:])


def _configure_process() -> None:
    """Sets environment variables that libraries read when they are imported, and makes garbage collection rare.

    At the exit, Python does not search for cyclic garbage, whose memory the system takes back anyway: the searches
    among the objects of all imported modules took 0.17 s, an eighth of a review of a short log.
    """
    # Matrices are so small that several threads of OpenBLAS mostly wait for each other: on two busy cores they doubled
    # the time of `mavdem learn`.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Matplotlib writes pictures to files and opens no window. "agg" works even if a backend that the user has chosen is
    # not installed.
    os.environ["MPLBACKEND"] = "agg"
    # Before its first check, pydantic searches all installed packages for plugins of its own; mavdem needs none.
    os.environ["PYDANTIC_DISABLE_PLUGINS"] = "__all__"
    gc.set_threshold(GARBAGE_THRESHOLD)
    atexit.register(gc.freeze)


if __name__ == "__main__":
    sys.exit(run())
