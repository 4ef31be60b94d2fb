"""Rerun's own program, started so that it tells nobody of it: by itself it reports its use to those who make it."""

from __future__ import annotations

import os
import sys


def rerun_command(*options: str) -> list[str]:
    """The command line of the program that belongs to the package, with these options."""
    return [sys.executable, "-m", "rerun", *options]


def rerun_environment() -> dict[str, str]:
    """This process's environment but for what decides about reports.

    ``rerun analytics disable`` would decide for its user for good. What it does not report is what runs where ``CI`` is
    set, unless it is forced to. Source: https://github.com/rerun-io/rerun/tree/main/crates/utils/re_analytics.
    """
    environment = os.environ | {"CI": "1"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    return environment
