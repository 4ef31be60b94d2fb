"""Raw samples of gyro and accelerometer: batches, samples without gaps, PX4's FIFO, and the motors' speeds."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx

from mavdem.ingest.dataflash.samples import raw_samples
from mavdem.ingest.px4_translation import messages_of_topics

IDS = {"INS_GYR_ID": 1.0, "INS_GYR2_ID": 2.0, "INS_ACC_ID": 3.0}


def batches(instance, first=0):
    """Returns two complete batches of 64 gyro samples at 1 kHz, in blocks out of order, and half of a third batch."""
    number = first + np.array([0, 1, 2])
    header = {
        "TimeUS": 1e6 * number + 2e5,
        "time": number + 0.2,
        "boot": np.zeros(3, int),
        "N": number,
        "type": np.ones(3),
        "instance": np.full(3, instance),
        "mul": np.full(3, 100.0),
        "smp_cnt": np.full(3, 64),
        "SampleUS": 1e6 * number,
        "smp_rate": np.full(3, 1000.0),
    }
    values = np.arange(5 * 32).reshape(5, 32)[[1, 0, 2, 3, 4]]
    data = {"N": first + np.array([0, 0, 1, 1, 2]), "seqno": np.array([1, 0, 0, 1, 0])}
    return header, {**data, "time": data["N"], **dict.fromkeys("xyz", values)}


def test_whole_batches_are_samples_before_the_filters_and_behind_them():
    """The parameter INS_LOG_BAT_OPT says whether ArduPilot logged raw or filtered samples, or both by turns."""
    (header, data), (more, other) = batches(0), batches(2, first=10)
    tables = {
        "ISBH": {name: np.append(header[name], more[name]) for name in header},
        "ISBD": {name: np.concatenate([data[name], other[name]]) for name in data},
    }
    samples_by_message = raw_samples(tables, {**IDS, "INS_LOG_BAT_OPT": 4.0})
    assert {name: sample_columns[0] for name, sample_columns in samples_by_message.items()} == {
        "GYRO_BEFORE": "ISBH",
        "GYRO_AFTER": "ISBH",
    }
    columns = samples_by_message["GYRO_BEFORE"][1]
    assert_allclose(columns["x"], np.arange(128) / 100)
    assert_allclose(columns["time"][[0, 1, 64]], [0.0, 0.001, 1.0])
    assert samples_by_message["GYRO_AFTER"][1]["time"][0] == 10.0
    assert [*raw_samples(tables, {**IDS, "INS_LOG_BAT_OPT": 2.0})] == ["GYRO_AFTER"]


def test_samples_without_gaps_have_their_own_stamps_and_imu_is_behind_the_filters():
    time = np.arange(10) / 10
    axes = dict.fromkeys(("GyrX", "GyrY", "GyrZ"), time)
    stamps = {"time": time, "boot": np.zeros(10, int), "I": np.zeros(10)}
    raw = {**stamps, **axes, "TimeUS": 1e6 * time, "SampleUS": 1e6 * time - 2000}
    samples_by_message = raw_samples({"GYR": raw, "IMU": {**stamps, **axes}}, IDS)
    assert [samples_by_message[name][0] for name in ("GYRO_BEFORE", "GYRO_AFTER")] == ["GYR", "IMU"]
    assert_allclose(samples_by_message["GYRO_BEFORE"][1]["time"], time - 0.002)


def test_px4s_fifo_holds_several_samples_and_escs_report_speeds():
    """Each message of the gyro's FIFO has several samples, the last of which has its time stamp."""
    time = np.array([1.0, 1.004])
    fifo = {
        "time": time,
        "timestamp": 1e6 * time,
        "timestamp_sample": 1e6 * time - 500,
        "dt": np.full(2, 125.0),
        "scale": np.full(2, 0.001),
        "samples": np.array([4, 2]),
        **{f"{axis}[{n}]": np.array([n, n + 100]) for axis in "xyz" for n in range(32)},
    }
    speeds = {"time": time, **{f"esc[{n}].esc_rpm": np.full(2, 6000 + n) for n in range(4)}}
    level = ("q[0]", "q[1]", "q[2]", "q[3]", "rollspeed", "pitchspeed", "yawspeed")
    attitude = {"vehicle_attitude": {0: {"time": time, **dict.fromkeys(level, np.ones(2))}}}
    _, messages, source_names = messages_of_topics(
        {"sensor_gyro_fifo": {0: fifo}, "esc_status": {0: speeds}, **attitude}, {}
    )
    samples = messages["GYRO_BEFORE"]
    assert source_names["GYRO_BEFORE"] == "sensor_gyro_fifo"
    assert_allclose(samples["x"], [0.0, 0.001, 0.002, 0.003, 0.1, 0.101])
    assert_allclose(samples["time"][:4], 0.9995 - 125e-6 * np.array([3, 2, 1, 0]))
    assert messages["ESC"]["RPM"][:4].tolist() == [6000, 6001, 6002, 6003]
    gyro = ("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]")
    combined = {"time": time, **dict.fromkeys(gyro, np.full(2, 0.1))}
    _, messages, source_names = messages_of_topics(
        {"sensor_combined": {0: combined}, **attitude}, {}
    )
    assert source_names["GYRO_BEFORE"] == "sensor_combined" and messages["GYRO_BEFORE"][
        "y"
    ] == approx(0.1)
