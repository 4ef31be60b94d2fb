"""What needs no multirotor is judged of every vehicle; motors, margins, tracking and wind name its type."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed, columns, disarmed, log_of
from pytest import approx, fixture, mark

from mavdem.assessment.assess import assess
from mavdem.assessment.innovations import INNOVATION_FIELDS
from mavdem.dataset.flight_states import airborne_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.log import LogLight
from mavdem.facts.power import PowerLight
from mavdem.facts.sources import Flaw, Repair
from mavdem.facts.trust import TrustCheck
from mavdem.facts.vibration import VibrationLight
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND

HOVER = Hover()
TIME = HOVER.stamps(5.0)
MULTIROTOR_LIGHTS = ("motors", "tracking", "margins", "wind")
BATTERY_PARAMETERS = {"BATT_LOW_VOLT": 9.5, "BATT_CRT_VOLT": 9.0}


def telemetry(vehicle, vibration=2.0, volts=12.4):
    """A trip with attitude, outputs of four channels, vibration, a battery of three cells and an estimator."""
    telemetry_of_vehicle = HOVER.telemetry(
        10.0, 10.0, vehicle=vehicle, parameters=BATTERY_PARAMETERS
    )
    innovations = dict.fromkeys(INNOVATION_FIELDS["EKF_STATUS_REPORT"], 0.1)
    telemetry_of_vehicle = changed(
        telemetry_of_vehicle, "EKF_STATUS_REPORT", **columns(TIME, flags=0.0, **innovations)
    )
    level = {f"vibration_{axis}": vibration for axis in "xyz"}
    clips = {f"clipping_{imu}": 0.0 for imu in range(3)}
    telemetry_of_vehicle = changed(
        telemetry_of_vehicle, "VIBRATION", **columns(TIME, **level, **clips)
    )
    sag = np.where((TIME > 10.0) & (TIME < 60.0), -0.02, 0.0)
    voltage = 1000 * (volts + sag)
    return changed(telemetry_of_vehicle, "SYS_STATUS", **columns(TIME, voltage_battery=voltage))


@fixture(params=["FIXED_WING", "GROUND_ROVER", "SUBMARINE"])
def vehicle(request):
    return request.param


def test_sensors_and_battery_of_every_vehicle_are_judged(vehicle):
    lights = assess(log_of(telemetry(vehicle))).lights
    assert lights["vibration"].code is VibrationLight.VIBRATION_MEASURED
    assert lights["vibration"].is_good
    assert lights["power"].code is PowerLight.BATTERY_HELD
    assert lights["log"].code is LogLight.RECORDED_OTHER_VEHICLE
    assert lights["log"].figures["attitude_rate"] == approx(10.0, rel=0.01)


@mark.slow
def test_a_position_that_is_lost_is_an_event_of_every_vehicle(vehicle):
    is_lost = (TIME > 40.0) & (TIME < 50.0)
    fix = columns(TIME, fix_type=np.where(is_lost, 1, 3))
    events = assess(log_of(changed(telemetry(vehicle), "GPS_RAW_INT", **fix))).events
    (lost,) = [event for event in events if event.code is MotionEvent.POSITION_LOST]
    assert (lost.time, lost.figures["duration"]) == approx((40.0, 10.0), abs=1.0)


def test_lights_of_multirotors_name_the_type(vehicle):
    lights = assess(log_of(telemetry(vehicle))).lights
    for name in MULTIROTOR_LIGHTS:
        assert lights[name].code is Unjudged.MULTIROTORS_ONLY
        assert vehicle in lights[name].sentence


def test_a_sound_vehicle_has_nothing_to_be_done(vehicle):
    judgement = assess(log_of(telemetry(vehicle))).judgement
    assert judgement.headline.code is Headline.NOTHING_WRONG
    assert judgement.next_step.code is NextStep.KEEP_LOG


@mark.parametrize("vibration, volts, light", [(40.0, 12.4, "vibration"), (2.0, 8.5, "power")])
def test_the_bad_light_of_another_vehicle_is_its_headline(vehicle, vibration, volts, light):
    full_at_first = np.where(TIME < 8.0, 12.4, volts)
    judgement = assess(log_of(telemetry(vehicle, vibration, full_at_first))).judgement
    assert judgement.headline == judgement.lights[light]
    assert judgement.headline.is_bad


def test_clipping_is_an_event_of_every_vehicle(vehicle):
    telemetry_of_vehicle = telemetry(vehicle)
    clips = np.where(TIME > 30.0, 7.0, 0.0)
    events = assess(log_of(changed(telemetry_of_vehicle, "VIBRATION", clipping_0=clips))).events
    [clipped] = [event for event in events if event.code is MotionEvent.CLIPPED]
    assert clipped.figures["count"] == 7
    assert clipped.time == approx(30.2, abs=0.01)


def test_channels_of_other_vehicles_are_no_motors(vehicle):
    telemetry_of_vehicle = telemetry(vehicle)
    # One of four channels goes up by a quarter of its range, and stays there.
    raised = np.where(HOVER.stamps(10.0) > 35.0, 1900.0, 1600.0)
    assessment = assess(
        log_of(changed(telemetry_of_vehicle, "SERVO_OUTPUT_RAW", servo1_raw=raised))
    )
    # Not even when they are at their limit.
    motor_events = [event for event in assessment.events if "motor" in event.subject]
    assert not motor_events
    take_offs = [event for event in assessment.events if event.code is ReportedEvent.OFF_GROUND]
    assert not take_offs


def test_a_vehicle_that_never_armed_did_not_operate(vehicle):
    judgement = assess(log_of(disarmed(telemetry(vehicle)))).judgement
    assert judgement.headline.code is NotLearnableReason.NEVER_ARMED


@mark.parametrize("kind, seconds", [("FIXED_WING", 20.0), ("GROUND_ROVER", 67.0)])
def test_a_land_detector_counts_for_what_can_fly(kind, seconds):
    """The land detector of a rover reports flight too, which is ignored."""
    telemetry_of_vehicle = telemetry(kind)
    state = np.where((TIME >= 20.0) & (TIME <= 40.0), IN_AIR, ON_GROUND)
    signals = Signals(
        changed(telemetry_of_vehicle, "EXTENDED_SYS_STATE", **columns(TIME, landed_state=state))
    )
    [(start, end)] = airborne_intervals(signals, 0)
    assert end - start == approx(seconds, abs=2.0)


def test_the_headline_of_a_sound_vehicle_names_what_was_judged_and_its_type(vehicle):
    headline = assess(log_of(telemetry(vehicle))).headline
    assert headline.sentence.startswith("Nothing wrong found in vibration, power and estimator;")
    assert vehicle in headline.sentence


def test_outputs_of_other_vehicles_are_no_motors_in_the_table_either(vehicle):
    names = [instance.name for instance in assess(log_of(telemetry(vehicle))).instances]
    assert "output 1" in names
    assert not [name for name in names if "motor" in name]


def test_of_other_vehicles_the_sensors_are_checked_and_no_flight(vehicle):
    (trust,) = assess(log_of(telemetry(vehicle))).trust
    codes = [check.code for check in trust.checks]
    assert codes == [
        TrustCheck.BAROMETER,
        TrustCheck.ACCELEROMETER,
        TrustCheck.POSITION,
        TrustCheck.STICK,
    ]


@mark.slow
def test_a_damaged_log_of_a_plane_has_a_light_to_be_watched():
    damage = Fact(Repair.FRAMES_LEFT_OUT, count=150, flaw=Flaw.DAMAGE)
    log = replace(log_of(replace(telemetry("FIXED_WING"), repairs=(damage,))), frames=1000)
    light = assess(log).lights[Light.LOG]
    assert light.code is LogLight.RECORDED_WITH_DAMAGE and light.level is Level.WATCH
    assert str(light).endswith("What is left has attitude at 10 Hz.")
