"""The entry point, ``mavdem`` and ``python -m mavdem``: signals are set before anything that takes time is imported."""

import gc
import os
import sys

from mavdem.cli.output import ending_at_once, unwind_when_terminated


def run() -> int:
    """Runs the command of the process and returns its exit code."""
    _prepare()
    with ending_at_once():
        from mavdem.cli.commands import main
    unwind_when_terminated()
    return main()


def load() -> int:
    """Runs as a loader of the Rerun Viewer and returns its exit code."""
    _prepare()
    with ending_at_once():
        from mavdem.cli.open import load
    unwind_when_terminated()
    return load(sys.argv[1:])


def _prepare() -> None:
    # Read when NumPy and SciPy are imported. For matrices as small as these more threads only wait for each other: on
    # two busy cores they doubled the time that `mavdem learn` takes.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Pictures are written to files, and no window is opened: a backend of the user's that is missing matters not.
    os.environ["MPLBACKEND"] = "agg"
    # Cyclic garbage is looked for less often: that took an eighth of the time of `mavdem learn`.
    gc.set_threshold(200_000)


if __name__ == "__main__":
    sys.exit(run())
