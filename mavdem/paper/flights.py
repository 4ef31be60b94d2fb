"""The flights of the experiments: five simulated ones, since the paper's are not public, and recorded ones."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.io import loadmat

from mavdem.alignment import read_flight
from mavdem.errors import NotLearnable
from mavdem.export.conversion import STREAMS
from mavdem.flight import Flight
from mavdem.ingest import read_log
from mavdem.ingest.vocabulary import IN_AIR
from sitl_scenarios.dynamics import euler
from sitl_scenarios.files import load, scenario_of
from sitl_scenarios.mavlink.transmitter import recorded
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation, fly

EXPERIMENTS = (1, 2, 3, 4, 5)

SAMPLE = 2  # the experiment that the paper's figures of one flight show

SHARED = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
"""The folder of the recorded flights, which are no part of the repository."""

TRAIN, TEST = 700, 150  # samples of a window, as in the paper, at every rate
HOP = (TRAIN + TEST) // 2  # samples from one window to the next
REAL = "ardrone_tudelft"  # the name of TU Delft's recorded flight: the paper's vehicle in the paper's laboratory
SKIPPED_HOVER_SECONDS = 3.0  # left out at the start of the hover, while the motion of the take-off decays


def paper_scenario(number: int, duration: float | None = None) -> Scenario:
    """The scenario in place of experiment 1 to 5 of the paper; ``duration`` in s, instead of the scenario's."""
    scenario = load(f"paper_{number}")
    return scenario_of(scenario.model_dump(mode="json") | {"duration": duration or scenario.duration})


def simulated_experiment(number: int, duration: float | None = None) -> Flight:
    """The simulated flight of :func:`paper_scenario`, as its log holds it."""
    return logged(paper_scenario(number, duration), f"paper_{number}")


def logged(scenario: Scenario, name: str = "flight") -> Flight:
    """A simulated flight: flown, written as a telemetry log of this name and read again."""
    motion = fly(scenario)
    with TemporaryDirectory() as folder:
        log = Path(folder) / f"{name}.tlog"
        with log.open("wb") as file:
            STREAMS[".tlog"](file, recorded(scenario, motion, Simulation(scenario).cycle, lambda _: None))
        return read_flight(log)


def hover(scenario: Scenario, motion: Motion) -> Flight:
    """The settled hover of a simulated flight as its autopilot estimates it, without a MAVLink link in between.

    Inputs are the motors. Outputs are y (m), ẏ (m/s), φ (rad) and φ̇ (rad/s). The rate is the scenario's.
    """
    airborne, rate = motion.time[motion.landed_state == IN_AIR], scenario.stream.rate
    time = np.arange(round((airborne[0] + SKIPPED_HOVER_SECONDS) * rate), int(airborne[-1] * rate)) / rate
    roll = np.array([euler(attitude)[0] for attitude in motion.known_attitude.tolist()])
    columns = (motion.known_position[:, 1], motion.known_velocity[:, 1], roll, motion.known_rates[:, 0])
    outputs = [np.interp(time, motion.time, column) for column in columns]
    motors = [np.interp(time, motion.time, column) for column in motion.outputs.T]
    return Flight(time, np.column_stack(motors), np.column_stack(outputs), dt=1 / rate)


def recorded_flights() -> Iterator[tuple[str, Flight]]:
    """Each recorded flight that a roll model can be trained on, by name; one for each vehicle of a log."""
    for path in sorted(SHARED.glob("sitl_*/*.tlog")):
        vehicles = read_log(path).vehicles
        for vehicle in vehicles:
            name = f"{vehicle.system}:{vehicle.component}"
            try:
                flight = read_flight(path, vehicle=name)
            except NotLearnable:
                continue
            yield path.stem if len(vehicles) == 1 else f"{path.stem} {name}", flight
    path = SHARED / "ardrone_tudelft" / "expData10_29_25.mat"
    if path.exists():
        yield REAL, ardrone(path)


def ardrone(path: Path) -> Flight:
    """TU Delft's AR.Drone 2.0 in wind: roll from motion capture, roll rate from the IMU, four PWM, at 120 Hz."""
    data = loadmat(path, squeeze_me=True, struct_as_record=False)["expData"].origData
    rate = 120
    # It is airborne from 21.7 s on, and never lands in the recording.
    time = np.arange(2600, len(data.otTime)) / rate
    time = time[time <= min(data.otTime[-1], data.imuTime[-1], data.navTime[-1])]
    roll = np.interp(time, data.otTime, data.otOrient[2])
    roll_rate = np.interp(time, data.imuTime, data.imuVAng[0])
    motors = [np.interp(time, data.navTime, motor) for motor in data.navMotor]
    return Flight(time, np.stack(motors, axis=1), np.stack([roll, roll_rate], axis=1), dt=1 / rate)
