"""Rerun's own program: how it is started, and how it opens a recording where there is a screen."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path


def show(path: str | os.PathLike[str]) -> str:
    """Opens the recording at ``path`` in the Rerun viewer; returns "" at once, or in one sentence why it cannot."""
    if not has_screen():
        return f"There is no screen here; open the recording where there is one, with `{_command(path)}`."
    if not Path(path).is_file():
        return f"There is no recording {path}."
    command = rerun_command("--bind", "127.0.0.1", os.fspath(path))
    subprocess.Popen(command, start_new_session=True, env=rerun_environment())
    return ""


def has_screen() -> bool:
    """Whether a window can probably be opened here."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _command(path: str | os.PathLike[str]) -> str:
    """What to type to open ``path``: the viewer beside this Python, by its path unless a shell finds it by name."""
    beside = Path(sys.executable).with_name("rerun")
    if not beside.is_file() or shutil.which("rerun") == str(beside):
        return shlex.join(["rerun", os.fspath(path)])
    here = Path.cwd()
    viewer = beside.relative_to(here) if here in beside.parent.parents else beside
    return shlex.join([str(viewer), os.fspath(path)])


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
