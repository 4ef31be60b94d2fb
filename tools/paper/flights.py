"""The simulated flights that stand for the paper's five, which are not public."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import mavdem
from mavdem.convert import STREAMS
from sitl_scenarios.files import load, scenario_of
from sitl_scenarios.mavlink.recorded import recorded
from sitl_scenarios.simulation import Simulation, fly

EXPERIMENTS = (1, 2, 3, 4, 5)

SAMPLE = 2
"""The experiment that the paper's figures of one flight show."""


def experiment(number: int, duration: float | None = None) -> mavdem.Flight:
    """The simulated flight in place of an experiment of the paper, flown, written as a log and read again.

    Args:
        number: of the experiment, 1 to 5.
        duration: seconds from arming to disarming, instead of the scenario's.
    """
    scenario = load(f"paper_{number}")
    if duration is not None:
        scenario = scenario_of(scenario.model_dump(mode="json") | {"duration": duration})
    motion = fly(scenario)
    with TemporaryDirectory() as folder:
        log = Path(folder) / f"paper_{number}.tlog"
        with log.open("wb") as file:
            STREAMS[".tlog"](file, recorded(scenario, motion, Simulation(scenario).cycle, lambda _: None))
        return mavdem.read_flight(log)
