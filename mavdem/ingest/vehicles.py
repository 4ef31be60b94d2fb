"""Who speaks in a stream, which of them are vehicles, and what each vehicle sent."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mavdem.ingest.census import Census
from mavdem.ingest.checksum import Bytes
from mavdem.ingest.decode import enum_name
from mavdem.ingest.log import Log, Speaker, Unread
from mavdem.ingest.messages import Messages
from mavdem.ingest.parameters import parameters
from mavdem.ingest.strays import Places, Times
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


def assemble(
    data: Bytes,
    census: Census,
    received: Callable[[Places], Times],
    receive_time: tuple[float, float],
    bytes_skipped: int,
    source: str,
    repairs: tuple[str, ...],
) -> Log:
    """The log a stream makes.

    Args:
        data: the stream.
        census: of all its frames.
        received: (n,) UNIX s the frames that begin at (n,) were received; NaN where that is not known.
        receive_time: the first and the last such, UNIX s.
        bytes_skipped: bytes that belong to no frame.
        source: the file's name.
        repairs: what was mended before the frames were found.

    Raises:
        Unreadable: the file was cut short meanwhile.
    """
    sent = census.sent()
    unread = census.unread(sent)
    repairs += _damage(unread, bytes_skipped)
    heard = []
    for ids, starts in sent.items():
        messages = Messages(data, starts, received, source)
        heard.append((_speaker(ids, messages, max(int(census.lost[ids]), 0)), messages))
    stores = {speaker.system: messages for speaker, messages in heard if speaker.component == PARAMETER_STORE}
    vehicles = tuple(
        _telemetry(speaker, messages, _stored_parameters(speaker, stores), source, repairs)
        for speaker, messages in heard
        if _is_vehicle(speaker)
    )
    speakers = tuple(speaker for speaker, _ in heard)
    return Log(source, vehicles, speakers, unread, census.frames, bytes_skipped, receive_time)


def _speaker(ids: int, messages: Messages, lost: int) -> Speaker:
    kind, autopilot = identity(messages["HEARTBEAT"]) if "HEARTBEAT" in messages else (UNNAMED, UNNAMED)
    counts = {name: messages.count(name) for name in messages}
    return Speaker(ids >> 8, ids & 0xFF, kind, autopilot, counts, lost)


def identity(heartbeats: Columns) -> tuple[str, str]:
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
