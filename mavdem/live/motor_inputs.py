"""Which motor outputs are the inputs of a live model, by the rules for logs applied to the last seconds."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.dataset import motor_outputs
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.motors import MOTOR_MESSAGES
from mavdem.ingest.output_scale import output_scale
from mavdem.ingest.telemetry import Fields, Telemetry, concatenated_columns
from mavdem.live.samples import MEMORY_SECONDS, SampleStream

MAX_USED_SAMPLES = 1024
"""Samples of a stream by which inputs are chosen, a choice: of a faster stream every second, third … sample is used,
which shows the same, and no row waits for the rest."""

StreamKey = tuple[str, int]
"""Name of a message and number of its port, ``NO_PORT`` of messages without ports."""

NO_PORT = 0
"""Port of messages without ports, such as those of the attitude."""


class PortChannel(NamedTuple):
    """One output channel of a message whose outputs come in several ports."""

    port: int
    """Number of the port, from 0 on."""

    offset: int
    """Number of the channel within its port, from 0 on."""


@dataclass(frozen=True, eq=False)
class MotorInputs:
    """The inputs of the model: the outputs of all motors in the last seconds, and their channels."""

    motors: MotorOutputs
    channels: tuple[PortChannel, ...]
    """The channel of each motor, in the order of the inputs."""

    @property
    def collective(self) -> TimeSeries | None:
        """Mean of the motors as a fraction of their range in the last seconds; None if no outputs came."""
        return self.motors.collective if len(self.motors.time) else None

    @cached_property
    def ports(self) -> tuple[int, ...]:
        """The ports with inputs, the one with most of them first, of several the lowest."""
        counts = Counter(channel.port for channel in sorted(self.channels))
        return tuple(port for port, _ in counts.most_common())

    @property
    def identity(self) -> tuple[object, ...]:
        """What must not change within a segment: message, channels of the motors, and their ports."""
        return self.motors.message, self.motors.geometry.channels, self.channels


class _TimedSamples(NamedTuple):
    """Some samples of one stream of motor outputs."""

    time: Array
    """(R,) Stamps, s of the boot clock."""

    values: Array
    """(R, channels) Outputs, in the unit of the message."""


class InputSelector:
    """Finds out which output channels drive the motors, by the last seconds and each channel's extremes in this boot.

    The extremes show which channels move, and on which scale, also while they do not change.
    """

    def __init__(self, boot: int = 0) -> None:
        self._boot = boot
        # Each stream has time, s, and values of the samples in which a channel was lowest or highest so far.
        self._extremes: dict[StreamKey, _TimedSamples] = {}

    def candidate_messages(
        self, streams: Mapping[StreamKey, SampleStream], present_message: str | None
    ) -> dict[str, Fields]:
        """Collects the motor messages from which the inputs are selected, in the form in which a log has them.

        An autopilot may send its outputs in several messages, and a message in several ports, whose columns are joined.

        Args:
            streams: samples by message and port.
            present_message: the message to stay with, as within a segment of rows; None if any may be selected.

        Returns:
            Columns by message name.
        """
        messages: dict[str, Fields] = {}
        for (name, port), stream in sorted(streams.items()):
            if name not in MOTOR_MESSAGES or not stream.time:
                continue
            if present_message is not None and name != present_message:
                continue
            columns = self._columns_of_port(name, port, stream)
            if name in messages:
                columns = concatenated_columns([messages[name], columns])
            messages[name] = columns
        return messages

    def select(
        self, messages: dict[str, Fields], vehicle: Telemetry, now: float
    ) -> MotorInputs | None:
        """Selects the motors among the output channels, by the rules for logs (``Signals.motors``).

        The rules also get the extremes of earlier samples, which show the range in which each channel moves. The result
        contains only the recent samples, and the port and offset of each motor's channel.

        Args:
            messages: columns of the messages with motor outputs, by name.
            vehicle: identity and parameters of the vehicle.
            now: present time on the boot clock, s; samples of the last ``MEMORY_SECONDS`` are returned.

        Returns:
            The inputs; None if no motors are found.
        """
        motors = Signals(replace(vehicle, messages=messages)).motors
        if motors is None:
            return None
        # Channels are numbered from 1 on through all ports, each of which has ``port_width`` channels.
        port_width = motor_outputs.channel_outputs(
            motors.message, messages[motors.message], vehicle.autopilot
        ).channels_per_port
        channels = []
        for number in motors.geometry.channels:
            port, offset = divmod(number - 1, port_width)
            channels.append(PortChannel(port, offset))
        # A climb of a few seconds at one throttle looks like an upper limit: only parameters show where that is.
        scale_by_parameters = output_scale(
            motors.outputs, vehicle.parameters, motors.geometry.drivers
        )
        scale = replace(motors.scale, upper_limit=scale_by_parameters.upper_limit)
        is_recent = motors.time >= now - MEMORY_SECONDS
        recent_motors = replace(
            motors,
            scale=scale,
            time=motors.time[is_recent],
            boot=motors.boot[is_recent],
            outputs=motors.outputs[is_recent],
        )
        return MotorInputs(recent_motors, tuple(channels))

    def _columns_of_port(self, name: str, port: int, stream: SampleStream) -> Fields:
        """Returns the outputs of one port as the columns that a log would have.

        The rules for logs find out from these columns which channels drive motors. They have R rows: first the samples
        with the smallest and the largest output of each channel since boot, then the latest samples; of a fast stream
        only every second, third … sample, so that no call takes long.

        Args:
            name: name of the message.
            port: number of the port; a port is one of several groups of channels that some messages number.
            stream: its samples, at least one, each with the outputs of all channels in the unit of the message.

        Returns:
            ``time`` (R,), s of the boot clock, ``boot`` (R,) and the outputs: one column (R, channels) where the
            message has an array of them, otherwise a column (R,) for each channel, and ``port`` (R,).
        """
        # Every ``stride``-th sample is used, so that at most ``MAX_USED_SAMPLES`` are.
        stride = 1 + len(stream.time) // MAX_USED_SAMPLES
        time = np.array(stream.time[::stride])
        table = stream.table()[::stride]
        if (name, port) in self._extremes:
            former_extremes = self._extremes[name, port]
            time = np.concatenate([former_extremes.time, time])
            table = np.concatenate([former_extremes.values, table])
        # The extremes so far are kept for the next call.
        extreme_rows = _rows_with_extremes(table)
        self._extremes[name, port] = _TimedSamples(time[extreme_rows], table[extreme_rows])
        columns = {"time": time, "boot": np.full(len(time), self._boot)}
        layout = MOTOR_MESSAGES[name]
        if not layout.is_ported:
            # The message has one field with an array of all channels.
            columns[layout.field] = table
            return columns
        # The message has one field for each channel, numbered from 1, and a field with the number of its port.
        for number, channel_values in enumerate(table.T, 1):
            columns[layout.field.format(number)] = channel_values
        columns["port"] = np.full(len(time), port)
        return columns


def _rows_with_extremes(table: Array) -> Indices:
    """Returns the rows in which any channel has its lowest or its highest output.

    The rules for logs find the motors by which channels move, and over which range. The last seconds alone may not show
    that, as in a steady hover, so that these samples are kept since boot: at most two for each channel.

    Args:
        table: (R, channels) outputs.

    Returns:
        The rows, ascending; each of them once, even if it is the extreme of several channels.
    """
    # Autopilots send 0 for a channel without an output yet: it is no lowest value.
    is_output = (table != 0) & np.isfinite(table)
    lowest_rows = np.where(is_output, table, inf).argmin(axis=0)
    highest_rows = np.where(is_output, table, -inf).argmax(axis=0)
    return np.union1d(lowest_rows, highest_rows)
