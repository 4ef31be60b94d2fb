"""Any field of a log: which messages, fields and instances there are, and the samples of one of them."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.ingest.mavlink.dialect import definitions_by_name
from mavdem.ingest.telemetry import Columns, Telemetry, rate_without_gaps

CLOCK_COLUMNS = ("time", "boot")
"""Columns that every message has besides the fields of its definition: when it was sent, and after which boot."""

INSTANCE_COLUMNS = ("instance", "Instance", "Inst", "I", "IMU", "C", "port", "id", "axis")
"""Fields that say which of several equal sensors, outputs or axes a message is of, as MAVLink's and ArduPilot's
definitions mark them; the first that a message has is taken."""


MAX_INSTANCE = 255
"""Largest number of an instance, a byte in MAVLink: larger numbers in such a field are codes, such as PX4's events."""


UNSET_VALUES = {
    ("BATTERY_STATUS", "battery_remaining"): -1,
    ("BATTERY_STATUS", "current_battery"): -1,
    ("BATTERY_STATUS", "current_consumed"): -1,
    ("BATTERY_STATUS", "energy_consumed"): -1,
    ("BATTERY_STATUS", "temperature"): 32767,
    ("BATTERY_STATUS", "voltages"): 65535,
    ("GLOBAL_POSITION_INT", "hdg"): 65535,
    ("GPS2_RAW", "cog"): 65535,
    ("GPS2_RAW", "eph"): 65535,
    ("GPS2_RAW", "epv"): 65535,
    ("GPS2_RAW", "satellites_visible"): 255,
    ("GPS2_RAW", "vel"): 65535,
    ("GPS_RAW_INT", "cog"): 65535,
    ("GPS_RAW_INT", "eph"): 65535,
    ("GPS_RAW_INT", "epv"): 65535,
    ("GPS_RAW_INT", "satellites_visible"): 255,
    ("GPS_RAW_INT", "vel"): 65535,
    ("OBSTACLE_DISTANCE", "distances"): 65535,
    ("RC_CHANNELS", "rssi"): 255,
    ("RC_CHANNELS_RAW", "rssi"): 255,
    ("SYS_STATUS", "battery_remaining"): -1,
    ("SYS_STATUS", "current_battery"): -1,
    ("SYS_STATUS", "voltage_battery"): 65535,
    **{
        (message, f"chan{channel}_raw"): 65535
        for message in ("RC_CHANNELS", "RC_CHANNELS_RAW")
        for channel in range(1, 19)
    },
}
"""Numbers that stand for "not known" or "not there", by message and field, array fields without the element's number:
the attribute ``invalid`` and the texts of MAVLink's common.xml. They are integers; a field of floats has NaN."""


class MessageFields(NamedTuple):
    """What a log holds of one message type."""

    message: str
    """Name of the message, as MAVLink calls it."""
    name_in_source: str
    """Name of the message in the log, "RCOU" for "SERVO_OUTPUT_RAW"."""
    messages: int
    """Number of messages."""
    rate: float
    """Messages per second without gaps; of the first instance, where there are several."""
    first_time: float
    """When the first one was sent, s on the autopilot's boot clock."""
    last_time: float
    """When the last one was sent, s; after a later boot, on that one's clock."""
    fields: tuple[str, ...]
    """Names of its numeric fields; an array's elements are "q[0]", "q[1]", and so on."""
    units: tuple[str, ...]
    """Unit of each field as MAVLink's definition writes it, such as "rad"; empty where it has none, or is the log's."""
    instances: tuple[int, ...]
    """Numbers of its instances, ascending; empty where the message has none."""


class FieldSamples(NamedTuple):
    """One field's samples, from one boot of the autopilot and perhaps of one instance."""

    time: Array
    """Times (N,), s on the autopilot's boot clock."""
    values: Array
    """Values (N,) in the unit of the message's definition; NaN where the log has none."""


def message_names(telemetry: Telemetry, text: str = "") -> list[str]:
    """Returns the names of a vehicle's messages that contain a text, in upper or lower case, in their order."""
    return sorted(name for name in telemetry.messages if text.lower() in name.lower())


def numeric_messages(telemetry: Telemetry, text: str = "") -> Iterator[MessageFields]:
    """Yields the messages of a vehicle that have numeric fields, in the order of their names.

    Args:
        telemetry: Messages of the vehicle.
        text: Only messages are described whose name contains this text, in upper or lower case.

    Yields:
        For each message its fields and instances, its count, and its rate, Hz. If it has several instances, such as
        batteries, the rate is of the first one.
    """
    for message in message_names(telemetry, text):
        columns = telemetry.messages[message]
        fields = _numeric_fields(columns)
        if not fields or not len(columns["time"]):
            continue
        instances = _instances(columns)
        time = columns["time"]
        if instances:
            is_first_instance = columns[_instance_column(columns)] == instances[0]
            time = time[is_first_instance]
        steps = np.diff(time)
        yield MessageFields(
            message=message,
            name_in_source=telemetry.name_in_source(message),
            messages=len(columns["time"]),
            rate=rate_without_gaps(steps[steps > 0]),
            first_time=float(columns["time"][0]),
            last_time=float(columns["time"][-1]),
            fields=tuple(fields),
            units=tuple(_unit_of_field(message, field) for field in fields),
            instances=instances,
        )


def field_samples(
    telemetry: Telemetry, message: str, field: str, instance: int | None = None, boot: int = 0
) -> FieldSamples:
    """Returns all samples of one field in the order of time.

    Samples are sorted by time, since messages may be late, and streams of several sensors may be concatenated. Only the
    columns of time, boot, instance and the field itself are read.

    Args:
        telemetry: Messages of the vehicle.
        message: Name of the message, as MAVLink or as the log calls it.
        field: One of the message's numeric fields, as ``numeric_messages`` lists them.
        instance: Number of one of several equal sensors or outputs; None for all of them.
        boot: Number of the boot of the autopilot, from 0.

    Returns:
        Times, s since boot, and values.

    Raises:
        ValueError: The log has no such message, field or instance; the error lists the fields that it has.
    """
    columns = _message_columns(telemetry, message)
    fields = _numeric_fields(columns)
    if field not in fields:
        raise ValueError(f"{message} has no field {field}: it has {', '.join(fields)}")
    is_selected = columns["boot"] == boot
    if instance is not None:
        instances = _instances(columns)
        if instance not in instances:
            available_instances = ", ".join(map(str, instances)) or "none"
            raise ValueError(
                f"{message} has no instance {instance}: there is {available_instances}"
            )
        is_selected &= columns[_instance_column(columns)] == instance
    time = columns["time"][is_selected]
    values = _with_nan_for_unset(fields[field][is_selected], message, field)
    order = np.argsort(time, kind="stable")
    return FieldSamples(time=time[order], values=values[order])


def _with_nan_for_unset(values: Array, message: str, field: str) -> Array:
    """Converts the values of a MAVLink field to floats, with NaN for unset values.

    Some integer fields have a number that means "unset", such as 65535 for the voltage of a cell.

    Args:
        values: Values (N,) of the field as the log has them.
        message: Name of the message, as MAVLink calls it.
        field: Name of the field, such as "voltages[1]".

    Returns:
        Values (N,).
    """
    floats = values.astype(float)
    # The elements of an array field, such as "voltages[1]", have one such number in common.
    array_name, _, _ = field.partition("[")
    unset_value = UNSET_VALUES.get((message, array_name))
    is_integer = values.dtype.kind in "iu"
    if unset_value is not None and is_integer:
        floats[values == unset_value] = np.nan
    return floats


def samples_between(samples: FieldSamples, start: float, end: float) -> FieldSamples:
    """Returns the samples from ``start`` to ``end``, s, both included."""
    is_within = (samples.time >= start) & (samples.time <= end)
    return FieldSamples(time=samples.time[is_within], values=samples.values[is_within])


def extremes_of_intervals(samples: FieldSamples, intervals: int) -> FieldSamples:
    """Reduces the number of samples for a plot, but keeps every peak.

    The time is divided into equal intervals. In each of them the samples with the smallest and with the largest value
    are kept, in the order of time.

    Args:
        samples: N samples, ascending in time.
        intervals: Number of intervals, at least 1.

    Returns:
        At most twice as many samples as there are intervals, ascending in time, with the samples' own times. Samples
        whose value is NaN are left out.
    """
    is_known = np.isfinite(samples.values) & np.isfinite(samples.time)
    time, values = samples.time[is_known], samples.values[is_known]
    if not len(time):
        return FieldSamples(time, values)
    edges = np.linspace(time[0], time[-1], intervals + 1)
    # The index of the first sample of each interval, and the end of the last interval.
    bounds = np.append(np.searchsorted(time, edges[:-1]), len(time)).tolist()
    kept_samples: list[int] = []
    for first_sample, end_sample in pairwise(bounds):
        is_empty = first_sample == end_sample
        if is_empty:
            continue
        interval_values = values[first_sample:end_sample]
        lowest = first_sample + int(interval_values.argmin())
        highest = first_sample + int(interval_values.argmax())
        # A set, since they are the same sample where all values are equal.
        kept_samples += sorted({lowest, highest})
    return FieldSamples(time=time[kept_samples], values=values[kept_samples])


def _message_columns(telemetry: Telemetry, message: str) -> Columns:
    """Returns the columns of a message by its name in MAVLink or, without one of that name, by its name in the log.

    Args:
        telemetry: Messages of the vehicle.
        message: Name of the message, such as "ATTITUDE" or, in a DataFlash log, "ATT".

    Raises:
        ValueError: The log has no such message.
    """
    if message in telemetry.messages:
        return telemetry.messages[message]
    # Only the names are compared: the columns of a message may have to be read from a file.
    for name in telemetry.messages:
        if message in telemetry.name_in_source(name).split("/"):
            return telemetry.messages[name]
    raise ValueError(f"the log has no {message}: it has {', '.join(sorted(telemetry.messages))}")


def _unit_of_field(message: str, field: str) -> str:
    """Returns the unit of a field by MAVLink's definition of its message; empty without a unit or a definition.

    Args:
        message: Name of the message, as MAVLink calls it.
        field: Name of the field, or of an element of it, such as "q[0]".
    """
    definition = definitions_by_name().get(message)
    name, _, _ = field.partition("[")
    return definition.units.get(name, "") if definition is not None else ""


def _numeric_fields(columns: Columns) -> dict[str, Array]:
    """Returns the numeric fields of a message, as views of its columns.

    Each element of an array field is a separate field, such as "controls[0]". Time and boot are left out.

    Args:
        columns: Fields of N messages, (N,) or, of an array field, (N, k).

    Returns:
        Fields (N,) by name.
    """
    fields: dict[str, Array] = {}
    for key, values in columns.items():
        # Some keys are members of a StrEnum, whose value is the name of the field.
        name = str(key)
        if name in CLOCK_COLUMNS or values.dtype.kind not in "biuf":
            continue
        if values.ndim == 1:
            fields[name] = values
        else:
            for index in range(values.shape[1]):
                fields[f"{name}[{index}]"] = values[:, index]
    return fields


def _instance_column(columns: Columns) -> str:
    """Returns the name of the field that numbers the instances of a message, such as several batteries.

    Args:
        columns: Fields of the messages.

    Returns:
        The first of ``INSTANCE_COLUMNS`` whose values can be numbers of instances; empty if there is none.
    """
    for name in INSTANCE_COLUMNS:
        if name not in columns or columns[name].dtype.kind not in "iu":
            continue
        numbers = columns[name]
        if len(numbers) and numbers.min() >= 0 and numbers.max() <= MAX_INSTANCE:
            return name
    return ""


def _instances(columns: Columns) -> tuple[int, ...]:
    """Returns the numbers of a message's instances, ascending; empty if it has none."""
    name = _instance_column(columns)
    if not name:
        return ()
    return tuple(np.unique(columns[name]).tolist())
