"""Inputs of a model, as recorded: the motor outputs of a vehicle or, instead, the controller's demand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array, Integers
from mavdem.dataset.axes import AXES
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    message_counts,
    names_by_preference,
    rows_of_boot,
)
from mavdem.facts import Fact
from mavdem.facts.learnability import Remedy, UnusableOutputs
from mavdem.ingest.motor_geometry import motor_geometry
from mavdem.ingest.motors import MOTOR_MESSAGES, MotorGeometry, demand_geometry
from mavdem.ingest.output_scale import OutputScale, output_scale
from mavdem.ingest.telemetry import Columns, Telemetry

INPUT_KINDS = ("motors", "demand")
"""The possible inputs of a model: motor outputs, or the controller's demand for the axis."""

RECORD_A_FLIGHT = Fact(Remedy.RECORD_A_FLIGHT)
"""Advice where a log has no motor outputs of a flight."""

DEMAND_MESSAGE = "ACTUATOR_CONTROL_TARGET"
"""MAVLink message with the controller's demands."""

DEMAND_FIELD = "controls"
"""Array field of that message; in group 0 it holds roll, pitch, yaw and thrust."""

FLIGHT_CONTROL_GROUP = 0
"""Group of that message (``group_mlx``) with the demands of the flight controller."""

THRUST_COLUMN = len(AXES)
"""Column of thrust in the field with the demands, after those of the axes."""

CHANNELS_PER_PORT = 8
"""Output channels of one port of SERVO_OUTPUT_RAW, as first defined.

Firmware that fills the sixteen fields of the extended message counts sixteen channels per port, and ArduPilot always
does (``GCS_MAVLINK::send_servo_output_raw``).
"""

UINT16_UNKNOWN = np.iinfo(np.uint16).max
"""Value of MAVLink's 16-bit fields that means "not available": an unused output, or no voltage."""

MIN_OBSERVED_LIMIT = 0.5
"""Lowest upper limit, as a fraction of the range, that is inferred from outputs; a choice, far above hover."""

MIN_STOP_SHARE = 0.01
"""Share of a motor's samples that must be at an upper limit before one is inferred; a choice."""

MIN_STOP_SAMPLES = 3
"""Number of samples that must be at an upper limit before one is inferred; a choice."""

STOP_BIN_WIDTH = 0.003
"""Width of the histogram bins in which a stop is looked for, as a fraction of the range; a choice."""

STOP_NEIGHBOUR_BINS = 5
"""Number of bins below the highest output whose mean says how often outputs come without a stop; a choice."""

MIN_STOP_EXCESS = 8
"""How many times as many samples the bin of a stop has as the bins below it. The crest of a sine has 3 to 5 times."""


@dataclass(frozen=True, eq=False)
class MotorOutputs:
    """The outputs of all k motors of a vehicle, or the demand for one axis as a single output."""

    message: str
    """Name of the message that they were recorded in."""
    time: Array
    """(N,) seconds on the clock of the sample's boot."""
    boot: Integers
    """(N,) number of the boot of each sample, from 0."""
    outputs: Array
    """(N, k) outputs in the unit of the stream."""
    geometry: MotorGeometry
    """Output channel and position of each motor."""
    scale: OutputScale
    """Unit, range and resolution of the outputs."""
    sent_count: int
    """Number of messages that were recorded."""
    unused_count: int
    """Number of those that could not be used: not finite, or a second value at the same stamp; without exact copies."""

    @property
    def collective(self) -> TimeSeries:
        """The mean output of all motors (N,), as a fraction of the range, 0 to 1."""
        return TimeSeries(self.time, self.boot, self.scale.fraction(self.outputs).mean(axis=1))

    def range_fractions(self, boot: int) -> TimeSeries:
        """Returns the outputs (N, k) of one boot as fractions of the range."""
        rows = rows_of_boot(self.boot, boot)
        fractions = self.scale.fraction(self.outputs[rows])
        return TimeSeries(self.time[rows], self.boot[rows], fractions)

    def motor_fractions(self, boot: int, motor: int) -> TimeSeries:
        """Returns the outputs (N,) of one motor in one boot as fractions of the range.

        Args:
            boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
            motor: Index of the motor, from 0.
        """
        rows = rows_of_boot(self.boot, boot)
        fractions = self.scale.fraction(self.outputs[rows, motor])
        return TimeSeries(self.time[rows], self.boot[rows], fractions)


def motor_outputs_or_reason(telemetry: Telemetry) -> MotorOutputs | Fact:
    """Returns the motor outputs of a vehicle, or why a log has none.

    Several messages can have them. The most preferred one that has the outputs of all motors is used.

    Args:
        telemetry: Messages of the vehicle.

    Returns:
        The outputs; where no message has them, the reason (``UnusableOutputs``) for the most preferred message.
    """
    counts = message_counts(telemetry, tuple(MOTOR_MESSAGES))
    first_reason = None
    for message in names_by_preference(counts):
        outputs_or_reason = _outputs_in_message(telemetry, message)
        if isinstance(outputs_or_reason, MotorOutputs):
            return outputs_or_reason
        if first_reason is None:
            first_reason = outputs_or_reason
    if first_reason is not None:
        return first_reason
    preferred_message_name = next(iter(MOTOR_MESSAGES))
    return Fact(
        UnusableOutputs.NO_MOTOR_MESSAGE, name=telemetry.name_in_source(preferred_message_name)
    )


def axis_demand(telemetry: Telemetry, axis: str) -> MotorOutputs | None:
    """Returns the controller's demand for one axis, -1 to 1, in the form of motor outputs with a single column.

    If motor outputs are logged too slowly, a model can use the demand instead, from which the mixer computes them. The
    resolution is the smallest difference between two recorded values.

    Args:
        telemetry: messages of the vehicle.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The demand; None if it was not recorded or never moved.
    """
    demand = control_target(telemetry, AXES.index(axis))
    if demand is None or not _is_moving(demand.values):
        return None
    resolution = float(np.diff(np.unique(demand.values)).min())
    return MotorOutputs(
        message=DEMAND_MESSAGE,
        time=demand.time,
        boot=demand.boot,
        outputs=demand.values[:, None],
        geometry=demand_geometry(axis),
        scale=OutputScale("demand", unit="", low=-1.0, high=1.0, step=resolution),
        sent_count=demand.sent_count,
        unused_count=demand.unused_count,
    )


def control_target(telemetry: Telemetry, column: int) -> TimeSeries | None:
    """Returns one of the controller's demands, as the mixer receives them, from ACTUATOR_CONTROL_TARGET.

    The message has groups of demands (``group_mlx``), of which others drive a gimbal, for example. Only the group of
    the flight controller is read, whose demands are on roll, pitch, yaw and thrust in this order.

    Args:
        telemetry: Messages of the vehicle.
        column: Which demand: the index of an axis in ``AXES``, -1 to 1, or ``THRUST_COLUMN``, 0 to 1.

    Returns:
        The demand (N,); None if no demands were recorded.
    """
    columns = telemetry.messages.get(DEMAND_MESSAGE)
    if columns is None:
        return None
    is_flight_control = None
    if "group_mlx" in columns:
        is_flight_control = np.asarray(columns["group_mlx"]) == FLIGHT_CONTROL_GROUP
    demands = float_column(columns, DEMAND_FIELD)[:, column]
    return clean_series(columns, demands, is_flight_control)


class ChannelOutputs(NamedTuple):
    """The outputs of all channels of an autopilot, from one message."""

    outputs: Array
    """(N, k) outputs of k channels, a new array; 0 for unused channels.

    They have 32 bits where these hold them exactly: 32 channels of hours of flight take hundreds of megabytes.
    """

    channels_per_port: int
    """How many of the channels belong to one port."""


def channel_outputs(message: str, columns: Columns, autopilot: str) -> ChannelOutputs:
    """Returns the outputs of all channels in a message, and the number of channels of one port.

    SERVO_OUTPUT_RAW has the number of a port and the outputs of its channels, each in a field of its own. Other
    messages have all outputs in one field, which are of one port.

    Args:
        message: Name of a message in ``MOTOR_MESSAGES``.
        columns: Its fields, N rows each.
        autopilot: MAV_AUTOPILOT without its prefix.
    """
    layout = MOTOR_MESSAGES[message]
    if not layout.is_ported:
        values = np.atleast_2d(columns[layout.field])
        outputs = values.astype(_exact_float_type(values))
        return ChannelOutputs(outputs, channels_per_port=outputs.shape[1])
    # The first field is the number of the port.
    output_fields = layout.fields[1:]
    values = np.column_stack([columns[field] for field in output_fields if field in columns])
    outputs = values.astype(_exact_float_type(values))
    outputs[outputs == UINT16_UNKNOWN] = 0.0
    has_all_fields = outputs.shape[1] == len(output_fields)
    if has_all_fields and _uses_extended_fields(outputs, autopilot):
        return ChannelOutputs(outputs, channels_per_port=len(output_fields))
    return ChannelOutputs(outputs, channels_per_port=CHANNELS_PER_PORT)


def _uses_extended_fields(outputs: Array, autopilot: str) -> bool:
    """Returns whether a port has channels beyond the first ``CHANNELS_PER_PORT`` of SERVO_OUTPUT_RAW.

    ArduPilot always uses all 16 fields of the extended message. Other autopilots may use only the first 8 of them; then
    the others are 0.

    Args:
        outputs: Outputs in all fields (N, 16); 0 for unused channels.
        autopilot: MAV_AUTOPILOT without its prefix.
    """
    return autopilot == "ARDUPILOTMEGA" or bool(np.any(outputs[:, CHANNELS_PER_PORT:]))


def _exact_float_type(values: Array) -> np.dtype[Any]:
    """Returns the type of floats with 32 bits if it holds all values of an array's type exactly, otherwise 64 bits."""
    return np.result_type(values, np.float32)


@dataclass(frozen=True, eq=False)
class _PortOutputs:
    """The outputs of one port: neighbouring output channels that an autopilot sends in one message."""

    first_channel: int
    """Number of the first channel, from 1."""
    series: TimeSeries
    """Outputs (N, w) of the port's w channels."""

    @property
    def channels(self) -> range:
        """Numbers of the port's channels."""
        return range(self.first_channel, self.first_channel + self.series.values.shape[1])

    def outputs(self, channel: int) -> Array:
        """Returns the outputs (N,) of one channel of the port."""
        return self.series.values[:, channel - self.first_channel]


def _outputs_in_message(telemetry: Telemetry, message: str) -> MotorOutputs | Fact:
    """Reads the outputs of all motors from one message.

    A message has the outputs of all channels of an autopilot, of which some drive servos or nothing. The channels of
    the motors follow from the parameters or, without these, from the channels whose outputs change.

    Args:
        telemetry: messages and parameters of the vehicle.
        message: name of a message with output channels that the log has.

    Returns:
        The outputs; or a fact with the reason why the message does not have them: the outputs of all motors are
        constant, or channels of motors are missing or constant.
    """
    ports = _outputs_by_port(message, telemetry.messages[message], telemetry.autopilot)
    port_of_channel = {}
    for port in ports:
        for channel in port.channels:
            port_of_channel[channel] = port
    moving_channels = []
    for channel, port in port_of_channel.items():
        if _is_moving(port.outputs(channel)):
            moving_channels.append(channel)
    # Of a parameter that changed, the first value counts, so that a motor that is disabled in flight keeps its channel.
    parameters = {**telemetry.parameters, **telemetry.initial_parameters}
    geometry = motor_geometry(
        telemetry.vehicle, telemetry.autopilot, parameters, moving_channels, len(ports[0].channels)
    )
    message_name = telemetry.name_in_source(message)
    if geometry is None or not moving_channels:
        return Fact(UnusableOutputs.MOTORS_CONSTANT, name=message_name, remedy=RECORD_A_FLIGHT)
    missing_channels = sorted(set(geometry.channels) - port_of_channel.keys())
    is_any_motor_moving = any(channel in moving_channels for channel in geometry.channels)
    if not missing_channels and is_any_motor_moving:
        ports_of_motors = [port_of_channel[channel] for channel in geometry.channels]
        return _combined_outputs(telemetry, message, geometry, ports_of_motors)
    reason = UnusableOutputs.CHANNELS_CONSTANT
    if missing_channels:
        reason = UnusableOutputs.CHANNELS_MISSING
    return Fact(
        reason,
        name=message_name,
        basis=geometry.basis,
        channels=sorted(geometry.channels),
        missing=missing_channels,
        moving=sorted(moving_channels),
        remedy=RECORD_A_FLIGHT,
    )


def _combined_outputs(
    telemetry: Telemetry, message: str, geometry: MotorGeometry, ports: Sequence[_PortOutputs]
) -> MotorOutputs | Fact:
    """Combines the outputs of all motors to one table at the stamps of the port with most motors.

    Each port sends the outputs of its channels in a message of its own. Those of another port are sent a moment before
    or after, and are interpolated.

    Args:
        telemetry: Messages of the vehicle.
        message: Name of the message with the outputs.
        geometry: The k motors, with their output channels.
        ports: For each motor, the port that has its channel; a port occurs once for each of its motors.

    Returns:
        The outputs; or a fact with the reason, if no row has a finite output of every motor.
    """
    main_port = max(ports, key=ports.count)
    sent_outputs = [
        port.outputs(channel) for port, channel in zip(ports, geometry.channels, strict=True)
    ]
    columns = []
    for port, outputs in zip(ports, sent_outputs, strict=True):
        if port is not main_port:
            outputs = _interpolated_outputs(main_port.series, port.series, outputs)
        columns.append(outputs)
    stamps = {"time": main_port.series.time, "boot": main_port.series.boot}
    combined_series = clean_series(stamps, np.column_stack(columns).astype(np.float64))
    if not len(combined_series.time):
        return Fact(UnusableOutputs.OUTPUTS_NOT_FINITE, name=telemetry.name_in_source(message))
    # The resolution is found from the outputs as sent: interpolated ones lie between the steps of the stream.
    # Of hours of flight, the distinct outputs of each motor take far less memory than all of them.
    distinct_outputs = np.concatenate([np.unique(outputs) for outputs in sent_outputs])
    scale = output_scale(
        distinct_outputs.astype(np.float64), telemetry.parameters, geometry.drivers
    )
    if scale.upper_limit == 1.0:
        # No parameter limits the motors below the full range, so a limit is inferred from the outputs.
        scale = replace(
            scale, upper_limit=_observed_upper_limit(scale.fraction(combined_series.values))
        )
    return MotorOutputs(
        message=message,
        time=combined_series.time,
        boot=combined_series.boot,
        outputs=combined_series.values,
        geometry=geometry,
        scale=scale,
        sent_count=main_port.series.sent_count,
        unused_count=main_port.series.unused_count + combined_series.unused_count,
    )


def _outputs_by_port(message: str, columns: Columns, autopilot: str) -> list[_PortOutputs]:
    """Splits a message with output channels by its ports.

    Autopilots send more than 8 or 16 outputs in several messages of the same name, which differ by their ``port``. A
    channel without a finite output on its port counts as unused, with outputs of 0.

    Args:
        message: name of the message, such as SERVO_OUTPUT_RAW.
        columns: fields of the message by name, N rows each.
        autopilot: MAV_AUTOPILOT without its prefix.

    Returns:
        The outputs of each port, in the order of the ports.
    """
    all_outputs, channels_per_port = channel_outputs(message, columns, autopilot)
    # (N, channels): each message has the channels of one port.
    outputs = all_outputs[:, :channels_per_port]
    port_numbers = float_column(columns, "port") if "port" in columns else np.zeros(len(outputs))
    is_finite = np.isfinite(outputs)
    outputs_by_port = []
    for number in np.unique(port_numbers):
        is_of_port = port_numbers == number
        is_unused_channel = ~is_finite[is_of_port].any(axis=0)
        if is_unused_channel.any():
            # The outputs are changed in place, since a copy of hours of flight takes hundreds of megabytes.
            outputs[np.ix_(is_of_port, is_unused_channel)] = 0.0
        first_channel = 1 + channels_per_port * int(number)
        series = clean_series(columns, outputs, is_of_port)
        outputs_by_port.append(_PortOutputs(first_channel, series))
    return outputs_by_port


def _is_moving(outputs: Array) -> bool:
    """Returns whether a channel (N,) takes several values besides 0, which stands for "no output yet"."""
    nonzero = outputs[outputs != 0]
    return len(nonzero) > 0 and np.ptp(nonzero) > 0


def _interpolated_outputs(target: TimeSeries, source: TimeSeries, outputs: Array) -> Array:
    """Interpolates outputs of one port to the stamps of another, within each boot.

    Args:
        target: Outputs of the port with the N wanted stamps; only its times and boots are used.
        source: Outputs of the other port, at M stamps; only its times and boots are used.
        outputs: (M,) outputs of one channel of the other port.

    Returns:
        (N,) outputs; NaN in boots in which the other port has no sample.
    """
    interpolated_outputs = np.full(len(target.time), np.nan)
    for boot in np.intersect1d(target.boot, source.boot):
        is_target = target.boot == boot
        is_source = source.boot == boot
        interpolated_outputs[is_target] = np.interp(
            target.time[is_target], source.time[is_source], outputs[is_source]
        )
    return interpolated_outputs


def _observed_upper_limit(fractions: Array) -> float:
    """Infers the upper limit that the autopilot sets to motor outputs, from how often their highest value occurs.

    Args:
        fractions: (N, k) outputs of k motors as fractions of the range.

    Returns:
        The limit as a fraction of the range: the highest output of all motors, if at least one motor shows that it is
        limited there; otherwise 1.
    """
    highest_output = float(fractions.max())
    if highest_output < MIN_OBSERVED_LIMIT:
        return 1.0
    for outputs in fractions.T:
        if _is_limited_at(highest_output, outputs):
            return highest_output
    return 1.0


def _is_limited_at(limit: float, outputs: Array) -> bool:
    """Returns whether the histogram of a motor's outputs shows that the autopilot limits them at a value.

    An output that moves freely is seldom exactly at its maximum, while a limited one stays there. So there must be far
    more samples in the bin of the limit than in the bins just below it, and most other samples still further below.

    Args:
        limit: highest output of all motors, as a fraction of the range.
        outputs: (N,) outputs of the motor, as fractions of the range.
    """
    # Outputs of 0 are of a motor that is off, and do not count.
    running_outputs = outputs[outputs > 0]
    # Bin 0 is the one of the limit, and each further bin is below the one before.
    bins = np.floor((limit - running_outputs) / STOP_BIN_WIDTH)
    count_at_limit = np.count_nonzero(bins == 0)
    count_below = np.count_nonzero(bins > 0)
    count_far_below = np.count_nonzero(bins > STOP_NEIGHBOUR_BINS)
    mean_count_just_below = (count_below - count_far_below) / STOP_NEIGHBOUR_BINS
    min_count_at_limit = max(
        MIN_STOP_SHARE * len(outputs),
        MIN_STOP_EXCESS * mean_count_just_below,
        MIN_STOP_SAMPLES,
    )
    is_mostly_far_below = count_far_below > count_below / 2
    return bool(count_at_limit >= min_count_at_limit and is_mostly_far_below)
