"""Simulation of a scenario, with instruments and a mishap if the scenario has them."""

from sitl_scenarios.flight_simulation import Simulation
from sitl_scenarios.mishaps.simulation import InstrumentedSimulation
from sitl_scenarios.motion import Motion, Progress, joined
from sitl_scenarios.plan import total_seconds
from sitl_scenarios.scenario import Scenario

__all__ = ["Simulation", "fly", "simulation_of"]


def simulation_of(scenario: Scenario) -> Simulation:
    """Returns the simulation of a scenario, with instruments where it has them."""
    if not scenario.has_instruments:
        return Simulation(scenario)
    return InstrumentedSimulation(scenario)


def fly(scenario: Scenario, progress: Progress | None = None) -> Motion:
    """Simulates all flights of a scenario.

    Args:
        scenario: Scenario to fly: vehicle, wind, excitation, sensors and faults.
        progress: Function that is called once per simulated second with the fraction that is done, 0 to 1.

    Returns:
        One row for each cycle of the autopilot.

    Raises:
        ValueError: The vehicle tumbles.
    """
    simulation = simulation_of(scenario)
    duration = total_seconds(scenario)
    cycles_per_second = round(1 / simulation.cycle)
    pieces = []
    while not simulation.finished:
        pieces.append(simulation.advance(cycles_per_second))
        if progress:
            fraction = min(pieces[-1].time[-1] / duration, 1.0)
            progress(1.0 if simulation.finished else fraction)
    return joined(pieces)
