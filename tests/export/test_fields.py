"""Any field of a log: its messages, fields and instances, and the samples of one of them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pymavlink
from pytest import fixture, mark, raises

from mavdem.export.fields import (
    UNSET_VALUES,
    FieldSamples,
    extremes_of_intervals,
    field_samples,
    numeric_messages,
)
from mavdem.ingest.telemetry import Telemetry


@fixture
def telemetry():
    """Two ESCs at 2 Hz that report by turns, a quaternion of two boots, and a text without numbers."""
    time = np.array([1.0, 1.0, 1.5, 1.5])
    escs = {
        "time": time,
        "boot": np.zeros(4, int),
        "Instance": np.array([0, 1, 0, 1], np.uint8),
        "RPM": np.array([100, 200, 110, np.nan]),
    }
    attitude = {
        "time": np.array([5.0, 0.2]),
        "boot": np.array([0, 1]),
        "q": np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0]]),
    }
    text = {
        "time": np.array([1.0]),
        "boot": np.array([0]),
        "text": np.array(["armed"], dtype=object),
    }
    return Telemetry(
        system=1,
        component=1,
        vehicle="QUADROTOR",
        autopilot="ARDUPILOTMEGA",
        messages={"ESC": escs, "ATTITUDE_QUATERNION": attitude, "STATUSTEXT": text},
        source_names={"ATTITUDE_QUATERNION": "ATT/AHR2"},
    )


def test_messages_are_listed_with_numeric_fields_and_instances(telemetry):
    attitude, escs = numeric_messages(telemetry)
    assert attitude.fields == ("q[0]", "q[1]", "q[2]", "q[3]")
    assert attitude.units == ("",) * 4
    assert attitude.instances == () and attitude.name_in_source == "ATT/AHR2"
    assert escs.fields == ("Instance", "RPM") and escs.instances == (0, 1)
    assert (escs.messages, escs.rate, escs.first_time, escs.last_time) == (4, 2, 1, 1.5)


@mark.parametrize("name", ["I", "IMU", "Inst", "Instance", "C"])
def test_dataflash_numbers_instances_by_fields_of_several_names(telemetry, name):
    """VIBE has IMU, BAT has Inst or Instance, XKF1 has C, and most others have I."""
    columns = dict(telemetry.messages["ESC"])
    columns[name] = columns.pop("Instance")
    (escs,) = numeric_messages(replace(telemetry, messages={"ESC": columns}))
    assert escs.instances == (0, 1)


def test_samples_are_those_of_one_instance_and_boot(telemetry):
    first_esc = field_samples(telemetry, "ESC", "RPM", instance=0)
    np.testing.assert_array_equal(first_esc.time, [1, 1.5])
    np.testing.assert_array_equal(first_esc.values, [100, 110])
    after_reboot = field_samples(telemetry, "AHR2", "q[1]", boot=1)
    assert (after_reboot.time.tolist(), after_reboot.values.tolist()) == ([0.2], [1.0])


def test_samples_ascend_in_time_where_messages_came_late(telemetry):
    late = dict(telemetry.messages["ESC"])
    late["time"] = np.array([1.0, 3.0, 2.0, 2.0])
    late["RPM"] = np.array([100, 200, 110, 120])
    samples = field_samples(replace(telemetry, messages={"ESC": late}), "ESC", "RPM")
    assert samples.time.tolist() == [1, 2, 2, 3]
    assert samples.values.tolist() == [100, 110, 120, 200]
    thinned = extremes_of_intervals(samples, 1)
    assert thinned.time.tolist() == [1, 3] and thinned.values.tolist() == [100, 200]


def test_no_other_message_is_read_for_one_by_its_name_in_the_log(telemetry):
    """AHR2 is the name in the log of ATTITUDE_QUATERNION.

    Only that message may be read, and none for a name that does not exist.
    """

    class CountedMessages(Mapping):
        """Messages that note which of them were read."""

        names_of_read = []

        def __getitem__(self, name):
            self.names_of_read.append(name)
            return telemetry.messages[name]

        def __contains__(self, name):
            return name in telemetry.messages

        def __iter__(self):
            return iter(telemetry.messages)

        def __len__(self):
            return len(telemetry.messages)

    counted = replace(telemetry, messages=CountedMessages())
    field_samples(counted, "AHR2", "q[0]")
    with raises(ValueError, match="the log has no NONE"):
        field_samples(counted, "NONE", "q[0]")
    assert CountedMessages.names_of_read == ["ATTITUDE_QUATERNION"]


def test_what_the_log_lacks_is_refused_with_what_it_has(telemetry):
    with raises(ValueError, match="the log has no GPS: it has ATTITUDE_QUATERNION, ESC"):
        field_samples(telemetry, "GPS", "Alt")
    with raises(ValueError, match="ESC has no field rpm: it has Instance, RPM"):
        field_samples(telemetry, "ESC", "rpm")
    with raises(ValueError, match="ESC has no instance 7: there is 0, 1"):
        field_samples(telemetry, "ESC", "RPM", instance=7)


def test_unset_values_are_gaps(telemetry):
    # Of a battery with one cell reported, as MAVLink's definition marks the cells that are not there.
    columns = {
        "time": np.array([1.0, 2.0]),
        "boot": np.zeros(2, int),
        "voltages": np.array([[3700, 65535], [3600, 65535]], np.uint16),
        "current_battery": np.array([-1, 200], np.int16),
    }
    telemetry = replace(telemetry, messages={"BATTERY_STATUS": columns})
    assert field_samples(telemetry, "BATTERY_STATUS", "voltages[0]").values.tolist() == [3700, 3600]
    assert np.isnan(field_samples(telemetry, "BATTERY_STATUS", "voltages[1]").values).all()
    current = field_samples(telemetry, "BATTERY_STATUS", "current_battery").values
    assert np.isnan(current[0]) and current[1] == 200


def test_no_peak_is_lost_when_samples_are_thinned():
    time = np.linspace(0, 10, 1001)
    values = np.sin(time)
    values[[137, 613]] = 7, -5
    values[500] = np.nan
    thinned = extremes_of_intervals(FieldSamples(time, values), 20)
    assert len(thinned.time) <= 40 and (np.diff(thinned.time) > 0).all()
    assert {(time[137], 7.0), (time[613], -5.0)} <= set(zip(*thinned, strict=True))
    assert not len(extremes_of_intervals(FieldSamples(time[:1], values[500:501]), 20).time)


@mark.slow
def test_unset_values_are_those_of_the_definition_of_mavlink():
    """Pymavlink's modules leave the attribute out, its copies of the definitions have it."""
    limits = {"UINT8_MAX": 2**8 - 1, "INT16_MAX": 2**15 - 1, "UINT16_MAX": 2**16 - 1}
    invalid = {}
    folder = Path(pymavlink.__file__).parent / "dialects" / "v20"
    # Common.xml includes standard.xml.
    for name in ("common.xml", "standard.xml"):
        for message in ElementTree.parse(folder / name).iter("message"):
            for field in message.iter("field"):
                text = field.get("invalid", "").strip("[]")
                if text:
                    invalid[message.get("name"), field.get("name")] = limits.get(text, text)
    checked = UNSET_VALUES.keys() & invalid.keys()
    assert all(int(invalid[name]) == UNSET_VALUES[name] for name in checked)
    # Where the attribute is missing, the text of the field says it.
    said_in_words = {message for message, _ in UNSET_VALUES.keys() - checked}
    assert said_in_words == {"RC_CHANNELS", "RC_CHANNELS_RAW"}


def test_fields_have_the_units_of_mavlinks_definition(telemetry):
    columns = {"time": np.zeros(1), "boot": np.zeros(1, int), "roll": np.ones(1), "own": np.ones(1)}
    columns["rollspeed"] = np.ones((1, 2))
    (message,) = numeric_messages(replace(telemetry, messages={"ATTITUDE": columns}))
    units = dict(zip(message.fields, message.units, strict=True))
    assert units == {"roll": "rad", "own": "", "rollspeed[0]": "rad/s", "rollspeed[1]": "rad/s"}
