"""mavdem without what only POSIX has: nearly Windows, as far as another system can be that."""

import os
import subprocess
import sys
from pathlib import Path

from pytest import mark
from recorded_flights import LOGS

pytestmark = mark.in_full

HERE = Path(__file__).parent


def test_nothing_needs_posix_or_a_console_in_utf_8_or_its_locale(tmp_path):
    """Also stops at a text file without an encoding, and at a sign that an old console of Windows does not have.

    On Windows and macOS themselves CI runs the same session with every push (tools/try_here).
    """
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parents[1])]),
        "PYTHONIOENCODING": "cp1252",
        "PYTHONWARNDEFAULTENCODING": "1",
        "MAVDEM_TRACEBACK": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    run = subprocess.run(
        [sys.executable, HERE / "session.py", LOGS / "ardupilot_default_rates.tlog", tmp_path],
        env=environment,
        capture_output=True,
        encoding="cp1252",
    )
    assert run.returncode == 0, run.stderr
    assert "Traceback" not in run.stderr
