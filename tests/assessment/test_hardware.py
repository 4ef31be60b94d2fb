"""Facts on the hardware: figures of the flight, and levels only where an autopilot's documentation has a limit."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed, columns, evidence_of
from pytest import approx, mark

from mavdem.assessment.hardware.calibration import calibration_fact, sensors_in_parameters
from mavdem.assessment.hardware.commands import command_facts
from mavdem.assessment.hardware.compasses import field_fact
from mavdem.assessment.hardware.controllers import controllers_fact
from mavdem.assessment.hardware.processor import processor_fact
from mavdem.assessment.hardware.receivers import receiver_fact
from mavdem.assessment.hardware.recording import recording_fact
from mavdem.assessment.hardware.temperatures import temperatures_fact
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.sources import Repair

HOVER = Hover()
TELEMETRY = HOVER.telemetry(20.0, 20.0)
TIME = HOVER.stamps(5.0)
HALF = np.arange(len(TIME)) < len(TIME) / 2


def evidence_with(message, parameters=None, autopilot="ARDUPILOTMEGA", **fields):
    """The evidence of a hover with one message replaced."""
    telemetry = changed(TELEMETRY, message, **columns(TIME, **fields))
    return evidence_of(
        Signals(replace(telemetry, parameters=parameters or {}, autopilot=autopilot))
    )


def test_controllers_are_judged_by_the_errors_that_they_count_alone():
    speeds = {"Instance": 0, "RPM": 5000.0, "Temp": np.where(HALF, 40.0, 60.0)}
    uncounted = controllers_fact(evidence_with("ESC", **speeds))
    assert (uncounted.level, uncounted.figures["temperature"]) == ("unknown", 60.0)
    assert controllers_fact(evidence_with("ESC", ErrorCount=7, **speeds)).level == "good"
    many_errors = controllers_fact(evidence_with("ESC", ErrorCount=20 * (TIME - TIME[0]), **speeds))
    assert (many_errors.level, many_errors.figures["current"]) == ("watch", None)


@mark.parametrize(
    "fields, doubts",
    [
        ({}, ()),
        ({"satellites_visible": 5}, ("number of satellites",)),
        ({"h_acc": 6000}, ("accuracy",)),
        # The accuracy is not known.
        ({"h_acc": 4_294_967_295}, ()),
        ({"jamming_indicator": 85, "eph": 300}, ("dilution", "jamming")),
        # For less than half, and for less than a twentieth of the flight.
        ({"satellites_visible": np.where(TIME - TIME[-1] > -20, 5, 14)}, ()),
        ({"jamming_indicator": np.where(TIME - TIME[-1] > -1, 90, 20)}, ()),
    ],
)
def test_a_receiver_is_doubted_by_what_the_filters_ask_for(fields, doubts):
    """The number of satellites, accuracy, dilution or jamming of a GPS receiver is beyond its limit."""
    usual = {"fix_type": 3, "satellites_visible": 14, "eph": 80, "h_acc": 900}
    fact = receiver_fact(evidence_with("GPS_RAW_INT", **usual | fields))
    assert fact.figures["doubts"] == doubts
    assert fact.level == ("watch" if doubts else "good")
    assert "for 95 % of the flight at least" in fact.sentence


@mark.parametrize("is_valid, level", [(True, "unknown"), (False, "watch")])
def test_a_receiver_without_fix_is_doubted_only_where_the_flight_needed_it(is_valid, level):
    """The estimator has a position from another source, such as external vision, or from none."""
    fields = {"fix_type": 0, "satellites_visible": 0, "eph": 9999, "noise_per_ms": 90}
    telemetry = changed(TELEMETRY, "GPS_RAW_INT", **columns(TIME, **fields))
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", valid=is_valid)
    fact = receiver_fact(evidence_of(Signals(telemetry)))
    assert (fact.level, bool(fact.remedy)) == (level, level == "watch")


@mark.parametrize("change, level", [(0.0, "good"), (0.4, "watch"), (-0.7, "bad")])
def test_a_field_is_judged_by_its_change_from_the_ground_to_the_flight(change, level):
    """The magnetic field changes with the throttle by a fraction of its size."""
    motors = TELEMETRY.messages["SERVO_OUTPUT_RAW"]
    command = np.mean([motors[f"servo{n}_raw"] for n in range(1, 5)], axis=0)
    # The throttle goes up and down, slowly against the averages of 2 s.
    swing = 50 * np.sin(2 * np.pi * motors["time"] / 20)
    pulses = {f"servo{n}_raw": motors[f"servo{n}_raw"] + swing for n in range(1, 5)}
    telemetry = changed(TELEMETRY, "SERVO_OUTPUT_RAW", **pulses)
    field = 500 * (1 + change * (command + swing - 1000) / 600) + np.cos(3 * motors["time"])
    telemetry = changed(
        telemetry, "SCALED_IMU", **columns(motors["time"], xmag=field, ymag=0.0, zmag=0.0)
    )
    fact = field_fact(evidence_of(Signals(telemetry)))
    assert fact.level == level
    assert fact.figures["change"] == approx(change, abs=0.08)
    if change:
        assert fact.figures["correlation"] * np.sign(change) > 0.95


def test_without_a_receiver_nothing_is_said_of_one():
    nothing = {"fix_type": 0, "satellites_visible": 0, "eph": 65535}
    assert receiver_fact(evidence_with("GPS_RAW_INT", **nothing)) is None
    jammed = receiver_fact(evidence_with("GPS_RAW_INT", noise_per_ms=90, **nothing))
    assert (jammed.level, jammed.figures["dilution"]) == ("watch", None)
    assert jammed.sentence.startswith("Usually no satellites; for 95 % of the flight noise")


@mark.slow
def test_the_processor_is_judged_by_the_limits_of_its_autopilot():
    busy = processor_fact(evidence_with("SYS_STATUS", load=np.where(HALF, 500, 1010)))
    assert (busy.level, busy.figures["load"]) == ("watch", approx(101.0))
    usual = {"load": 0.6, "ram_usage": 0.97}
    px4 = evidence_with("cpuload", autopilot="PX4", **usual)
    assert processor_fact(px4).level == "unknown"
    limits = {"COM_CPU_MAX": 95.0, "COM_RAM_MAX": 95.0}
    full = processor_fact(evidence_with("cpuload", limits, "PX4", **usual))
    assert (full.level, full.figures["memory_share_limit"]) == ("watch", 95.0)
    loops = evidence_with("PM", Load=420, Mem=51_200, NLon=3, NL=100)
    assert processor_fact(loops).figures["share"] == approx(0.03)
    assert processor_fact(loops).figures["memory_free"] == approx(50.0)


def test_gaps_in_flight_are_found_with_their_time():
    assert recording_fact(evidence_of(Signals(TELEMETRY))).level == "good"
    attitude = TELEMETRY.messages["ATTITUDE"]
    is_recorded = (attitude["time"] < 15.0) | (attitude["time"] > 16.5)
    cut = {name: values[is_recorded] for name, values in attitude.items()}
    fact = recording_fact(evidence_of(Signals(changed(TELEMETRY, "ATTITUDE", **cut))))
    assert (fact.level, fact.time) == ("watch", approx(15.0, abs=0.1))
    assert fact.figures["longest_gap"] == approx(1.6)


@mark.slow
def test_messages_of_the_barometer_that_are_missing_in_flight_are_reported():
    time = TELEMETRY.messages["ATTITUDE"]["time"]
    altitude = 100.0 + 0.1 * np.sin(time)

    def recording(is_recorded):
        samples = columns(time[is_recorded], altitude=altitude[is_recorded])
        return recording_fact(
            evidence_of(Signals(changed(TELEMETRY, "SCALED_PRESSURE", **samples)))
        )

    gap = recording((time < 15.0) | (time > 17.2))
    assert (gap.level, gap.figures["barometer_gap"]) == ("watch", approx(2.2, abs=0.15))
    assert "s without the barometer" in gap.sentence
    # A barometer that is merely logged slowly lacks no message.
    slow = recording(np.arange(len(time)) % round(1.5 / np.median(np.diff(time))) == 0)
    assert (slow.level, slow.figures["barometer_gap"]) == ("good", None)


def test_stamps_of_the_body_rates_are_called_theirs():
    assert str(recording_fact(evidence_of(Signals(TELEMETRY)))).startswith("Attitude every ")
    interpolated = Fact(Repair.ATTITUDE_INTERPOLATED, attitude_rate=20.0, rate=50.0)
    repaired = replace(TELEMETRY, repairs=(*TELEMETRY.repairs, interpolated))
    fact = recording_fact(evidence_of(Signals(repaired)))
    assert str(fact).startswith("Body rates every ")


def test_temperatures_are_stated_and_not_judged():
    fact = temperatures_fact(
        evidence_with("SCALED_PRESSURE", press_abs=1000.0, temperature=np.where(HALF, 2000, 2500))
    )
    assert (fact.level, fact.sentence) == ("unknown", "In flight barometer 20 to 25 °C.")


def test_only_a_log_has_the_temperature_of_the_imu_in_highres_imu():
    sent = changed(TELEMETRY, "HIGHRES_IMU", **columns(TIME, temperature=31.0))
    assert temperatures_fact(evidence_of(Signals(sent))) is None
    logged = replace(sent, source_names={"HIGHRES_IMU": "IMU"})
    assert temperatures_fact(evidence_of(Signals(logged))).sentence == "In flight IMU 31 °C."


def test_ardupilots_compasses_are_numbered_by_priority_and_need_offsets():
    """Of three entries in the parameters, two are compasses. The second one has no calibration offsets."""
    parameters = {
        "INS_ACC_ID": 2621706,
        "INS_ACCOFFS_X": 0.1,
        "COMPASS_DEV_ID": 658953,
        "COMPASS_DEV_ID2": 0,
        "COMPASS_DEV_ID3": 658945,
        "COMPASS_OFS_X": 20,
        **dict.fromkeys(("INS_ACCOFFS_Y", "INS_ACCOFFS_Z"), 0.0),
        **dict.fromkeys(("COMPASS_OFS_Y", "COMPASS_OFS_Z"), 0.0),
        **{f"COMPASS_OFS3_{axis}": 0.0 for axis in "XYZ"},
        "COMPASS_PRIO1_ID": 658953,
        "COMPASS_PRIO2_ID": 658945,
        "COMPASS_PRIO3_ID": 658945,
    }
    fact = calibration_fact(replace(TELEMETRY, parameters=parameters))
    assert (fact.level, fact.figures["missing"]) == ("watch", ("compass 2",))
    unused = calibration_fact(replace(TELEMETRY, parameters=parameters | {"COMPASS_USE2": 0}))
    assert (unused.level, unused.figures["names"]) == ("good", ("accelerometer 1", "compass 1"))
    disabled = calibration_fact(replace(TELEMETRY, parameters=parameters | {"COMPASS_ENABLE": 0}))
    assert (disabled.level, disabled.figures["names"]) == ("good", ("accelerometer 1",))
    # The offsets of the second compass are not in the stream.
    del parameters["COMPASS_OFS3_X"]
    assert calibration_fact(replace(TELEMETRY, parameters=parameters)).level == "good"
    parameters["COMPASS_OFS3_X"] = 5.0
    buses = [
        sensor.bus for sensor in sensors_in_parameters(replace(TELEMETRY, parameters=parameters))
    ]
    assert buses == ["SPI 1", "I2C 1", "I2C 0"]


def test_px4_has_parameters_of_calibrated_sensors_alone():
    parameters = {"CAL_ACC0_ID": 2949146, "CAL_MAG0_ID": 396809, "CAL_MAG0_PRIO": 0}
    fact = calibration_fact(replace(TELEMETRY, parameters=parameters, autopilot="PX4"))
    assert fact.figures["names"] == ("accelerometer 1",)
    assert calibration_fact(replace(TELEMETRY, parameters={}, autopilot="PX4")) is None


def test_errors_of_the_position_are_those_at_its_setpoints():
    time = TELEMETRY.messages["LOCAL_POSITION_NED"]["time"]
    position = {"x": np.sin(time), "y": np.cos(time), "z": -0.1 * time}
    target = position | {"x": position["x"] + 3.0, "y": position["y"] + 4.0}
    telemetry = changed(TELEMETRY, "LOCAL_POSITION_NED", **position)
    telemetry = changed(telemetry, "POSITION_TARGET_LOCAL_NED", **columns(time, **target))
    fact = command_facts(evidence_of(Signals(telemetry)))["position and velocity"]
    assert fact.figures["horizontal"] == approx(5.0)
    assert fact.figures["vertical"] == approx(0.0, abs=1e-9)


def test_sticks_and_switches_that_moved_in_flight_are_named():
    moving = np.where(HALF, 1500, 1700)
    channels = {f"chan{number}_raw": 1500 for number in range(1, 7)}
    fact = command_facts(
        evidence_with("RC_CHANNELS", **channels | {"chan2_raw": moving, "chan6_raw": moving})
    )["sticks and switches"]
    assert fact.figures["names"] == ("pitch",)
    assert fact.figures["channels"] == ("6",)
