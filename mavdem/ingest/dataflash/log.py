"""DataFlash logs: what an ArduPilot autopilot writes on board, binary (.bin) or as text (.log), as MAVLink's messages.

All messages carry one clock: TimeUS, µs since boot, or TimeMS before ArduPilot 3.3. A log may contain several boots,
appended. Ground stations write the text: one message a line, name first, values in their units, FMT lines as in the
binary log; a line that does not match its definition is left out. pymavlink's reader of such text gives up at a line
that is not UTF-8 or after a thousand lines that it does not know.
"""

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import isfinite

import numpy as np

from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, Source
from mavdem.files import PathName
from mavdem.ingest.contents import file_bytes, is_dataflash_text
from mavdem.ingest.dataflash import binary
from mavdem.ingest.dataflash.binary import (
    DataflashRecording,
    FormatDefinition,
    MessageTable,
    numbers,
    read_binary,
)
from mavdem.ingest.dataflash.samples import raw_samples
from mavdem.ingest.dataflash.states import ARMING
from mavdem.ingest.dataflash.translation import (
    ACCELEROMETERS,
    GYROS,
    NEEDED,
    OF_FLIGHT,
    texts_of,
    translated,
    under_later_names,
)
from mavdem.ingest.mavlink.clocks import MessageStamps, boot_clock
from mavdem.ingest.telemetry import (
    Columns,
    Log,
    Parameters,
    Tables,
    Telemetry,
    log_of_vehicles,
    repair_facts,
    selected_rows,
)
from mavdem.ingest.vocabulary import (
    AUTOPILOT_COMPONENT,
    UNNAMED,
    board_name_in_texts,
    board_number_in_texts,
    mavlink_constant,
)

_BYTE = re.compile(rb"\s*\d{1,3}\s*")  # A number of one byte as text
_Lines = list[tuple[int, bytes]]  # The lines of one definition: their numbers, and their values


def read_text(content: bytes) -> DataflashRecording:
    """Returns the messages in the bytes of a text log."""
    lines: dict[str, _Lines] = {}
    definitions: dict[str, FormatDefinition] = {}
    skipped = lost = 0
    for number, line in enumerate(content.split(b"\n")):
        name, _, values = line.partition(b",")
        text = name.decode("latin-1").strip()
        if text == binary.FORMAT.name and (definition := _definition(values)) is not None:
            definitions.setdefault(text, binary.FORMAT)
            definitions.setdefault(definition.name, definition)
        if text in definitions and values.count(b",") >= len(definitions[text].fields) - 1:
            lines.setdefault(text, []).append((number, values))
        elif line.strip():
            skipped += len(line) + 1
            lost += 1

    def table(name: str) -> MessageTable:
        return _decoded(definitions[name], lines[name]) if name in lines else binary.EMPTY

    counts = {name: len(own) for name, own in lines.items()}
    return DataflashRecording(
        counts, table, skipped, repair_facts(Repair.LINES_LEFT_OUT, count=lost)
    )


def _definition(values: bytes) -> FormatDefinition | None:
    parts = values.split(b",", 4)
    if len(parts) < 5 or not all(_BYTE.fullmatch(part) for part in parts[:2]):
        return None
    definition = binary.defined((int(parts[0]), int(parts[1]), parts[2], parts[3], parts[4]))
    return definition[1] if definition else None


def _decoded(definition: FormatDefinition, lines: _Lines) -> MessageTable:
    count = len(definition.fields)
    if definition.wire is None or not count:
        return binary.EMPTY
    # A text that is the last field may hold commas.
    numeric = {
        i
        for i, character in enumerate(definition.characters)
        if character not in binary.TEXTS + "aM"
    }
    places = []
    whole = []
    for number, values in lines:
        row = [value.strip() for value in values.split(b",", count - 1)]
        with suppress(ValueError):
            whole.append([float(value) if i in numeric else value for i, value in enumerate(row)])
            places.append(number)
    # Texts as objects: an array of bytes would give all the room of the longest.
    kinds = [np.float64 if i in numeric else np.object_ for i in range(count)]
    named = enumerate(zip(definition.fields, kinds, strict=True))
    columns = {name: np.array([row[i] for row in whole], dtype=kind) for i, (name, kind) in named}
    return MessageTable(np.array(places, dtype=np.int64), columns)


CLOCKS = {"TimeUS": 1e6, "TimeMS": 1e3}  # Fields with the time stamp and their units in a second
# Without a stamp, as before ArduCopter 3.4, they have the time of the message before them; texts have
# their own only between their neighbours', for those of the start are older
EVENTS = ("EV", "ARM", "ERR", "MODE", "MSG", "PARM")
FIRMWARES = {
    "plane": "FIXED_WING",
    "copter": "QUADROTOR",
    "tracker": "ANTENNA_TRACKER",
    "blimp": "AIRSHIP",
    "rover": "GROUND_ROVER",
    "sub": "SUBMARINE",
}
"""MAV_TYPE by what follows "Ardu", "APM:" or "Antenna" in MSG ("ArduCopter V4.5.7", "APM:Copter V3.5")."""
_FIRMWARE = re.compile(rf"^(?:Ardu|APM:|Antenna)?({'|'.join(FIRMWARES)})\b", re.IGNORECASE)
FRAME_CLASSES = (
    "QUADROTOR",
    "QUADROTOR",
    "HEXAROTOR",
    "OCTOROTOR",
    "OCTOROTOR",
    "HEXAROTOR",
    "HELICOPTER",
    "TRICOPTER",
    "COAXIAL",
    "COAXIAL",
    "COAXIAL",
    "HELICOPTER",
    "DODECAROTOR",
    "HELICOPTER",
    "DECAROTOR",
)
"""MAV_TYPE by FRAME_CLASS, as in ArduCopter's HEARTBEAT (``get_frame_mav_type``)."""
FRAME_NAMES = {
    "QUAD": "QUADROTOR",
    "HEXA": "HEXAROTOR",
    "Y6": "HEXAROTOR",
    "OCTA": "OCTOROTOR",
    "OCTAQUAD": "OCTOROTOR",
    "OCTA_QUAD": "OCTOROTOR",
    "TRI": "TRICOPTER",
    "HELI": "HELICOPTER",
}
"""The same by the name in MSG: "Frame: QUAD/X"."""
_FRAME = re.compile(r"^Frame: ([A-Z0-9_]+)")


def read_dataflash(path: PathName) -> Log:
    """Reads a DataFlash log; a damaged one as far as possible.

    The log has one vehicle. Its component counts the messages under DataFlash's names ("ATT"), the telemetry has them
    under MAVLink's ("ATTITUDE"). Raises Unreadable: the file cannot be opened, or has no message of ArduPilot.
    """
    source = os.fspath(path)
    content = file_bytes(path)
    recording = read_text(content) if is_dataflash_text(content) else read_binary(content)
    counts = recording.counts
    frames = sum(counts.values())
    vehicle = _vehicle(recording, source)
    return log_of_vehicles((vehicle,), frames, recording.bytes_skipped, counts=counts)


def _vehicle(recording: DataflashRecording, source: str) -> Telemetry:
    logged = {name: under_later_names(name, numbers(recording.table(name))) for name in NEEDED}
    imu = logged["IMU"]  # by far the most messages: only what is used of each is kept
    used = {*imu.columns} & {*CLOCKS, "I", *GYROS, *ACCELEROMETERS}
    logged["IMU"] = MessageTable(imu.place, {name: imu.columns[name] for name in used})
    tables, repairs = _on_boot_clock(logged)
    texts = texts_of(logged["MSG"].columns, "Message")
    if not any(len(tables[name]["time"]) for name in OF_FLIGHT if name in tables):
        named = sorted(recording.counts)
        code = Source.DATAFLASH_WITHOUT_FLIGHT if named else Source.DATAFLASH_WITHOUT_MESSAGES
        raise Unreadable(code, path=source, names=named)
    parameters, first = (_parameters(logged["PARM"].columns, way) for way in (1, -1))
    kind = _mav_type(texts, parameters)
    # DSF counts the messages that the logger had no room for, anew with each boot.
    counts = numbers(recording.table("DSF")).columns.get("Dp", np.zeros(0)).astype(np.float64)
    dropouts = int(np.nansum(np.maximum(np.diff(counts), 0)))
    messages, names, notes = translated(tables, mavlink_constant(f"MAV_TYPE_{kind}"))
    samples = raw_samples(tables, parameters)
    messages |= {name: columns for name, (_, columns) in samples.items()}
    names |= {name: own for name, (own, _) in samples.items()}
    repairs = (
        *recording.repairs,
        *repair_facts(Repair.BYTES_SKIPPED, count=recording.bytes_skipped, part="message"),
        *repairs,
        *notes,
        *repair_facts(Repair.LOGGER_WITHOUT_ROOM, count=dropouts),
    )
    system_ids = ("MAV_SYSID", "SYSID_THISMAV")  # from ArduPilot 4.7 on, and before
    return Telemetry(
        system=next(
            (int(parameters[name]) for name in system_ids if 1 <= parameters.get(name, 0) <= 255), 1
        ),
        component=AUTOPILOT_COMPONENT,
        vehicle=UNNAMED if kind == "GENERIC" else kind,
        autopilot="ARDUPILOTMEGA",
        messages=messages,
        parameters=parameters,
        source=source,
        repairs=repairs,
        translated_from="DataFlash",
        firmware=next((text.strip() for text in texts if _FIRMWARE.match(text)), ""),
        dropouts=dropouts,
        source_names=names,
        board=board_number_in_texts(texts),
        hardware=board_name_in_texts(texts),
        initial_parameters={
            name: value for name, value in first.items() if value != parameters[name]
        },
    )


def _on_boot_clock(
    tables: Mapping[str, MessageTable],
) -> tuple[Tables, Facts]:
    """The tables with stamps, or of ``EVENTS``, with ``time`` (s) and ``boot``, and the repairs."""
    stamps = {
        name: table.columns[field] / CLOCKS[field]
        for name, table in tables.items()
        for field in CLOCKS
        if field in table.columns
    }
    clocks = [name for name in stamps if name not in ("MSG", "PARM")]
    if not clocks:
        return {}, ()
    offsets = np.concatenate([tables[name].place for name in clocks])
    order = np.argsort(offsets, kind="stable")
    offsets = offsets[order]
    seconds = np.concatenate([stamps[name] for name in clocks])[order]
    # As a float, or in text, a damaged stamp may be anything.
    impossible = ~((seconds >= 0) & (seconds <= 2.0**63 / 1e6))
    seconds[impossible] = 0.0  # no stamp, to the boot clock
    on_clock, repairs = boot_clock([MessageStamps("", np.arange(len(offsets)), seconds)])
    time, boot = on_clock[""]
    placed: dict[str, Columns] = {}
    for name, table in tables.items():
        row = np.searchsorted(offsets, table.place)
        if name in clocks:
            # A message whose stamp was ignored has the time of the one before it: it is not to be trusted either.
            on_boot = {**table.columns, "time": time[row], "boot": boot[row]}
            placed[name] = selected_rows(on_boot, time[row] == seconds[row])
        elif name in EVENTS and len(row):
            before = np.maximum(row - 1, 0)
            after = np.minimum(row, len(offsets) - 1)
            # Nothing is logged while disarmed: arming ends a gap, what else has no stamp begins one.
            arms = name == "EV" and np.isin(table.columns.get("Id", 0), ARMING)
            at_end = np.where(arms & (boot[after] == boot[before]), np.inf, -np.inf)
            own = stamps.get(name, at_end)
            placed[name] = {
                **table.columns,
                "time": np.clip(own, time[before], np.maximum(time[after], time[before])),
                "boot": boot[before],
            }
    lost = np.count_nonzero(impossible)
    left_out = repair_facts(Repair.LOGGED_MESSAGES_LEFT_OUT, count=lost, flaw=Flaw.IMPOSSIBLE_STAMP)
    return placed, left_out + repairs


def _parameters(logged: Columns, way: int) -> Parameters:
    """The last values, or the first, ``way`` -1."""
    values = logged.get("Value", np.zeros(0)).astype(float)[::way].tolist()
    pairs = zip(texts_of(logged, "Name")[::way], values, strict=False)
    return {name: value for name, value in pairs if isfinite(value)}


def _mav_type(texts: Sequence[str], parameters: Parameters) -> str:
    """The vehicle's MAV_TYPE, from the texts of MSG and its parameters; GENERIC where neither has it."""
    firmwares = [match[1].lower() for text in texts if (match := _FIRMWARE.match(text))]
    kind = "GENERIC"
    if firmwares:
        kind = FIRMWARES[firmwares[0]]
    elif {"FRAME_CLASS", "ATC_RAT_RLL_P"} <= parameters.keys():  # no other vehicle has both
        kind = FIRMWARES["copter"]
    if kind != FIRMWARES["copter"]:
        return kind
    if "FRAME_CLASS" in parameters:
        number = int(parameters["FRAME_CLASS"])
        return dict(enumerate(FRAME_CLASSES)).get(number, "GENERIC_MULTIROTOR")
    named = next((match[1] for text in texts if (match := _FRAME.match(text))), "")
    return FRAME_NAMES.get(named, "GENERIC_MULTIROTOR")
