"""Charts of the hardware: what the log has within the time shown, and nothing that stands for "not known"."""

import numpy as np
from hover import Hover, changed, columns, evidence_of
from numpy.testing import assert_allclose
from pytest import mark

from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.lights import Unjudged
from mavdem.facts.vibration import VibrationLight
from mavdem.report.charts.hardware_charts import (
    hardware_groups,
    raw_sensor_charts,
    vibration_charts,
)
from mavdem.report.charts.timeline import history_timeline
from mavdem.vibration.vibration_message import CLIPPING_FIELDS, LEVEL_FIELDS

HOVER = Hover()
TIME = HOVER.stamps(5.0)


def charts_by_title(telemetry):
    """The charts of the hardware of a vehicle by their titles, the parts that have charts, and the timeline."""
    evidence = evidence_of(Signals(telemetry))
    timeline = history_timeline(evidence.time_history)
    charts = {}
    parts = hardware_groups(evidence, timeline)
    for groups in parts.values():
        for group in groups:
            for column in group.columns:
                charts |= {chart.title: chart for chart in column}
    return charts, set(parts), timeline


@mark.slow
def test_speeds_compasses_and_reported_quantities_are_drawn_in_plain_units():
    """Raw values of ESCs, compass, battery and barometer are converted.

    Values that stand for unknown ones are left out.
    """
    telemetry = HOVER.telemetry(20.0, 20.0)
    controllers = columns(
        np.repeat(TIME, 2),
        Instance=np.tile([0, 1], len(TIME)),
        RPM=np.column_stack([5000 + TIME, 4000 + TIME]).ravel(),
        Curr=5.0,
    )
    telemetry = changed(telemetry, "ESC", **controllers)
    telemetry = changed(
        telemetry, "SCALED_IMU", **columns(TIME, xmag=300.0, ymag=0.0, zmag=400.0, temperature=0)
    )
    current = np.full(len(TIME), 1250)
    # The first values are not known.
    current[:20] = -1
    power = columns(TIME, current_battery=current, load=305)
    telemetry = changed(telemetry, "SYS_STATUS", **power)
    # At the freezing point: MAVLink has no value for a barometer temperature that is not known.
    pressure = columns(TIME, press_abs=1000.0, temperature=np.where(np.median(TIME) > TIME, 0, 100))
    telemetry = changed(telemetry, "SCALED_PRESSURE", **pressure)
    charts, _, timeline = charts_by_title(telemetry)
    speeds = charts["Motor speeds"].lines
    assert [line.name for line in speeds] == ["ESC 1", "ESC 2", "motors"]
    assert speeds[-1].is_on_right_axis
    np.testing.assert_allclose(charts["Currents of the motors"].lines[1].y, 5)
    compass, motors = charts["Magnetic field"].lines
    np.testing.assert_allclose(compass.y, 500)
    assert motors.is_on_right_axis
    np.testing.assert_allclose(charts["Battery current"].lines[0].y, 12.5)
    np.testing.assert_allclose(charts["Processor load"].lines[0].y, 30.5)
    # 0 throughout stands for an IMU temperature that is not known.
    (barometer,) = charts["Temperatures"].lines
    assert (barometer.name, set(barometer.y)) == ("barometer", {0, 1})
    assert charts["Motor speeds"].x.limits == timeline.span


@mark.slow
def test_setpoints_are_drawn_with_the_estimate_and_switches_beside_the_sticks():
    telemetry = HOVER.telemetry(20.0, 20.0)
    target = columns(TIME, x=1.0, y=np.nan, z=-2.0, vx=np.nan, vy=np.nan, vz=0.0)
    telemetry = changed(telemetry, "POSITION_TARGET_LOCAL_NED", **target)
    channels = {f"chan{number}_raw": 1500 + number for number in range(1, 7)}
    telemetry = changed(telemetry, "RC_CHANNELS", **columns(TIME, **channels))
    charts, _, _ = charts_by_title(telemetry)
    assert charts["Position north"].lines[0].name == "setpoint"
    assert "Position east" not in charts
    assert [line.name for line in charts["Sticks"].lines] == ["roll", "pitch", "throttle", "yaw"]
    assert {line.name for line in charts["Switches"].lines} == {"channel 5", "channel 6"}


def test_a_log_without_such_messages_has_charts_of_its_sampling_alone():
    telemetry = HOVER.telemetry(20.0, 20.0)
    message_names = {"ATTITUDE", "HEARTBEAT", "SERVO_OUTPUT_RAW"}
    for message in set(telemetry.messages) - message_names:
        telemetry = changed(telemetry, message, time=np.zeros(0), boot=np.zeros(0, int))
    _, parts, _ = charts_by_title(telemetry)
    assert parts == {"recording"}


def test_vibration_and_clips_are_drawn_with_the_limits_of_a_light_that_judged_them():
    fields = dict.fromkeys(LEVEL_FIELDS, 5.0) | dict.fromkeys(CLIPPING_FIELDS, 0)
    # The first IMU clips three times a second apart, the others never.
    fields["clipping_0"] = np.searchsorted((20.0, 21.0, 22.0), TIME)
    telemetry = changed(HOVER.telemetry(20.0, 20.0), "VIBRATION", **columns(TIME, **fields))
    evidence = evidence_of(Signals(telemetry))
    timeline = history_timeline(evidence.time_history)
    judged = Fact(VibrationLight.VIBRATION_MEASURED, Level.WATCH)
    vibration, clips = vibration_charts(evidence, timeline, judged)
    names = [line.name for line in vibration.lines]
    assert names == ["x", "y", "z", "watch above 15", "bad above 30"]
    counted, limit = clips.lines
    assert counted.name == "IMU 1" and counted.y[-1] == 3 and limit.name == "bad above 100"
    unjudged = Fact(Unjudged.MULTIROTORS_ONLY)
    assert len(vibration_charts(evidence, timeline, unjudged)[0].lines) == 3


@mark.slow
def test_raw_acceleration_and_angular_rate_are_those_of_the_fastest_message_in_degrees():
    times = HOVER.stamps(50.0)
    fast = columns(times, x=np.full(len(times), 0.1), y=0.0, z=0.0)
    slow = columns(TIME, xgyro=1.0, ygyro=1.0, zgyro=1.0, xacc=0.0, yacc=0.0, zacc=-9.8)
    telemetry = changed(HOVER.telemetry(20.0, 20.0), "GYRO_BEFORE", **fast)
    telemetry = changed(telemetry, "HIGHRES_IMU", **slow)
    evidence = evidence_of(Signals(telemetry))
    timeline = history_timeline(evidence.time_history)
    axes = {"accelerometer": ("forward", "right", "down"), "gyro": ("roll", "pitch", "yaw")}
    acceleration, rate = raw_sensor_charts(evidence, timeline, axes)
    assert [line.name for line in acceleration.lines] == ["forward", "right", "down"]
    assert_allclose(acceleration.lines[2].y, -9.8)
    assert_allclose(rate.lines[0].y, np.degrees(0.1))
