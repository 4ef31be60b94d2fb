"""Flights for the paper's experiments: simulated in place of the paper's, whose samples are not named, and recorded."""

import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from mavdem.dataset.flights import read_flight
from mavdem.errors import NotLearnable, Unreadable
from mavdem.experiments.scores import REFERENCE_RATE
from mavdem.experiments.window import part_samples
from mavdem.facts.forecasts import ForecastFact
from mavdem.files import PathName
from mavdem.flight import Flight
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import interpolated
from mavdem.ingest.tlog import write_tlog
from mavdem.ingest.vocabulary import IN_AIR
from sitl_scenarios.files import load
from sitl_scenarios.mavlink.transmitter import recorded_stream
from sitl_scenarios.motion import Motion, estimated_angles
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

TRAINING_SAMPLES, TEST_SAMPLES = part_samples(1 / REFERENCE_RATE)
"""Samples of the training and of the test part of a window: 700 and 150, as in the paper, at every sampling rate."""

DATA_FOLDER = Path(os.environ.get("MAVDEM_SHARED_DATA", "shared/data"))
"""Folder of the recorded flights, which are not part of the package.

The environment variable ``MAVDEM_SHARED_DATA`` names it; the default is a folder of the working directory.
"""

ARDRONE_RECORDING = DATA_FOLDER / "ardrone_tudelft" / "expData10_29_25.mat"
"""MATLAB file of TU Delft's recorded AR.Drone 2.0 in wind: the paper's vehicle in the paper's laboratory."""

ARDRONE_NAME = "the real AR.Drone"
"""Name of the flights of that vehicle in sentences and documents."""

ARDRONE_RATE = 120
"""Hz, the rate at which the recorded AR.Drone is sampled, as in the paper's experiments."""

ARDRONE_FIRST_SAMPLE = 2600
"""First sample of the raw recording that is used: the AR.Drone is airborne from 21.7 s on, and never lands."""

ROLL_ROW, ROLL_RATE_ROW = 6, 9
"""Rows of roll (rad) and roll rate (rad/s) among the twelve measured states of a published flight."""

MATLAB_FILE_ERRORS = (
    MatReadError,
    ValueError,
    TypeError,
    KeyError,
    AttributeError,
    IndexError,
    OverflowError,
    zlib.error,
)
"""Errors that SciPy raises for damaged files and files of other kinds, and errors by missing variables and fields."""

TAKE_OFF_SECONDS = 3.0
"""s that are left out at the start of a simulated hover, while the motion of the take-off decays; a choice."""


def simulated_experiment(number: int) -> Flight:
    """Returns the simulated flight that replaces an experiment of the paper, 1 to 5, as read from its telemetry log."""
    return simulated_flight(load(f"paper_{number}"), f"paper_{number}")


def simulated_flight(scenario: Scenario, name: str = "flight") -> Flight:
    """Simulates a scenario, writes it as a telemetry log, and reads the flight from that log.

    Args:
        scenario: scenario to fly: vehicle, wind, excitation, sensors and faults.
        name: stem of the log's file name.

    Returns:
        The flight, with the message rates, clocks and rounding of a real log.
    """
    motion = fly(scenario)
    with TemporaryDirectory() as folder:
        log = Path(folder) / f"{name}.tlog"
        write_log(log, scenario, motion)
        return read_flight(log)


def write_log(path: PathName, scenario: Scenario, motion: Motion) -> None:
    """Writes a telemetry log (``.tlog``) of the simulated ``motion`` of a scenario."""
    with open(path, "wb") as file:
        write_tlog(file, recorded_stream(scenario, motion))


def settled_hover(scenario: Scenario, motion: Motion) -> Flight:
    """Returns the hover of a simulated flight as its autopilot estimates it, without a MAVLink link in between.

    The first seconds in the air, ``TAKE_OFF_SECONDS``, are left out.

    Args:
        scenario: scenario that gives the sampling rate.
        motion: the simulated motion, with the autopilot's estimates.

    Returns:
        A flight with the motors as inputs and four outputs: lateral position y (m), its rate ẏ (m/s), roll angle φ
        (rad) and roll rate φ̇ (rad/s).
    """
    airborne_times = motion.time[motion.landed_state == IN_AIR]
    rate = scenario.stream.rate
    first_sample = round((airborne_times[0] + TAKE_OFF_SECONDS) * rate)
    after_last_sample = int(airborne_times[-1] * rate)
    time = np.arange(first_sample, after_last_sample) / rate
    lateral_position = motion.known_position[:, 1]
    lateral_velocity = motion.known_velocity[:, 1]
    roll = estimated_angles(motion)[:, 0]
    roll_rate = motion.known_rates[:, 0]
    estimates = np.column_stack([lateral_position, lateral_velocity, roll, roll_rate])
    outputs = interpolated(time, motion.time, estimates)
    motors = interpolated(time, motion.time, motion.outputs)
    return Flight(time, motors, outputs, dt=1 / rate)


def recorded_flights() -> Iterator[tuple[str, Flight]]:
    """Yields the name and the flight of each recording in ``DATA_FOLDER`` that a roll model can be trained on.

    These are the logs of SITL sessions, one flight for each vehicle of a log, and the recorded AR.Drone.
    """
    for path in sorted(DATA_FOLDER.glob("sitl_*/*.tlog")):
        vehicles = read_log(path).vehicles
        for vehicle in vehicles:
            vehicle_name = f"{vehicle.system}:{vehicle.component}"
            try:
                flight = read_flight(path, vehicle=vehicle_name)
            except NotLearnable:
                continue
            if len(vehicles) == 1:
                yield path.stem, flight
            else:
                yield f"{path.stem} {vehicle_name}", flight
    if ARDRONE_RECORDING.exists():
        yield ARDRONE_RECORDING.parent.name, read_ardrone_flight(ARDRONE_RECORDING)


def read_ardrone_folder(folder: Path) -> dict[str, Flight]:
    """Reads all recordings of the AR.Drone in a folder, as their authors publish them.

    Args:
        folder: folder with MATLAB files (``.mat``).

    Returns:
        Flights by the stem of their files, in the order of the names.

    Raises:
        Unreadable: the folder has no such file, or one of them has no flight.
    """
    paths = sorted(folder.glob("*.mat"))
    if not paths:
        raise Unreadable(ForecastFact.NO_MATLAB_FILES, name=str(folder))
    return {path.stem: read_ardrone_flight(path) for path in paths}


def read_ardrone_flight(path: Path) -> Flight:
    """Reads one of TU Delft's recorded flights of an AR.Drone 2.0 from its MATLAB file, in either of two layouts.

    The flights of Bos et al. (``exp_25_WW_WM_2.mat``) are aligned by their authors and have a variable ``Data_model``;
    a raw recording (``expData10_29_25.mat``) has ``expData``.

    Args:
        path: path of the MATLAB file.

    Returns:
        A flight with the PWM of four motors as inputs, and as outputs roll (rad) and roll rate (rad/s).

    Raises:
        Unreadable: the file is damaged, or has neither variable.
    """
    try:
        variables = loadmat(path, squeeze_me=True, struct_as_record=False)
        if "Data_model" in variables:
            return _aligned_flight(variables["Data_model"])
        return _interpolated_flight(variables["expData"].origData)
    except MATLAB_FILE_ERRORS as error:
        raise Unreadable(ForecastFact.NOT_AN_ARDRONE_FLIGHT, name=path.name) from error


def _aligned_flight(data: Any) -> Flight:
    """Returns the flight of a structure ``Data_model``: twelve states and four motor commands at common times.

    Args:
        data: MATLAB structure with ``time`` (N,) and its step ``dt``, s, the states ``x_measured`` (12, N) in SI units,
            and the motor commands ``v`` (4, N).

    Returns:
        A flight with the four motor commands as inputs, and roll, rad, and roll rate, rad/s, as outputs.
    """
    time = np.asarray(data.time, float)
    states = np.asarray(data.x_measured, float)
    # The structure has its samples in columns, a flight in rows.
    roll_and_rate = states[[ROLL_ROW, ROLL_RATE_ROW]].T
    motor_commands = np.asarray(data.v, float).T
    return Flight(time, motor_commands, roll_and_rate, dt=data.dt)


def _interpolated_flight(data: Any) -> Flight:
    """Returns the flight of a structure ``expData.origData``, a raw recording.

    Motion capture, inertial sensor and motors have clocks of their own rates; all are interpolated to
    ``ARDRONE_RATE``. Roll comes from motion capture, roll rate from the inertial sensor.

    Args:
        data: MATLAB structure with times, s, and values of each device: ``otTime`` and the angles ``otOrient``, rad, of
            the motion capture; ``imuTime`` and the body rates ``imuVAng``, rad/s, of the inertial sensor; ``navTime``
            and the commands ``navMotor`` of the four motors. Samples are in columns.

    Returns:
        A flight with the commands of the four motors as inputs, and roll, rad, and its rate, rad/s, as outputs. It ends
        when the first of the three recordings ends.
    """
    # In the names of the file "ot" is the motion capture, "imu" the inertial sensor and "nav" the motors' log.
    time = np.arange(ARDRONE_FIRST_SAMPLE, len(data.otTime)) / ARDRONE_RATE
    end_time = min(data.otTime[-1], data.imuTime[-1], data.navTime[-1])
    time = time[time <= end_time]
    # Roll is the third angle of the motion capture, and the first body rate of the inertial sensor.
    roll = np.interp(time, data.otTime, data.otOrient[2])
    roll_rate = np.interp(time, data.imuTime, data.imuVAng[0])
    motors = [np.interp(time, data.navTime, motor) for motor in data.navMotor]
    return Flight(
        time,
        np.stack(motors, axis=1),
        np.stack([roll, roll_rate], axis=1),
        dt=1 / ARDRONE_RATE,
    )
