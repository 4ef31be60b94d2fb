"""Inventory of a log: senders, rates, damage; of each vehicle identity, learnability, condition and tier."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from mavdem.assessment.autopilot_messages import (
    SEVERITIES,
    merge_repeats,
    reported_problems,
    status_texts,
)
from mavdem.assessment.condition import Condition, condition_of
from mavdem.containers import JsonValues
from mavdem.dataset.learnability import Learnability, learnability_of, slower_stream_rate
from mavdem.dataset.segments import settled_segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, MIN_STREAM_RATE, Signals, global_positions
from mavdem.dataset.time_series import float_column
from mavdem.facts import Fact
from mavdem.facts.vehicle import Allowed, Basis
from mavdem.ingest import Log
from mavdem.ingest.telemetry import Columns, Telemetry, rate_without_gaps, selected_rows
from mavdem.ingest.vocabulary import (
    board_name_in_texts,
    board_number_in_bytes,
    board_number_in_texts,
    version_text,
)

CALIBRATIONS = {
    Basis.ACCELEROMETER: ("INS_ACCOFFS_{} INS_ACCSCAL_{}", "CAL_ACC0_{}OFF CAL_ACC0_{}SCALE"),
    Basis.COMPASS: ("COMPASS_OFS_{}", "CAL_MAG0_{}OFF"),
}
"""Parameters, X, Y and Z of each, that a vehicle's own sensors have, ArduPilot's and PX4's, the more lasting first: a
compass is calibrated anew in the field, the gyroscopes at each start."""
# Offsets that every vehicle of ArduPilot's simulator has
SIMULATED = ((0.001, 0.001, 0.001), (5.0, 13.0, -18.0))
# A clock that was never set shows an earlier time
FIRST_SECOND = datetime(2001, 1, 1, tzinfo=UTC).timestamp()


@dataclass(frozen=True)
class Identity:
    """Which vehicle a log is of: a ``name`` by which its logs are known, made of the ``basis``.

    Of another kind, or another autopilot, the name differs. ``system`` is the MAVLink id; ``autopilot``, ``frame`` and
    ``firmware`` are as the log has them, empty where it does not; ``date`` is when its settled flight began, or the
    log, UTC, or None. ``hardware`` is the kind of board, as its firmware calls it; ``place`` the first fix, degrees
    north and east.
    """

    name: str
    basis: Basis
    system: int
    autopilot: str
    frame: str
    firmware: str
    date: datetime | None
    hardware: str = ""
    place: tuple[float, float] | None = None


def identity_of(signals: Signals, received: float = float("nan")) -> Identity:
    """Returns the identity of the vehicle of ``signals``; ``received`` is when the log's first message was, UNIX s."""
    vehicle = signals.telemetry
    firmware = vehicle.firmware or _firmware(vehicle)
    date = _date(signals, received)
    hardware = vehicle.hardware or board_name_in_texts(_texts(vehicle))
    name, basis = _name(vehicle)
    return Identity(
        name,
        basis,
        vehicle.system,
        vehicle.autopilot,
        vehicle.vehicle,
        firmware,
        date,
        hardware,
        _place(vehicle),
    )


def _name(telemetry: Telemetry) -> tuple[str, Basis]:
    if (
        number := telemetry.board
        or board_number_in_texts(_texts(telemetry))
        or _sent_number(telemetry)
    ):
        return number, Basis.BOARD
    for sensor, families in CALIBRATIONS.items():
        for family in families:
            names = [name.format(axis) for name in family.split() for axis in "XYZ"]
            values = [telemetry.parameters[name] for name in names if name in telemetry.parameters]
            offsets = tuple(round(offset, 6) for offset in values[:3])
            if len(values) == len(names) and any(offsets) and offsets not in SIMULATED:
                # the digits that text and float32 keep
                text = " ".join(f"{value:.4g}" for value in values)
                return f"{sensor}-{hashlib.sha256(text.encode()).hexdigest()[:12]}", sensor
    return f"{telemetry.autopilot}-{telemetry.system}".lower(), Basis.SYSTEM_ID


def _sent_number(telemetry: Telemetry) -> str:
    """The number in AUTOPILOT_VERSION: the last that is one."""
    columns = telemetry.messages.get("AUTOPILOT_VERSION", {})
    rows = np.atleast_2d(np.asarray(columns.get("uid2", []), dtype=np.uint8))
    words = telemetry.autopilot == "ARDUPILOTMEGA"
    numbers = [board_number_in_bytes(row.tobytes(), words) for row in rows]
    return next(filter(None, reversed(numbers)), "")


def _texts(telemetry: Telemetry) -> list[str]:
    return [text.text for text in status_texts(telemetry)]


def autopilot_alarms(telemetry: Telemetry) -> list[JsonValues]:
    """Returns what the autopilot itself warned of, once where it repeats it: the worst first, then by ``time``.

    That is s since boot. With how often it came (``count``). Of texts, and of ERR in DataFlash.
    """
    alarms = [
        {
            "severity": fact.figures.get("severity") or SEVERITIES[-1],
            "text": fact.figures.get("text") or fact.sentence,
            "time": fact.time,
            "boot": fact.figures["boot"],
            "count": fact.figures["count"],
        }
        for fact in merge_repeats(reported_problems(telemetry))
        if not fact.is_good
    ]
    return sorted(alarms, key=lambda alarm: SEVERITIES.index(alarm["severity"]))


def _firmware(telemetry: Telemetry) -> str:
    prefixes = "ArduCopter V", "APM:Copter V"
    said = next((text for text in _texts(telemetry) if text.startswith(prefixes)), "")
    columns = telemetry.messages.get("AUTOPILOT_VERSION", {})
    if said or "flight_sw_version" not in columns:
        return said
    version = int(columns["flight_sw_version"][-1])
    name = {"ARDUPILOTMEGA": "ArduPilot V", "PX4": "PX4 v"}.get(telemetry.autopilot, "")
    if version:
        return f"{name}{version_text(version)}"
    return ""


def _place(telemetry: Telemetry) -> tuple[float, float] | None:
    """Latitude and longitude of the first fix, degrees, to a metre; None without one."""
    for name in ("GPS_RAW_INT", "GLOBAL_POSITION_INT"):
        if "lat" in (columns := telemetry.messages.get(name, {})):
            places, fixed = global_positions(columns)
            if fixed.any():
                north, east = places[fixed][0]
                return round(float(north), 5), round(float(east), 5)
    return None


def _date(signals: Signals, received: float) -> datetime | None:
    columns = signals.telemetry.messages.get("SYSTEM_TIME", {})
    flight = min(settled_segments(signals), default=None)
    if "time_unix_usec" in columns:
        unix = float_column(columns, "time_unix_usec") / 1e6
        plausible = unix > FIRST_SECOND
        if flight is not None and (own := plausible & (columns["boot"] == flight.boot)).any():
            return _utc(unix[own][0] + flight.start - columns["time"][own][0])
        if plausible.any():
            return _utc(unix[plausible][0])
    if received > FIRST_SECOND:
        return _utc(received)
    return None


def _utc(seconds: float) -> datetime | None:
    with suppress(OverflowError, ValueError, OSError):  # a damaged message
        return datetime.fromtimestamp(seconds, UTC)
    return None


# Hz, of attitude and motor outputs, down to which their means, spreads and limits are known
SLOWEST_RATE = 1.0
TIERS = {
    "a": Fact(Allowed.TIER_A, rate=MIN_STREAM_RATE),
    "b": Fact(Allowed.TIER_B, rate=MIN_SLOW_MOTION_RATE),
    "c": Fact(Allowed.TIER_C),
}


class NextTier(NamedTuple):
    """A better tier than that of a log."""

    tier: str
    reason: Fact  # why the log has it not, and what to change
    is_slow: bool  # whether rates are what is missing

    @property
    def remedy(self) -> str:
        """What to change for it."""
        return self.reason.remedy

    @property
    def needs(self) -> str:
        """What the log must have for it."""
        return TIERS[self.tier].remedy if self.is_slow else self.remedy.rstrip(".")


class Tier(NamedTuple):
    """What a log allows."""

    tier: str | None  # "a", "b" or "c"; None where there is no settled flight
    tier_reason: Fact  # what decided; of all but "a", why it is no better, and what to change
    allows: Fact | None  # what it gives
    next_tier: NextTier | None  # None for "a"


def tier_of(learnability: Learnability, condition: Condition) -> Tier:
    """Returns the tier by the rates; in the second :func:`mavdem.assessment.axis.analyse` may refuse a model."""
    reason = learnability.reason
    if learnability.learnable:
        return Tier("a", reason, TIERS["a"], None)
    slower = slower_stream_rate(learnability.figures)
    is_slow = slower < MIN_STREAM_RATE
    if not condition.settled or not condition.lean or 0 < slower < SLOWEST_RATE:
        return Tier(None, reason, None, NextTier("c", reason, is_slow))
    name, following = ("b", "a") if slower >= MIN_SLOW_MOTION_RATE else ("c", "b")
    return Tier(name, reason, TIERS[name], NextTier(following, reason, is_slow))


class Seen(NamedTuple):
    """What a log says of one vehicle before learning."""

    telemetry: Telemetry
    learnability: Learnability
    condition: Condition
    identity: Identity


def inventory(log: Log, seen: Sequence[Seen] | None = None) -> JsonValues:
    """Returns everything there is to report of a log before learning, by keys of documents; times in s, rates in Hz.

    Of each component ``lost_share`` is the share of its sequence numbers that do not occur, and of a vehicle
    ``missing_share`` the share of messages missing from a stream by the stream's usual step, the median over its
    streams; None where there are none. A link loses messages of all kinds alike: where ``missing_share`` is near 0, the
    sequence numbers that do not occur are of kinds that the log leaves out. A change of rates raises ``missing_share``
    but not ``lost_share``; only both together mean a loss. Vehicles are those that were ``seen``; all, unless given.
    """
    if seen is None:
        seen = [_seen(telemetry, log) for telemetry in log.vehicles]
    missing = {
        (vehicle.system, vehicle.component): _missing_share(vehicle) for vehicle in log.vehicles
    }
    described = [_vehicle(*vehicle) for vehicle in seen]
    return {
        "source": log.source,
        "frames": log.frames,
        "bytes_skipped": log.bytes_skipped,
        "receive_time": log.receive_time,
        "unread": [
            {
                "message_id": unread.message_id,
                "system": unread.system,
                "component": unread.component,
                "frames": unread.frames,
                "of": unread.total,
                "cause": unread.cause.replace("_", " "),
            }
            for unread in log.unread
        ],
        "speakers": [
            {
                "system": component.system,
                "component": component.component,
                "kind": component.kind,
                "messages": (sent := sum(component.messages.values())),
                "lost": component.lost,
                "lost_share": component.lost / max(component.lost + sent, 1),
                "missing_share": missing.get((component.system, component.component)),
            }
            for component in log.components
        ],
        "vehicles": described,
        "learnable": any(vehicle["verdict"].learnable for vehicle in described),
    }


def _seen(telemetry: Telemetry, log: Log) -> Seen:
    signals = Signals(telemetry)
    learnability = learnability_of(signals, log.components)
    identity = identity_of(signals, log.receive_time[0])
    return Seen(telemetry, learnability, condition_of(signals), identity)


def _vehicle(
    telemetry: Telemetry, learnability: Learnability, condition: Condition, identity: Identity
) -> JsonValues:
    messages = sorted(telemetry.messages.items())
    return {
        "system": telemetry.system,
        "component": telemetry.component,
        "vehicle": telemetry.vehicle,
        "autopilot": telemetry.autopilot,
        "translated_from": telemetry.translated_from,
        "names": {
            name: telemetry.source_names[name]
            for name, _ in messages
            if name in telemetry.source_names
        },
        "parameters": len(telemetry.parameters),
        "messages": {
            name: {"count": len(sent["time"]), "rate": _rate(sent)} for name, sent in messages
        },
        "boots": len(
            set().union(
                *(np.unique(columns["boot"]).tolist() for columns in telemetry.messages.values())
            )
        ),
        "segments": learnability.segments,
        "repairs": telemetry.repairs,
        "verdict": learnability,
        **tier_of(learnability, condition)._asdict(),
        "identity": identity,
        "condition": condition,
        "autopilot_alarms": autopilot_alarms(telemetry),
    }


def _rate(columns: Columns) -> float | None:
    """Messages a second of the port or group that has most; without pauses, but of what comes in bursts with them."""
    for field in columns.keys() & {"port", "group_mlx"}:
        instances, of = np.unique(columns[field], return_inverse=True)
        if len(instances) > 1:
            columns = selected_rows(columns, of == np.bincount(of).argmax())
    steps = np.diff(columns["time"])[np.diff(columns["boot"]) == 0]
    apart = steps[steps > 0]  # sensors of a kind are sent at once
    if not len(apart):
        return None
    rate = rate_without_gaps(apart)
    mean = 1 / apart.mean()
    return rate if mean > rate / 4 else mean


def _missing_share(telemetry: Telemetry) -> float | None:
    shares = []
    for columns in telemetry.messages.values():
        time = columns["time"]
        boot = columns["boot"]
        steps = np.diff(time)[np.diff(boot) == 0]
        # The mean of the middle half: a loop of 4 ms makes steps of 8 and 12 ms of 10.
        quarter = len(steps) // 4
        middle = np.sort(steps)[quarter : len(steps) - quarter]
        usual = middle.mean() if len(time) >= 50 and len(steps) else 0.0
        if usual > 0:
            # A quarter of a step is jitter.
            gaps = np.rint(steps / usual - 0.25) - 1
            missing = np.maximum(gaps, 0).sum()
            shares.append(missing / (missing + len(time)))
    if shares:
        return np.median(shares)
    return None
