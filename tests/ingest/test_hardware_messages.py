"""Processor, receivers, temperatures, controllers and position targets of DataFlash and ULog, as MAVLink has them."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import mark

from mavdem.ingest.dataflash.translation import mavlink_messages
from mavdem.ingest.px4_motor_messages import motor_speeds
from mavdem.ingest.px4_translation import messages_of_topics

TIME = np.arange(20.0, 23.0)


def table(time=TIME, **fields):
    """Columns of one message or topic, each of one value or of one for each stamp."""
    columns = {"time": time, "boot": np.zeros(len(time), np.int64)}
    for name, values in fields.items():
        columns[name] = np.broadcast_to(np.asarray(values, float), len(time)).copy()
    return columns


def of_dataflash(**tables):
    """The messages that these DataFlash messages become."""
    messages, _, _ = mavlink_messages(tables, vehicle_type=2, parameters={})
    return messages


def test_dataflash_has_temperatures_and_the_load_of_the_main_loop():
    messages = of_dataflash(
        PM=table(NLon=3, Load=420, Mem=70_000),
        MCU=table(MTemp=41.5, MVolt=3.3),
        IMU=table(AccX=0, AccY=0, AccZ=-9.8, T=38),
        BARO=table(Alt=1, Temp=35.5),
    )
    assert messages["PM"]["Load"].tolist() == [420] * 3
    assert_allclose(messages["MCU_STATUS"]["MCU_temperature"], 4150)
    assert_allclose(messages["HIGHRES_IMU"]["temperature"], 38)
    assert_allclose(messages["SCALED_PRESSURE"]["temperature"], 3550)


def test_accuracy_and_noise_are_those_before_each_fix():
    fix = table(Status=3, NSats=12, HDop=0.8, Lat=47, Lng=8)
    accuracy = table(TIME[1:] - 0.1, HAcc=[0.9, 1.1], VAcc=2, SAcc=0.3)
    noise = table(Instance=0, noisePerMS=95, jamInd=[10, 20, 30])
    receiver = of_dataflash(GPS=fix, GPA=accuracy, UBX1=noise)["GPS_RAW_INT"]
    assert_allclose(receiver["h_acc"], [np.nan, 900, 1100])
    assert_allclose(receiver["vel_acc"][1:], 300)
    assert_allclose(receiver["jamming_indicator"], [10, 20, 30])


def test_position_targets_are_unknown_while_their_axis_is_not_controlled():
    controlled = table(TIME[1:], TPN=5, TVN=1)
    targets = of_dataflash(PSCD=table(TPD=-3, TVD=0), PSCN=controlled)["POSITION_TARGET_LOCAL_NED"]
    assert_allclose(targets["z"], -3)
    assert_allclose(targets["x"], [np.nan, 5, 5])
    assert "y" not in targets


def test_px4_has_the_same():
    """Topics of PX4 are translated to the messages and units that MAVLink has for the same hardware."""
    topics = {
        "vehicle_attitude": table(**{f"q[{n}]": float(n == 0) for n in range(4)}, rollspeed=0.0),
        "vehicle_acceleration": table(**{f"xyz[{n}]": 0.0 for n in range(3)}),
        "vehicle_imu_status": table(TIME[1:], temperature_accel=31),
        "vehicle_status": table(arming_state=2),
        "cpuload": table(load=0.6, ram_usage=0.5),
        "vehicle_gps_position": table(
            fix_type=3, satellites_used=14, lat=0, lon=0, eph=0.7, jamming_indicator=12
        ),
        "trajectory_setpoint": table(
            **{f"position[{n}]": n for n in range(3)},
            **{f"velocity[{n}]": np.nan for n in range(3)},
        ),
    }
    by_instance = {name: {0: columns} for name, columns in topics.items()}
    messages = messages_of_topics(by_instance, {}).messages
    assert_allclose(messages["cpuload"]["load"], 0.6)
    assert_allclose(messages["HIGHRES_IMU"]["temperature"], [np.nan, 31, 31])
    assert_allclose(messages["GPS_RAW_INT"]["h_acc"], 700)
    assert_allclose(messages["GPS_RAW_INT"]["jamming_indicator"], 12)
    assert_allclose(messages["POSITION_TARGET_LOCAL_NED"]["y"], 1)


def test_temperatures_of_dronecan_controllers_in_kelvin_become_celsius():
    topic = table(
        **{
            "esc[0].esc_rpm": 5000,
            "esc[0].esc_temperature": [293.15, 303.15, 313.15],
            "esc[0].esc_current": 4,
        }
    )
    speeds = motor_speeds({"esc_status": {0: topic}})
    assert_allclose(speeds["Temp"], [20, 30, 40])
    assert_allclose(speeds["Curr"], 4)


@mark.parametrize(
    "temperatures, celsius",
    [
        ([0.0, np.nan, 313.15], [np.nan, np.nan, 40.0]),
        ([50.0, 60.0, 3000.0], [50.0, 60.0, 3000.0]),
        ([-5.0, 0.0, 5.0], [-5.0, 0.0, 5.0]),
    ],
)
def test_a_controller_before_its_first_report_or_one_wrong_value_changes_no_unit(
    temperatures, celsius
):
    topic = table(**{"esc[0].esc_rpm": 5000, "esc[0].esc_temperature": temperatures})
    assert_allclose(motor_speeds({"esc_status": {0: topic}})["Temp"], celsius)
