"""The table of all instances: each is named, with its range in flight and its state."""

from dataclasses import replace

import dataflash_logs as made
import numpy as np
from hover import Hover, changed, columns, evidence_of, pulses, with_pulses
from instrumented import instrumented
from pytest import approx, mark

from mavdem.assessment.instances import Instance, list_instances
from mavdem.assessment.lights.estimator import estimator_light
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.instances import InstanceState
from mavdem.facts.vibration import VibrationLight
from mavdem.ingest import read_log
from mavdem.ingest.px4_instances import further_sensors
from mavdem.ingest.vocabulary import (
    ACCELEROMETERS_MESSAGE,
    IN_AIR,
    INSTANCES_MESSAGE,
    ON_GROUND,
    EstimatorRatio,
)
from mavdem.report.instances import instance_table
from mavdem.witnesses import sensor_trust
from mavdem.witnesses.sensors import barometer_altitude

HOVER = Hover()
TIME = HOVER.stamps(5.0)


def by_name(telemetry):
    return {instance.name: instance for instance in list_instances(evidence_of(Signals(telemetry)))}


def with_sensors():
    """Returns the hover with two GPS receivers, one without a fix, two barometers, a compass and speed controllers."""
    parameters = {"BARO_PRIMARY": 1.0, "COMPASS_USE": 0.0}
    telemetry = HOVER.telemetry(20.0, 20.0, parameters=parameters)
    for message, fix_type, satellites in (("GPS_RAW_INT", 3, 12), ("GPS2_RAW", 1, 2)):
        receiver = {"fix_type": fix_type, "satellites_visible": satellites}
        fields = {name: np.full(len(TIME), value) for name, value in receiver.items()}
        telemetry = changed(telemetry, message, **columns(TIME, **fields))
    for message, offset in (("SCALED_PRESSURE", 0.0), ("SCALED_PRESSURE2", 100.0)):
        altitude = columns(TIME, altitude=offset + np.sin(TIME))
        telemetry = changed(telemetry, message, **altitude)
    telemetry = changed(
        telemetry,
        "SCALED_IMU",
        **columns(TIME, xmag=300 + TIME, ymag=0 * TIME, zmag=400 + 0 * TIME),
    )
    controllers = columns(
        np.repeat(TIME, 2),
        Instance=np.tile([0, 1], len(TIME)),
        RPM=np.column_stack([5000 + TIME, 0 * TIME]).ravel(),
    )
    return changed(telemetry, "ESC", **controllers)


@mark.slow
def test_every_instance_has_its_range_and_state():
    instances = by_name(with_sensors())
    assert (instances["GPS 1"].high, instances["GPS 1"].state.level) == (12, "good")
    assert "No fix for 100 %" in str(instances["GPS 2"].state)
    assert instances["barometer 2"].high == approx(101, abs=0.1)
    assert [instances[f"barometer {n}"].used_share for n in (1, 2)] == [0.0, 1.0]
    assert instances["compass 1"].used_share == 0.0
    assert instances["ESC 1 (motor 1)"].low > 5000
    assert (instances["ESC 2 (motor 2)"].high, instances["ESC 2 (motor 2)"].state.level) == (
        0,
        "unknown",
    )
    assert instances["output 1 (motor 1)"].unit == "µs"


def test_outputs_in_flight_are_those_that_carry_the_vehicle():
    """Its autopilot reports it off the ground while the motors are still off."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    outputs = pulses(telemetry)
    take_off = time[(outputs > 1300).all(axis=0)].min()
    is_early = time < take_off - 2.0
    landed = np.where(is_early, ON_GROUND, IN_AIR)
    telemetry = changed(telemetry, "EXTENDED_SYS_STATE", **columns(time, landed_state=landed))
    spun_up = np.where(is_early | (time >= take_off), outputs, 1000.0)
    (output, *_) = [
        instance
        for instance in list_instances(evidence_of(Signals(with_pulses(telemetry, spun_up))))
        if instance.kind == "output"
    ]
    assert output.low > 1200


def test_a_receiver_that_does_not_count_satellites_has_the_type_of_its_fix():
    unknown = columns(TIME, fix_type=3, satellites_visible=255)
    receiver = by_name(changed(with_sensors(), "GPS_RAW_INT", **unknown))["GPS 1"]
    assert (receiver.quantity, receiver.high) == ("fix type", 3)


def test_the_first_compass_of_a_stream_of_ardupilot_is_in_raw_imu():
    telemetry = HOVER.telemetry(20.0, 20.0)
    for message, strength in (("RAW_IMU", 400.0), ("SCALED_IMU2", 500.0)):
        field = columns(TIME, xmag=strength, ymag=0.0, zmag=0.0)
        telemetry = changed(telemetry, message, **field)
    instances = by_name(telemetry)
    assert (instances["compass 1"].high, instances["compass 2"].high) == (400.0, 500.0)


def test_the_share_of_an_estimator_counts_the_flight_alone():
    in_flight = evidence_of(Signals(HOVER.telemetry(20.0, 20.0))).flights(0)
    is_flying = in_intervals(TIME, in_flight)
    assert 0 < np.count_nonzero(is_flying) < len(TIME)
    ratios = dict.fromkeys(EstimatorRatio, 0.1)
    cores = columns(
        np.repeat(TIME, 2),
        instance=np.tile([0, 1], len(TIME)),
        is_primary=np.column_stack([~is_flying, is_flying]).ravel(),
        **ratios,
    )
    instances = by_name(changed(HOVER.telemetry(20.0, 20.0), INSTANCES_MESSAGE, **cores))
    assert (instances["EKF core 0"].used_share, instances["EKF core 1"].used_share) == (0.0, 1.0)


@mark.slow
def test_the_table_has_a_row_for_each_instance():
    instances = list_instances(evidence_of(Signals(with_sensors())))
    table = instance_table(instances, Fact(VibrationLight.VIBRATION_UNKNOWN), has_flown=True)
    assert [row[0] for row in table.rows] == [instance.name for instance in instances]
    rows = {row[0]: row for row in table.rows}
    assert rows["barometer 1"][1] == "no" and rows["barometer 2"][1] == "yes"
    assert rows["barometer 2"][3].replace("\N{NO-BREAK SPACE}", " ") == "99.0 to 101 m"
    assert rows["GPS 2"][4].level == "watch"


def test_the_row_of_an_imu_warns_as_the_light_of_the_vibration_does():
    measured = Fact(InstanceState.MEASURED)
    imus = [Instance("IMU", f"IMU {n}", "vibration", "m/s²", 5.0, 25.0, measured) for n in (1, 2)]
    light = Fact(VibrationLight.VIBRATION_MEASURED, Level.BAD, subject="IMU 1")
    first, second = instance_table(imus, light, has_flown=True).rows
    assert (first[4], first[4].level, second[4]) == ("Bad: see vibration", "bad", "Measured")


@mark.slow
def test_the_row_of_an_imu_warns_of_its_clips():
    """The first IMU clips in two periods, and the second in one of them."""
    levels = {f"vibration_{axis}": np.sin(TIME) ** 2 for axis in "xyz"}
    counts = 7 * (TIME > 30.0) + 5 * (TIME > 40.0)
    clipped = columns(TIME, **levels, clipping_0=counts, clipping_1=counts > 9, clipping_2=0)
    telemetry = changed(HOVER.telemetry(20.0, 20.0), "VIBRATION", **clipped)
    clips = [
        Fact(MotionEvent.CLIPPED, time=start, end_time=start + 1.0, count=count, boot=0)
        for start, count in ((30.0, 7), (40.0, 5))
    ]
    evidence = replace(evidence_of(Signals(telemetry)), events=tuple(clips))
    states = {instance.name: instance.state for instance in list_instances(evidence)}
    assert states["IMU 1"].sentence == "Clipped 12 times from 30.0 to 41.0 s."
    assert states["IMU 1"].level == "watch"


def test_ranges_of_a_log_without_flight_are_not_called_ranges_in_flight():
    instances = list_instances(evidence_of(Signals(with_sensors())))
    unknown = Fact(VibrationLight.VIBRATION_UNKNOWN)
    assert "range in flight" in instance_table(instances, unknown, has_flown=True).header
    assert "range" in instance_table(instances, unknown, has_flown=False).header


@mark.slow
def test_further_sensors_of_a_dataflash_log_have_messages_of_their_own(tmp_path, monkeypatch):
    """Second sensors are numbered by an instance (GPS, BARO), or are in messages of their own (MAG2, ESC2)."""
    definitions = {
        "GPS": (170, "QBBBfLL", "TimeUS,I,Status,NSats,HDop,Lat,Lng"),
        "BARO": (171, "QBf", "TimeUS,I,Alt"),
        "MAG": (172, "Qhhh", "TimeUS,MagX,MagY,MagZ"),
        "MAG2": (173, "Qhhh", "TimeUS,MagX,MagY,MagZ"),
        "ESC1": (174, "Qi", "TimeUS,RPM"),
        "ESC2": (175, "Qi", "TimeUS,RPM"),
    }
    for name, definition in definitions.items():
        monkeypatch.setitem(made.MESSAGES, name, definition)
    rows = made.flight([20 + 0.1 * row for row in range(100)])
    for second in range(20, 30):
        stamp = 1_000_000 * second
        for instance in (0, 1):
            rows.append(made.message("GPS", stamp, instance, 3, 10 + instance, 0.8, 0, 0))
            rows.append(made.message("BARO", stamp, instance, 5.0 + instance))
        rows.append(made.message("MAG", stamp, 100, 0, 0))
        rows.append(made.message("MAG2", stamp, 200, 0, 0))
        rows.append(made.message("ESC1", stamp, 5000))
        rows.append(made.message("ESC2", stamp, 6000))
    path = tmp_path / "flight.bin"
    path.write_bytes(made.log(*rows))
    messages = read_log(path).vehicles[0].messages
    assert set(messages["GPS_RAW_INT"]["satellites_visible"].tolist()) == {10}
    assert set(messages["GPS2_RAW"]["satellites_visible"].tolist()) == {11}
    assert set(messages["SCALED_PRESSURE2"]["altitude"].tolist()) == {6.0}
    assert set(messages["SCALED_IMU"]["xmag"].tolist()) == {100}
    assert set(messages["SCALED_IMU2"]["xmag"].tolist()) == {200}
    speeds = messages["ESC"]
    assert set(speeds["RPM"][speeds["Instance"] == 1].tolist()) == {6000}


def test_further_sensors_of_px4_are_instances_of_a_topic():
    makers = further_sensors()
    topic = {"time": np.arange(3.0), "altitude": np.full(3, 7.0)}
    name, maker = makers["SCALED_PRESSURE2"]
    assert name == "sensor_baro"
    assert maker({"sensor_baro": {0: topic, 1: topic}})["altitude"].tolist() == [7, 7, 7]


def with_accelerometers(parameters=None, gravities=(9.8, 9.0, 8.0)):
    """Three IMUs that measure this force at rest, m/s²."""
    telemetry = instrumented()
    telemetry = replace(telemetry, parameters={**telemetry.parameters, **(parameters or {})})
    time = telemetry.messages["HIGHRES_IMU"]["time"]
    first, second, third = gravities
    noise = 0.01 * np.random.default_rng(4).standard_normal(len(time))
    telemetry = changed(telemetry, "HIGHRES_IMU", zacc=noise - first)
    further = columns(
        np.repeat(time, 2),
        instance=np.tile([1, 2], len(time)),
        xacc=0.0,
        yacc=0.0,
        zacc=np.tile([-second, -third], len(time)),
    )
    return changed(telemetry, ACCELEROMETERS_MESSAGE, **further)


@mark.slow
def test_a_spare_accelerometer_that_is_wrong_is_to_be_watched_unless_it_is_not_used():
    telemetry = with_accelerometers({"INS_USE3": 0.0, "EK3_IMU_MASK": 7.0})
    instances = by_name(telemetry)
    levels = [instances[f"IMU {number}"].state.level for number in (1, 2, 3)]
    assert levels == ["good", "watch", "unknown"]
    light = estimator_light(evidence_of(Signals(telemetry)))
    assert (light.subject, light.figures["is_spare"]) == ("IMU 2", True)
    assert "of IMU 2, a spare one, measured 9.0" in light.sentence


@mark.slow
def test_a_spare_accelerometer_without_a_core_of_the_estimator_is_in_the_table_alone():
    telemetry = with_accelerometers()
    assert by_name(telemetry)["IMU 2"].state.level == "watch"
    assert estimator_light(evidence_of(Signals(telemetry))).code is not (
        EstimatorLight.ACCELEROMETER_WRONG
    )


@mark.slow
def test_the_accelerometer_of_the_primary_core_counts():
    telemetry = with_accelerometers({"EK3_IMU_MASK": 6.0})
    telemetry = changed(
        telemetry, "estimator_selector_status", **columns([0.0, 1.0], primary_instance=1)
    )
    trust = sensor_trust(Signals(telemetry), 0)
    assert trust.accelerometer.name == "IMU 3"
    assert trust.is_accelerometer_sound is False
    assert by_name(telemetry)["IMU 3"].used_share == 1.0


def test_the_imus_of_a_stream_are_messages_of_their_own():
    """A telemetry log has two IMUs in RAW_IMU and SCALED_IMU2, of which the second measures too little gravity."""
    telemetry = instrumented()
    time = telemetry.messages["HIGHRES_IMU"]["time"]
    for message, gravity in (("RAW_IMU", 1000.0), ("SCALED_IMU2", 900.0)):
        force = columns(time, xacc=0.0, yacc=0.0, zacc=-gravity)
        telemetry = changed(telemetry, message, **force)
    messages = dict(telemetry.messages)
    del messages["HIGHRES_IMU"]
    telemetry = replace(telemetry, messages=messages)
    trust = sensor_trust(Signals(telemetry), 0)
    gravities = {
        accelerometer.name: accelerometer.gravity_at_rest for accelerometer in trust.accelerometers
    }
    assert gravities == approx({"IMU 1": 9.81, "IMU 2": 8.83}, abs=0.01)


def test_a_barometer_that_differs_from_the_used_one_in_flight_is_to_be_watched():
    telemetry = with_sensors()
    altitude = 100.0 + np.sin(TIME) + 9.0 * (TIME > 30.0)
    telemetry = changed(telemetry, "SCALED_PRESSURE2", altitude=altitude)
    differing = by_name(telemetry)["barometer 1"].state
    assert (differing.level, differing.figures["name"]) == ("watch", "barometer 2")


@mark.slow
def test_a_compass_that_is_not_used_is_not_judged_and_a_used_one_is_named():
    telemetry = HOVER.telemetry(20.0, 20.0, parameters={"COMPASS_USE": 0.0})
    is_flying = (TIME > 8.0) & (TIME < 60.0)
    for message in ("RAW_IMU", "SCALED_IMU2"):
        disturbed = columns(TIME, xmag=np.where(is_flying, 600.0, 400.0), ymag=1.0, zmag=1.0)
        telemetry = changed(telemetry, message, **disturbed)
    light = estimator_light(evidence_of(Signals(telemetry)))
    assert (light.code, light.subject) == (EstimatorLight.COMPASS_DISTURBED, "compass 2")
    assert light.sentence.startswith("The field of compass 2 is 50 % stronger in flight")


def test_the_barometer_that_is_used_counts_and_one_that_stands_still_gives_way():
    telemetry = instrumented()
    pressure = telemetry.messages["SCALED_PRESSURE"]
    second = columns(pressure["time"], altitude=2 * pressure["altitude"])
    telemetry = changed(telemetry, "SCALED_PRESSURE2", **second)
    telemetry = replace(telemetry, parameters={**telemetry.parameters, "BARO_PRIMARY": 1.0})
    used = barometer_altitude(Signals(telemetry))
    assert used.values.max() == approx(260, abs=1)
    dead = changed(telemetry, "SCALED_PRESSURE2", altitude=7.0)
    assert barometer_altitude(Signals(dead)).values.max() == approx(130, abs=1)
