"""Raw samples of gyro and accelerometer in DataFlash logs, before the autopilot's filters and after them.

There are three kinds of messages: ISBH begins a batch of samples that ISBD messages continue, 32 samples each; GYR and
ACC hold one sample each and have no gaps; IMU holds the filtered values. Of an autopilot that logs raw and filtered
samples, the instances with filtered ones count on from those of the sensors. Sources: ``BatchSampler`` and
``log_gyro_raw`` of https://github.com/ArduPilot/ardupilot.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.containers import Names
from mavdem.ingest.dataflash.tables import messages_with_fields, rows_of_instance
from mavdem.ingest.telemetry import (
    MICROSECONDS,
    Columns,
    Parameters,
    Tables,
    concatenated_columns,
    rows_by_value,
    selected_rows,
)

GYRO_FIELDS = ("GyrX", "GyrY", "GyrZ")
"""Fields of GYR and IMU with body rates, rad/s."""
ACCELEROMETER_FIELDS = ("AccX", "AccY", "AccZ")
"""Fields of ACC and IMU with accelerations, m/s²."""


class SensorLogging(NamedTuple):
    """How samples of one kind of sensor are logged."""

    fields: Names
    """Fields with the three axes, in the messages with one sample each."""
    sample_message: str
    """Message with one sample, without gaps."""
    batch_type: int
    """Value of ISBH.type."""
    id_parameters: Names
    """Parameters that are not 0 for each sensor that there is."""


SENSORS = {
    "GYRO": SensorLogging(GYRO_FIELDS, "GYR", 1, ("INS_GYR_ID", "INS_GYR2_ID", "INS_GYR3_ID")),
    "ACCEL": SensorLogging(
        ACCELEROMETER_FIELDS, "ACC", 0, ("INS_ACC_ID", "INS_ACC2_ID", "INS_ACC3_ID")
    ),
}
"""Both kinds of sensors."""


class FilterStageOption(NamedTuple):
    """The parameter that decides whether samples are logged before the filters or after them."""

    parameter: str
    """Name of the parameter, a bit mask."""
    filtered_flag: int
    """Bit that is set where samples after the filters are logged instead of those before."""
    both_flag: int
    """Bit that is set where both are logged."""


BATCH_OPTION = FilterStageOption("INS_LOG_BAT_OPT", filtered_flag=1 << 1, both_flag=1 << 2)
"""The option of batches, ISBH and ISBD."""
SAMPLE_OPTION = FilterStageOption("INS_RAW_LOG_OPT", filtered_flag=1 << 2, both_flag=1 << 3)
"""The option of single samples, GYR and ACC."""


class RawSamples(NamedTuple):
    """Samples of one sensor, before the autopilot's filters or after them."""

    source_name: str
    """Name of the message in the log, such as "GYR"."""
    columns: Columns
    """``time``, s, ``boot``, and ``x``, ``y`` and ``z``, rad/s or m/s²: each (N,)."""


def raw_samples(tables: Tables, parameters: Parameters) -> dict[str, RawSamples]:
    """Collects the samples of the first gyro and of the first accelerometer, before the filters and after them.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        parameters: The autopilot's parameters by name.

    Returns:
        The samples by GYRO_BEFORE, GYRO_AFTER, ACCEL_BEFORE and ACCEL_AFTER, as far as they were logged.
    """
    samples = {}
    for sensor, logging in SENSORS.items():
        for stage, samples_of_stage in _samples_by_stage(tables, parameters, logging).items():
            samples[f"{sensor}_{stage}"] = samples_of_stage
    return samples


def _samples_by_stage(
    tables: Tables, parameters: Parameters, logging: SensorLogging
) -> dict[str, RawSamples]:
    """Collects the samples of the first sensor of one kind, before the filters and after them.

    ArduPilot has three ways of logging them, of which the first that has samples is used: batches (ISBH and ISBD),
    single samples without gaps (GYR and ACC), and the filtered samples of IMU.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        parameters: The autopilot's parameters by name.
        logging: How sensors of this kind are logged.

    Returns:
        The samples by stage, "BEFORE" and "AFTER"; only stages that were logged.
    """
    sensor_count = sum(parameters.get(name, 0.0) != 0 for name in logging.id_parameters)
    batch_instances = _instance_by_stage(BATCH_OPTION, parameters, sensor_count)
    sample_instances = _instance_by_stage(SAMPLE_OPTION, parameters, sensor_count)
    samples = {}
    for stage, instance in batch_instances.items():
        columns = _batch_samples(tables, logging.batch_type, instance)
        if columns:
            samples[stage] = RawSamples("ISBH", columns)
    for stage, instance in sample_instances.items():
        columns = _single_samples(tables, logging.sample_message, logging.fields, instance)
        if columns and stage not in samples:
            samples[stage] = RawSamples(logging.sample_message, columns)
    columns = _single_samples(tables, "IMU", logging.fields, instance=0)
    if columns and "AFTER" not in samples:
        samples["AFTER"] = RawSamples("IMU", columns)
    return samples


def _instance_by_stage(
    option: FilterStageOption, parameters: Parameters, sensor_count: int
) -> dict[str, int]:
    """Returns the instance numbers under which the log has the first sensor's samples before and after the filters.

    ArduPilot numbers the sensors from 0. If it logs both stages, filtered samples have the numbers after the numbers of
    all sensors: with 3 gyros, instance 3 is the first gyro after its filters.

    Args:
        option: The parameter that decides which stages are logged.
        parameters: The autopilot's parameters by name.
        sensor_count: Number of gyros, or of accelerometers.

    Returns:
        The instance by stage, "BEFORE" and "AFTER"; only stages that the parameter switches on.
    """
    flags = int(parameters.get(option.parameter, 0.0))
    if flags & option.both_flag:
        return {"BEFORE": 0, "AFTER": sensor_count}
    if flags & option.filtered_flag:
        return {"AFTER": 0}
    return {"BEFORE": 0}


def _single_samples(tables: Tables, message: str, fields: Names, instance: int) -> Columns:
    """Returns the samples of one instance in messages with one sample each.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        message: Name of the message: "GYR".
        fields: Its fields with the three axes.
        instance: Number of the sensor, from 0.

    Returns:
        ``time``, s, ``boot``, ``x``, ``y`` and ``z`` (N,), rad/s or m/s²; empty if there are none. The times
        are SampleUS, when the sample was taken, if it was logged; otherwise the times of the messages.
    """
    logged_columns = rows_of_instance(messages_with_fields(tables, message, fields), "I", instance)
    if not logged_columns:
        return {}
    time = logged_columns["time"]
    if "SampleUS" in logged_columns:
        time = _sample_time(logged_columns, logged_columns["SampleUS"])
    x_field, y_field, z_field = fields
    return {
        "time": time,
        "boot": logged_columns["boot"],
        "x": logged_columns[x_field],
        "y": logged_columns[y_field],
        "z": logged_columns[z_field],
    }


def _sample_time(logged_columns: Columns, sample_stamps: Array) -> Array:
    """Converts the stamps of samples to the boot clock.

    A sample is older than the message that reports it by the difference of their stamps, so that its time is the
    message's time on the boot clock less this delay.

    Args:
        logged_columns: The messages (N,), with ``time`` and, if it was logged, TimeUS.
        sample_stamps: Stamp of each sample (N,), µs, on the clock of TimeUS.

    Returns:
        Times (N,) since boot, s.
    """
    message_stamps = logged_columns.get("TimeUS", sample_stamps)
    delay = message_stamps.astype(np.float64) - sample_stamps.astype(np.float64)
    return logged_columns["time"] - delay / MICROSECONDS


def _batch_samples(tables: Tables, batch_type: int, instance: int) -> Columns:
    """Returns the samples of all complete batches of one instance.

    A batch is one header, ISBH, and some messages ISBD of 32 samples per axis, which carry the header's number N.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        batch_type: Kind of sensor, as in ISBH.type.
        instance: Number of the sensor, as in ISBH.instance.

    Returns:
        ``time``, s, ``boot``, ``x``, ``y`` and ``z`` (N,), rad/s or m/s²; empty if there are no complete batches.
    """
    header_fields = ("N", "type", "instance", "mul", "smp_cnt", "smp_rate", "SampleUS")
    headers = messages_with_fields(tables, "ISBH", header_fields)
    data = messages_with_fields(tables, "ISBD", ("N", "seqno", "x", "y", "z"))
    if not headers or not data or any(data[axis].ndim != 2 for axis in "xyz"):
        return {}
    batch_numbers = data["N"]
    if batch_numbers.dtype.kind == "f":
        # Damage may have made the numbers floats; only integers can be grouped.
        batch_numbers = batch_numbers.astype(np.int64)
    data_rows_by_batch = rows_by_value(batch_numbers)
    is_wanted = (headers["type"] == batch_type) & (headers["instance"] == instance)
    is_sound = (headers["mul"] > 0) & (headers["smp_rate"] > 0)
    headers = selected_rows(headers, is_wanted & is_sound)
    start_times = _sample_time(headers, headers["SampleUS"])
    no_rows = np.zeros(0, np.intp)
    batches = []
    for row, batch_number in enumerate(headers["N"].tolist()):
        data_rows = data_rows_by_batch.get(int(batch_number), no_rows)
        header = {field: values[row] for field, values in headers.items()}
        batch = _complete_batch(header, start_times[row], data, data_rows)
        if batch is not None:
            batches.append(batch)
    return concatenated_columns(batches) if batches else {}


def _complete_batch(
    header: Mapping[str, Any],
    start_time: float,
    data: Columns,
    data_rows: NDArray[np.signedinteger],
) -> Columns | None:
    """Returns the samples of one batch, unless one of its messages was lost: then their times are not known.

    Args:
        header: Fields of the header: the sampling rate ``smp_rate``, Hz, the number of samples ``smp_cnt``, the factor
            ``mul`` by which values were multiplied to be logged as integers, and ``boot``.
        start_time: Time of the first sample, s since boot.
        data: Columns of all messages ISBD.
        data_rows: Rows of the messages of this batch, in any order.

    Returns:
        ``time``, s, ``boot``, ``x``, ``y`` and ``z`` (n,), rad/s or m/s²; None if samples are missing.
    """
    axes = _samples_by_axis(data, data_rows, scale=float(header["mul"]))
    count = len(axes["x"])
    if count != header["smp_cnt"]:
        return None
    time = start_time + np.arange(count) / float(header["smp_rate"])
    return {"time": time, "boot": np.full(count, header["boot"]), **axes}


def _samples_by_axis(
    data: Columns, rows: NDArray[np.signedinteger], scale: float
) -> dict[str, Array]:
    """Returns the samples in some messages ISBD, in the order in which they were taken.

    Args:
        data: Columns of all messages ISBD: ``seqno``, the number of a message in its batch, and ``x``, ``y`` and ``z``.
        rows: Rows of the messages of one batch, in any order.
        scale: Factor by which the values were multiplied to be logged as integers.

    Returns:
        Samples (n,) of each axis by name, rad/s or m/s².
    """
    sending_order = np.argsort(data["seqno"][rows], kind="stable")
    ordered_rows = rows[sending_order]
    return {axis: data[axis][ordered_rows].ravel() / scale for axis in "xyz"}
