"""Show: opens a recording in the native viewer, where there is a screen."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from mavdem.view.rerun_program import rerun_command, rerun_environment


def show(path: str | os.PathLike[str]) -> str:
    """Opens the recording at ``path`` in the Rerun viewer and returns at once; the viewer lives on.

    Returns:
        "" when the viewer was started, else one sentence that says why not.
    """
    if not has_screen():
        return f"There is no screen here; open the recording where there is one, with `{_command(path)}`."
    if not Path(path).is_file():
        return f"There is no recording {path}."
    command = rerun_command("--bind", "127.0.0.1", os.fspath(path))
    subprocess.Popen(command, start_new_session=True, env=rerun_environment())
    return ""


def has_screen() -> bool:
    """Whether a window can be opened here, as far as one can tell beforehand."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _command(path: str | os.PathLike[str]) -> str:
    """What to type to open ``path``: the viewer beside this Python, by its path unless a shell finds it by name."""
    beside = Path(sys.executable).with_name("rerun")
    if not beside.is_file() or shutil.which("rerun") == str(beside):
        return shlex.join(["rerun", os.fspath(path)])
    here = Path.cwd()
    viewer = beside.relative_to(here) if here in beside.parent.parents else beside
    return shlex.join([str(viewer), os.fspath(path)])
