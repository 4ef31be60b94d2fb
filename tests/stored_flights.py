"""Simulated flights are stored: many tests, and every run of them, fly the same scenarios.

A flight is that of its scenario and of the simulator's code: whatever changes either of them is another flight. Where
none is stored, as in a new environment, all are simulated.
"""

import os
import pickle
import sys
from functools import wraps
from hashlib import sha256
from pathlib import Path
from shutil import rmtree

import numpy as np

import sitl_scenarios
from sitl_scenarios import dynamics, gyro
from sitl_scenarios.motion import joined
from sitl_scenarios.simulation import simulation_of

ROOT = Path(sitl_scenarios.__file__).parents[1]
SIMULATOR_FILES = (
    "sitl_scenarios/**/*.py",
    "sitl_scenarios/*.toml",
    "mavdem/loops/*controller*.py",
    "mavdem/loops/autopilot_parameters.py",
    "mavdem/loops/filters.py",
    "mavdem/ingest/vocabulary.py",
)
"""The simulator's own files, and those of mavdem that say what its controllers and filters compute."""


def simulator_digest():
    """Returns a digest of all on which a flight depends besides its scenario: code, and what runs it."""
    digest = sha256(f"{sys.version} {np.__version__}".encode())
    for pattern in SIMULATOR_FILES:
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


class StoredSimulation:
    """A simulation that was flown before: its motion comes in one piece."""

    def __init__(self, scenario, motion):
        self.cycle = scenario.cycle
        self.finished = False
        self._motion = motion

    def advance(self, cycles):
        self.finished = True
        return self._motion


class RecordedSimulation:
    """A simulation whose motion is stored once it is flown to its end."""

    def __init__(self, scenario, path):
        self.cycle = scenario.cycle
        self._simulation = simulation_of(scenario)
        self._path = path
        self._pieces = []

    @property
    def finished(self):
        return self._simulation.finished

    def advance(self, cycles):
        self._pieces.append(self._simulation.advance(cycles))
        if self.finished:
            # Another process finds no file, or a whole one; and it may have deleted the folder as an old one.
            self._path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = self._path.with_name(f"{self._path.name}.{os.getpid()}")
            unfinished.write_bytes(pickle.dumps(joined(self._pieces)))
            unfinished.replace(self._path)
        return self._pieces[-1]


def time_of_use(folder):
    """Returns when a folder of flights was used last, and 0 where another process has deleted it."""
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def delete_old_flights(parent):
    """Deletes the stored flights of all simulators but the two that flew last, such as those of two branches."""
    folders = sorted(parent.iterdir(), key=time_of_use)
    for folder in folders[:-2]:
        rmtree(folder, ignore_errors=True)


def stored_simulation_of(parent):
    """Returns what stands in for ``simulation_of``: it takes flights from a folder below ``parent``, or stores them."""
    folder = parent / simulator_digest()
    folder.mkdir(parents=True, exist_ok=True)
    folder.touch()
    delete_old_flights(parent)

    @wraps(simulation_of)
    def simulation(scenario):
        # Fixtures may have set these limits.
        steps = dynamics.MAX_STEP_SECONDS, gyro.MAX_SAMPLING_PERIOD
        path = folder / sha256(f"{steps} {scenario!r}".encode()).hexdigest()
        try:
            motion = pickle.loads(path.read_bytes())
        except FileNotFoundError:
            return RecordedSimulation(scenario, path)
        return StoredSimulation(scenario, motion)

    return simulation
