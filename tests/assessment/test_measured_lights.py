"""Lights of power, estimator, wind and log: what was measured in flight against the limits that are stated."""

from dataclasses import replace

import numpy as np
from hover import Hover, changed, columns, evidence_of, with_demand
from partial_records import partial_record
from pytest import approx, mark
from recorded_flights import recorded

from mavdem.assessment.battery_levels import CELL_VOLTAGE_LIMITS, FULL_CELL_VOLTAGES
from mavdem.assessment.innovations import (
    ARDUPILOT_FAILSAFE_LIMIT,
    FAILSAFE_SECONDS,
    INNOVATION_FIELDS,
    INNOVATION_LIMIT,
)
from mavdem.assessment.lights.estimator import MAX_FIELD_CHANGE, estimator_light
from mavdem.assessment.lights.log import (
    MAX_CUT_BYTES,
    MAX_GAP,
    log_light,
)
from mavdem.assessment.lights.power import (
    BOARD_VOLTAGE_LIMITS,
    LOW_VOLTAGE_SECONDS,
    MAX_BOARD_VOLTAGE_DROP,
    further_power_warnings,
    power_light,
    with_low_supply,
    with_supply_as_suspect,
)
from mavdem.assessment.lights.wind import wind_light
from mavdem.assessment.mean_interval import MeanFigure
from mavdem.assessment.simulation import MAX_SIMULATED_RATE_CHANGE, simulation_fact
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import ReportedEvent
from mavdem.facts.identifiability import Status
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.log import LogLight, Simulator
from mavdem.facts.margins import MarginsLight
from mavdem.facts.online import DragSource
from mavdem.facts.power import PowerLight
from mavdem.facts.sources import Flaw, Repair
from mavdem.facts.wind import WindDoubt
from mavdem.wind_velocity.from_log import WindEvidence, wind_evidence
from mavdem.wind_velocity.vehicle_drag import Drag
from mavdem.wind_velocity.velocity import WindVelocity

HOVER = Hover()
TIME = HOVER.stamps(5.0)
FLYING = (TIME > 12.0) & (TIME < 60.0)
SAG = np.where(FLYING, -0.01, 0.0)


def evidence(telemetry, ending=None):
    signals = Signals(telemetry)
    return evidence_of(signals, wind=wind_evidence(signals), ending=ending)


def telemetry_with(message, parameters=None, **fields):
    """Returns telemetry of the hover at 20 Hz, with a further message at 5 Hz."""
    telemetry = HOVER.telemetry(20.0, 20.0, parameters=parameters)
    return changed(telemetry, message, **columns(TIME, **fields))


def battery(volts, parameters=None):
    return telemetry_with("SYS_STATUS", parameters, voltage_battery=1000 * volts)


def sagging_voltage(cell, seconds=20.0):
    """Returns the voltage of four cells: nearly full, but ``cell`` V each for some seconds of the flight."""
    low = (TIME >= 30.0) & (30.0 + seconds > TIME)
    return np.where(low, 4 * cell, 16.4)


@mark.slow
def test_a_battery_is_judged_by_its_cells_and_its_load():
    """The voltage sags by 0.04 V for each ampere: the resistance of the battery is estimated."""
    amperes = np.where(FLYING, 20.0 + 5 * np.sin(5 * TIME), 0.5)
    drawn = {"current_battery": 100 * amperes}
    telemetry = changed(battery(16.6 - 0.04 * amperes), "SYS_STATUS", **drawn)
    fact = power_light(evidence(telemetry))
    assert (fact.code, fact.level) == (PowerLight.BATTERY_HELD, "good")
    assert fact.figures["cells"] == 4 and fact.figures["resistance"] == approx(0.04)
    assert fact.figures["voltage"] == approx(15.8, abs=0.1)
    telemetry_reversed = changed(battery(16.0 - 0.04 * amperes[::-1]), "SYS_STATUS", **drawn)
    assert power_light(evidence(telemetry_reversed)).figures["resistance"] is None


@mark.slow
def test_a_current_too_small_to_hover_on_is_not_a_measured_one():
    volts = 16.4 + SAG
    parameters = {"BATT_AMP_PERVLT": 17.0}
    amperes = np.where(FLYING, 0.3 + 0.3 * np.sin(5 * TIME), 0.1)
    telemetry = battery(volts, parameters)
    telemetry = changed(telemetry, "SYS_STATUS", current_battery=100 * amperes)
    fact = power_light(evidence(telemetry))
    assert (fact.code, fact.level) == (PowerLight.CURRENT_UNCALIBRATED, "watch")
    assert "reads 0.3 A" in fact.sentence and "BATT_AMP_PERVLT" in fact.remedy
    # The supply of the board decides whether the autopilot goes on. The other warning stands beside it.
    low_supply = columns(TIME, Vcc=4600 - SAG)
    judged = evidence(changed(telemetry, "POWER_STATUS", **low_supply))
    light = power_light(judged)
    assert light.code is PowerLight.SUPPLY_LOW
    (other,) = further_power_warnings(judged, light).values()
    assert other.code is PowerLight.CURRENT_UNCALIBRATED
    # A current of a hover, and one that no sensor measures.
    for factor in (5.0, 0.0):
        measured = changed(telemetry, "SYS_STATUS", current_battery=100 * factor * amperes)
        assert power_light(evidence(measured)).code is PowerLight.BATTERY_HELD


@mark.parametrize(
    "autopilot, parameters, names",
    [
        ("ARDUPILOTMEGA", {}, "BATT_LOW_VOLT and BATT_CRT_VOLT"),
        ("ARDUPILOTMEGA", {"FS_BATT_VOLTAGE": 0.0}, "FS_BATT_VOLTAGE"),
        ("PX4", {}, "BAT1_N_CELLS"),
        ("PX4", {"BAT_N_CELLS": 0.0}, "BAT_N_CELLS"),
    ],
)
def test_advice_on_unknown_cells_names_parameters_of_this_autopilot(autopilot, parameters, names):
    telemetry = battery(8 * FULL_CELL_VOLTAGES[0] + 0.2 + SAG, parameters)
    fact = power_light(evidence(replace(telemetry, autopilot=autopilot)))
    assert fact.code is PowerLight.CELLS_UNKNOWN
    assert fact.remedy == f"Set {names}."


@mark.slow
@mark.parametrize(
    "volts, parameters, level",
    [
        (sagging_voltage(CELL_VOLTAGE_LIMITS.watch + 0.05), {}, "good"),
        (sagging_voltage(CELL_VOLTAGE_LIMITS.watch - 0.05), {}, "watch"),
        (sagging_voltage(CELL_VOLTAGE_LIMITS.bad - 0.05), {}, "bad"),
        (sagging_voltage(CELL_VOLTAGE_LIMITS.bad - 0.05, LOW_VOLTAGE_SECONDS / 2), {}, "good"),
        (sagging_voltage(CELL_VOLTAGE_LIMITS.bad - 0.05, 12.6), {}, "bad"),
        (sagging_voltage(3.6), {"BATT_LOW_VOLT": 14.5}, "watch"),
        (sagging_voltage(3.6), {"BATT_CRT_VOLT": 14.5}, "bad"),
        # It can have seven cells, and eight.
        (8 * FULL_CELL_VOLTAGES[0] + 0.2 + SAG, {}, "unknown"),
        (7 * FULL_CELL_VOLTAGES[1] - 0.2 + SAG, {}, "unknown"),
        (8 * FULL_CELL_VOLTAGES[0] + 0.2 + SAG, {"BAT1_N_CELLS": 8.0}, "good"),
    ],
)
def test_battery_voltages_have_the_levels_of_their_limits(volts, parameters, level):
    """The voltage sags below limits for each cell, or below limits of the parameters, for some seconds."""
    fact = power_light(evidence(battery(volts, parameters)))
    assert fact.level == level
    if level in ("watch", "bad"):
        assert fact.code is PowerLight.BATTERY_LOW
    else:
        assert fact.code is not PowerLight.BATTERY_LOW
    assert fact.figures["voltage"] == approx(volts[FLYING].min())
    if level == "unknown":
        assert fact.code is PowerLight.CELLS_UNKNOWN
    else:
        assert fact.code is not PowerLight.CELLS_UNKNOWN


@mark.parametrize(
    "volts, parameters",
    [(6.0 + SAG, {"FS_BATT_VOLTAGE": 10.5}), (12.6 + 0 * SAG, {}), (12.6 + SAG, {})],
)
def test_what_is_no_battery_is_not_judged(volts, parameters):
    """Below the failsafe in the whole log, or always the same; the last is a battery."""
    code = power_light(evidence(battery(volts, parameters))).code
    if volts.max() < 11 or np.ptp(volts) == 0:
        assert code is PowerLight.POWER_UNMEASURED
    else:
        assert code is not PowerLight.POWER_UNMEASURED


@mark.slow
def test_what_follows_a_loss_is_no_fault_of_the_battery():
    volts = np.where(TIME > 40.0, 11.0, 16.4)
    lost = Fact(PowerLight.BATTERY_LOW, Level.BAD, time=39.0)
    assert power_light(evidence(battery(volts))).level == "bad"
    assert power_light(evidence(battery(volts), lost)).level == "good"


@mark.slow
@mark.parametrize(
    "usual, least, code, level",
    [
        (5.0, BOARD_VOLTAGE_LIMITS.watch + 0.1, PowerLight.SUPPLY_HELD, "unknown"),
        (5.3, 5.25 - MAX_BOARD_VOLTAGE_DROP, PowerLight.SUPPLY_FELL, "watch"),
        (5.0, BOARD_VOLTAGE_LIMITS.watch - 0.05, PowerLight.SUPPLY_LOW, "watch"),
        (5.0, BOARD_VOLTAGE_LIMITS.bad - 0.05, PowerLight.SUPPLY_LOW, "bad"),
        (
            BOARD_VOLTAGE_LIMITS.bad - 0.1,
            BOARD_VOLTAGE_LIMITS.bad - 0.2,
            PowerLight.SUPPLY_LOW,
            "bad",
        ),
        # It never changes: it is not measured.
        (5.0, 5.0, PowerLight.POWER_UNMEASURED, "unknown"),
        (np.nan, np.nan, PowerLight.POWER_UNMEASURED, "unknown"),
    ],
)
def test_supply_voltages_of_the_board_have_the_levels_of_their_limits(usual, least, code, level):
    """The supply of the flight controller falls from its usual to its least voltage for 10 s."""
    volts = np.where((TIME > 30) & (TIME < 40), least, usual)
    # A board that works is never without a supply: that is a message without a measurement.
    volts[len(volts) // 2] = 0.0
    fact = power_light(evidence(telemetry_with("POWER_STATUS", Vcc=1000 * volts)))
    assert (fact.code, fact.level) == (code, level)
    # The average over 2 s follows the fall, unless the supply is low throughout.
    falls = code in (PowerLight.SUPPLY_FELL, PowerLight.SUPPLY_LOW)
    is_low_at_first = usual < BOARD_VOLTAGE_LIMITS.watch
    assert (fact.time is not None and 28 < fact.time < 32) is (falls and not is_low_at_first)
    # What was low from the take-off on did not fall at its first sample.
    assert ("already when the flight began" in fact.sentence) is is_low_at_first
    assert ("first at" in fact.sentence) is (falls and not is_low_at_first)


@mark.slow
def test_a_voltage_that_changes_is_not_called_one_whatever_the_load():
    volts = 16.4 + SAG
    open_input = power_light(evidence(battery(volts, {"BATT_LOW_VOLT": 20.0})))
    assert open_input.code is PowerLight.POWER_UNMEASURED
    assert "whatever the load" not in open_input.sentence
    constant = power_light(evidence(battery(0 * volts + 16.4)))
    assert "it reads 16.4 V whatever the load" in constant.sentence
    loaded = changed(battery(16.4 + 0 * SAG), "SYS_STATUS", current_battery=100 * (20 + SAG))
    assert "16.4 V while the current rises to" in power_light(evidence(loaded)).sentence


@mark.slow
def test_a_vehicle_that_stayed_on_the_ground_has_no_flight_to_judge_the_power_by():
    flight_evidence = evidence(battery(16.4 + SAG))
    stayed = Fact(MotionEvent.NOT_FLOWN, Level.WATCH, time=12.0, boot=0)
    fact = power_light(replace(flight_evidence, events=(stayed,)))
    assert fact.sentence == "No flight shows the battery under load."


def telemetry_with_innovations(flags=831, **ratios):
    """Returns the hover with reports of the estimator: its innovation ratios are 0.1, and larger for some seconds.

    ``ratios`` has by the name of an innovation its larger ratio, and how many seconds that lasts.
    """
    fields = dict.fromkeys(INNOVATION_FIELDS["EKF_STATUS_REPORT"], 0.1)
    for name, (value, seconds) in ratios.items():
        is_other = (TIME > 30.0) & (30.1 + seconds > TIME)
        fields[f"{name}_variance"] = np.where(is_other, value, 0.1)
    glitch = np.where((TIME > 30.0) & (TIME < 33.0), flags, 831)
    return telemetry_with("EKF_STATUS_REPORT", flags=glitch, **fields)


BEYOND = INNOVATION_LIMIT + 0.05
IDLE = dict.fromkeys(INNOVATION_FIELDS["EKF_STATUS_REPORT"], 0.0)
"""Of a filter that does not run."""


@mark.slow
@mark.parametrize(
    "telemetry, code, level",
    [
        (telemetry_with_innovations(), EstimatorLight.FILTER_AGREED, "good"),
        (
            telemetry_with_innovations(compass=(BEYOND, FAILSAFE_SECONDS - 0.5)),
            EstimatorLight.FILTER_AGREED,
            "good",
        ),
        (
            telemetry_with_innovations(compass=(BEYOND, FAILSAFE_SECONDS + 0.5)),
            EstimatorLight.FILTER_DOUBTED,
            "watch",
        ),
        (
            telemetry_with_innovations(compass=(BEYOND, 2.0), velocity=(BEYOND, 2.0)),
            EstimatorLight.FILTER_DOUBTED,
            "bad",
        ),
        (
            telemetry_with_innovations(velocity=(2 * BEYOND, 2.0)),
            EstimatorLight.FILTER_DOUBTED,
            "bad",
        ),
        (telemetry_with_innovations(flags=831 | 1 << 15), EstimatorLight.GPS_DOUBTED, "watch"),
        (HOVER.telemetry(20.0, 20.0), EstimatorLight.ESTIMATOR_UNMEASURED, "unknown"),
        (
            telemetry_with("EKF_STATUS_REPORT", **IDLE),
            EstimatorLight.ESTIMATOR_UNMEASURED,
            "unknown",
        ),
    ],
)
def test_innovations_of_the_estimator_have_the_levels_of_their_limits(telemetry, code, level):
    fact = estimator_light(evidence(telemetry))
    assert (fact.code, fact.level) == (code, level)
    if code is EstimatorLight.ESTIMATOR_UNMEASURED:
        # A flight in which the message did not come names it, as the live session does.
        has_come = "EKF_STATUS_REPORT" in telemetry.messages
        reason = "EKF innovations were not logged" if has_come else "No EKF_STATUS_REPORT came"
        assert fact.sentence == f"{reason} in flight."
    if level == "bad":
        assert fact.figures["name"] == "velocity" and fact.time == approx(30.2)
    if code is EstimatorLight.GPS_DOUBTED:
        assert fact.figures["duration"] == approx(2.8, abs=0.3)
    is_beyond = level == "good" and fact.figures["ratio"] > 1
    if is_beyond:
        assert "beyond their limits for 0.2 s at most" in str(fact)
    else:
        assert "beyond their limits for 0.2 s at most" not in str(fact)


@mark.slow
def test_a_barometer_that_froze_is_named_before_the_height_that_the_filter_then_rejects():
    doubted = evidence(telemetry_with_innovations(pos_vert=(BEYOND, 9.0)))
    assert estimator_light(doubted).code is EstimatorLight.FILTER_DOUBTED
    frozen = Fact(MotionEvent.BAROMETER_DRIFTED, time=30.0, change=8.0, frozen_since=30.0, boot=0)
    light = estimator_light(replace(doubted, events=(frozen,)))
    assert light == frozen and light.level is Level.WATCH


@mark.slow
def test_the_failsafe_may_doubt_a_filter_that_rejects_nothing():
    seconds = FAILSAFE_SECONDS + 1.0
    below_limit = (ARDUPILOT_FAILSAFE_LIMIT + INNOVATION_LIMIT) / 2
    single = estimator_light(evidence(telemetry_with_innovations(compass=(below_limit, seconds))))
    assert single.is_good and single.figures["ratio"] == approx(below_limit)
    # An innovation that overflowed has a ratio that can be printed.
    infinite = estimator_light(evidence(telemetry_with_innovations(velocity=(np.inf, seconds))))
    assert infinite.is_bad and "innovation 1000 or more times its limit" in str(infinite)
    pair = dict.fromkeys(("compass", "velocity"), (below_limit, seconds))
    fact = estimator_light(evidence(telemetry_with_innovations(**pair)))
    assert fact.is_bad and fact.figures["failsafe_limit"] == ARDUPILOT_FAILSAFE_LIMIT
    assert "rejected" not in fact.sentence and "(80 %) for 1.8 s: velocity 90 %" in fact.sentence


@mark.slow
def test_an_innovation_far_beyond_its_limit_is_to_be_watched_however_short_it_is():
    fact = estimator_light(evidence(telemetry_with_innovations(pos_vert=(8.63, 0.1))))
    assert (fact.code, fact.level) == (EstimatorLight.FILTER_AGREED, "watch")
    assert "863 %" in fact.sentence and fact.remedy


@mark.slow
def test_the_largest_innovation_of_all_flights_is_named(monkeypatch):
    flight_evidence = evidence(telemetry_with_innovations(compass=(0.5, 0.1)))
    monkeypatch.setattr(
        type(flight_evidence), "flights", lambda self, boot: [(10.0, 25.0), (26.0, 60.0)]
    )
    fact = estimator_light(flight_evidence)
    assert fact.is_good and fact.figures["ratio"] == approx(0.5)


def test_a_rejection_with_single_accepted_samples_has_its_total_too():
    """One sample in the middle of 12 s is accepted; ArduPilot's failsafe does not check the height."""
    height = np.where((TIME > 30.0) & (TIME < 42.0) & (abs(TIME - 35.0) > 0.15), 3.0, 0.1)
    fact = estimator_light(
        evidence(
            changed(telemetry_with_innovations(), "EKF_STATUS_REPORT", pos_vert_variance=height)
        )
    )
    assert fact.level is Level.WATCH
    assert fact.figures["duration"] < 7.0 and fact.figures["total_duration"] > 10.0
    assert "without a break, 11 s in all" in fact.sentence
    assert fact.sentence.endswith("the autopilot's failsafe does not check the height.")


@mark.slow
def test_where_the_failsafe_acts_an_innovation_that_it_checks_is_named():
    fact = estimator_light(
        evidence(telemetry_with_innovations(pos_vert=(9.0, 5.0), velocity=(2 * BEYOND, 3.0)))
    )
    assert (fact.level, fact.figures["name"]) == (Level.BAD, "velocity")
    assert "is_unchecked" not in fact.figures


@mark.slow
def test_poor_fixes_of_one_flight_of_several_have_its_time(monkeypatch):
    dilution = np.where(TIME < 40.0, 200, 260)
    report = columns(TIME, fix_type=3, satellites_visible=7, eph=dilution)
    flight_evidence = evidence(changed(telemetry_with_innovations(), "GPS_RAW_INT", **report))
    monkeypatch.setattr(
        type(flight_evidence), "flights", lambda self, boot: [(10.0, 39.0), (41.0, 55.0)]
    )
    fact = estimator_light(flight_evidence)
    assert fact.code is EstimatorLight.FIX_POOR
    assert fact.sentence.startswith("GPS was poor in flight from 41.")


@mark.slow
def test_a_lost_position_is_the_light_of_the_estimator():
    lost = Fact(
        MotionEvent.POSITION_LOST, Level.BAD, time=30.0, end_time=48.0, duration=18.0, boot=0
    )
    fact = estimator_light(replace(evidence(telemetry_with_innovations()), events=(lost,)))
    assert (fact.code, fact.level) == (MotionEvent.POSITION_LOST, "bad")


@mark.parametrize(
    "satellites, dilution, code",
    [
        (12, 0.8, EstimatorLight.FILTER_AGREED),
        (5, 0.8, EstimatorLight.FIX_POOR),
        (12, 2.6, EstimatorLight.FIX_POOR),
    ],
)
def test_few_satellites_or_a_large_dilution_of_gps_are_a_poor_fix(satellites, dilution, code):
    report = columns(TIME, fix_type=3, satellites_visible=satellites, eph=100 * dilution)
    fact = estimator_light(evidence(changed(telemetry_with_innovations(), "GPS_RAW_INT", **report)))
    assert fact.code is code and fact.figures.get("dilution", dilution) == approx(dilution)


@mark.slow
def test_a_filter_that_assumes_a_standstill_in_flight_has_no_position():
    """Neither vehicle recorded a satellite receiver: by its flags one has a position, and one assumes a standstill."""
    assert estimator_light(evidence(telemetry_with_innovations())).is_good
    fact = estimator_light(
        evidence(changed(telemetry_with_innovations(), "EKF_STATUS_REPORT", flags=165))
    )
    assert (fact.code, fact.level) == (EstimatorLight.FIX_MISSING, "watch")
    assert fact.sentence == (
        "The EKF assumed that the vehicle stands still in flight: nothing measured the position."
    )


@mark.slow
def test_a_flight_without_any_fix_is_to_be_watched_unless_the_position_came_from_elsewhere():
    """GPS searches in vain. The position may be known all the same, by optical flow for example."""
    searching = columns(TIME, fix_type=1, satellites_visible=2, eph=9999)
    telemetry = changed(telemetry_with_innovations(), "GPS_RAW_INT", **searching)
    # The bits 3 and 4 say that the filter has a position.
    telemetry = changed(telemetry, "EKF_STATUS_REPORT", flags=831 - 24)
    fact = estimator_light(evidence(telemetry))
    assert (fact.code, fact.level) == (EstimatorLight.FIX_MISSING, "watch")
    assert "GPS had no fix in flight (2 satellites at most)" in fact.sentence
    stabilized = changed(telemetry, "HEARTBEAT", custom_mode=0)
    fact = estimator_light(evidence(stabilized))
    assert (
        fact.is_good and "2 satellites at most), and the flight modes needed none" in fact.sentence
    )
    fact = estimator_light(evidence(changed(telemetry, "LOCAL_POSITION_NED", valid=True)))
    assert fact.is_good and "Position without GPS (no fix, 2 satellites at most)" in fact.sentence
    unlogged = {**telemetry.messages}
    del unlogged["EKF_STATUS_REPORT"]
    with_flow = {**telemetry.parameters, "FLOW_ENABLE": 1.0}
    fact = estimator_light(evidence(replace(telemetry, messages=unlogged, parameters=with_flow)))
    assert fact.code is EstimatorLight.ESTIMATOR_UNMEASURED
    assert "GPS had no fix in flight (2 satellites at most)" in fact.sentence
    submarine = replace(telemetry, vehicle="SUBMARINE")
    assert estimator_light(evidence(submarine)).code is not EstimatorLight.FIX_MISSING


@mark.slow
def test_what_a_receiver_does_not_know_is_not_printed():
    """The values 255 and 65535 mean that the number of satellites and the dilution are unknown."""
    unknown = columns(TIME, fix_type=3, satellites_visible=255, eph=65535)
    assert estimator_light(
        evidence(changed(telemetry_with_innovations(), "GPS_RAW_INT", **unknown))
    ).is_good
    fix_without_dilution = columns(TIME, fix_type=3, satellites_visible=4, eph=65535)
    fact = estimator_light(
        evidence(changed(telemetry_with_innovations(), "GPS_RAW_INT", **fix_without_dilution))
    )
    assert fact.sentence == "GPS was poor in flight: 4 satellites."
    diluted = columns(TIME, fix_type=3, satellites_visible=255, eph=300)
    fact = estimator_light(
        evidence(changed(telemetry_with_innovations(), "GPS_RAW_INT", **diluted))
    )
    assert fact.sentence == "GPS was poor in flight: HDOP 3.0."


@mark.parametrize(
    "change, before, code",
    [
        (MAX_FIELD_CHANGE + 0.05, 20, EstimatorLight.COMPASS_DISTURBED),
        (MAX_FIELD_CHANGE - 0.05, 20, EstimatorLight.FILTER_AGREED),
        (-MAX_FIELD_CHANGE - 0.05, 20, EstimatorLight.COMPASS_DISTURBED),
        (MAX_FIELD_CHANGE + 0.05, 19, EstimatorLight.FILTER_AGREED),
    ],
)
def test_a_compass_whose_field_is_another_in_flight(change, before, code):
    """The magnetic field changes at take-off by more or less than its limit, after enough seconds on the ground."""
    time = TIME[29 - before :]  # The vehicle flies from there on.
    field = 400.0 * np.where(time > 5.7, 1 + change, 1.0)
    report = columns(time, xmag=0.6 * field, ymag=0.0, zmag=0.8 * field)
    fact = estimator_light(evidence(changed(telemetry_with_innovations(), "RAW_IMU", **report)))
    assert fact.code is code and fact.figures.get("change", change) == approx(change)


@mark.slow
@mark.parametrize("time, level", [(30.0, "watch"), (2.0, "good")])
def test_what_the_autopilot_warns_of_in_flight(time, level):
    warned = Fact(ReportedEvent.ESTIMATOR_SWITCHED, Level.WATCH, time=time, boot=0)
    flagged = Fact(ReportedEvent.BATTERY_WARNED, Level.WATCH, time=time, boot=0)
    powered = columns(TIME, voltage_battery=4000 * (3.8 + SAG))
    flight_evidence = evidence(changed(telemetry_with_innovations(), "SYS_STATUS", **powered))
    flight_evidence = replace(flight_evidence, events=(warned, flagged))
    assert (
        estimator_light(flight_evidence).level == level
        and power_light(flight_evidence).level == level
    )


@mark.slow
def test_a_height_that_diverged_in_flight_makes_the_estimator_bad():
    diverged = Fact(MotionEvent.HEIGHT_DIVERGED, time=30.0, boot=0, climb_rate=-2.0, speed=2.0)
    light = estimator_light(replace(evidence(telemetry_with_innovations()), events=(diverged,)))
    assert (light.code, light.level) == (MotionEvent.HEIGHT_DIVERGED, "bad")


@mark.slow
@mark.parametrize("force, level", [(9.8, "good"), (8.4, "watch")])
def test_an_accelerometer_that_is_wrong_at_rest_is_to_be_watched(force, level):
    telemetry = with_force_at_rest(force)
    assert estimator_light(evidence(telemetry)).level == level
    if level == "watch":
        # A flight without a receiver, on purpose, does not hide it.
        without_position = changed(telemetry, "EKF_STATUS_REPORT", flags=165)
        for flown in (telemetry, without_position):
            assert estimator_light(evidence(flown)).code is EstimatorLight.ACCELEROMETER_WRONG


@mark.slow
@mark.parametrize(
    "autopilot, recorder, parameters, advice",
    [
        ("ARDUPILOTMEGA", "DataFlash", {}, "(BATT_MONITOR), and log BAT "),
        ("PX4", "ULog", {"BAT_SOURCE": 0.0}, "(BAT_SOURCE), and log battery_status."),
        ("PX4", "", {"SYS_AUTOSTART": 1.0}, "power module, and log SYS_STATUS."),
    ],
)
def test_advice_to_measure_the_battery_is_for_this_autopilot(
    autopilot, recorder, parameters, advice
):
    telemetry = replace(
        HOVER.telemetry(20.0, 20.0),
        autopilot=autopilot,
        translated_from=recorder,
        parameters=parameters,
    )
    assert advice in power_light(evidence(telemetry)).remedy
    # What the log has needs no advice to log it.
    constant = battery(0 * SAG + 16.4, parameters)
    assert "log" not in power_light(evidence(constant)).remedy


def with_force_at_rest(force):
    """The hover with a filter's report, whose accelerometer measures a specific force, m/s², all the time."""
    telemetry = changed(
        telemetry_with_innovations(),
        "HIGHRES_IMU",
        **columns(TIME, xacc=0.0, yacc=0.0, zacc=-force),
    )
    noise = 1e-3 * np.random.default_rng(5).standard_normal(
        len(telemetry.messages["ATTITUDE"]["time"])
    )
    return changed(telemetry, "ATTITUDE", rollspeed=noise)


def test_a_constant_supply_voltage_is_stated_as_unmeasured():
    light = power_light(evidence(telemetry_with("POWER_STATUS", Vcc=5000.0)))
    assert light.code is PowerLight.POWER_UNMEASURED
    assert "supply reads 5.00 V throughout" in light.sentence


@mark.slow
def test_wind_that_takes_half_of_the_most_lean_leaves_too_little():
    flight_evidence = evidence(recorded("sitl_events/ap_short_with_climb.tlog"))
    limits = {"ANGLE_MAX": 3000.0, "ATC_ANGLE_MAX": 30.0, "MPC_TILTMAX_AIR": 30.0}
    for lean_angle, level in ((14.0, "good"), (16.0, "watch")):
        lean = {"roll": MeanFigure(np.radians(lean_angle), None, 0.0)}
        leaning = replace(flight_evidence, condition=replace(flight_evidence.condition, lean=lean))
        for name, limit in limits.items():
            strong = replace(flight_evidence.signals.telemetry, parameters={name: limit})
            evidence_of_lean = replace(leaning, signals=Signals(strong))
            fact = wind_light(evidence_of_lean, estimator_light(evidence_of_lean))
            assert fact.level == level


@mark.slow
@mark.parametrize(
    "directions, last_speed, turn",
    [
        (
            (200.0, 310.0),
            5.3,
            "speed 5.6 m/s (5.2 to 6.0), turning from SSW (200°) ↑ to NW (310°) ↘, gusts",
        ),
        (
            (200.0, 310.0, 195.0),
            5.3,
            "turning from SSW (200°) ↑ to NW (310°) ↘ and then to SSW (195°) ↑, gusts to 7.0 m/s",
        ),
        ((200.0, 210.0), 3.0, None),
    ],
)
def test_the_light_of_a_wind_that_turned_names_the_speed_that_blew(directions, last_speed, turn):
    """The direction of the wind differs between minutes.

    The light names the directions, with the mean speed of the flight instead of the speed of the vector mean.
    """
    minutes = [{"speed": 5.9, "direction": direction} for direction in directions]
    minutes[-1]["speed"] = last_speed
    wind = partial_record(
        WindVelocity,
        speed=4.0,
        speed_interval=(3.6, 4.5),
        direction=262.0,
        direction_interval=4.0,
        mean_speed=np.mean([minute["speed"] for minute in minutes]),
        mean_speed_interval=(5.2, 6.0),
        gust=7.0,
        status={"speed": Status.REPORTED, "direction": Status.REPORTED},
        reasons={},
        drag=Drag.from_parameters(),
        minutes=tuple(minutes),
    )
    flight_evidence = replace(evidence(HOVER.telemetry()), wind=WindEvidence(wind, None, None))
    light = wind_light(flight_evidence, Fact(EstimatorLight.FILTER_AGREED, Level.GOOD))
    if turn is None:
        assert "turning" not in light.sentence
    else:
        assert turn in light.sentence


@mark.slow
@mark.parametrize(
    "interval, level", [((4.6, 6.5), "good"), ((0.5, 3.3), "good"), ((3.4, 9.9), "unknown")]
)
def test_a_wind_is_good_if_its_interval_is_no_wider_than_one_beaufort_number(interval, level):
    """The speed is biased, and its interval has a different width in each case.

    A wide interval leaves the light unknown unless the lean of the vehicle is small.
    """
    low, high = interval
    doubt = Fact(WindDoubt.SPEED_UNSURE, status=Status.BIASED, low=low, high=high, by_drag=True)
    figures = {
        "speed": (low + high) / 2,
        "speed_interval": interval,
        "mean_speed": (low + high) / 2,
        "mean_speed_interval": interval,
        "gust": 9.0,
        "direction": 82.0,
        "direction_interval": 8.0,
        "status": {"speed": Status.BIASED, "direction": Status.REPORTED},
        "reasons": {"speed": doubt},
        "drag": Drag.from_parameters(),
        "minutes": (),
    }
    wind = partial_record(WindVelocity, **figures)
    flight_evidence = evidence(HOVER.telemetry())
    flight_evidence = replace(flight_evidence, wind=WindEvidence(wind, None, None))
    light = wind_light(flight_evidence, Fact(EstimatorLight.FILTER_AGREED, Level.GOOD))
    assert light.level == level and ", by the drag of typical multirotors" in str(light)
    assert ("known only roughly" in str(light)) is (level == "unknown")
    assert light.remedy.startswith("Fly a box for a minute") is (level == "unknown")
    lean = {"roll": MeanFigure(np.radians(7.0), None, 0.0)}
    limited = replace(flight_evidence.signals.telemetry, parameters={"ATC_ANGLE_MAX": 35.0})
    leaning = replace(
        flight_evidence,
        signals=Signals(limited),
        condition=replace(flight_evidence.condition, lean=lean),
    )
    light_by_lean = wind_light(leaning, Fact(EstimatorLight.FILTER_AGREED, Level.GOOD))
    assert light_by_lean.level == "good"
    assert ("mean lean is 20 % of" in str(light_by_lean)) is (level == "unknown")
    drag = replace(wind.drag, source=DragSource.FLIGHT)
    own_drag = partial_record(WindVelocity, **(figures | {"drag": drag}))
    flight_evidence = replace(flight_evidence, wind=WindEvidence(own_drag, None, None))
    assert "typical" not in str(
        wind_light(flight_evidence, Fact(EstimatorLight.FILTER_AGREED, Level.GOOD))
    )


@mark.slow
def test_the_log_is_judged_by_its_rates_and_gaps():
    """The log is complete, slow, has a gap or dropouts, or lacks the attitude."""
    complete_telemetry = HOVER.telemetry(50.0, 50.0)
    time = HOVER.stamps(50.0)
    holed = HOVER.telemetry(time[(time < 30) | (time > 30.1 + MAX_GAP)], 50.0)
    for telemetry, code in (
        (complete_telemetry, LogLight.RECORDED_FAST),
        (HOVER.telemetry(10.0, 50.0), LogLight.RECORDED_SLOWLY),
        (holed, LogLight.RECORDED_WITH_GAPS),
        (replace(complete_telemetry, dropouts=3), LogLight.RECORDED_WITH_GAPS),
        (HOVER.telemetry(50.0, without=("ATTITUDE",)), LogLight.MOTION_NOT_RECORDED),
    ):
        fact = log_light(evidence(telemetry))
        assert fact.code is code
        if code is not LogLight.RECORDED_FAST:
            assert fact.remedy
        else:
            assert not fact.remedy
        if telemetry is holed:
            assert str(fact) == "The log has a gap: 1.1 s without attitude in flight."
            # A next step repeats the remedy where its reason does not stand.
            lost_attitude = "No attitude was received for 1.1 s in flight: bring the antennas"
            assert fact.remedy.startswith(lost_attitude)


@mark.parametrize(
    "margins, level",
    [
        (
            Fact(MarginsLight.MARGINS_UNKNOWN, reason=Fact(NotLearnableReason.STREAMS_TOO_SLOW)),
            "watch",
        ),
        (Fact(MarginsLight.MARGINS_UNKNOWN, reason=Fact(NotLearnableReason.TOO_SHORT)), "good"),
        (Fact(MarginsLight.NO_RESONANCE, Level.GOOD), "good"),
    ],
)
def test_slow_streams_are_to_be_watched_only_where_margins_are_lost_by_them(margins, level):
    fact = log_light(evidence(HOVER.telemetry(10.0, 50.0)), margins)
    assert (fact.code, fact.level) == (LogLight.RECORDED_SLOWLY, level)
    assert bool(fact.remedy) is (level == "watch")
    assert ("no judgement is lost" in str(fact)) is (level == "good")


@mark.parametrize("last_share, code", [(0.3, "commands_incomplete"), (0.7, "recorded_fast")])
def test_commands_that_end_early_in_flight_are_incomplete(last_share, code):
    time = HOVER.stamps(50.0)
    last_command = 6.0 + last_share * (HOVER.landed - 6.0)
    telemetry = HOVER.telemetry(50.0, time[time < last_command])
    landed_state = columns(HOVER.stamps(1.0), landed_state=np.where(HOVER.stamps(1.0) < 6.0, 1, 2))
    fact = log_light(evidence(changed(telemetry, "EXTENDED_SYS_STATE", **landed_state)))
    assert fact.code == code
    assert ("what the motors did" in fact.sentence) is (code == "commands_incomplete")


@mark.slow
def test_the_log_states_how_often_the_attitude_was_recorded():
    interpolated = Fact(Repair.ATTITUDE_INTERPOLATED, attitude_rate=20.0, rate=50.0)
    fact = log_light(evidence(replace(HOVER.telemetry(50.0, 50.0), repairs=(interpolated,))))
    assert fact.code is LogLight.RECORDED_FAST
    assert "50 Hz (models need 40 Hz), attitude at 20 Hz" in fact.sentence
    enough = interpolated.replace(attitude_rate=45.0)
    fact = log_light(evidence(replace(HOVER.telemetry(50.0, 50.0), repairs=(enough,))))
    assert fact.code is LogLight.RECORDED_FAST
    assert "Attitude at 45 Hz, commands at 50 Hz" in fact.sentence


def test_motor_outputs_that_the_demand_replaces_are_stated_with_their_rate():
    fact = log_light(evidence(with_demand(HOVER.telemetry(50.0, 10.0), 50.0)))
    assert fact.code is LogLight.RECORDED_FAST
    assert "the controller's demand" in fact.sentence and "commands" not in fact.sentence
    assert "motor outputs at 10 Hz" in fact.sentence


@mark.slow
def test_the_light_of_a_log_that_ends_in_the_air_says_so_unless_it_was_lost():
    judged = evidence(HOVER.telemetry(50.0, 50.0))
    ended = Fact(MotionEvent.LOG_ENDED_IN_AIR, time=36.5, boot=0, height=12.0, height_source="")
    assert log_light(replace(judged, events=(ended,))) is ended
    after_loss = ended.replace(is_after_loss=True)
    assert log_light(replace(judged, events=(after_loss,))).code is LogLight.RECORDED_FAST


@mark.slow
@mark.parametrize("least, is_suspect", [(BOARD_VOLTAGE_LIMITS.watch - 0.05, True), (5.0, False)])
def test_a_low_supply_is_the_suspected_reason_for_a_log_that_ends_in_the_air(least, is_suspect):
    volts = np.where(TIME > 30, least, 5.1)
    ended = Fact(MotionEvent.LOG_ENDED_IN_AIR, time=36.5, boot=0, height=12.0, height_source="")
    judged = evidence(telemetry_with("POWER_STATUS", Vcc=1000 * volts))
    (event,) = with_supply_as_suspect(replace(judged, events=(ended,)))
    # A low supply is an event as well, unless the autopilot's messages had it below the critical voltage already.
    low_supplies = [fact for fact in with_low_supply(judged) if fact is not event]
    assert [fact.code for fact in low_supplies] == [ReportedEvent.BOARD_VOLTAGE_LOW] * is_suspect
    assert with_low_supply(replace(judged, events=tuple(low_supplies))) == tuple(low_supplies)
    for low_supply in low_supplies:
        assert f"below {BOARD_VOLTAGE_LIMITS.watch:.2f} V" in low_supply.sentence
    assert ("board supply down to" in event.sentence) is is_suspect
    assert ("power module" in event.remedy) is is_suspect


def repair_of_skipped_bytes(count):
    """The repair of a DataFlash log of ten megabytes in which ``count`` bytes belong to no message."""
    return Fact(Repair.BYTES_SKIPPED, count=count, total=10_000_000, part="message")


@mark.slow
def test_damage_of_which_only_the_bytes_are_known_is_to_be_watched():
    """Damaged messages of DataFlash have no checksum, so that they count as bytes."""
    for count, code in (
        (90_000, LogLight.RECORDED_FAST),
        (1_200_000, LogLight.RECORDED_WITH_DAMAGE),
    ):
        light = log_light(
            evidence(
                replace(HOVER.telemetry(50.0, 50.0), repairs=(repair_of_skipped_bytes(count),))
            )
        )
        assert light.code is code
    assert str(light).startswith("Damaged: 1200000 bytes left out, 12 % of the log. What is left")


@mark.slow
def test_the_light_of_the_log_states_what_was_lost_by_damage():
    """Logs with each kind of damage are judged as sound ones are, with the loss stated first.

    A cut last message and a foreign dialect are no damage.
    """
    damage = Fact(Repair.ULOG_DAMAGED, Level.WATCH, count=640, places=10, duration=0.25)
    slow = HOVER.telemetry(10.0, 50.0)
    for telemetry in (HOVER.telemetry(50.0, 50.0), slow, replace(slow, dropouts=3)):
        sound = log_light(evidence(telemetry))
        damaged = log_light(evidence(replace(telemetry, repairs=(damage,))))
        assert damaged.code is sound.code
        assert str(damaged) == f"Damaged: 640 bytes, 0.25 s lost. {sound}"
    for repairs, statement in (
        ([repair_of_skipped_bytes(5000)], "5000 bytes left out"),
        (
            [
                Fact(Repair.FRAMES_LEFT_OUT, count=2, flaw=Flaw.DAMAGE),
                repair_of_skipped_bytes(400),
            ],
            "400 bytes and 2 frames left out",
        ),
        ([Fact(Repair.CHUNKS_DAMAGED, count=1, size=900, duration=1.5)], "900 bytes, 1.5 s lost"),
    ):
        judged = evidence(replace(slow, repairs=tuple(repairs)))
        damaged = log_light(replace(judged, log=replace(judged.log, frames=1000)))
        assert str(damaged) == f"Damaged: {statement}. {log_light(evidence(slow))}"
    last_message_cut = repair_of_skipped_bytes(MAX_CUT_BYTES)
    assert "Damaged" not in str(log_light(evidence(replace(slow, repairs=(last_message_cut,)))))
    other_dialect = Fact(Repair.FRAMES_LEFT_OUT, count=2, flaw=Flaw.ANOTHER_DIALECT)
    assert "Damaged" not in str(log_light(evidence(replace(slow, repairs=(other_dialect,)))))
    fast = HOVER.telemetry(50.0, 50.0)
    for count, code in ((5, LogLight.RECORDED_FAST), (150, LogLight.RECORDED_WITH_DAMAGE)):
        repair = Fact(Repair.FRAMES_LEFT_OUT, count=count, flaw=Flaw.DAMAGE)
        judged = evidence(replace(fast, repairs=(repair,)))
        light = log_light(replace(judged, log=replace(judged.log, frames=1000)))
        assert light.code is code
    assert str(light).startswith("Damaged: 150 frames left out, 15 % of the log. What is left")
    assert light.level is Level.WATCH and light.remedy.startswith("Copy the log anew")
    long_damage = Fact(Repair.ULOG_DAMAGED, Level.WATCH, count=640, places=1, duration=195.4)
    assert "195 s lost" in str(log_light(evidence(replace(slow, repairs=(long_damage,)))))
    assert "195 s of the log" in long_damage.sentence
    assert "1 byte was left out" in long_damage.replace(count=1).sentence


def telemetry_with_drift_at_rest(change, rate=50.0):
    """Returns the hover with a roll rate that drifts on the ground by ``change``, rad/s, each fiftieth of a second."""
    telemetry = HOVER.telemetry(rate, 50.0)
    attitude = telemetry.messages["ATTITUDE"]
    ground = 50.0 * change * attitude["time"]
    turning = np.where(attitude["time"] < 5.0, ground, attitude["rollspeed"])
    return changed(telemetry, "ATTITUDE", rollspeed=turning)


def telemetry_with_text(text):
    """Returns telemetry of a hover whose autopilot sends a text at boot."""
    time = np.array([1.0])
    texts = columns(time, severity=[6], text=[text.encode()])
    return changed(HOVER.telemetry(20.0, 20.0), "STATUSTEXT", **texts)


@mark.slow
def test_what_shows_that_a_flight_was_simulated():
    """Parameters and messages of simulators, names, texts, and a gyro with too little drift show a simulated flight."""
    telemetry = HOVER.telemetry(20.0, 20.0)
    other_text = telemetry_with_text("Not Simulated by mavdem")
    for real in (
        telemetry,
        telemetry_with_drift_at_rest(5.1e-5),
        telemetry_with_drift_at_rest(5.1e-5, 100.0),
        telemetry_with_drift_at_rest(0.0),
        other_text,
        replace(telemetry, autopilot="PX4", parameters={"SIM_BAT_DRAIN": 60.0, "SIM_GZ_EN": 0.0}),
    ):
        assert simulation_fact(evidence(real).signals) is None
    for differences, kind in (
        ({"parameters": {"SYS_HITL": 1.0}}, Simulator.HARDWARE),
        ({"parameters": {"SIM_WIND_SPD": 5.0}}, Simulator.SOFTWARE),
        ({"autopilot": "PX4", "parameters": {"SIM_GZ_EN": 1.0}}, Simulator.SOFTWARE),
        ({"parameters": {"SYS_AUTOSTART": 10040.0}}, Simulator.SOFTWARE),
        ({"parameters": {"CAL_GYRO0_ID": 1310988.0}}, Simulator.SOFTWARE),
        ({"hardware": "PX4_SITL"}, Simulator.SOFTWARE),
        # The columns of the message do not matter.
        (
            {"messages": {**telemetry.messages, "SIMSTATE": telemetry.messages["ATTITUDE"]}},
            Simulator.SOFTWARE,
        ),
        (
            {"messages": telemetry_with_drift_at_rest(MAX_SIMULATED_RATE_CHANGE / 2).messages},
            Simulator.SOFTWARE,
        ),
        (
            {"messages": telemetry_with_text("Simulated by mavdem, frame QUAD_X").messages},
            Simulator.SOFTWARE,
        ),
    ):
        fact = simulation_fact(evidence(replace(telemetry, **differences)).signals)
        assert (fact.code, fact.figures["kind"]) == (LogLight.SIMULATED, kind)
