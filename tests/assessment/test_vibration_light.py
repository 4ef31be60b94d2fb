"""The light of vibration, by the limits of the autopilot, in flight only."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed, columns, evidence_of
from partial_records import partial_record
from pytest import approx, mark

from mavdem.assessment.clipping import clipping_events
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.vibration import (
    ARDUPILOT_LEVELS,
    CLIP_LIMITS,
    PX4_LEVELS,
    vibration_light,
)
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.ending import Ending
from mavdem.facts.vibration import VibrationLight
from mavdem.vibration.vibration_message import CLIPPING_FIELDS, LEVEL_FIELDS, reported_vibration

HOVER = Hover()


def shaken_signals(levels, clips=0, autopilot="ARDUPILOTMEGA", firmware=""):
    """Of these levels in flight, and ten times as much once landed; clips of the second IMU and half of the third."""
    telemetry = HOVER.telemetry(10.0, 10.0, autopilot=autopilot)
    time = HOVER.stamps(5.0)[100:]
    shaken = np.outer(np.where(time < HOVER.landed, 1.0, 10.0), levels)
    fields = dict(zip(("vibration_x", "vibration_y", "vibration_z"), shaken.T, strict=False))
    fields |= {"clipping_0": 0, "clipping_1": clips * (time > 30.0) + 1}
    fields |= {"clipping_2": fields["clipping_1"] // 2}
    fields |= {"vibration_z": shaken[:, 0]} if autopilot == "PX4" else {}
    fields |= {"levels": shaken} if len(levels) != 3 else {}
    signals_telemetry = changed(telemetry, "VIBRATION", **columns(time, **fields))
    return Signals(replace(signals_telemetry, firmware=firmware), inputs="motors")


def light(*arguments, **keywords):
    """Of the signals of ``shaken_signals``."""
    return vibration_light(partial_record(Evidence, signals=shaken_signals(*arguments, **keywords)))


@mark.slow
@mark.parametrize("autopilot, limits", [("ARDUPILOTMEGA", ARDUPILOT_LEVELS), ("PX4", PX4_LEVELS)])
def test_the_limits_are_the_autopilot_s(autopilot, limits):
    near = [share * limit for limit in limits for share in (0.99, 1.01)]
    levels = [light([most, 0.1, 0.1], autopilot=autopilot).level for most in near]
    assert levels == ["good", "watch", "watch", "bad"]


@mark.slow
def test_the_worst_axis_of_the_worst_imu_is_named():
    light_fact = light([1, 2, 3, 4, 16, 5])
    assert (light_fact.subject, light_fact.figures["axis"], light_fact.level) == (
        "IMU 2",
        "y",
        "watch",
    )
    assert light_fact.figures["vibration"] == approx(16)
    assert light([1, 2], autopilot="PX4").subject == "IMU 2"
    assert "(axis z; above 15.0; the other IMU 8.0)" in light([1, 2, 8, 1, 1, 16]).sentence
    of_three = light([1, 2, 8, 1, 1, 16, 9, 1, 1]).sentence
    assert "(axis z; above 15.0; the other IMUs at most 9.0)" in of_three
    assert "other IMU" not in light([1, 2, 15.5, 1, 1, 16]).sentence


@mark.slow
def test_clips_of_the_accelerometer_have_the_levels_of_their_limits():
    assert "no clips in settled flight" in light([1, 1, 1]).sentence
    assert {light([1, 1, 1], clips=count).level for count in (1, CLIP_LIMITS.bad)} == {"watch"}
    many_clips = light([1, 1, 1], clips=CLIP_LIMITS.bad + 1)
    assert many_clips.level == "bad" and f" {CLIP_LIMITS.bad + 1} clips " in many_clips.sentence


@mark.parametrize("clips, level", [(CLIP_LIMITS.bad, "good"), (CLIP_LIMITS.bad + 1, "bad")])
def test_many_clips_besides_settled_flight_count(clips, level):
    """From 30 s on the vehicle rolls to and fro by more than in settled flight, as with a propeller that came loose."""
    telemetry = HOVER.telemetry(10.0, 10.0)
    time = HOVER.stamps(5.0)
    fields = dict.fromkeys(LEVEL_FIELDS, 0.5) | dict.fromkeys(CLIPPING_FIELDS, 0)
    telemetry_with_clips = changed(
        telemetry, "VIBRATION", **columns(time, **fields | {"clipping_0": clips * (time > 33.0)})
    )
    attitude_time = telemetry_with_clips.messages["ATTITUDE"]["time"]
    roll = np.radians(70.0) * np.sin(6.0 * attitude_time) * (attitude_time > 30.0)
    flight = evidence_of(
        Signals(changed(telemetry_with_clips, "ATTITUDE", roll=roll), inputs="motors"), events=()
    )
    light_fact = vibration_light(flight)
    assert (light_fact.level, light_fact.figures["is_settled"]) == (level, True)
    if level == "good":
        assert light_fact.sentence.endswith("(axis x; below 15.0), no clips in settled flight.")
    else:
        assert "in settled flight; " in light_fact.sentence and light_fact.sentence.endswith(
            "in all flight."
        )


def test_clips_of_an_impact_do_not_count():
    """The accelerometer clips at 38.5 s, after control was lost at 38 s; the flight has no settled part."""
    telemetry = HOVER.telemetry(10.0, 10.0)
    time = HOVER.stamps(5.0)
    fields = dict.fromkeys(LEVEL_FIELDS, 0.5) | dict.fromkeys(CLIPPING_FIELDS, 0)
    fields |= {"clipping_0": 50 * (time > 38.5)}
    telemetry_with_clips = changed(telemetry, "VIBRATION", **columns(time, **fields))
    # It rolls to and fro by more than a settled flight does.
    roll = np.radians(70.0) * np.sin(6.0 * telemetry_with_clips.messages["ATTITUDE"]["time"])
    telemetry_with_clips = changed(telemetry_with_clips, "ATTITUDE", roll=roll)
    flight = evidence_of(Signals(telemetry_with_clips, inputs="motors"), events=())
    lost = replace(flight, ending=Fact(Ending.CONTROL_LOST, time=38.0, boot=0))
    assert vibration_light(flight).figures["clips"] == 50
    assert vibration_light(lost).figures["clips"] == 0
    assert vibration_light(lost).sentence.endswith("no clips in flight until 38.0 s.")


def test_vibration_is_unknown_without_its_message():
    telemetry = HOVER.telemetry(10.0, 10.0)
    light_fact = vibration_light(
        partial_record(Evidence, signals=Signals(telemetry, inputs="motors"))
    )
    assert (light_fact.code, light_fact.level) == (VibrationLight.VIBRATION_UNKNOWN, "unknown")
    # The messages of this flight are from a stream.
    assert light_fact.sentence == "No VIBRATION came in flight."


def test_a_vibration_of_zero_throughout_was_not_measured():
    light_fact = light([0, 0, 0])
    assert (light_fact.code, light_fact.level) == (VibrationLight.VIBRATION_UNKNOWN, "unknown")
    assert "0 throughout" in light_fact.sentence and "firmware" in light_fact.remedy


@mark.parametrize("firmware, is_known", [("PX4 v1.12.3", False), ("PX4 v1.13.0", True), ("", True)])
def test_increments_of_the_velocity_are_no_vibration(firmware, is_known):
    light_fact = light([0.05], autopilot="PX4", firmware=firmware)
    assert (light_fact.code is VibrationLight.VIBRATION_MEASURED) is is_known
    assert ("increments of the velocity" in light_fact.sentence) is not is_known


def test_the_version_is_also_that_of_the_message():
    telemetry = shaken_signals([0.05], autopilot="PX4").telemetry
    version = columns([1.0], flight_sw_version=np.array([0x010B03FF], dtype=np.uint32))
    of_1_11 = changed(telemetry, "AUTOPILOT_VERSION", **version)
    assert reported_vibration(Signals(of_1_11, inputs="motors")) is None
    assert reported_vibration(Signals(telemetry, inputs="motors")) is not None


def test_clips_count_whatever_the_level_is_of():
    signals = shaken_signals([0.05], clips=3, autopilot="PX4", firmware="PX4 v1.11.3")
    (clipped,) = clipping_events(signals, 0, [(0.0, 100.0)])
    assert clipped.figures["count"] == 3


def test_clips_are_those_of_the_imu_that_clipped_most():
    fields = dict.fromkeys(LEVEL_FIELDS, np.ones(4))
    for field, clips in zip(CLIPPING_FIELDS, (3.0, 5.0, 0.0), strict=True):
        # One sample alone would count as damaged.
        fields[field] = np.array([0.0, 0.0, clips, clips])
    telemetry = changed(HOVER.telemetry(), "VIBRATION", **columns(np.arange(4.0), **fields))
    vibration = reported_vibration(Signals(telemetry, inputs="motors"))
    assert vibration.most_clips(np.ones(4, np.bool_)) == 5
