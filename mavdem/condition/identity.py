"""Identity: which vehicle a log is of, what it runs, and when it flew."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from mavdem.alignment.align import settled_segments
from mavdem.alignment.signals import Signals
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import board_number_in_bytes, board_number_in_texts, version_text

CALIBRATIONS = {
    "accelerometer": (
        ("INS_ACCOFFS_X", "INS_ACCOFFS_Y", "INS_ACCOFFS_Z", "INS_ACCSCAL_X", "INS_ACCSCAL_Y", "INS_ACCSCAL_Z"),
        ("CAL_ACC0_XOFF", "CAL_ACC0_YOFF", "CAL_ACC0_ZOFF", "CAL_ACC0_XSCALE", "CAL_ACC0_YSCALE", "CAL_ACC0_ZSCALE"),
    ),
    "compass": (
        ("COMPASS_OFS_X", "COMPASS_OFS_Y", "COMPASS_OFS_Z"),
        ("CAL_MAG0_XOFF", "CAL_MAG0_YOFF", "CAL_MAG0_ZOFF"),
    ),
}
"""Parameters that a vehicle's own sensors have, ArduPilot's and PX4's, the more lasting first: a compass is calibrated
anew in the field, the gyroscopes at each start."""
SIMULATED = ((0.001, 0.001, 0.001), (5.0, 13.0, -18.0))  # Offsets that every vehicle of ArduPilot's simulator has
OFFSETS, DIGITS = 3, 4  # The first three are offsets; significant digits, which a parameter keeps as text or float32
FIRST_SECOND = datetime(2001, 1, 1, tzinfo=UTC).timestamp()  # A clock that was never set shows an earlier time


@dataclass(frozen=True)
class Identity:
    """Which vehicle a log is of.

    Attributes:
        name: by which logs of this vehicle are known; of another kind, or another autopilot, it differs.
        basis: what the name is made of: "board", "accelerometer", "compass" or "system id", the last shared by many.
        system: MAVLink system id.
        autopilot, frame, firmware: as the log has them; empty where it does not.
        date: when its settled flight began, or the log, UTC; None where no message has the time of day.
    """

    name: str
    basis: str
    system: int
    autopilot: str
    frame: str
    firmware: str
    date: datetime | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values; the date in ISO 8601."""
        return asdict(self) | {"date": None if self.date is None else self.date.isoformat(timespec="seconds")}


def identity_of(signals: Signals, received: float = float("nan")) -> Identity:
    """Returns the identity of the vehicle of ``signals``; ``received`` is when the log's first message was, UNIX s."""
    vehicle = signals.telemetry
    firmware, date = vehicle.firmware or _firmware(vehicle), _date(signals, received)
    return Identity(*_name(vehicle), vehicle.system, vehicle.autopilot, vehicle.vehicle, firmware, date)


def _name(telemetry: Telemetry) -> tuple[str, str]:
    if number := telemetry.board or board_number_in_texts(_texts(telemetry)) or _sent_number(telemetry):
        return number, "board"
    for sensor, families in CALIBRATIONS.items():
        for names in families:
            values = [telemetry.parameters[name] for name in names if name in telemetry.parameters]
            offsets = tuple(round(offset, 6) for offset in values[:OFFSETS])
            if len(values) == len(names) and any(offsets) and offsets not in SIMULATED:
                text = " ".join(f"{value:.{DIGITS}g}" for value in values)
                return f"{sensor}-{hashlib.sha256(text.encode()).hexdigest()[:12]}", sensor
    return f"{telemetry.autopilot}-{telemetry.system}".lower(), "system id"


def _sent_number(telemetry: Telemetry) -> str:
    """The number in AUTOPILOT_VERSION: the last that is one."""
    columns = telemetry.messages.get("AUTOPILOT_VERSION")
    if columns is None or "uid2" not in columns:
        return ""
    rows = np.atleast_2d(np.asarray(columns["uid2"], dtype=np.uint8))
    words = telemetry.autopilot == "ARDUPILOTMEGA"
    return next((number for row in rows[::-1] if (number := board_number_in_bytes(row.tobytes(), words))), "")


def _texts(telemetry: Telemetry) -> list[str]:
    columns = telemetry.messages.get("STATUSTEXT")
    texts = columns["text"].tolist() if columns is not None and "text" in columns else []
    return [text.decode(errors="replace") if isinstance(text, bytes) else str(text) for text in texts]


def _firmware(telemetry: Telemetry) -> str:
    """What the autopilot says at boot, or AUTOPILOT_VERSION; empty where there is neither."""
    said = next((text.strip() for text in _texts(telemetry) if text.startswith(("ArduCopter V", "APM:Copter V"))), "")
    columns = telemetry.messages.get("AUTOPILOT_VERSION")
    if said or columns is None or "flight_sw_version" not in columns:
        return said
    version = int(columns["flight_sw_version"][-1])
    name = {"ARDUPILOTMEGA": "ArduPilot V", "PX4": "PX4 v"}.get(telemetry.autopilot, "")
    return f"{name}{version_text(version)}" if version else ""


def _date(signals: Signals, received: float) -> datetime | None:
    columns = signals.telemetry.messages.get("SYSTEM_TIME")
    segments = settled_segments(signals)
    flight = min(segments, key=lambda segment: (segment.boot, segment.start), default=None)
    if columns is not None and "time_unix_usec" in columns:
        unix = np.asarray(columns["time_unix_usec"], dtype=np.float64) / 1e6
        known = unix > FIRST_SECOND
        if flight is not None and (known & (columns["boot"] == flight.boot)).any():
            known &= columns["boot"] == flight.boot
        if known.any():
            at, time = float(unix[known][0]), float(columns["time"][known][0])
            same = flight is not None and flight.boot == columns["boot"][known][0]
            return _utc(at + (flight.start - time) if flight is not None and same else at)
    return _utc(received) if received > FIRST_SECOND else None


def _utc(seconds: float) -> datetime | None:
    with suppress(OverflowError, ValueError, OSError):  # a damaged message
        return datetime.fromtimestamp(seconds, UTC)
    return None
