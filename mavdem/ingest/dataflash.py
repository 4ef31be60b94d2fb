"""DataFlash logs: what an ArduPilot autopilot writes on board, binary (.bin) or as text (.log).

Read into MAVLink's messages and units (``dataflash_translation``), so that nothing downstream knows the difference.
"""

from __future__ import annotations

import os

from mavdem.errors import Unreadable
from mavdem.ingest.dataflash_binary import read_binary
from mavdem.ingest.dataflash_clock import on_boot_clock
from mavdem.ingest.dataflash_definition import Recording, numbers
from mavdem.ingest.dataflash_text import is_text, read_text
from mavdem.ingest.dataflash_translation import NEEDED, needs_gyros, translated
from mavdem.ingest.dataflash_vehicle import UNKNOWN, mav_type, parameters, system_id, texts
from mavdem.ingest.decode import enum_name
from mavdem.ingest.files import file_bytes
from mavdem.ingest.framing import Progress
from mavdem.ingest.log import Log, Speaker
from mavdem.ingest.vehicles import UNNAMED
from mavdem.telemetry import Telemetry

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
ARDUPILOT = 3
"""MAV_AUTOPILOT_ARDUPILOTMEGA."""


def read_dataflash(path: str | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads a DataFlash log, damaged ones as far as they go.

    The log has one vehicle. Its one speaker counts the messages under DataFlash's names ("ATT"), the telemetry has
    them under MAVLink's ("ATTITUDE").

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, or there is no message of an ArduPilot autopilot in it.
    """
    name = os.fspath(path)
    content = file_bytes(path)
    recording = read_text(content, progress) if is_text(content) else read_binary(content, progress)
    wanted = [*NEEDED, "IMU"] if needs_gyros(recording.counts) else list(NEEDED)
    tables, clock_repairs = on_boot_clock({message: numbers(recording.table(message)) for message in wanted})
    if not any(len(columns["time"]) for columns in tables.values()):
        raise Unreadable(_nothing_in(name, recording))
    values = parameters(recording.table("PARM"))
    kind = mav_type(texts(recording.table("MSG"), "Message"), values)
    vehicle = Telemetry(
        system=system_id(values),
        component=AUTOPILOT,
        vehicle=UNNAMED if kind == UNKNOWN else enum_name("MAV_TYPE", kind),
        autopilot=enum_name("MAV_AUTOPILOT", ARDUPILOT),
        messages=translated(tables, kind, ARDUPILOT),
        parameters=values,
        source=name,
        repairs=recording.repairs + _skipped(recording) + clock_repairs,
        translated_from="DataFlash",
    )
    speaker = Speaker(vehicle.system, AUTOPILOT, vehicle.vehicle, vehicle.autopilot, recording.counts, lost=0)
    unknown_times = (float("nan"), float("nan"))
    count = sum(recording.counts.values())
    return Log(name, (vehicle,), (speaker,), (), count, recording.bytes_skipped, unknown_times)


def _skipped(recording: Recording) -> tuple[str, ...]:
    if not recording.bytes_skipped:
        return ()
    return (f"{recording.bytes_skipped} bytes that belong to no message were skipped.",)


def _nothing_in(path: str, recording: Recording) -> str:
    if recording.counts:
        return (
            f"{path} holds {sum(recording.counts.values())} DataFlash messages, but none of attitude, motors or events "
            "with the time since boot: it is damaged, or another autopilot's."
        )
    return f"{path} holds no DataFlash messages: name an ArduPilot log (.bin or .log)."
