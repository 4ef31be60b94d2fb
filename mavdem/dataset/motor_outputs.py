"""Motor outputs, or the controller's demand in their place: what turns the vehicle, as a log recorded it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Integers
from mavdem.dataset.axes import AXES
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
    message_counts,
    names_by_preference,
)
from mavdem.facts import Fact
from mavdem.facts.learnability import MotorObstacle, Remedy
from mavdem.ingest.motors import (
    MOTOR_MESSAGES,
    MotorMessage,
    demand_geometry,
    motor_geometry,
)
from mavdem.ingest.motors import MotorGeometry as MotorGeometry
from mavdem.ingest.motors import position_name as position_name
from mavdem.ingest.output_scale import OutputScale, output_scale
from mavdem.ingest.telemetry import Columns, Telemetry

# The possible inputs of a model: motor outputs, or the controller's command for the axis
INPUT_KINDS = ("motors", "demand")
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
class MotorOutputs:
    """Motor outputs, or the demand as one column."""

    message: str  # they come from
    time: Array  # with boot: (N,) s on the clock of a boot
    boot: Integers
    outputs: Array  # (N, k) in the unit of the stream
    geometry: MotorGeometry  # which channels and where their motors are
    scale: OutputScale  # unit, range and resolution
    sent_count: int  # messages in the stream
    # those not used: not finite, or with the stamp of another. Exact copies do not count.
    unused_count: int

    @property
    def collective(self) -> TimeSeries:
        """How hard they work together, 0 to 1: the mean of their shares (N,)."""
        return TimeSeries(self.time, self.boot, self.scale.fraction(self.outputs).mean(axis=1))

    def range_fractions(self, boot: int) -> TimeSeries:
        """Returns the shares (N, k) of their range in one boot."""
        shares = TimeSeries(self.time, self.boot, self.scale.fraction(self.outputs))
        return shares.select(self.boot == boot)


def motor_outputs_or_obstacle(telemetry: Telemetry) -> MotorOutputs | Fact:
    """Returns the outputs of the most preferred message that has those of all motors; else why there are none."""
    obstacles = []
    for message in names_by_preference(message_counts(telemetry, tuple(MOTOR_MESSAGES))):
        motors = _motors_in(telemetry, message)
        if isinstance(motors, MotorOutputs):
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


def _motors_in(telemetry: Telemetry, message: str) -> MotorOutputs | Fact:
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
    whole = clean_series({"time": signal.time, "boot": signal.boot}, outputs)
    if not len(whole.time):
        return Fact(MotorObstacle.OUTPUTS_NOT_FINITE, name=name)
    # Of the values as sent: interpolated ones fall between the steps of the stream.
    scale = output_scale(np.concatenate(sent), telemetry.parameters, plan.drivers)
    left_out = signal.unused_count + whole.unused_count
    scale = replace(scale, stop=min(scale.stop, _observed_upper_stop(scale.fraction(whole.values))))
    return MotorOutputs(
        message, whole.time, whole.boot, whole.values, plan, scale, signal.sent_count, left_out
    )


def _observed_upper_stop(shares: Array) -> float:
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


def axis_demand(telemetry: Telemetry, axis: str) -> MotorOutputs | None:
    """Returns the controller's command for the axis, −1 to 1; None when it never moved."""
    signal = control_target(telemetry, AXES.index(axis))
    if signal is None or not _moves(signal.values):
        return None
    scale = OutputScale("demand", "", -1.0, 1.0, float(np.diff(np.unique(signal.values)).min()))
    outputs = signal.values[:, None]
    return MotorOutputs(
        DEMAND_MESSAGE,
        signal.time,
        signal.boot,
        outputs,
        demand_geometry(axis),
        scale,
        signal.sent_count,
        signal.unused_count,
    )


def control_target(telemetry: Telemetry, column: int) -> TimeSeries | None:
    """Returns the controller's command for roll, pitch, yaw, -1 to 1, or thrust, 0 to 1, by its number, from 0."""
    columns = telemetry.messages.get(DEMAND_MESSAGE)
    if columns is None:
        return None
    # Group 0 is flight control: roll, pitch, yaw and thrust.
    group_0 = np.asarray(columns["group_mlx"]) == 0 if "group_mlx" in columns else None
    return clean_series(columns, float_column(columns, DEMAND_FORM.field)[:, column], group_0)


class _Bank(NamedTuple):
    """Output channels ``first``, ``first`` + 1, … as one stream sends them: values (N, width)."""

    first: int
    signal: TimeSeries

    def sent(self, channel: int) -> Array:
        return self.signal.values[:, channel - self.first]


def channel_outputs(message: str, columns: Columns) -> tuple[Array, int]:
    """Returns the outputs (N, k) of a message, unused ones as 0, and how many channels one port has."""
    first, *channels = MOTOR_MESSAGES[message].fields
    if not channels:
        values = np.atleast_2d(float_column(columns, first))
        return values, values.shape[1]
    values = float_columns(columns, (field for field in channels if field in columns))
    values[values == UINT16_UNKNOWN] = 0.0
    wide = values.shape[1] == len(channels) and np.any(values[:, PORT_CHANNELS:])
    return values, len(channels) if wide else PORT_CHANNELS


def _banks(message: str, columns: Columns) -> Iterator[_Bank]:
    """A bank of outputs a port; a channel that never has a number has none."""
    values, width = channel_outputs(message, columns)
    port = float_column(columns, "port") if "port" in columns else np.zeros(len(values))
    for number in np.unique(port):
        sent = values[port == number, :width]
        table = np.where(np.isfinite(sent).any(axis=0), values[:, :width], 0.0)
        yield _Bank(1 + width * int(number), clean_series(columns, table, port == number))


def _moves(values: Array) -> bool:
    """Whether a channel takes several values beside 0, which stands for "no output yet"."""
    running = values[values != 0]
    return len(running) > 0 and np.ptp(running) > 0


def _interpolated(main: TimeSeries, bank: TimeSeries, values: Array) -> Array:
    moved = np.full(len(main.time), np.nan)
    for boot in np.intersect1d(main.boot, bank.boot):
        there = bank.boot == boot
        here = main.boot == boot
        moved[here] = np.interp(main.time[here], bank.time[there], values[there])
    return moved
