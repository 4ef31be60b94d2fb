"""Samples of gyro and accelerometer as they were measured, before the filters and behind them.

ISBH begins a batch that ISBD continues, 32 samples each; GYR and ACC are logged without gaps; IMU is behind the
filters. Of an autopilot that logs both, instances behind the filters count on from those of the sensors. Sources:
``BatchSampler`` and ``log_gyro_raw`` of https://github.com/ArduPilot/ardupilot.
"""

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Names
from mavdem.ingest.dataflash.translation import ACCELEROMETERS, GYROS, having, instance
from mavdem.ingest.telemetry import Columns, Parameters, Tables, concatenated_columns, rows_by_value

FIELDS = {"GYRO": GYROS, "ACCEL": ACCELEROMETERS}
RAW = {"GYRO": "GYR", "ACCEL": "ACC"}
"""The messages of samples without gaps."""
BATCH_TYPES = ("ACCEL", "GYRO")  # by ISBH.type
IDS = {
    "GYRO": ("INS_GYR_ID", "INS_GYR2_ID", "INS_GYR3_ID"),
    "ACCEL": ("INS_ACC_ID", "INS_ACC2_ID", "INS_ACC3_ID"),
}
"""Parameters that are not 0 for each sensor that there is."""
OPTIONS = {"ISBH": ("INS_LOG_BAT_OPT", 2, 4), "raw": ("INS_RAW_LOG_OPT", 4, 8)}
"""The parameter, and its bits: samples behind the filters alone, and of both."""


def raw_samples(tables: Tables, parameters: Parameters) -> dict[str, tuple[str, Columns]]:
    """Returns GYRO_BEFORE, GYRO_AFTER, ACCEL_BEFORE and ACCEL_AFTER, of the first sensor, with what the log calls them.

    They have ``x``, ``y``, ``z``, rad/s or m/s², behind the filters or before.
    """
    samples = {}
    for sensor, fields in FIELDS.items():
        sensors = sum(parameters.get(name, 0.0) != 0 for name in IDS[sensor])
        for source, (option, behind, both) in OPTIONS.items():
            bits = int(parameters.get(option, 0.0))
            first = "AFTER" if bits & behind and not bits & both else "BEFORE"
            stages = {first: 0, "AFTER": sensors} if bits & both else {first: 0}
            for stage, number in stages.items():
                columns = (
                    _batches(tables, sensor, number)
                    if source == "ISBH"
                    else _plain(tables, RAW[sensor], fields, number)
                )
                if columns and f"{sensor}_{stage}" not in samples:
                    name = RAW[sensor] if source == "raw" else source
                    samples[f"{sensor}_{stage}"] = (name, columns)
        if f"{sensor}_AFTER" not in samples:
            columns = _plain(tables, "IMU", fields, 0)
            if columns:
                samples[f"{sensor}_AFTER"] = ("IMU", columns)
    return samples


def _plain(tables: Tables, message: str, fields: Names, number: int) -> Columns:
    """Those of one instance, at the stamps of the samples where these are logged."""
    logged = instance(having(tables, message, fields), "I", number)
    if not logged:
        return {}
    measured = dict(zip("xyz", (logged[field] for field in fields), strict=True))
    sampled = logged.get("SampleUS")
    time = logged["time"] if sampled is None else _on_clock(logged, sampled)
    return {"time": time, "boot": logged["boot"], **measured}


def _on_clock(logged: Columns, sampled: Array) -> Array:
    """(N,) stamps of samples, µs, on the boot clock of their messages."""
    late = logged.get("TimeUS", sampled).astype(np.float64) - sampled.astype(np.float64)
    return logged["time"] - late / 1e6


def _batches(tables: Tables, sensor: str, number: int) -> Columns:
    """The samples of all whole batches of an instance."""
    fields = ("N", "type", "instance", "mul", "smp_cnt", "smp_rate", "SampleUS")
    header = having(tables, "ISBH", fields)
    data = having(tables, "ISBD", ("N", "seqno", *"xyz"))
    if not header or not data or any(data[axis].ndim != 2 for axis in "xyz"):
        return {}
    batches = []
    rows_of = rows_by_value(data["N"].astype(np.int64))
    start = _on_clock(header, header["SampleUS"])
    own = (header["type"] == BATCH_TYPES.index(sensor)) & (header["instance"] == number)
    for row in np.flatnonzero(own & (header["mul"] > 0) & (header["smp_rate"] > 0)):
        rows = rows_of.get(int(header["N"][row]), np.zeros(0, np.intp))
        rows = rows[np.argsort(data["seqno"][rows], kind="stable")]
        samples = {axis: data[axis][rows].ravel() / float(header["mul"][row]) for axis in "xyz"}
        steps = np.arange(len(samples["x"]))
        if len(steps) == header["smp_cnt"][row]:
            time = start[row] + steps / float(header["smp_rate"][row])
            boot = np.full(len(steps), header["boot"][row])
            batches.append({"time": time, "boot": boot, **samples})
    return concatenated_columns(batches) if batches else {}
