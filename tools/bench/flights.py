"""The recorded flights that the benchmarks run on, and the windows they are cut into."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.io import loadmat

import mavdem
from mavdem.errors import NotLearnable
from mavdem.ingest import read_log

SHARED = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
"""Where the recorded flights lie; they are no part of the repository."""

TRAIN, TEST, HOP = 700, 150, 425
"""Samples learnt from, samples forecast, and samples from one window to the next."""


def recorded_flights() -> Iterator[tuple[str, mavdem.Flight]]:
    """Each recorded flight that a roll model can be learnt from, by name; every vehicle of a log is one."""
    for path in sorted(SHARED.glob("sitl_*/*.tlog")):
        vehicles = read_log(path).vehicles
        for vehicle in vehicles:
            name = f"{vehicle.system}:{vehicle.component}"
            try:
                flight = mavdem.read_flight(path, vehicle=name)
            except NotLearnable:
                continue
            yield path.stem if len(vehicles) == 1 else f"{path.stem} {name}", flight
    path = SHARED / "ardrone_tudelft" / "expData10_29_25.mat"
    if path.exists():
        yield "ardrone_tudelft", ardrone(path)


def ardrone(path: Path) -> mavdem.Flight:
    """TU Delft's AR.Drone 2.0 in wind: roll from motion capture, roll rate from the IMU, four PWM, at 120 Hz."""
    recorded = loadmat(path, squeeze_me=True, struct_as_record=False)["expData"].origData
    rate = 120
    # It is airborne from 21.7 s on, and never lands in the recording.
    time = np.arange(2600, len(recorded.otTime)) / rate
    time = time[time <= min(recorded.otTime[-1], recorded.imuTime[-1], recorded.navTime[-1])]
    roll = np.interp(time, recorded.otTime, recorded.otOrient[2])
    roll_rate = np.interp(time, recorded.imuTime, recorded.imuVAng[0])
    motors = [np.interp(time, recorded.navTime, motor) for motor in recorded.navMotor]
    return mavdem.Flight(time, np.stack(motors, axis=1), np.stack([roll, roll_rate], axis=1), dt=1 / rate)
