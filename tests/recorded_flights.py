"""Recorded flights that are not in the repository: a test that needs one is skipped where they are not."""

import os
from pathlib import Path

import pytest

SHARED = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[2] / "shared/data"))


def shared(name: str) -> Path:
    """A recorded log, by its path within the shared data."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"{name} is not here; MAVDEM_SHARED_DATA says where the recorded flights are")
    return path
