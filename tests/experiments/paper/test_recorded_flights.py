"""Recorded flights of the AR.Drone: their MATLAB files are read, damaged ones are named, and their errors tabulated."""

import numpy as np
from command_line import run
from numpy.random import default_rng
from pytest import mark, raises
from scipy.io import savemat

from mavdem.errors import Unreadable
from mavdem.experiments.paper import benchmark
from mavdem.experiments.paper.flights import (
    ARDRONE_FIRST_SAMPLE,
    ARDRONE_RATE,
    read_ardrone_folder,
)
from mavdem.experiments.paper.runner import RECORDED_METHODS, Runner

SAMPLES = 30
TIME = np.arange(SAMPLES) / ARDRONE_RATE
MOTORS = default_rng(0).normal(size=(4, SAMPLES))
STATES = default_rng(1).normal(size=(12, SAMPLES))
ALIGNED = {"time": TIME, "dt": 1 / ARDRONE_RATE, "x_measured": STATES, "v": MOTORS}


def test_aligned_flights_are_read_by_name(tmp_path):
    savemat(tmp_path / "exp_2.mat", {"Data_model": ALIGNED})
    savemat(tmp_path / "exp_1.mat", {"Data_model": ALIGNED | {"v": 2 * MOTORS}})
    flights = read_ardrone_folder(tmp_path)
    assert list(flights) == ["exp_1", "exp_2"]
    flight = flights["exp_2"]
    assert np.array_equal(flight.inputs, MOTORS.T)
    assert np.array_equal(flight.outputs[:, 0], STATES[6])
    assert np.array_equal(flight.outputs[:, 1], STATES[9])
    assert flight.dt == 1 / ARDRONE_RATE


def test_a_raw_recording_is_interpolated_to_common_times(tmp_path):
    seconds = np.arange(ARDRONE_FIRST_SAMPLE + SAMPLES) / ARDRONE_RATE
    slow_seconds = np.arange(0.0, seconds[-1] + 0.1, 0.05)
    recording = {
        "otTime": seconds,
        "otOrient": np.vstack([0 * seconds, 0 * seconds, np.sin(seconds)]),
        "imuTime": slow_seconds,
        "imuVAng": np.vstack([3 * slow_seconds, slow_seconds]),
        "navTime": slow_seconds,
        "navMotor": np.vstack([index * slow_seconds for index in range(4)]),
    }
    savemat(tmp_path / "expData.mat", {"expData": {"origData": recording}})
    (flight,) = read_ardrone_folder(tmp_path).values()
    assert len(flight) == SAMPLES
    assert np.allclose(flight.outputs[:, 0], np.sin(flight.time))
    assert np.allclose(flight.outputs[:, 1], 3 * flight.time)
    assert np.allclose(flight.inputs[:, 2], 2 * flight.time)


@mark.parametrize(
    "content",
    [
        b"",
        b"MATLAB 5.0 MAT-file" + bytes(200),
        bytes(range(256)) * 20,
    ],
)
def test_a_damaged_file_is_named(tmp_path, content):
    (tmp_path / "exp_9.mat").write_bytes(content)
    with raises(Unreadable, match=r"exp_9\.mat is damaged"):
        read_ardrone_folder(tmp_path)


@mark.parametrize("variables", [{"other": 1.0}, {"Data_model": {"time": TIME}}, {"expData": 3.0}])
def test_a_file_without_flight_is_named(tmp_path, variables):
    savemat(tmp_path / "exp_9.mat", variables)
    with raises(Unreadable, match=r"exp_9\.mat is damaged, or no flight"):
        read_ardrone_folder(tmp_path)


def test_the_command_refuses_a_folder_without_flights(tmp_path, capsys):
    assert run("reproduce", "noise", "--flights", tmp_path, "--out", tmp_path / "paper") != 0
    assert "has no MATLAB files" in capsys.readouterr().err


def test_the_table_has_the_lowest_median_first_and_counts_the_worse_windows():
    ratios = {name: np.array([0.5, 2.0, 3.0]) for name in RECORDED_METHODS}
    ratios[RECORDED_METHODS[0]] = np.array([0.1, 0.2, 0.3])
    ratios[benchmark.DEM_P1] = np.array([4.0, 1.0, 5.0])
    introduction, table = benchmark.recorded_table(ratios)
    assert "in 3 windows" in introduction.text
    assert "in 2 of them" in introduction.text
    assert table.rows[0] == [RECORDED_METHODS[0], "0.20", "0"]
    assert table.rows[-1] == [benchmark.DEM_P1, "4.0", "2"]
    assert len(table.rows) == len(RECORDED_METHODS) - 1


def test_recorded_windows_come_flight_by_flight(tmp_path):
    long_time = np.arange(1300) / ARDRONE_RATE
    recording = {
        "time": long_time,
        "dt": 1 / ARDRONE_RATE,
        "x_measured": default_rng(2).normal(size=(12, 1300)),
        "v": default_rng(3).normal(size=(4, 1300)),
    }
    savemat(tmp_path / "b.mat", {"Data_model": recording})
    savemat(tmp_path / "a.mat", {"Data_model": recording})
    runner = Runner(recorded_flights=read_ardrone_folder(tmp_path))
    assert [window.flight for window in runner.recorded_windows] == ["a", "a", "b", "b"]
    assert [window.start for window in runner.recorded_windows] == [0, 425, 0, 425]
