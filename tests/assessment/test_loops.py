"""Loops of a log whose gains change: the part with one set of gains, the longest, with these."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
from hover import Hover, changed, columns, log_of, with_texts
from pytest import approx, mark
from recorded_flights import recorded
from refusals import refused

from mavdem.assessment.axis import loops
from mavdem.assessment.axis.gains import autotune_fact, sections_with_one_gain_set
from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.segments import settled_segments
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import ControllerFact, LoopFact
from mavdem.facts.model import NoPhysical
from mavdem.plant import NotIdentifiable

AUTOTUNE = 15
STABILIZE = 0
P = "ATC_RAT_RLL_P"


def sections_and_caution(values, modes=()):
    """Returns the sections of a hover with one set of gains, and the caution about them.

    ``values`` has name, time and value of each parameter that was set.
    """
    telemetry = Hover().telemetry(parameters={name: value for name, _, value in values})
    names, times, set_to = zip(*values, strict=True)
    parameter_columns = {"param_id": np.array([name.encode() for name in names])}
    parameter_columns |= {"param_value": np.array(set_to, np.float32)}
    telemetry = changed(telemetry, "PARAM_VALUE", **columns(np.array(times), **parameter_columns))
    if modes:
        mode_times, numbers = np.transpose(modes)
        telemetry = changed(telemetry, "CURRENT_MODE", **columns(mode_times, custom_mode=numbers))
    signals = Signals(telemetry)
    flights = tuple(aligned_flight(signals, segment) for segment in settled_segments(signals))
    assert (round(flights[0].time[0]), round(flights[0].time[-1])) == (12, 51)
    return sections_with_one_gain_set(signals, flights)


@mark.slow
def test_the_longest_part_with_one_set_of_gains_has_these():
    """The gain P is set at 30 s and at 32 s: the part from 32 s to 51 s is the longest."""
    (part,), caution = sections_and_caution([(P, 1.0, 0.5), (P, 30.0, 0.25), (P, 32.0, 0.125)])
    assert (part.time[0], part.time[-1]) == approx((32.0, 51.0), abs=1)
    assert part.provenance["parameters"][P] == 0.125
    assert (caution.code, caution.figures["names"]) == (LoopFact.GAINS_OF_PART, (P,))
    durations, values = zip(*caution.figures["parts"], strict=True)
    assert durations == approx((18.0, 2.0), abs=1) and values == (((P, 0.5),), ((P, 0.25),))
    assert caution.figures["duration"] == approx(part.duration)
    (part,), _ = sections_and_caution([(P, 1.0, 0.5), (P, 35.0, 0.25)])
    assert part.time[-1] == approx(35.0, abs=0.01)
    assert part.provenance["parameters"][P] == 0.5


def spans(parts):
    return [(round(part.time[0]), round(part.time[-1])) for part in parts]


@mark.slow
def test_parts_with_the_same_gains_count_together():
    parts, _ = sections_and_caution([(P, 1.0, 0.5), (P, 24.0, 0.25), (P, 39.0, 0.5)])
    assert spans(parts) == [(12, 24), (39, 51)]


@mark.parametrize("name", ["ATC_RAT_PIT_P", "MOT_THST_HOVER", "RTL_ALT"])
def test_parameters_of_other_axes_do_not_divide_the_flight(name):
    (part,), caution = sections_and_caution([(P, 1.0, 0.5), (name, 2.0, 0.5), (name, 30.0, 0.25)])
    assert caution is None and round(part.duration) == 39


@mark.slow
def test_a_change_after_the_flight_leaves_the_gains_that_were_flown():
    (part,), caution = sections_and_caution([(P, 1.0, 0.5), (P, 70.0, 0.25)])
    assert caution is None and part.provenance["parameters"][P] == 0.5
    assert part.provenance["earlier"] == {}


@mark.slow
def test_autotune_has_gains_that_no_parameter_has():
    parameter_changes = [(P, 1.0, 0.5)]
    parts, caution = sections_and_caution(
        parameter_changes, [(0.0, STABILIZE), (20.0, AUTOTUNE), (30.0, STABILIZE)]
    )
    assert spans(parts) == [(12, 20), (30, 51)]
    assert (caution.code, caution.figures["names"]) == (LoopFact.GAINS_OF_PART, ())
    assert (
        refused(sections_and_caution, parameter_changes, [(0.0, AUTOTUNE)]).code
        is LoopFact.GAINS_OF_AUTOTUNE
    )


@mark.slow
def test_a_recorded_autotune_has_its_span_and_what_it_found():
    signals = Signals(recorded("sitl_raw/ap_autotune.BIN.xz"))
    autotune = autotune_fact(signals, refusal := Fact(LoopFact.NOT_STEERED))
    assert (round(autotune.time), round(autotune.end_time)) == (64, 184)
    _, before, after = zip(*sorted(autotune.figures["changes"]), strict=True)
    assert (before, after) == (approx((4.5, 0.0018, 0.0675, 0.0675)), (36.0, 0.0006, 0.116, 0.116))
    assert autotune_fact(signals.for_axis("pitch"), refusal) is None


def test_autotune_of_yaw_names_what_it_tuned_and_damage_is_no_number():
    """ArduPilot's autotune reports its gains as texts, one of which is damaged."""
    texts = "AutoTune: Yaw(E) Rate: P:0.5.1, I:0.05", "AutoTune: Pitch Rate: P:0.2"
    texts += ("AutoTune: Yaw Angle P:36.000, Max Accel:609317",)
    autotune = autotune_fact(
        Signals(with_texts(Hover().telemetry(), *texts), "yaw"), Fact(LoopFact.NOT_STEERED)
    )
    assert autotune.figures["changes"] == (
        ("ATC_RAT_YAW_P", None, 0.5),
        ("ATC_RAT_YAW_I", None, 0.05),
        ("ATC_ANG_YAW_P", None, 36.0),
    )
    assert autotune.time == 1.0
    assert "36 is more than the 12 that ArduPilot recommends" in autotune.sentence
    assert "At the end of the log the parameters are those from before" in autotune.sentence


@mark.slow
def test_without_a_rate_setpoint_the_reason_includes_what_inputs_and_outputs_show(monkeypatch):
    telemetry = Hover().telemetry()
    not_logged = NotLearnable(LoopFact.NO_RATE_SETPOINT, is_logged=False, least_rate=8.0)
    unmoved = NotIdentifiable(Fact(NoPhysical.NO_LIKELIHOOD))
    monkeypatch.setattr(loops, "identify_plant_in_loop", Mock(side_effect=not_logged))
    monkeypatch.setattr(loops, "physical", lambda flights: unmoved)
    reason = loops.identified_loop_or_reason(Signals(telemetry), log_of(telemetry))
    expected = not_logged.fact.replace(recorder="", autopilot="ARDUPILOTMEGA")
    assert reason.figures["reasons"] == (expected, unmoved.reason)


@mark.parametrize(
    "firmware, advice",
    [
        ("PX4 v1.9.0", "Update to PX4 v1.14 or newer."),
        ("PX4 v1.15.0", "Record all parameters"),
        ("", "With PX4 v1.14 or newer record all parameters"),
    ],
)
def test_a_mixer_that_is_not_logged_is_advised_by_the_version_of_px4(monkeypatch, firmware, advice):
    telemetry = replace(Hover().telemetry(), autopilot="PX4", firmware=firmware)
    missing = NotLearnable(ControllerFact.MIXER_IN_FILE)
    monkeypatch.setattr(loops, "loop_of_axis", Mock(side_effect=missing))
    reason = loops.identified_loop_or_reason(Signals(telemetry), log_of(telemetry))
    assert reason.remedy.startswith(advice)
    assert ("cannot be tuned" in reason.sentence) is (firmware == "PX4 v1.9.0")


def test_an_arducopter_with_the_older_thrust_curve_is_not_asked_for_newer_parameters(monkeypatch):
    telemetry = Hover().telemetry(parameters={"MOT_TCRV_ENABLE": 1.0})
    telemetry = replace(telemetry, firmware="ArduCopter V3.2.1")
    missing = NotLearnable(ControllerFact.PARAMETERS_MISSING, names=("MOT_THST_EXPO",))
    monkeypatch.setattr(loops, "loop_of_axis", Mock(side_effect=missing))
    reason = loops.identified_loop_or_reason(Signals(telemetry), log_of(telemetry))
    assert "ArduCopter V3.2.1 has no MOT_THST_EXPO" in reason.sentence
    assert "--params" not in reason.remedy


def test_the_mixer_of_a_hexarotor_is_not_known_and_no_flight_is_said_to_lead_to_its_gains():
    telemetry = Hover().telemetry(vehicle="HEXAROTOR", parameters={"FRAME_CLASS": 2.0})
    signals = Signals(telemetry)
    reason = loops.identified_loop_or_reason(signals, log_of(telemetry))
    assert reason.sentence == "The mixer of 6 motors is not known, only that of quadrotors."
    assert reason.remedy == "Tune with the autopilot's AutoTune."
    assert loops.controller_fault(signals, Fact(LoopFact.NOT_STEERED)) == reason
