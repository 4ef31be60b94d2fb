"""Which message means what: attitude, motor outputs, armed, airborne and climbing, out of a vehicle's Telemetry.

The one place that knows message and field names. Every function takes a ``Telemetry`` and answers with plain arrays on
its boot clock, in time order, each stamp once, per boot; a message that is not there answers None.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem.euler import roll_and_pitch
from mavdem.ingest.decode import enum_name
from mavdem.ingest.geometry import Layout, layout, of_demand
from mavdem.ingest.scale import Scale, recognise
from mavdem.telemetry import Columns, Telemetry

AXES = ("roll", "pitch")

ATTITUDE_MESSAGES = ("ATTITUDE", "ATTITUDE_QUATERNION")
"""What attitude is read from, the preferred first."""

DEMAND = "ACTUATOR_CONTROL_TARGET"
_THRUST = 3
"""Place of thrust in ACTUATOR_CONTROL_TARGET.controls of group 0."""
MOTOR_MESSAGES = ("SERVO_OUTPUT_RAW", "ACTUATOR_OUTPUT_STATUS", "HIL_ACTUATOR_CONTROLS")
"""What motor outputs are read from, the preferred first."""
UNUSED_CHANNEL = 65535
"""What SERVO_OUTPUT_RAW sends for a channel that has no output."""
ARMED, CUSTOM_MODE = 128, 1
"""MAV_MODE_FLAG_SAFETY_ARMED and _CUSTOM_MODE_ENABLED in HEARTBEAT.base_mode."""
IN_AIR = 2
"""MAV_LANDED_STATE_IN_AIR in EXTENDED_SYS_STATE.landed_state; 3 and 4 are taking off and landing."""
CLIMBS = {"LOCAL_POSITION_NED": ("vz", -1.0), "GLOBAL_POSITION_INT": ("vz", -0.01), "VFR_HUD": ("climb", 1.0)}
"""Where vertical speed is read from, the preferred first: the field and what makes it m/s upwards."""
TURN = 2 * np.pi
"""rad: no Euler angle lies beyond, whatever the convention."""
FASTEST = np.radians(4000.0)
"""rad/s: beyond the range of the gyroscopes that autopilots carry, 2000 °/s and at most 4000."""
_AS_FAST = 0.9
"""A preferred message is passed over for another only when it comes slower than this share of the other's rate."""


@dataclass(frozen=True, eq=False)
class Attitude:
    """One axis at ``time`` (N,) s of ``boot`` (N,), from ``message``.

    Rows that are not finite or cannot be are left out.

    Attributes:
        angle: (N,) Euler angle, rad.
        rate: (N,) body rate, rad/s: p for roll, q for pitch.
        slope: (N,) the derivative of ``angle`` that the three body rates and the attitude imply, rad/s.
        sent: messages in the stream.
        left_out: those of them that are not here, but for copies of others: not finite, or impossible, or of a stamp
            that another has.
        impossible: those with a roll or pitch beyond ``TURN`` or a body rate beyond ``FASTEST``.
    """

    message: str
    time: NDArray[np.float64]
    boot: NDArray[np.int64]
    angle: NDArray[np.float64]
    rate: NDArray[np.float64]
    slope: NDArray[np.float64]
    sent: int
    left_out: int
    impossible: int


@dataclass(frozen=True, eq=False)
class Motors:
    """Motor outputs (N, k) in the unit of the stream at ``time`` (N,) s of ``boot`` (N,), from ``message``.

    Of the ``sent`` messages ``left_out`` are not here, but for copies of others: not finite, or of a stamp that another
    has.
    """

    message: str
    time: NDArray[np.float64]
    boot: NDArray[np.int64]
    outputs: NDArray[np.float64]
    layout: Layout
    scale: Scale
    sent: int
    left_out: int


@dataclass(frozen=True, eq=False)
class Signal:
    """One quantity: ``values`` (N,) at ``time`` (N,) s of ``boot`` (N,)."""

    time: NDArray[np.float64]
    boot: NDArray[np.int64]
    values: NDArray[np.float64]


def attitude(telemetry: Telemetry, axis: str) -> Attitude | None:
    """Angle and rate of ``axis``, "roll" or "pitch".

    From ATTITUDE or, where it comes clearly faster, ATTITUDE_QUATERNION.
    Both messages give body rates p, q, r, not the derivatives of the Euler angles; near hover p and q are the same.

    Raises:
        ValueError: an axis that is neither.
    """
    if axis not in AXES:
        raise ValueError(f"axis must be one of {', '.join(AXES)}, not {axis!r}")
    message = _fastest(telemetry, ATTITUDE_MESSAGES)
    if message is None:
        return None
    columns = telemetry.messages[message]
    if message == "ATTITUDE_QUATERNION":
        roll, pitch = roll_and_pitch(np.column_stack(_columns(columns, "q1", "q2", "q3", "q4")))
    else:
        roll, pitch = _columns(columns, "roll", "pitch")
    p, q, r = _columns(columns, "rollspeed", "pitchspeed", "yawspeed")
    most = zip((roll, pitch, p, q, r), (TURN, TURN, FASTEST, FASTEST, FASTEST), strict=True)
    impossible = np.any([np.isfinite(values) & (np.abs(values) > limit) for values, limit in most], axis=0)
    with np.errstate(invalid="ignore", over="ignore"):  # rows that are not finite are left out below
        # Z-Y-X Euler kinematics (any flight dynamics text, e.g. Stevens and Lewis, chapter 1).
        if axis == "roll":
            table = np.column_stack([roll, p, p + (q * np.sin(roll) + r * np.cos(roll)) * np.tan(pitch)])
        else:
            table = np.column_stack([pitch, q, q * np.cos(roll) - r * np.sin(roll)])
    table[impossible] = np.nan
    time, boot, kept, left_out = _in_order(columns["time"], columns["boot"], table)
    angle, rate, slope = kept.T
    return Attitude(message, time, boot, angle, rate, slope, len(table), left_out, int(np.count_nonzero(impossible)))


def motors(telemetry: Telemetry) -> Motors | None:
    """Motor outputs; None when no message holds them or none of its channels ever moved.

    From SERVO_OUTPUT_RAW, ACTUATOR_OUTPUT_STATUS or HIL_ACTUATOR_CONTROLS, in that order of preference.
    """
    message = _fastest(telemetry, MOTOR_MESSAGES)
    if message is None:
        return None
    banks = _banks(message, telemetry.messages[message])
    moving = [bank.first + i for bank in banks for i in range(bank.values.shape[1]) if _moves(bank.values[:, i])]
    plan = layout(telemetry.vehicle, telemetry.autopilot, telemetry.parameters, moving, banks[0].values.shape[1])
    if plan is None or not set(plan.channels) & set(moving):
        return None
    # One row a message of the bank that holds most motors; the other bank's rows come a moment before or after.
    main = max(banks, key=lambda bank: len(bank.among(plan.channels)))
    outputs = np.full((len(main.time), len(plan.channels)), np.nan)
    sent = []
    for bank in banks:
        for channel in bank.among(plan.channels):
            values = bank.values[:, channel - bank.first]
            sent.append(values)
            outputs[:, plan.channels.index(channel)] = values if bank is main else _onto(main, bank, values)
    time, boot, outputs, lost = _in_order(main.time, main.boot, outputs)
    # Of the values as sent: those that were moved to another bank's stamps fall between the steps of the stream.
    scale = recognise(np.concatenate(sent), telemetry.parameters)
    if not len(time):
        return None
    return Motors(message, time, boot, outputs, plan, scale, main.sent, main.left_out + lost)


def demand(telemetry: Telemetry, axis: str) -> Motors | None:
    """What the controller asked of the axis, −1 to 1, from ACTUATOR_CONTROL_TARGET; None when it never moved.

    Raises:
        ValueError: an axis that is neither "roll" nor "pitch".
    """
    if axis not in AXES:
        raise ValueError(f"axis must be one of {', '.join(AXES)}, not {axis!r}")
    columns = telemetry.messages.get(DEMAND)
    if columns is None:
        return None
    bank = _bank(columns, _floats(columns, "controls")[:, [AXES.index(axis)]], 1, _flight_control(columns))
    if not _moves(bank.values[:, 0]):
        return None
    scale = Scale("demand", "", -1.0, 1.0, float(np.diff(np.unique(bank.values)).min()))
    plan = of_demand(axis)
    return Motors(DEMAND, bank.time, bank.boot, bank.values, plan, scale, bank.sent, bank.left_out)


def collective(telemetry: Telemetry) -> Signal | None:
    """How hard the motors work together, 0 to 1: their mean, or the thrust that the controller asked for."""
    working = motors(telemetry)
    if working is not None:
        return Signal(working.time, working.boot, working.scale.fraction(working.outputs).mean(axis=1))
    columns = telemetry.messages.get(DEMAND)
    if columns is None:
        return None
    bank = _bank(columns, _floats(columns, "controls")[:, [_THRUST]], 1, _flight_control(columns))
    return Signal(bank.time, bank.boot, bank.values[:, 0]) if len(bank.time) else None


def _flight_control(columns: Columns) -> NDArray[np.bool_]:
    """Which ACTUATOR_CONTROL_TARGET are of group 0, which is roll, pitch, yaw and thrust."""
    return np.asarray(columns["group_mlx"]) == 0 if "group_mlx" in columns else np.ones(len(columns["time"]), bool)


def armed(telemetry: Telemetry) -> Signal | None:
    """Whether the vehicle was armed, from HEARTBEAT, with strays outvoted.

    Heartbeats that name another type or autopilot than the vehicle's are not its own; a state that neither the
    heartbeat before nor the one after shares is not believed.
    """
    columns = telemetry.messages.get("HEARTBEAT")
    if columns is None or not len(columns["time"]):
        return None
    # Where nothing says what the vehicle is, its heartbeats say so: GENERIC.
    own = _named(columns["type"], "MAV_TYPE", "GENERIC" if telemetry.vehicle == "UNKNOWN" else telemetry.vehicle)
    own &= _named(columns["autopilot"], "MAV_AUTOPILOT", telemetry.autopilot)
    if not own.any():
        return None
    state = (np.asarray(columns["base_mode"]).astype(np.int64) & ARMED) > 0
    order = np.lexsort((columns["time"][own], columns["boot"][own]))
    time, boot, state = columns["time"][own][order], columns["boot"][own][order], state[own][order]
    before, after = np.concatenate([state[:1], state[:-1]]), np.concatenate([state[1:], state[-1:]])
    return Signal(time, boot, ((state & before) | (state & after) | (before & after)).astype(np.float64))


def in_air(telemetry: Telemetry) -> Signal | None:
    """Whether the autopilot said it was in the air and neither taking off nor landing, from EXTENDED_SYS_STATE."""
    columns = telemetry.messages.get("EXTENDED_SYS_STATE")
    if columns is None:
        return None
    landed = _floats(columns, "landed_state")
    said = landed > 0  # 0 is "undefined": the autopilot does not tell
    if not said.any():
        return None
    time, boot, table, _ = _in_order(columns["time"][said], columns["boot"][said], landed[said, None])
    return Signal(time, boot, (table[:, 0] == IN_AIR).astype(np.float64))


def climb_rate(telemetry: Telemetry) -> Signal | None:
    """Vertical speed, m/s, up, from LOCAL_POSITION_NED, GLOBAL_POSITION_INT or VFR_HUD."""
    for message, (field, factor) in CLIMBS.items():
        columns = telemetry.messages.get(message)
        if columns is not None and len(columns["time"]) > 1:
            climb = factor * _floats(columns, field)[:, None]
            time, boot, table, _ = _in_order(columns["time"], columns["boot"], climb)
            return Signal(time, boot, table[:, 0])
    return None


@dataclass(frozen=True, eq=False)
class _Bank:
    """Output channels ``first``, ``first`` + 1, … as one stream sends them: values (N, width); see ``Motors``."""

    time: NDArray[np.float64]
    boot: NDArray[np.int64]
    values: NDArray[np.float64]
    first: int
    sent: int
    left_out: int

    def among(self, channels: tuple[int, ...]) -> list[int]:
        return [channel for channel in channels if self.first <= channel < self.first + self.values.shape[1]]


def _banks(message: str, columns: Columns) -> list[_Bank]:
    if message != "SERVO_OUTPUT_RAW":
        field = "actuator" if message == "ACTUATOR_OUTPUT_STATUS" else "controls"
        return [_bank(columns, np.atleast_2d(_floats(columns, field)), 1, np.ones(len(columns["time"]), dtype=bool))]
    fields = [f"servo{n}_raw" for n in range(1, 17) if f"servo{n}_raw" in columns]
    values = np.column_stack([_floats(columns, field) for field in fields])
    values[values == UNUSED_CHANNEL] = 0.0
    port = _floats(columns, "port") if "port" in columns else np.zeros(len(values))
    # The message began with 8 channels a port; firmware that fills the 16 of the extension counts ports by 16.
    width = 16 if values.shape[1] == 16 and np.any(values[:, 8:]) else 8
    return [_bank(columns, values[:, :width], 1 + width * int(p), port == p) for p in np.unique(port)]


def _bank(columns: Columns, values: NDArray[np.float64], first: int, rows: NDArray[np.bool_]) -> _Bank:
    time, boot, kept, left_out = _in_order(columns["time"][rows], columns["boot"][rows], values[rows])
    return _Bank(time, boot, kept, first, int(np.count_nonzero(rows)), left_out)


def _moves(values: NDArray[np.float64]) -> bool:
    """Whether a channel takes several values beside 0, which stands for "no output yet"."""
    running = values[values != 0]
    return len(running) > 0 and float(np.ptp(running)) > 0


def _onto(main: _Bank, bank: _Bank, values: NDArray[np.float64]) -> NDArray[np.float64]:
    moved = np.full(len(main.time), np.nan)
    for boot in np.unique(main.boot):
        there, here = bank.boot == boot, main.boot == boot
        if there.any():
            moved[here] = np.interp(main.time[here], bank.time[there], values[there])
    return moved


def _fastest(telemetry: Telemetry, preferred: tuple[str, ...]) -> str | None:
    """The first message of ``preferred`` that came about as often as the most frequent of them."""
    counts = {name: len(telemetry.messages[name]["time"]) for name in preferred if name in telemetry.messages}
    return fastest(counts)


def fastest(counts: Mapping[str, int]) -> str | None:
    """The first of messages, in the order of preference, that came about as often as the most frequent of them."""
    most = max(counts.values(), default=0)
    return next((name for name, count in counts.items() if count and count >= _AS_FAST * most), None)


def _columns(columns: Columns, *fields: str) -> list[NDArray[np.float64]]:
    return [_floats(columns, field) for field in fields]


def _named(values: NDArray[np.integer], enum: str, name: str) -> NDArray[np.bool_]:
    """Which of ``values`` (N,) the MAVLink enum calls ``name``."""
    return np.isin(values, [value for value in np.unique(values) if enum_name(enum, int(value)) == name])


def _floats(columns: Columns, field: str) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):  # what is no number stays none
        return np.asarray(columns[field], dtype=np.float64)


def _in_order(
    time: NDArray[np.float64], boot: NDArray[np.int64], table: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], int]:
    """Rows sorted by boot and time, repeats of a stamp and rows with non-finite values left out.

    Last how many rows were left out, but for those whose stamp and values are both those of another.
    """
    finite = np.isfinite(table).all(axis=1) & np.isfinite(time)
    lost = int(np.count_nonzero(~finite))
    time, boot, table = time[finite], boot[finite], table[finite]
    order = np.lexsort((time, boot))
    time, boot, table = time[order], boot[order], table[order]
    new = np.ones(len(time), dtype=bool)
    new[1:] = (np.diff(time) > 0) | (np.diff(boot) > 0)
    other = np.zeros(len(time), dtype=bool)
    other[1:] = (np.diff(table, axis=0) != 0).any(axis=1)
    return time[new], boot[new], table[new], lost + int(np.count_nonzero(other & ~new))
