"""What drives the vehicle: motor outputs or the controller's demand, from columns of a vehicle's Telemetry."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import tau
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Integers
from mavdem.containers import Names
from mavdem.facts import Fact
from mavdem.facts.learnability import MotorObstacle, Remedy
from mavdem.ingest.motors import (
    MOTOR_MESSAGES,
    MotorMessage,
    OutputScale,
    demand_geometry,
    motor_geometry,
    output_scale,
)
from mavdem.ingest.motors import MotorGeometry as MotorGeometry
from mavdem.ingest.motors import position_name as position_name
from mavdem.ingest.telemetry import MIN_PREFERRED_SHARE, Columns, Telemetry

MAX_ANGLE = tau  # rad: no Euler angle lies beyond, whatever the convention
MAX_BODY_RATE = np.radians(4000.0)
"""rad/s: beyond the range of the gyroscopes that autopilots carry, 2000 °/s and at most 4000."""


@dataclass(frozen=True, eq=False)
class Signal:
    """One quantity: ``values`` (N,) or (N, k) at ``time`` (N,) s of ``boot`` (N,), of ``sent`` messages.

    ``left_out`` counts those not used: not finite, or with the stamp of another. Exact copies do not count.
    """

    time: Array
    boot: Integers
    values: Array
    sent: int = 0
    left_out: int = 0

    def at(self, rows: Flags) -> Signal:
        """Returns the samples of these ``rows`` (N,)."""
        return Signal(self.time[rows], self.boot[rows], self.values[rows])


def floats(columns: Columns, field: str) -> Array:
    """Returns a field of a message as floats; what is no number becomes NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray(columns[field], dtype=float)


def table_of(columns: Columns, fields: Iterable[str]) -> Array:
    """Returns fields of a message (N, k) as :func:`floats`."""
    return np.column_stack([floats(columns, field) for field in fields])


def series(columns: Columns, values: Array, rows: Flags | None = None) -> Signal:
    """Returns ``values`` (N,) or (N, k) of all messages, or ``rows`` (N,), in time order, each stamp once, finite."""
    time, boot = columns["time"], columns["boot"]
    table = np.atleast_2d(values.T).T
    chosen = np.ones(len(time), dtype=bool) if rows is None else rows
    order = np.flatnonzero(chosen & np.isfinite(table).all(axis=1) & np.isfinite(time))
    finite = len(order)
    order = order[np.lexsort((time[order], boot[order]))]
    again = np.flatnonzero((np.diff(time[order]) <= 0) & (np.diff(boot[order]) <= 0))
    others = int(np.count_nonzero((table[order[again]] != table[order[again + 1]]).any(axis=1)))
    order = np.delete(order, again + 1)
    sent = int(np.count_nonzero(chosen))
    return Signal(time[order], boot[order], values[order], sent, sent - finite + others)


def recorded(telemetry: Telemetry, message: str, *fields: str) -> Signal | None:
    """Returns a field of a message (N,), or several (N, k), as :func:`series` does; None where none was finite."""
    columns = telemetry.messages.get(message, {})
    if not all(field in columns for field in fields):
        return None
    table = table_of(columns, fields)
    signal = series(columns, table if len(fields) > 1 else table[:, 0])
    return signal if len(signal.time) else None


def message_counts(telemetry: Telemetry, names: Names) -> dict[str, int]:
    """Returns how many of each message there are, of those that there are."""
    return {
        name: len(telemetry.messages[name]["time"]) for name in names if name in telemetry.messages
    }


def preferred_message(counts: Mapping[str, int]) -> str | None:
    """Returns the first of ``counts``, the preferred first, that came about as often as the most frequent."""
    return next(iter(by_preference(counts)), None)


def by_preference(counts: Mapping[str, int]) -> list[str]:
    """Returns the names of ``counts``, the preferred first; behind them those that came clearly less often."""
    enough = MIN_PREFERRED_SHARE * max(counts.values(), default=0)
    return sorted(filter(counts.get, counts), key=lambda name: counts[name] < enough)


TILT_AXES = ("roll", "pitch")  # The axes of a model with angle and rate; yaw has its rate only
AXES = (*TILT_AXES, "yaw")

# The possible inputs of a model: motor outputs, or the controller's command for the axis
INPUTS = ("motors", "demand")
RECORD_A_FLIGHT = Fact(Remedy.RECORD_A_FLIGHT)
DEMAND_MESSAGE = "ACTUATOR_CONTROL_TARGET"
DEMAND_FORM = MotorMessage("controls")
THRUST_COLUMN = len(AXES)  # Place of thrust in ACTUATOR_CONTROL_TARGET.controls of group 0
PORT_CHANNELS = 8
"""Channels a port of SERVO_OUTPUT_RAW; firmware that fills the message's extension counts ports by all of them."""
LEAST_STOP = 0.5
STOP_SHARE = 0.01
STOP_WIDTH = 0.003
STOP_BINS = 5
STOP_EXCESS = 8
"""An upper stop that the outputs show: at least so much of the range, so often reached, this wide, how many bins of
that width below it show what is usual, and how many times as often it is reached: the crest of a sine 3 to 5 times."""
# MAVLink's uint16 for what there is none of: an output, or the voltage of a cell
UINT16_UNKNOWN = np.iinfo(np.uint16).max


@dataclass(frozen=True, eq=False)
class Motors:
    """Motor outputs, or the demand as one column."""

    message: str  # they come from
    time: Array  # with boot: (N,) s on the clock of a boot
    boot: Integers
    outputs: Array  # (N, k) in the unit of the stream
    layout: MotorGeometry  # which channels and where their motors are
    scale: OutputScale  # unit, range and resolution
    sent: int  # messages in the stream
    # those not used: not finite, or with the stamp of another. Exact copies do not count.
    left_out: int

    @property
    def collective(self) -> Signal:
        """How hard they work together, 0 to 1: the mean of their shares (N,)."""
        return Signal(self.time, self.boot, self.scale.fraction(self.outputs).mean(axis=1))

    def shares(self, boot: int) -> Signal:
        """Returns the shares (N, k) of their range in one boot."""
        shares = Signal(self.time, self.boot, self.scale.fraction(self.outputs))
        return shares.at(self.boot == boot)


def motors_or_obstacle(telemetry: Telemetry) -> Motors | Fact:
    """Returns the outputs of the most preferred message that has those of all motors; else why there are none."""
    obstacles = []
    for message in by_preference(message_counts(telemetry, tuple(MOTOR_MESSAGES))):
        motors = _motors_in(telemetry, message)
        if isinstance(motors, Motors):
            return motors
        obstacles.append(motors)
    return (
        obstacles[0]
        if obstacles
        else Fact(
            MotorObstacle.NO_MOTOR_MESSAGE,
            name=telemetry.name_in_source(next(iter(MOTOR_MESSAGES))),
        )
    )


def _motors_in(telemetry: Telemetry, message: str) -> Motors | Fact:
    name = telemetry.name_in_source(message)
    banks = tuple(_banks(message, telemetry.messages[message]))
    width = banks[0].signal.values.shape[1]
    bank_of = {bank.first + i: bank for bank in banks for i in range(width)}
    moving = [channel for channel, bank in bank_of.items() if _moves(bank.sent(channel))]
    # A motor that is disabled in flight keeps its place.
    parameters = {**telemetry.parameters, **telemetry.initial_parameters}
    plan = motor_geometry(telemetry.vehicle, telemetry.autopilot, parameters, moving, width)
    if plan is None or not moving:
        return Fact(MotorObstacle.MOTORS_CONSTANT, name=name, remedy=RECORD_A_FLIGHT)
    missing = sorted(set(plan.channels) - bank_of.keys())
    if missing or not set(plan.channels) & set(moving):
        return Fact(
            MotorObstacle.CHANNELS_MISSING if missing else MotorObstacle.CHANNELS_CONSTANT,
            name=name,
            basis=plan.basis,
            channels=sorted(plan.channels),
            missing=missing,
            moving=sorted(moving),
            remedy=RECORD_A_FLIGHT,
        )
    # One row a message of the bank that holds most motors; the other bank's rows come a moment before or after.
    chosen = [bank_of[channel] for channel in plan.channels]
    main = max(chosen, key=chosen.count)
    signal = main.signal
    sent = [bank.sent(channel) for bank, channel in zip(chosen, plan.channels, strict=True)]
    columns = [
        values if bank is main else _interpolated(signal, bank.signal, values)
        for bank, values in zip(chosen, sent, strict=True)
    ]
    outputs = np.column_stack(columns)
    whole = series({"time": signal.time, "boot": signal.boot}, outputs)
    if not len(whole.time):
        return Fact(MotorObstacle.OUTPUTS_NOT_FINITE, name=name)
    # Of the values as sent: interpolated ones fall between the steps of the stream.
    scale = output_scale(np.concatenate(sent), telemetry.parameters, plan.drivers)
    left_out = signal.left_out + whole.left_out
    scale = replace(scale, stop=min(scale.stop, _seen_stop(scale.fraction(whole.values))))
    return Motors(message, whole.time, whole.boot, whole.values, plan, scale, signal.sent, left_out)


def _seen_stop(shares: Array) -> float:
    """The share of the range at which motors (N, k) stay, as no output does that moves freely; 1 where they do not.

    That is the highest of all, with ``STOP_SHARE`` of some motor's samples and far more than in the bins below it.
    """
    highest = float(shares.max())
    for column in shares.T if highest >= LEAST_STOP else ():
        bins = np.floor((highest - column[column > 0]) / STOP_WIDTH)
        at_stop = np.count_nonzero(bins == 0)
        near = np.count_nonzero((bins > 0) & (bins <= STOP_BINS)) / STOP_BINS
        reached = at_stop >= max(STOP_SHARE * len(column), STOP_EXCESS * near, 3)
        if reached and np.count_nonzero(bins > STOP_BINS) > np.count_nonzero(bins > 0) / 2:
            return highest
    return 1.0


def demand(telemetry: Telemetry, axis: str) -> Motors | None:
    """Returns the controller's command for the axis, −1 to 1; None when it never moved."""
    signal = control(telemetry, AXES.index(axis))
    if signal is None or not _moves(signal.values):
        return None
    scale = OutputScale("demand", "", -1.0, 1.0, float(np.diff(np.unique(signal.values)).min()))
    outputs = signal.values[:, None]
    return Motors(
        DEMAND_MESSAGE,
        signal.time,
        signal.boot,
        outputs,
        demand_geometry(axis),
        scale,
        signal.sent,
        signal.left_out,
    )


def control(telemetry: Telemetry, column: int) -> Signal | None:
    """Returns the controller's command for roll, pitch, yaw, -1 to 1, or thrust, 0 to 1, by its number, from 0."""
    columns = telemetry.messages.get(DEMAND_MESSAGE)
    if columns is None:
        return None
    # Group 0 is flight control: roll, pitch, yaw and thrust.
    group_0 = np.asarray(columns["group_mlx"]) == 0 if "group_mlx" in columns else None
    return series(columns, floats(columns, DEMAND_FORM.field)[:, column], group_0)


class _Bank(NamedTuple):
    """Output channels ``first``, ``first`` + 1, … as one stream sends them: values (N, width)."""

    first: int
    signal: Signal

    def sent(self, channel: int) -> Array:
        return self.signal.values[:, channel - self.first]


def outputs_by_port(message: str, columns: Columns) -> tuple[Array, int]:
    """Returns the outputs (N, k) of a message, unused ones as 0, and how many channels one port has."""
    first, *channels = MOTOR_MESSAGES[message].fields
    if not channels:
        values = np.atleast_2d(floats(columns, first))
        return values, values.shape[1]
    values = table_of(columns, (field for field in channels if field in columns))
    values[values == UINT16_UNKNOWN] = 0.0
    wide = values.shape[1] == len(channels) and np.any(values[:, PORT_CHANNELS:])
    return values, len(channels) if wide else PORT_CHANNELS


def _banks(message: str, columns: Columns) -> Iterator[_Bank]:
    """A bank of outputs a port; a channel that never has a number has none."""
    values, width = outputs_by_port(message, columns)
    port = floats(columns, "port") if "port" in columns else np.zeros(len(values))
    for number in np.unique(port):
        sent = values[port == number, :width]
        table = np.where(np.isfinite(sent).any(axis=0), values[:, :width], 0.0)
        yield _Bank(1 + width * int(number), series(columns, table, port == number))


def _moves(values: Array) -> bool:
    """Whether a channel takes several values beside 0, which stands for "no output yet"."""
    running = values[values != 0]
    return len(running) > 0 and np.ptp(running) > 0


def _interpolated(main: Signal, bank: Signal, values: Array) -> Array:
    moved = np.full(len(main.time), np.nan)
    for boot in np.intersect1d(main.boot, bank.boot):
        there = bank.boot == boot
        here = main.boot == boot
        moved[here] = np.interp(main.time[here], bank.time[there], values[there])
    return moved
