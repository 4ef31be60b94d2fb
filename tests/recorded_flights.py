"""Recorded flights; a test that needs one that is not in the repository is skipped where it is not."""

import os
from pathlib import Path

from pytest import skip

from mavdem.ingest import read_log

LOGS = Path(__file__).parents[1] / "logs"
FLIGHT = LOGS / "ardupilot_wind5_steps.tlog"
SLOW = LOGS / "ardupilot_default_rates.tlog"
SAMPLE_LOGS = (SLOW, LOGS / "px4_wind5_steps.tlog")
"""One log of each autopilot, of stock and of high rates, for tests of what every log has."""
SHARED = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[2] / "shared/data"))


def short_flight(folder):
    """The first third of ``FLIGHT``, 19 s in the air, of which all is said that is said of the whole."""
    path = folder / FLIGHT.name
    path.write_bytes(FLIGHT.read_bytes()[:250_000])
    return path


def shared(name):
    """A recorded log, by its path within the shared data."""
    path = SHARED / name
    if not path.exists():
        skip(f"{name} is not here; MAVDEM_SHARED_DATA says where the recorded flights are")
    return path


def recorded(name):
    """The first vehicle of a recorded log."""
    return read_log(shared(name)).vehicles[0]
