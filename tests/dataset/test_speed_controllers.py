"""Speed controllers: the same speeds and errors, from the messages of each autopilot and each kind of log."""

import numpy as np
from hover import Hover, changed, columns
from pytest import approx

from mavdem.dataset.signals import Signals
from mavdem.dataset.speed_controllers import speed_controllers
from mavdem.ingest.motors import ChannelSource, MotorGeometry
from mavdem.ingest.px4_motor_messages import motor_speeds

HOVER = Hover()
TIME = np.arange(0.0, 60.0, 0.2)
SPEEDS = np.column_stack([5000 + TIME, 5100 + TIME, 0 * TIME, 5300 + TIME])


def with_message(name, time=TIME, **fields):
    telemetry = HOVER.telemetry(10.0, 10.0)
    return changed(telemetry, name, **columns(time, **fields))


def highest_speeds(telemetry):
    return {
        controller.name: controller.speed.values.max()
        for controller in speed_controllers(Signals(telemetry))
    }


def test_dataflash_has_a_row_for_each_controller():
    telemetry = with_message(
        "ESC",
        np.repeat(TIME, 4),
        Instance=np.tile(np.arange(4), len(TIME)),
        RPM=SPEEDS.ravel(),
        Err=np.tile([0.0, 2.0, 0.0, 0.0], len(TIME)),
    )
    assert highest_speeds(telemetry)["ESC 2"] == approx(5160, abs=1)
    second = speed_controllers(Signals(telemetry))[1]
    assert second.error_share.values.max() == approx(0.02)


def test_the_status_of_px4_has_four_controllers_a_message_and_its_errors_another():
    index = np.tile([0, 4], len(TIME))
    both = np.repeat(TIME, 2)
    telemetry = with_message("ESC_STATUS", both, index=index, rpm=np.repeat(-SPEEDS, 2, axis=0))
    errors = np.repeat(np.outer(TIME, [0, 10, 0, 0]), 2, axis=0)
    information = columns(both, index=index, count=4, error_count=errors)
    telemetry = changed(telemetry, "ESC_INFO", **information)
    assert list(highest_speeds(telemetry)) == ["ESC 1", "ESC 2", "ESC 3", "ESC 4"]
    assert highest_speeds(telemetry)["ESC 4"] == approx(5360, abs=1)
    assert speed_controllers(Signals(telemetry))[1].error_count.values.max() == approx(598, abs=1)


def test_a_status_without_the_number_of_controllers_has_those_that_turn():
    telemetry = with_message("ESC_STATUS", index=0, rpm=SPEEDS)
    assert list(highest_speeds(telemetry)) == ["ESC 1", "ESC 2", "ESC 4"]


def test_a_controller_of_ardupilot_that_is_silent_has_no_speed_of_0():
    """From 40 s on, the message count of controller 6 stays the same, and its speed is logged as 0."""
    count = np.repeat(np.arange(len(TIME))[:, None], 4, axis=1)
    is_silent = TIME > 40.0
    count[is_silent, 1] = count[~is_silent, 1].max()
    speeds = np.where(is_silent[:, None] & (np.arange(4) == 1), 0.0, 5000.0)
    telemetry = with_message("ESC_TELEMETRY_5_TO_8", rpm=speeds, count=count)
    controllers = {
        controller.number: controller for controller in speed_controllers(Signals(telemetry))
    }
    assert list(controllers) == [5, 6, 7, 8]
    assert controllers[6].speed.time.max() == approx(40.0, abs=0.3)
    assert controllers[6].speed.values.min() == 5000


def test_px4_logs_up_to_eight_controllers_and_the_motor_of_each():
    """The flags of the log say that controllers 2 and 6 of eight are online."""
    topic = {
        "time": TIME,
        "esc_count": np.full(len(TIME), 6),
        "esc_online_flags": 0 * TIME + 0b100010,
    }
    for number in range(8):
        topic[f"esc[{number}].esc_rpm"] = -1000.0 * number + 0 * TIME
        topic[f"esc[{number}].esc_errorcount"] = number + 0 * TIME
        topic[f"esc[{number}].actuator_function"] = 106 - number + 0 * TIME
    logged = motor_speeds({"esc_status": {0: topic}})
    telemetry = with_message("ESC", **logged)
    controllers = speed_controllers(Signals(telemetry))
    assert [(controller.number, controller.motor) for controller in controllers] == [(2, 5), (6, 1)]
    assert highest_speeds(telemetry)["ESC 6"] == 5000


def test_a_controller_without_the_number_of_its_motor_has_that_of_its_output():
    geometry = MotorGeometry((1, 2), (6, 2), (), ChannelSource.SERVO_FUNCTIONS)
    telemetry = with_message("ESC_STATUS", index=0, rpm=SPEEDS)
    indices = {
        controller.number: controller.motor_index(geometry)
        for controller in speed_controllers(Signals(telemetry))
    }
    assert indices == {1: None, 2: 1, 4: None}
