"""The wind in m/s: made-up flights with known drag, recorded ones that something is done to, and what is no flight."""

from dataclasses import replace
from functools import cache
from unittest.mock import Mock

import numpy as np
from hover import Hover, changed, columns
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from partial_records import partial_record
from pytest import approx, fixture, mark, raises
from recorded_flights import recorded, shared
from refusals import refused
from scipy.interpolate import interp1d
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import mavdem
from mavdem.assessment.assess import without_flight_advice
from mavdem.dataset.position_fix import measures_velocity
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.facts.online import AirflowFact, DragSource
from mavdem.facts.sources import Repair
from mavdem.facts.wind import NoWind, WindAdvice, WindDoubt, WindLight, WindShare
from mavdem.ingest import read_log
from mavdem.live.session_status import SessionStatus
from mavdem.live.wind import LiveWind
from mavdem.report.blocks import plain_text
from mavdem.report.condition import wind_blocks, wind_tables
from mavdem.report.pages import wind_page
from mavdem.report.screen import remarks_on_wind
from mavdem.wind_velocity.compass import meteorological_direction
from mavdem.wind_velocity.estimate_resets import YAW_RESET, estimate_resets, is_position_reset
from mavdem.wind_velocity.from_log import (
    WindEvidence,
    drag_settings,
    wind_evidence,
    wind_of_signals,
)
from mavdem.wind_velocity.ground_motion import recorded_ground_motion
from mavdem.wind_velocity.identifiability import speed_status
from mavdem.wind_velocity.mean_wind import _layer_rows, lower_speed_bound
from mavdem.wind_velocity.torque_share import torque_share_of_wind
from mavdem.wind_velocity.vehicle_drag import Drag, drag_model_setting
from mavdem.wind_velocity.velocity import WindVelocity

LINEAR = np.array([0.3, 0.24])
QUADRATIC = np.array([0.01, 0.016])


def flight(
    legs=5.0,
    turning=0.05,
    seed=0,
    wind=(-3.0, 4.0),
    gusts=0.5,
    lean=(0.0, 0.0),
    jump=0.0,
    seconds=120,
):
    """Time, attitude, velocity and wind at 10 Hz of legs of 10 s there and back, in gusts of 3 s."""
    rng = default_rng(seed)
    time = np.arange(0, seconds, 0.1)
    white = rng.standard_normal((2, len(time) + 200))
    gust = lfilter([1], [1, -np.exp(-0.1 / 3)], white)[:, 200:].T
    air = np.outer(1 + jump * (time > seconds / 2), wind) + gusts * gust / gust.std()
    course = np.floor(time / 20) * np.pi / 2 + np.pi * (time % 20 > 10)
    legs_flown = legs * np.column_stack([np.cos(course), np.sin(course), 0 * time])
    # A mean of the 2 s before.
    velocity = uniform_filter1d(legs_flown, 20, 0, mode="nearest", origin=9)
    # The thrust is what drag and gravity leave of the acceleration, and body z is against it.
    needed = np.gradient(velocity, time, axis=0) - [0, 0, 9.80665]
    level = (0, 0), (0, 1)
    u = velocity - np.pad(air, level)
    drag = 0
    heading = Rotation.from_euler("z", (turning * time)[:, np.newaxis])
    for _ in range(8):
        forward, right, down = heading.apply(drag - needed, inverse=True).T
        pitch = np.arctan2(forward, down)
        roll = -np.arctan2(right, np.hypot(forward, down))
        body = heading * Rotation.from_euler("YX", np.column_stack([pitch, roll]))
        along = body.apply(u, inverse=True)[:, :2]
        force = lean - (LINEAR + QUADRATIC * np.hypot(*along.T)[:, None]) * along
        drag = body.apply(np.pad(force, level))
    attitude = np.column_stack([roll, pitch, turning * time])
    return time, attitude, velocity + 0.02 * rng.standard_normal(velocity.shape), air


@mark.parametrize(
    ("changes", "parameters", "code"),
    [
        ({"fix_type": 1, "satellites_visible": 5}, {}, NoWind.NO_POSITION_FIX),
        ({"fix_type": 3, "satellites_visible": 0}, {}, NoWind.NO_POSITION_FIX),
        ({}, {"GPS_TYPE": 0.0}, NoWind.NO_POSITION_FIX),
        ({}, {"GPS_TYPE": 0.0, "FLOW_TYPE": 1.0}, None),
        ({"fix_type": 3, "satellites_visible": 9}, {}, None),
    ],
)
def test_without_a_position_fix_there_is_no_wind(changes, parameters, code):
    """The velocity counts as measured only with a GPS fix, or with optical flow."""
    telemetry = Hover().telemetry(20.0, 20.0, parameters=parameters)
    stamps = Hover().stamps(5.0)
    if changes:
        fields = {name: np.full(len(stamps), value) for name, value in changes.items()}
        telemetry = changed(telemetry, "GPS_RAW_INT", **columns(stamps, **fields))
    known = measures_velocity(telemetry, 0, stamps)
    assert known.all() == (code is None) and known.any() == (code is None)
    drift = columns(stamps, x=stamps, y=stamps, z=-stamps, vx=stamps, vy=stamps, vz=stamps)
    evidence = wind_evidence(Signals(changed(telemetry, "LOCAL_POSITION_NED", **drift)))
    if code is not None:
        assert evidence.reason.code is code


def test_a_velocity_that_comes_too_slowly_is_the_reason_for_no_wind():
    stamps = np.arange(0.0, Hover().end, 1.6)
    slow = columns(stamps, z=-stamps, vx=stamps, vy=stamps, vz=stamps)
    telemetry = changed(Hover().telemetry(20.0, 20.0), "LOCAL_POSITION_NED", **slow)
    reason = wind_evidence(Signals(telemetry)).reason
    assert reason.code is NoWind.NO_FLIGHT_WITH_VELOCITY
    assert "came every 1.6 s" in reason.sentence and "at least every 1.5 s" in reason.sentence
    often = Hover().stamps(3.0)
    velocity = dict.fromkeys(("vx", "vy", "vz"), 100.0)
    telemetry = changed(
        telemetry, "GLOBAL_POSITION_INT", **columns(often, relative_alt=5e3, **velocity)
    )
    motion = recorded_ground_motion(telemetry)
    assert_array_equal(motion.time, often)
    assert_array_equal(motion.values, [[1.0, 1.0, 1.0, 5.0]] * len(often))


def test_a_log_without_a_receiver_is_refused_for_that():
    stamps = Hover().stamps(5.0)
    drift = columns(stamps, z=-stamps, vx=stamps, vy=stamps, vz=stamps)
    telemetry = changed(Hover().telemetry(20.0, 20.0), "LOCAL_POSITION_NED", **drift)
    telemetry = changed(telemetry, "EKF_STATUS_REPORT", **columns(stamps, flags=0))
    reason = wind_evidence(Signals(telemetry)).reason
    assert reason.sentence.startswith("No GPS in this log") and "GPS" in reason.remedy


def test_a_flight_without_a_fix_has_no_wind_for_that_reason():
    telemetry = Hover().telemetry(20.0, 20.0, autopilot="PX4")
    stamps = Hover().stamps(5.0)
    invalid = columns(stamps, z=-stamps, vx=stamps, vy=stamps, vz=stamps, valid=False)
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", **invalid)
    assert wind_evidence(Signals(telemetry)).reason.code is NoWind.NO_FLIGHT_WITH_VELOCITY
    searching = columns(stamps, fix_type=0, satellites_visible=2)
    reason = wind_evidence(Signals(changed(telemetry, "GPS_RAW_INT", **searching))).reason
    assert (reason.code, reason.figures["satellites"]) == (NoWind.NO_POSITION_FIX, 2)


@mark.slow
def test_legs_show_wind_drag_and_lean():
    wind = mavdem.estimate_wind(*flight(lean=(0.2, -0.1), seconds=240, gusts=0.3)[:3])
    assert set(wind.status.values()) == {"reported"} and not wind.reasons
    assert abs(wind.speed - 5) < 0.6 and abs(wind.direction - meteorological_direction(-3, 4)) < 10
    assert abs(wind.drag.lean - [0.2, -0.1]).max() < 0.1
    low, high = wind.drag.interval("linear")
    assert np.all(low < LINEAR) and np.all(high > LINEAR)


@mark.slow
def test_band_holds_and_a_jump_is_followed():
    """The wind jumps at 60 s. The 90 % band of the estimate contains the simulated wind, and gusts are found."""
    time, attitude, velocity, air = flight(seed=7, jump=1.0)
    wind = mavdem.estimate_wind(time, attitude, velocity, height=5.0 + 10 * (time > 60))
    true = interp1d(time, air, axis=0)(wind.time)
    assert 0.8 < np.mean(abs(wind.velocity - true) <= wind.band) <= 1.0
    speeds = np.hypot(*wind.velocity.T)
    assert speeds[wind.time < 55].mean() < 6.5 and speeds[wind.time > 65].mean() > 8.5
    gusts = uniform_filter1d(np.hypot(*air.T), 30)
    assert wind.gust_interval[0] < gusts.max() < wind.gust_interval[1] < 1.5 * gusts.max()
    # The strongest gust is found where it blew, and its time is shown.
    assert wind.gust_time == approx(time[gusts.argmax()], abs=2.0)
    blocks = wind_blocks(WindEvidence(wind, None, None))
    assert f"at {wind.gust_time:.0f} s" in blocks[0].text
    assert wind.lull == approx(gusts[15:-15].min(), abs=1.0)
    assert f"lulls to {wind.lull:.1f} m/s" in blocks[0].text
    # A jump in a flight of little more than a minute is seen in its parts.
    short = mavdem.estimate_wind(*(values[200:1000] for values in (time, attitude, velocity)))
    assert [round(one["speed"] / 5) for one in short.minutes] == [1, 2]
    assert "the mean is from 0 to 119 s; each" in blocks[1].text
    assert wind.gust > 9 and [round(one["speed"] / 5) for one in wind.minutes] == [1, 2]
    assert np.diff([(one["start"], one["end"]) for one in wind.minutes]) == approx(60.0, abs=1.0)
    layers = [(one["height"], round(one["speed"] / 5)) for one in wind.profile]
    assert layers == [(5.0, 1), (15.0, 2)]


@mark.slow
@mark.parametrize("legs", [5.0, 0.0])
def test_the_torque_share_is_known_where_the_air_velocity_along_the_body_changes(legs):
    time, attitude, velocity, _ = flight(legs=legs, turning=0.0, seed=5, seconds=80)
    wind = mavdem.estimate_wind(time, attitude, velocity)
    noise = default_rng(0).normal(0.0, 2.0, len(time))
    by_wind = np.interp(time, wind.time, wind.along[:, 1]) * (legs > 0)
    explained = torque_share_of_wind(wind, time, by_wind + noise)
    assert explained.code is (WindShare.SHARE_KNOWN if legs else WindShare.SHARE_UNKNOWN)
    assert explained.figures["share"] == (approx(0.98, abs=0.02) if legs else None)
    chance = torque_share_of_wind(wind, time, default_rng(1).normal(size=len(time)))
    assert not chance.figures["share"]


@mark.parametrize("size, code", [(0.9, WindShare.SHARE_UNKNOWN), (1.1, WindShare.SHARE_KNOWN)])
def test_air_along_the_body_that_changes_by_less_than_1_m_s_explains_nothing(size, code):
    time = np.arange(0.0, 120.0, 0.1)
    along = np.outer(size * np.sign(np.sin(2 * np.pi * (time + 1) / 30)), [1.0, 0.0])
    wind = partial_record(WindVelocity, time=time, along=along)
    assert torque_share_of_wind(wind, time, along[:, 0]).code is code


@mark.parametrize(
    "speed, half, status",
    [
        (3.0, 0.69, "reported"),
        (3.0, 0.71, "biased"),
        (10.0, 1.19, "reported"),
        (10.0, 1.21, "biased"),
        (9.0, 6.99, "biased"),
        (9.0, 7.01, "not identifiable"),
        (0.0, 3.29, "biased"),
        (0.0, 3.31, "not identifiable"),
    ],
)
def test_the_band_of_a_speed_is_0_7_m_s_or_12_percent_and_at_most_a_factor_of_eight(
    speed, half, status
):
    assert speed_status(speed, speed - half, speed + half) == status


def certainty(wind):
    """What a report says of how certain a wind is."""
    blocks = wind_blocks(WindEvidence(wind, None, None))
    return next(block.text for block in blocks if block.lead == "How certain:")


@mark.parametrize("level", [Level.GOOD, Level.WATCH])
def test_the_lean_that_the_wind_took_is_said_and_warns_where_it_is_large(level):
    wind = Fact(WindLight.WIND_BLEW, level, calm=False, share=0.4, reason=None)
    estimator = Fact(WindLight.WIND_NOT_KNOWN, Level.GOOD)
    judgement = Mock(lights={Light.WIND: wind, Light.ESTIMATOR: estimator})
    (lean,) = remarks_on_wind(judgement)
    assert "40 % of the lean allowed" in lean.text
    warns = level is Level.WATCH
    assert ("Fly in less wind" in lean.text) is warns and (lean.level is Level.WATCH) is warns


@mark.parametrize("source", DragSource)
def test_a_drag_that_the_flight_does_not_show_is_said_to_be_of_another_source(source):
    figures = {"relative_sd": 0.5, "steered": 0.1, "ground_speed": 1.0, "source": source}
    doubt = Fact(WindDoubt.DRAG_UNSURE, status=Status.NOT_IDENTIFIABLE, **figures)
    *_, sentence_on_source = doubt.sentence.split(". ")
    assert sentence_on_source.startswith("The drag") and "_" not in sentence_on_source


def test_parts_of_a_flight_without_a_wind_estimate_are_marked():
    time = np.concatenate([np.arange(10.0, 20.0, 0.5), np.arange(30.0, 40.0, 0.5)])
    parts = wind_page._intervals_without_wind(time, span=(0.0, 50.0))
    assert parts == ((0.0, 10.0), (19.5, 30.0), (39.5, 50.0))


@mark.slow
def test_hover_takes_the_drag_of_another_flight():
    """A hover does not show its drag: the drag of another flight makes the wind precise."""
    hover = flight(legs=0.0, turning=0.0, seed=3)[:3]
    alone = mavdem.estimate_wind(*hover)
    drag = mavdem.estimate_drag(*flight(seed=4))
    assert alone.status["drag"] == "not identifiable"
    assert alone.status["speed"] != "reported"
    # The condition of the intervals is the same for every flight, and another one with the drag of an earlier flight.
    assert "if the drag is that of typical multirotors (linear 0.1 to 0.8 1/s)" in certainty(alone)
    alone = replace(alone, status=alone.status | {"speed": Status.NOT_IDENTIFIABLE})
    assert "known only very roughly" in wind_blocks(WindEvidence(alone, None, None))[0].text
    blocks = alone.without_unidentified_speeds
    assert np.isnan(blocks.speed) and not blocks.velocity
    assert {doubt.code for doubt in alone.reasons.values()} == set(WindDoubt)
    assert alone.drag.source == "population" and all(map(str, alone.reasons.values()))
    assert abs(drag.linear / LINEAR - 1).max() < 0.2
    known = mavdem.estimate_wind(*hover, drag=Drag.from_dict(drag.as_dict()))
    widths = [np.diff(one.speed_interval)[0] for one in (known, alone)]
    assert abs(known.speed - 5) < 0.7 and widths[0] < 0.6 * widths[1]
    # What was advised does what it was to do: flight in several directions with turns of the heading.
    advised = mavdem.estimate_wind(*flight(seed=5)[:3]).drag.for_next_flight()
    with_prior = mavdem.estimate_wind(*hover, drag=advised)
    assert "if the vehicle has the drag of the earlier flight" in certainty(with_prior)
    low, high = with_prior.speed_interval
    rough = replace(with_prior, mean_speed=5.0, mean_speed_interval=(2.2, 7.8))
    headline = wind_blocks(WindEvidence(rough, None, None))[0].text
    assert headline.startswith("mean speed about 5.0 m/s (2.2 to 7.8, known only roughly)")
    assert alone.advice.code is WindAdvice.FLY_BOX
    assert (high - low) / 2 == approx(alone.advice.figures["expected_speed_error"], rel=0.4)
    # After a crash the advice is for the time after the repair.
    grounded = without_flight_advice(WindEvidence(alone, None, None))
    (advice,) = [block for block in wind_blocks(grounded) if block.lead == "To know it better:"]
    assert advice.text.startswith("Once the vehicle may fly again, fly a box")
    assert not any(
        "Fly" in reason.sentence_and_remedy for reason in grounded.estimate.reasons.values()
    )


@mark.slow
def test_calm_air_is_below_a_speed():
    """In nearly still air only an upper end of the speed is known, and no direction."""
    wind = mavdem.estimate_wind(*flight(wind=(0, 0), gusts=0.05, seconds=80)[:3])
    assert wind.calm and wind.speed < 0.7 and wind.speed_interval[0] == 0
    # Still air has no gusts either.
    assert wind.gust_interval[0] == 0 < wind.gust
    assert lower_speed_bound(0.6, 6.0)
    autopilot_wind = TimeSeries(
        wind.time, np.zeros(len(wind.time), int), np.ones((len(wind.time), 2))
    )
    blocks = wind_blocks(WindEvidence(wind, autopilot_wind, None))
    assert any("own estimate, 1.4 m/s from the south-west (225°)" in block.text for block in blocks)
    of_other_boot = replace(autopilot_wind, boot=autopilot_wind.boot + 1)
    blocks = wind_blocks(WindEvidence(wind, of_other_boot, None))
    assert not any("own estimate" in block.text for block in blocks)
    # Where the autopilot makes none, the setting is named with which it does.
    setting = drag_model_setting("PX4", {})
    blocks = wind_blocks(WindEvidence(wind, None, None, setting))
    assert any("(EKF2_DRAG_CTRL 1 switches it on)" in block.text for block in blocks)
    blocks = wind_blocks(WindEvidence(wind, None, None, setting, "WIND"))
    assert any("nothing, since WIND is always 0 (" in block.text for block in blocks)
    course = tuple(
        {
            "start": 60.0 * i,
            "end": 60.0 * i + 59,
            "speed": i,
            "low": i / 2,
            "high": 2.0 * i,
            "direction": 90.0,
        }
        for i in range(10)
    )
    # The vehicle was on the ground from 130 to 145 s.
    times = np.arange(600.0)
    in_air = (times <= 130) | (times >= 145)
    (table,) = wind_tables(replace(wind, minutes=course, profile=(), time=times[in_air]))
    # The direction of a wind that may be still air is not shown, and the mounting is no reason for that.
    assert "Still air" in wind.reasons["direction"].sentence
    assert table.header == ["Time (s)", "Vector mean (m/s)"]
    first_cells = [row[0] for row in table.rows]
    assert first_cells[1:4] == ["60–119", "120–179 (44 s of it)", "180–239"]
    assert len(first_cells) == len(course)
    assert table.rows[3][1] == "3.0 (1.5 to 6.0)"


@mark.slow
def test_a_wind_that_turned_is_told_with_its_speed_beside_that_of_its_mean():
    """The means of minutes differ in direction, so that the speed of the mean is lower than the mean speed."""
    wind = mavdem.estimate_wind(*flight(wind=(0, -5), gusts=0.5, seconds=60)[:3])
    assert wind.direction_identifiable

    def lead_sentence(vector_speed, speeds, directions=(240.0, 300.0)):
        minutes = tuple(
            {
                "start": 60.0 * i,
                "speed": speed,
                "low": 4.0,
                "high": 6.0,
                "direction": direction,
            }
            for i, (speed, direction) in enumerate(zip(speeds, directions, strict=False))
        )
        turned = replace(wind, speed=vector_speed, mean_speed=5.2, minutes=minutes)
        return wind_blocks(WindEvidence(turned, None, None))[0].text

    low, high = wind.mean_speed_interval
    mean_speed = f"mean speed 5.2 m/s ({low:.1f} to {high:.1f})"
    expected_text = (
        f"{mean_speed}, which turned from the west-south-west (240°) to the west-north-west (300°), "
        "so that its vector mean is only 4.7 m/s ("
    )
    assert lead_sentence(4.7, [5.3, 5.1]).startswith(expected_text)
    expected_text = f"{mean_speed}, which turned from the north (350°) to the east (90°) and then to the north (5°),"
    assert expected_text in lead_sentence(2.0, [5.3, 5.2, 5.1], (350.0, 90.0, 5.0))
    expected_text = f"{mean_speed}, which turned from the north (350°) to the south (175°),"
    assert expected_text in lead_sentence(2.0, [5.3, 5.2, 5.1], (350.0, 170.0, 175.0))
    steady = lead_sentence(5.1, [5.3, 5.1])
    assert "turned" not in steady
    assert steady.startswith(f"{mean_speed} from the ")
    assert "turned" not in lead_sentence(4.7, [5.3])


@mark.slow
def test_a_loss_of_control_is_no_gust():
    """What follows an attitude far from its setpoint is left out, and the report says so once."""
    estimate = mavdem.wind(shared("real/logs/no_fault_while_yawing.BIN"))
    ((start, end),) = estimate.left_out
    # The attitude of this flight misses its setpoint from 352 s on, by up to 50°.
    assert start < 352 < end and estimate.time[-1] <= start
    text = plain_text(wind_blocks(WindEvidence(estimate, None, None)))
    assert text.count(f"{start:.0f} to {end:.0f} s, within 10 s of an attitude far") == 1


def test_what_is_no_free_flight_is_refused():
    """Velocities do not fit the lean, angles are unknown, or the motion is too short."""
    time, attitude, velocity, air = flight(seconds=60)
    wind = mavdem.estimate_wind
    assert refused(wind, time, attitude, 0.01 * velocity).code is AirflowFact.VELOCITY_INCONSISTENT
    assert (
        refused(wind, time, attitude * [1, 1, np.nan], velocity).code is AirflowFact.MOTION_UNKNOWN
    )
    for rows, stamps in ((100, time), (12, time), (12, time / 5), (12, 0 * time)):
        short = (stamps[:rows], attitude[:rows], velocity[:rows])
        assert refused(wind, *short).code is AirflowFact.MOTION_TOO_SHORT
    short = (column[:140] for column in (time, attitude, velocity, air))
    assert refused(mavdem.estimate_drag, *short).code is AirflowFact.MOTION_TOO_SHORT
    with raises(ValueError, match="degrees"):
        mavdem.estimate_wind(time, np.degrees(attitude), velocity)


@mark.slow
def test_quick_tilts_between_slow_samples_do_not_make_a_flight_a_held_vehicle():
    time = np.arange(0, 60, 0.01)
    phase = time % 1.2
    roll = np.where(phase < 0.1, 0.25, np.where(phase < 0.2, -0.25, 0.0))
    east = np.cumsum(9.81 * np.tan(roll)) * 0.01
    attitude, velocity = (np.zeros((len(time), 3)) for _ in range(2))
    attitude[:, 0], velocity[:, 1] = roll, east
    slow = slice(None, None, 23)
    assert mavdem.estimate_wind(time[slow], attitude[slow], velocity[slow]).speed_interval[0] == 0.0
    assert refused(mavdem.estimate_wind, time, attitude, 0.01 * velocity).code is (
        AirflowFact.VELOCITY_INCONSISTENT
    )


@mark.slow
def test_the_drag_of_fast_laps_is_searched_until_it_is_found():
    # Hardly accelerating, it needs 5.5 m/s² at 14.5 m/s against the wind, and 4.2 m/s² at 19.6 m/s with it: 4.8 m/s.
    wind = mavdem.wind(shared("real/logs/px4_crash_hovers_at_12_percent.ulg"))
    assert wind.speed_interval[0] < 4.8 < wind.speed_interval[1]
    assert abs(wind.direction - 85) < 15


def test_resets_are_no_motion():
    yaw = np.array([6.2, 0.1, 0.2, 1.4, 1.5])  # Past north, and then a reset.
    assert np.flatnonzero(estimate_resets(0.1 * np.arange(5.0), yaw, YAW_RESET, 2 * np.pi)) == [2]
    # Half a second at 3 m/s is 1.5 m; what is 1 m, and 2 m/s, off that is a reset.
    ways = np.array([-0.6, -0.4, 3.4, 3.6])
    assert is_position_reset(ways, 2.0, 4.0, 0.5).tolist() == [True, False, False, True]
    indoors = shared("real/logs/px4_two_armed_times.ulg")  # Its v_xy_valid is 0.
    refusal = refused(mavdem.wind, indoors)
    assert refusal.code is NoWind.NO_FLIGHT_WITH_VELOCITY
    assert refusal.figures["airborne"] == 0.0


@mark.slow
def test_velocity_of_another_core_stands_in_for_the_primary_s():
    log = read_log(shared("sitl_events/ap_quiet10.BIN"))
    (vehicle,) = log.vehicles
    (repair,) = [fact for fact in vehicle.repairs if fact.code is Repair.OTHER_CORE_READ]
    assert "XKF1[1]" in repair.figures["names"]
    # The velocity comes several times a second from take-off to landing.
    motion = recorded_ground_motion(vehicle)
    attitude_time = vehicle.messages["ATTITUDE"]["time"]
    assert np.isfinite(motion.values).all() and np.diff(motion.time).max() < 1.0
    assert np.ptp(motion.time) > 0.9 * np.ptp(attitude_time)


@mark.in_full
def test_solo_beside_an_anemometer():
    """A real hover beside an anemometer: drag from the first half, wind in the second half.

    Means of 10 s agree to 0.6 m/s, of 60 s to 0.4 m/s.
    """
    path = shared("real/wind/solo_sonic_1hz.csv")
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding=None)
    stamps = np.array([np.datetime64(one[:19]) for one in table["datetime"]]).astype(float)
    attitude = np.radians(np.column_stack([table["solo_roll"], table["solo_pitch"], 0 * stamps]))
    true = -table["sonic_wind"] * np.exp(1j * np.radians(table["sonic_wind_dir"]))
    air = np.column_stack([true.real, true.imag])
    first, second = np.array_split(np.arange(len(stamps)), 2)
    hovers = [(stamps[part], attitude[part], 0 * attitude[part]) for part in (first, second)]
    drag = mavdem.estimate_drag(*hovers[0], air[first])
    wind = mavdem.estimate_wind(*hovers[1], drag=drag)
    estimate = np.interp(stamps[second], wind.time, wind.velocity @ [1, 1j])
    for seconds, most in ((10, 0.6), (60, 0.4)):
        whole = len(estimate) // seconds * seconds
        means = (
            np.array([estimate[:whole], true[second][:whole]]).reshape(2, -1, seconds).mean(axis=2)
        )
        assert np.sqrt(np.mean(np.diff(abs(means), axis=0) ** 2)) < most
    assert np.degrees(np.sqrt(np.mean(np.angle(means[0] / means[1]) ** 2))) < 10


@cache
def drag_in_a_jump_of_the_wind():
    """The drag of a flight whose wind is known and jumps in its middle."""
    return mavdem.estimate_drag(*flight(seed=7, jump=1.0))


@mark.slow
@mark.parametrize(
    "scale, why", [(1.0, ""), (0.01, "does not follow the tilt"), (0.0, "never changes")]
)
def test_live_rows_are_of_free_flight_only(scale, why):
    """The live estimate follows a simulated wind; it refuses velocities that do not fit the lean."""
    time, attitude, velocity, air = flight(seed=7, jump=1.0)
    live = LiveWind()
    live.earlier_drag = drag_in_a_jump_of_the_wind()
    inside = []
    downs_first = np.roll(scale * velocity, 1, axis=1)
    for at, angles, moved in zip(time, attitude, downs_first, strict=True):
        live.add_attitude(at, *angles)
        live.add_velocity("LOCAL_POSITION_NED", at, moved)
        if row := live.latest:
            inside.append(abs(row.velocity - air[time > row.time][0]) < row.band)
    if why:
        assert why in str(live.no_estimate_reason)
        assert live.latest is None
        assert live.mean is None
    else:
        assert live.latest is not None
        assert np.mean(inside) > 0.8
        light = live.mean.light.figures
        assert light["low"] < np.hypot(*air.mean(axis=0)) < light["high"] and not light["calm"]


@mark.slow
@mark.parametrize("lean, seconds, refused", [(27, 8, True), (27, 4, False), (23, 8, False)])
def test_a_vehicle_that_something_holds_shows_no_wind(lean, seconds, refused):
    """The vehicle leans by 27° for 8 s and its position does not change: something holds it."""
    telemetry = recorded("sitl_events/ap_short_with_climb.tlog")
    attitude = telemetry.messages["ATTITUDE"]
    place = telemetry.messages["LOCAL_POSITION_NED"]

    def held(table, column, value):
        is_held = abs(table["time"] - 80 - seconds / 2) < seconds / 2
        return np.where(is_held, value, table[column])

    leaning = changed(telemetry, "ATTITUDE", roll=held(attitude, "roll", np.radians(lean)))
    fixed = {axis: held(place, axis, 0.0) for axis in "xyz"}
    reason = wind_evidence(Signals(changed(leaning, "LOCAL_POSITION_NED", **fixed)))[2]
    code = None if reason is None else reason.code
    if refused:
        assert code is NoWind.STUCK
    else:
        assert code is not NoWind.STUCK


@mark.slow
def test_a_missing_yaw_and_a_ground_spin_are_left_out_and_a_clock_jump_is_refused():
    """Single yaws are wrong, yaw jumps on the ground, or the clock jumps by three weeks."""
    telemetry = recorded("sitl_events/ap_short_with_climb.tlog")
    columns = telemetry.messages["ATTITUDE"]

    def found(**values):
        return wind_of_signals(Signals(changed(telemetry, "ATTITUDE", **values)))

    yaw = np.where(np.arange(len(columns["yaw"])) % 50, columns["yaw"], 1e30)
    sound = found()
    assert found(yaw=yaw).speed == approx(sound.speed, abs=0.1)
    middle = np.median(columns["time"])
    spun = columns["yaw"] + 2.0 * (columns["time"] > 120)
    reset = columns["yaw"] + 2.0 * (columns["time"] < 60)
    assert drag_settings(sound.drag, telemetry) and not drag_settings(
        Drag.validated_or_population(None), telemetry
    )
    assert found(yaw=spun).speed == sound.speed
    assert found(yaw=reset).time[0] > 60 > sound.time[0]
    late = {
        name: table | {"time": table["time"] + 2e6 * (table["time"] > middle)}
        for name, table in telemetry.messages.items()
    }
    late = Signals(replace(telemetry, messages=late))
    assert refused(wind_of_signals, late).code is NoWind.CLOCK_JUMPS
    without_motion = Signals(changed(telemetry, "LOCAL_POSITION_NED", vx=0.0))
    assert refused(wind_of_signals, without_motion).code is NoWind.NOT_MEASURED


@fixture(scope="module")
def wind_of_hover(fits_once):
    """The estimated wind of a hover, at two heights, in a wind that jumps when the height does."""
    time, attitude, velocity, _ = flight(legs=0.0, turning=0.0, jump=1.0, gusts=0.2, seed=5)
    return mavdem.estimate_wind(time, attitude, velocity, height=5.0 + 10 * (time > time.mean()))


@mark.slow
def test_the_mean_of_a_layer_is_formed_as_that_of_a_minute(wind_of_hover):
    """Of an uncertain drag the mean over the posterior is larger than the median, which is reported."""
    wind = wind_of_hover
    by_height, by_minute = ([one["speed"] for one in part] for part in (wind.profile, wind.minutes))
    assert by_height == approx(by_minute, rel=0.005)
    assert min(by_height) < wind.speed < max(by_height)


def test_a_hover_at_one_height_is_one_layer():
    """It is partly above and partly below the border of two layers, which the vehicle climbed through to it."""
    heights = np.concatenate([np.linspace(0.0, 20.0, 300), 20.0 + 0.5 * np.sin(np.arange(600))])
    climb, hover = _layer_rows(heights)
    assert heights[climb].max() < 10 and len(climb) + len(hover) == len(heights)
    high = np.repeat([12.0, 27.0], 100)
    assert [high[rows].mean() for rows in _layer_rows(high)] == [12, 27]


@mark.slow
def test_the_speed_through_the_air_of_a_hover_in_gusts_is_that_of_the_gusts(wind_of_hover):
    wind = wind_of_hover
    speed = np.hypot(*wind.air_velocity.T)
    # Along the body it is shorter by the cosine of the tilt, which is below 25°.
    assert speed == approx(np.hypot(*wind.velocity.T), rel=0.1)
    assert speed[wind.time > 65].mean() > 1.3 * speed[wind.time < 55].mean()


@mark.slow
def test_a_doubtful_speed_is_by_what_adds_most_to_its_variance():
    hover = {"legs": 0.0, "turning": 0.0, "seconds": 60}
    # In calm air the drag hardly matters, and the unknown lean is as large as all of the wind.
    calm = mavdem.estimate_wind(*flight(**hover, wind=(0.3, 0.0), gusts=0.3)[:3])
    windy = mavdem.estimate_wind(*flight(**hover, wind=(-6.0, 8.0))[:3])
    for wind, by_drag in ((calm, False), (windy, True)):
        assert "drag" in wind.reasons
        assert wind.reasons["speed"].figures["by_drag"] is by_drag
    assert "part of the lean" in str(calm.reasons["speed"])


@mark.slow
def test_a_live_mean_outlasts_flight_that_is_not_free_and_says_since_when():
    """A vehicle that lost control no longer leans into the wind; what it has shown before stays known."""
    time, attitude, velocity, _ = flight(seed=7, jump=1.0)
    live = LiveWind()
    live.earlier_drag = drag_in_a_jump_of_the_wind()
    half = len(time) // 2
    for number, (at, angles, moved) in enumerate(zip(time, attitude, velocity, strict=True)):
        is_free = number < half
        live.add_attitude(at, *angles)
        moved_down_first = np.roll(moved if is_free else 0.01 * moved, 1)
        live.add_velocity("LOCAL_POSITION_NED", at, moved_down_first)
        if is_free:
            mean = live.mean
    assert live.latest is None
    assert abs(live.mean.velocity - mean.velocity).max() < 0.5
    assert time[half] - 20.0 < live.mean.time <= time[half]
    status = SessionStatus(
        is_flying=True, mean_wind=live.mean, no_wind_reason=live.no_estimate_reason
    )
    light = status.overall_judgement.lights[Light.WIND]
    assert f"; not known since {live.mean.time:.0f} s: the velocity does not" in light.sentence
    assert light.sentence.startswith("Mean wind")
