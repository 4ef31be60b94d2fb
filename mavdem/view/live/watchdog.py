"""A script that runs a program until standard input ends, and then kills it.

The process that starts this script holds the other end of its standard input, which closes when that process ends for
any reason, even if it is killed. The script runs in a session of its own and imports only what loads fast.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from threading import Thread


def main(command: list[str]) -> int:
    """Runs the command and returns its exit code."""
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as running:
        Thread(target=_kill_at_end_of_input, daemon=True).start()
        return running.wait()


def _kill_at_end_of_input() -> None:
    sys.stdin.buffer.read()
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
