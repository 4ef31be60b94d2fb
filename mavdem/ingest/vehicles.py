"""Who speaks in a stream, which of them are vehicles, and what each vehicle sent."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.clocks import Times
from mavdem.ingest.decode import enum_name
from mavdem.ingest.framing import GOOD, UNKNOWN, Bytes, Frames
from mavdem.ingest.log import Log, Speaker, Unread
from mavdem.ingest.messages import Messages
from mavdem.ingest.parameters import parameters
from mavdem.telemetry import Columns, Telemetry

UNNAMED = "UNKNOWN"
NOT_VEHICLES = frozenset(
    {"GCS", "ANTENNA_TRACKER", "ONBOARD_CONTROLLER", "GIMBAL", "ADSB", "CAMERA", "CHARGING_STATION", "FLARM", "SERVO"}
    | {"ODID", "BATTERY", "LOG", "OSD", "IMU", "GPS", "WINCH", "ILLUMINATOR", "GRIPPER", "PARACHUTE"}
)
"""MAV_TYPEs of components and ground equipment."""
FLIES = ("ATTITUDE", "ATTITUDE_QUATERNION", "SERVO_OUTPUT_RAW", "ACTUATOR_OUTPUT_STATUS", "HIL_ACTUATOR_CONTROLS")
"""Messages that make a vehicle of a component that sent no HEARTBEAT."""
GENERIC_WEIGHT = 0.1
"""What a HEARTBEAT of type GENERIC counts for: it says nothing, and scripts send it under any id."""
PARAMETER_STORE = 190
"""Component (MAV_COMP_ID_MISSIONPLANNER) under which MAVProxy writes the parameters it holds of a system."""
FEWEST_OF_A_DIALECT = 3
"""Frames of one message that must all fail before they count as another dialect, not as damage."""


def assemble(
    data: Bytes, frames: Frames, received: Times, bytes_skipped: int, source: str, repairs: tuple[str, ...]
) -> Log:
    """The log a table of frames makes.

    Args:
        data, frames: as ``find_frames`` takes and gives them.
        received: (N,) UNIX s each frame was received; NaN where that is not known.
        bytes_skipped: bytes that belong to no frame.
        source: the file's name.
        repairs: what was mended before the frames were found.
    """
    unread = _unread(frames)
    repairs += _damage(unread, bytes_skipped)
    sources = frames.system.astype(np.int64) << 8 | frames.component
    order = np.argsort(sources, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(sources[order])) + 1)
    heard = []
    for rows in groups:
        good = rows[frames.verdict[rows] == GOOD]
        if len(good):
            messages = Messages(data, frames[good], received[good])
            heard.append((_speaker(int(sources[rows[0]]), messages, _lost(frames.sequence[rows])), messages))
    stores = {speaker.system: messages for speaker, messages in heard if speaker.component == PARAMETER_STORE}
    vehicles = tuple(
        _telemetry(speaker, messages, _stored_parameters(speaker, stores), source, repairs)
        for speaker, messages in heard
        if _is_vehicle(speaker)
    )
    known = received[~np.isnan(received)]
    span = (float(known.min()), float(known.max())) if len(known) else (np.nan, np.nan)
    return Log(source, vehicles, tuple(speaker for speaker, _ in heard), unread, len(frames), bytes_skipped, span)


def _speaker(ids: int, messages: Messages, lost: int) -> Speaker:
    kind, autopilot = _identity(messages["HEARTBEAT"]) if "HEARTBEAT" in messages else (UNNAMED, UNNAMED)
    counts = {name: messages.count(name) for name in messages}
    return Speaker(ids >> 8, ids & 0xFF, kind, autopilot, counts, lost)


def _identity(heartbeats: Columns) -> tuple[str, str]:
    """What most HEARTBEATs say the component is, and the autopilot most of those name."""
    votes = np.bincount(heartbeats["type"]).astype(np.float64)
    votes[0] *= GENERIC_WEIGHT
    kind = int(votes.argmax())
    autopilot = int(np.bincount(heartbeats["autopilot"][heartbeats["type"] == kind]).argmax())
    return enum_name("MAV_TYPE", kind), enum_name("MAV_AUTOPILOT", autopilot)


def _is_vehicle(speaker: Speaker) -> bool:
    if speaker.kind == UNNAMED:
        return any(name in speaker.messages for name in FLIES)
    return speaker.kind not in NOT_VEHICLES and set(speaker.messages) != {"HEARTBEAT"}


def _telemetry(
    speaker: Speaker, messages: Messages, stored: Mapping[str, float], source: str, repairs: tuple[str, ...]
) -> Telemetry:
    own = parameters(messages["PARAM_VALUE"], speaker.autopilot) if "PARAM_VALUE" in messages else {}
    return Telemetry(
        system=speaker.system,
        component=speaker.component,
        vehicle=speaker.kind,
        autopilot=speaker.autopilot,
        messages=messages,
        parameters={**stored, **own},
        source=source,
        repairs=repairs + messages.repairs,
    )


def _stored_parameters(vehicle: Speaker, stores: Mapping[int, Messages]) -> dict[str, float]:
    """The vehicle's parameters as MAVProxy notes them in its logs, from the stores by system."""
    store = stores.get(vehicle.system)
    if store is None or "PARAM_VALUE" not in store:
        return {}
    return parameters(store["PARAM_VALUE"], vehicle.autopilot)


def _lost(sequence: NDArray[np.uint8]) -> int:
    """Messages missing by sequence number; a step back by up to half the range is a late or repeated message."""
    missing = (np.diff(sequence) - np.uint8(1)).astype(np.int64)
    return int(missing[missing < 128].sum())


def _unread(frames: Frames) -> tuple[Unread, ...]:
    keys = frames.message_id << 16 | frames.system.astype(np.int64) << 8 | frames.component
    totals = dict(zip(*(counted.tolist() for counted in np.unique(keys, return_counts=True)), strict=True))
    bad, failures = np.unique(keys[frames.verdict != GOOD], return_counts=True)
    unknown = set(np.unique(keys[frames.verdict == UNKNOWN]).tolist())
    speaking = set(np.unique(keys[frames.verdict == GOOD] & 0xFFFF).tolist())
    found = []
    for key, count in zip(bad.tolist(), failures.tolist(), strict=True):
        total = totals[key]
        strange = key & 0xFFFF in speaking if key in unknown else count == total >= FEWEST_OF_A_DIALECT
        cause = "another dialect" if strange else "damage"
        found.append(Unread(key >> 16, key >> 8 & 0xFF, key & 0xFF, count, total, cause))
    return tuple(found)


def _damage(unread: tuple[Unread, ...], bytes_skipped: int) -> tuple[str, ...]:
    failed = sum(kind.frames for kind in unread if kind.cause == "damage")
    foreign = sum(kind.frames for kind in unread if kind.cause == "another dialect")
    sentences = []
    if failed:
        sentences.append(f"{failed} damaged frames were left out.")
    if foreign:
        sentences.append(f"{foreign} frames of another dialect were left out.")
    if bytes_skipped:
        sentences.append(f"{bytes_skipped} bytes that belong to no frame were skipped.")
    return tuple(sentences)
