"""All messages of a log under its own names, beyond those that mavdem translates."""

import dataflash_logs
import numpy as np
import ulog_files
from pytest import mark

from mavdem.ingest import read_log
from mavdem.ingest.all_messages import with_all_messages


def all_messages_of(content, path):
    """The messages of the vehicle of a log with this content."""
    path.write_bytes(content)
    (vehicle,) = read_log(path).vehicles
    return with_all_messages(vehicle, path).messages


def test_a_dataflash_log_has_all_its_messages_under_its_own_names(tmp_path):
    times = 20 + 0.1 * np.arange(50)
    barometer = dataflash_logs.message("BARO", 22_000_000, 1, 3.5, 1e5)
    content = dataflash_logs.log(*dataflash_logs.flight(times), barometer)
    messages = all_messages_of(content, tmp_path / "flight.bin")
    assert {"ATT", "RATE", "RCOU", "BARO", "PARM"} <= set(messages)
    np.testing.assert_allclose(messages["ATT"]["Roll"][:3], [2, 4, 6])
    np.testing.assert_allclose(messages["ATT"]["time"], times)
    assert messages["BARO"]["I"].tolist() == [1]
    assert messages["BARO"]["Alt"].tolist() == [3.5]


@mark.slow
def test_a_ulog_has_all_its_topics_with_instances_in_order_of_time(tmp_path):
    second_battery = ulog_files.subscription("battery_status", instance=1)
    batteries = [
        ulog_files.data("battery_status", 21.0, 12.0, 11.9),
        ulog_files.data("battery_status", 21.5, 10.0, 9.9, instance=1),
        ulog_files.data("battery_status", 22.0, 11.0, 10.9),
    ]
    content = ulog_files.log(second_battery, *ulog_files.flight(ulog_files.TIMES), *batteries)
    messages = all_messages_of(content, tmp_path / "flight.ulg")
    np.testing.assert_allclose(messages["cpuload"]["load"], 0.5)
    np.testing.assert_allclose(messages["battery_status"]["time"], [21, 21.5, 22])
    assert messages["battery_status"]["instance"].tolist() == [0, 1, 0]
    np.testing.assert_allclose(messages["battery_status"]["voltage_filtered_v"], [11.9, 9.9, 10.9])
