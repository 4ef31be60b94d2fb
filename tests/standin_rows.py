"""Rows of a log without reading it: what its name says is done to the process. Workers import this by its name."""

from __future__ import annotations

import ctypes
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from mavdem.dem.parallel import spare_cores
from mavdem.errors import Unreadable
from mavdem.fleet.row import FlightRow

READ = "standin_rows:rows_of_log"


def rows_of_log(path: Path, page: Any, pages: str, key: str) -> list[FlightRow]:
    """Two rows of one of seven vehicles, by the log's size."""
    name, size = path.name, path.stat().st_size
    if "slow" in name:
        time.sleep(60)
    if "while" in name:
        time.sleep(0.2)
    if "crash" in name:
        ctypes.string_at(0)
    if "big" in name:
        bytearray(3 << 30)
    if "bug" in name:
        raise KeyError("a fault of mavdem")
    if "where" in name:
        return [FlightRow(file=str(path), status=f"{spare_cores()} {os.getpid()} {tempfile.gettempdir()}")]
    if "damaged" in name:
        raise Unreadable(f"{path} is damaged.")
    return [FlightRow(file=str(path), vehicle=f"quad {size % 7}", axis=axis, tier="a") for axis in ("roll", "pitch")]
