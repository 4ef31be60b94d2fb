"""The entry point: it decides what signals do before anything that takes time is imported."""

from __future__ import annotations

from mavdem.cli.signals import ending_at_once, unwind_when_terminated


def run() -> int:
    """Runs the command that the process was given and answers its exit code."""
    with ending_at_once():
        from mavdem.cli.main import main
    unwind_when_terminated()
    return main()
