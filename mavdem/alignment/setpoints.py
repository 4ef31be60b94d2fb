"""Setpoints: what was asked of an axis, from a vehicle's Telemetry.

A setpoint is a command: it holds until the next one. So a sample has the last setpoint with a stamp at or before its
own, never one from the future, and none where that is older than ``HOLD_SECONDS``. On average it is half an interval
late.

All stamps are on the boot clock, with the resolution of their messages (1 ms in MAVLink, 1 µs in most logs). ArduPilot
stamps ATTITUDE_TARGET and RC_CHANNELS when it sends them, with the values of then. PX4 stamps ATTITUDE_TARGET with the
time of its attitude setpoint and sends the body rates of its last step until it sends: those may be some of its steps
of 4 ms newer than their stamp (the test of a flight recorded both ways has the figures), as those in its ATTITUDE.
MANUAL_CONTROL has no stamp in MAVLink, and gets the time of the message before it.

A rate setpoint is not the same everywhere: in ArduPilot's ATTITUDE_TARGET it is the rate of the attitude setpoint; in
DataFlash's RATE and from PX4 it corrects the error of the attitude as well.

Only setpoints that do not themselves answer the wind are instruments for the motors' effect. The sticks are such; the
others are so where no outer loop makes them of the vehicle's own motion, as position hold does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.columns import MAX_BODY_RATE, Signal, floats, in_order, message_counts, preferred_message
from mavdem.ingest.mavlink.euler import euler_angles
from mavdem.ingest.telemetry import Columns, Telemetry

TARGET_MESSAGE = "ATTITUDE_TARGET"
RATE_FIELDS = {"roll": "body_roll_rate", "pitch": "body_pitch_rate", "yaw": "body_yaw_rate"}
IGNORED_RATES = {"roll": 1, "pitch": 2, "yaw": 4}
IGNORED_ATTITUDE = 128
"""Bits of ATTITUDE_TARGET.type_mask (ATTITUDE_TARGET_TYPEMASK): a field with its bit set is no setpoint."""
MANUAL_MESSAGE = "MANUAL_CONTROL"
MANUAL_FIELDS, MANUAL_RANGE = {"roll": "y", "pitch": "x", "yaw": "r"}, 1000.0
"""Fields of MANUAL_CONTROL, and full deflection; 32767 stands for none."""
RADIO_MESSAGES = ("RC_CHANNELS", "RC_CHANNELS_RAW")  # With the receiver's channels, the preferred first
RADIO_CHANNELS = {"roll": 1, "pitch": 2, "yaw": 4}  # ArduPilot's default; PX4 has none
MIN_PULSE, MAX_PULSE = 500.0, 2500.0  # µs; 0 and 65535 stand for no channel
ROUNDING = 1e-6  # s: stamps have no more digits, and the sum of steps that a grid point is may fall just before one
HOLD_SECONDS = 2.0
"""Age beyond which a setpoint is unknown: ground stations ask for the sticks at 1 Hz and more, and in flight modes that
have no such setpoint its messages end."""


@dataclass(frozen=True, eq=False)
class Setpoint:
    """One setpoint of one axis: ``signal`` from ``message``, called ``name``, in ``unit``."""

    name: str
    unit: str
    message: str
    signal: Signal


def setpoints(telemetry: Telemetry, axis: str) -> tuple[Setpoint, ...]:
    """The setpoints of ``axis`` that were recorded, of at most three.

    "roll rate setpoint" (rad/s) and, not of yaw, "roll setpoint" (rad), from ATTITUDE_TARGET; "roll stick" from
    MANUAL_CONTROL (-1 to 1) or else the receiver's channel (µs).
    """
    targets = telemetry.messages.get(TARGET_MESSAGE)
    manual = telemetry.messages.get(MANUAL_MESSAGE)
    radio = preferred_message(message_counts(telemetry, RADIO_MESSAGES))
    found: list[tuple[str, str, str, Columns, NDArray[np.float64]]] = []
    if targets is not None:
        ignored = _ignored(targets)
        rates = np.where(ignored & IGNORED_RATES[axis], np.nan, floats(targets, RATE_FIELDS[axis]))
        rates[np.abs(rates) > MAX_BODY_RATE] = np.nan
        found.append((f"{axis} rate setpoint", "rad/s", TARGET_MESSAGE, targets, rates))
        if axis != "yaw":
            angles = np.where(ignored & IGNORED_ATTITUDE, np.nan, _angles(targets, axis))
            found.append((f"{axis} setpoint", "rad", TARGET_MESSAGE, targets, angles))
    if manual is not None:
        deflection = floats(manual, MANUAL_FIELDS[axis]) / MANUAL_RANGE
        deflection[np.abs(deflection) > 1] = np.nan
        found.append((f"{axis} stick", "", MANUAL_MESSAGE, manual, deflection))
    elif radio is not None and (pulses := _pulses(telemetry, radio, axis)) is not None:
        found.append((f"{axis} stick", "µs", radio, telemetry.messages[radio], pulses))
    made = (Setpoint(name, unit, message, _signal(columns, values)) for name, unit, message, columns, values in found)
    return tuple(setpoint for setpoint in made if len(setpoint.signal.time))


def held(setpoint: Setpoint, boot: int, time: NDArray[np.float64]) -> NDArray[np.float64]:
    """The setpoint at ``time`` (T,) s of ``boot``: the last one until then; NaN where none came in ``HOLD_SECONDS``."""
    here = setpoint.signal.boot == boot
    stamps, values = setpoint.signal.time[here], setpoint.signal.values[here]
    if not len(stamps):
        return np.full(len(time), np.nan)
    last = np.searchsorted(stamps, time + ROUNDING, side="right") - 1
    known = (last >= 0) & (time - stamps[np.maximum(last, 0)] <= HOLD_SECONDS + ROUNDING)
    return np.where(known, values[np.maximum(last, 0)], np.nan)


def _ignored(targets: Columns) -> NDArray[np.int64]:
    if "type_mask" not in targets:
        return np.zeros(len(targets["time"]), dtype=np.int64)
    return np.asarray(targets["type_mask"]).astype(np.int64)


def _angles(targets: Columns, axis: str) -> NDArray[np.float64]:
    """(N,) rad; NaN where the quaternion is none."""
    attitude = np.atleast_2d(floats(targets, "q"))
    with np.errstate(invalid="ignore", divide="ignore"):
        roll, pitch, _ = euler_angles(attitude / np.linalg.norm(attitude, axis=1, keepdims=True))
    return roll if axis == "roll" else pitch


def _pulses(telemetry: Telemetry, message: str, axis: str) -> NDArray[np.float64] | None:
    """(N,) µs of the receiver's channel for ``axis``; None where no channel is known for it."""
    columns, parameters = telemetry.messages[message], telemetry.parameters
    if telemetry.autopilot == "PX4":
        channel = int(parameters.get(f"RC_MAP_{axis.upper()}", 0))
    else:
        channel = int(parameters.get(f"RCMAP_{axis.upper()}", RADIO_CHANNELS[axis]))
    field = f"chan{channel}_raw"
    if field not in columns:
        return None
    pulses = floats(columns, field)
    unusable = ~((pulses >= MIN_PULSE) & (pulses <= MAX_PULSE))
    if message == "RC_CHANNELS_RAW" and "port" in columns:
        unusable |= np.asarray(columns["port"]) != 0
    return np.where(unusable, np.nan, pulses)


def _signal(columns: Columns, values: NDArray[np.float64]) -> Signal:
    there = np.isfinite(values)
    time, boot, table, _ = in_order(columns["time"][there], columns["boot"][there], values[there, None])
    return Signal(time, boot, table[:, 0])
