"""Leash: runs a program until standard input ends, and then ends it.

Whoever started this holds the other end, which closes with its process however that ended: nothing else tells of a
process that was killed. It is a script of its own, in a session of its own, and imports nothing that takes time.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from threading import Thread


def main(command: list[str]) -> int:
    """Runs the command and answers its exit code."""
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as running:
        Thread(target=_end_with_input, daemon=True).start()
        return running.wait()


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
