"""The wind in m/s: simulated flights with known drag, recorded ones beside an anemometer, and what is no flight."""

import csv
from datetime import datetime

import numpy as np
import pytest
from recorded_flights import shared

import mavdem
from mavdem.condition.wind_velocity import coming_from
from mavdem.dem.airflow import posterior
from mavdem.dem.drag import Drag
from mavdem.errors import NotLearnable

LINEAR, QUADRATIC = np.array([0.3, 0.24]), np.array([0.01, 0.016])


def flown(air, yaw, velocity, time, lean=(0.0, 0.0)):
    """Attitude (T, 3) of a vehicle with that drag: the thrust is what drag and gravity leave of the acceleration."""
    needed = np.gradient(velocity, time, axis=0) + [0, 0, -9.80665]
    u, drag = velocity - np.pad(air, ((0, 0), (0, 1))), np.zeros_like(velocity)
    heading = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)])
    for _ in range(8):
        z = -(needed - drag) / np.linalg.norm(needed - drag, axis=1, keepdims=True)
        y = np.cross(z, heading)
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        axes = np.stack([np.cross(y, z), y], axis=1)
        along = np.einsum("tij,tj->ti", axes, u)
        force = np.asarray(lean) - (LINEAR + QUADRATIC * np.hypot(*along.T)[:, None]) * along
        drag = np.einsum("ti,tij->tj", force, axes)
    roll, pitch = np.arctan2(axes[:, 1, 2], z[:, 2]), -np.arcsin(axes[:, 0, 2])
    return np.column_stack([roll, pitch, yaw])


def flight(wind=(-3.0, 4.0), seconds=120, legs=5.0, turning=0.05, seed=0, gusts=0.5, lean=(0.0, 0.0), jump=0.0):
    """Time, attitude, velocity and wind of legs of 20 s at 10 Hz in a wind with gusts of 3 s."""
    rng, time = np.random.default_rng(seed), np.arange(0, seconds, 0.1)
    white = rng.standard_normal((len(time) + 200, 2))
    kernel = np.exp(-np.arange(0, 20, 0.1) / 3)
    gust = np.column_stack([np.convolve(column, kernel)[200 : 200 + len(time)] for column in white.T])
    air = np.array(wind) * (1 + jump * (time > seconds / 2))[:, None] + gusts * gust / gust.std()
    course = np.floor(time / 20) * np.pi / 2 + np.pi * (time % 20 > 10)
    smooth = np.ones(20) / 20
    moving = [
        np.convolve(np.pad(legs * part, (19, 0), "edge"), smooth, "valid") for part in (np.cos(course), np.sin(course))
    ]
    velocity = np.column_stack([*moving, 0 * time]) + 0.02 * rng.standard_normal((len(time), 3))
    attitude = flown(air, turning * time, np.column_stack([*moving, 0 * time]), time, lean)
    return time, attitude, velocity, air


def test_legs_show_wind_drag_and_lean():
    found = [mavdem.estimate_wind(*flight(seed=seed, lean=(0.2, -0.1))[:3]) for seed in range(3)]
    for wind in found:
        assert set(wind.status.values()) == {"reported"} and not wind.reasons
        assert abs(wind.speed - 5) < 0.6 and abs(wind.direction - coming_from(-3, 4)) < 10
        assert np.abs(wind.drag.lean - [0.2, -0.1]).max() < 0.1
        assert np.all(wind.drag.interval("linear")[0] < LINEAR) and np.all(wind.drag.interval("linear")[1] > LINEAR)


def test_band_holds_and_a_jump_is_followed():
    time, attitude, velocity, air = flight(seed=7, jump=1.0)
    wind = mavdem.estimate_wind(time, attitude, velocity)
    true = np.column_stack([np.interp(wind.time, time, part) for part in air.T])
    assert 0.8 < np.mean(np.abs(wind.velocity - true) <= wind.band) <= 1.0
    speeds = np.hypot(*wind.velocity.T)
    assert speeds[wind.time < 55].mean() < 6.5 and speeds[wind.time > 65].mean() > 8.5
    assert wind.gust > 9 and [round(one["speed"] / 5) for one in wind.minutes] == [1, 2]


def test_hover_keeps_the_drag_that_it_is_given():
    time, attitude, velocity, air = flight(legs=0.0, turning=0.0, seed=3)
    alone = mavdem.estimate_wind(time, attitude, velocity)
    assert alone.status["drag"] == "not identifiable" and alone.status["speed"] != "reported"
    assert "fly legs" in alone.reasons["drag"] and alone.drag.source == "population"
    drag = mavdem.estimate_drag(*flight(seed=4))
    assert np.abs(drag.linear / LINEAR - 1).max() < 0.15
    again = Drag.from_dict(drag.as_dict())
    known = mavdem.estimate_wind(time, attitude, velocity, drag=again)
    widths = [np.diff(one.speed_interval)[0] for one in (known, alone)]
    assert abs(known.speed - 5) < 0.7 and widths[0] < 0.6 * widths[1]


def test_calm_air_is_below_a_speed():
    wind = mavdem.estimate_wind(*flight(wind=(0, 0), gusts=0.05)[:3])
    assert wind.calm and wind.speed < 0.7


def test_what_is_no_free_flight_has_a_sentence_and_no_number():
    time, attitude, velocity, _ = flight(seconds=60)
    with pytest.raises(NotLearnable, match="does not follow the tilt"):
        mavdem.estimate_wind(time, attitude, 0.01 * velocity)
    with pytest.raises(NotLearnable, match="The yaw is not known"):
        mavdem.estimate_wind(time, attitude * [1, 1, np.nan], velocity)
    with pytest.raises(NotLearnable, match="less than 15 s"):
        mavdem.estimate_wind(time[:100], attitude[:100], velocity[:100])
    with pytest.raises(ValueError, match="degrees"):
        mavdem.estimate_wind(time, np.degrees(attitude), velocity)


def test_parameters_are_read_and_written_in_the_autopilots_units():
    # 0.5 ρ / q: 17.2 kg/m² is 0.0356 1/m, as ArduPilot's simulated quadrotor has it.
    set_ = {"EK3_DRAG_MCOEF": 0.209, "EK3_DRAG_BCOEF_X": 17.2, "EK3_DRAG_BCOEF_Y": 17.2}
    drag = Drag.of_parameters("ARDUPILOTMEGA", set_)
    assert drag.source == "parameters" and np.allclose(drag.quadratic, 0.6125 / 17.2)
    assert all(abs(drag.parameters("ARDUPILOTMEGA")[name][0] / value - 1) < 1e-6 for name, value in set_.items())
    assert Drag.of_parameters("PX4", {"EKF2_MCOEF": 0.15, "EKF2_BCOEF_X": 100.0}).source == "population"


def test_posterior_of_no_likelihood_is_the_prior():
    prior = np.diag([0.5, 0.9, 0.2, 0.35, 0.18, 0.18]) ** 2
    mean, covariance = posterior(lambda places: np.zeros(len(places)), np.zeros(6), prior, 128, 5)
    assert np.abs(mean / np.sqrt(np.diag(prior))).max() < 0.1
    assert np.allclose(np.diag(covariance) / np.diag(prior), 1, atol=0.35)


def test_solo_beside_an_anemometer():
    with shared("real/wind/solo_sonic_1hz.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = ("solo_roll", "solo_pitch", "sonic_wind", "sonic_wind_dir")
    roll, pitch, speed, origin = np.array([[float(row[name]) for name in names] for row in rows]).T
    time = np.array([datetime.fromisoformat(row["datetime"]).timestamp() for row in rows])
    attitude, still = np.radians(np.column_stack([roll, pitch, 0 * roll])), np.zeros((len(time), 3))
    air = -speed[:, None] * np.column_stack([np.cos(np.radians(origin)), np.sin(np.radians(origin))])
    first, second = slice(len(time) // 2), slice(len(time) // 2, None)
    drag = mavdem.estimate_drag(time[first], attitude[first], still[first], air[first])
    wind = mavdem.estimate_wind(time[second], attitude[second], still[second], drag=drag)
    course = np.column_stack([np.interp(time[second], wind.time, part) for part in wind.velocity.T])
    for seconds, most in ((10, 0.6), (60, 0.4)):
        block = ((time[second] - time[second][0]) // seconds).astype(int)
        counts = np.bincount(block)
        whole = counts >= 0.9 * seconds
        means = [[np.bincount(block, part)[whole] / counts[whole] for part in one.T] for one in (course, air[second])]
        (n, e), (true_n, true_e) = means
        assert np.sqrt(np.mean((np.hypot(n, e) - np.hypot(true_n, true_e)) ** 2)) < most
    turned = np.degrees(np.angle((n + 1j * e) / (true_n + 1j * true_e)))
    assert np.sqrt(np.mean(turned**2)) < 10


@pytest.mark.parametrize(
    ("log", "speed", "origin"),
    [
        ("sitl_ardupilot/ardupilot_inertia_wind5_steps.tlog", 5.0, 83.0),
        ("sitl_px4/px4_wind5_steps.tlog", 5.0, 90.0),
        ("sitl_events/ap_short_with_climb.tlog", 2.04, 83.0),  # 5 m/s at 60 m: SIM_WIND_T is its default
    ],
)
def test_recorded_simulators(log, speed, origin):
    wind = mavdem.wind(shared(log))
    assert wind.speed_interval[0] < speed < wind.speed_interval[1]
    assert wind.status["speed"] != "reported" or abs(wind.speed - speed) < 0.7
    assert abs((wind.direction - origin + 180) % 360 - 180) < max(10, 1.3 * wind.direction_interval)
