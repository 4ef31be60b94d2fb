"""Signs in a log that its flight was simulated: names and texts of simulators, a gyroscope without noise."""

from math import inf

import numpy as np

from mavdem.assessment.status_texts import status_texts
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dataset import flight_states
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.log import LogLight, Simulator
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import SCENARIO_TEXT, SIH_AIRFRAMES

SIMULATED_SENSOR_BUS = 4
"""Type of the bus in the lower three bits of PX4's device ids that means simulation
(src/lib/drivers/device/Device.hpp)."""

DEVICE_BUS_TYPES = 8
"""Number of types of a bus in PX4's device ids: three bits."""

SIMULATOR_MESSAGES = ("SIMSTATE", "SIM_STATE")
"""MAVLink messages on the state of a simulated vehicle, which firmware of a real board does not send
(common.xml, ardupilotmega.xml)."""

MAX_SIMULATED_RATE_CHANGE = 5e-5
"""Median change of the roll rate over ``RATE_CHANGE_SECONDS`` on the ground, rad/s, below which no real gyroscope
measured it.

A gyroscope with 0.003°/s/√Hz, low-passed at 10 Hz, has 1.5e-4, recorded real vehicles have 3e-4 and more, ArduPilot's
simulator has 2e-5 to 4e-5.
"""

RATE_CHANGE_SECONDS = 0.02
"""Interval, s, over which the change of the roll rate on the ground is measured."""


def simulation_fact(signals: Signals) -> Fact | None:
    """Returns the fact that the flight was simulated, with the kind of simulator.

    PX4 has the parameter SYS_HITL if a computer simulates the flight for a real autopilot. A simulation without one is
    recognised by names of a simulator in the log, or by a gyroscope without noise.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The fact; None if nothing in the log shows it.
    """
    simulator = named_simulator(signals.telemetry)
    if simulator is None and _is_without_sensor_noise(signals):
        simulator = Simulator.SOFTWARE
    return None if simulator is None else Fact(LogLight.SIMULATED, kind=simulator)


def named_simulator(telemetry: Telemetry) -> Simulator | None:
    """Returns the kind of simulator that parameters, hardware or texts of a vehicle name; None if they name none.

    Unlike :func:`simulation_fact` it needs no motion, so that a live session can ask it at any time.

    Args:
        telemetry: parameters, hardware and texts of the vehicle.
    """
    if telemetry.parameters.get("SYS_HITL", 0) > 0:
        return Simulator.HARDWARE
    return Simulator.SOFTWARE if _names_software_simulator(telemetry) else None


def _names_software_simulator(telemetry: Telemetry) -> bool:
    """Returns whether a log comes from a simulator in software, by its parameters, board, messages or texts.

    ArduPilot's simulator has "SITL" in the name of its board, and sends the true state of the vehicle
    (``SIMULATOR_MESSAGES``). The simulator of this project (`mavdem fly`) sends a text at boot.

    Args:
        telemetry: messages, parameters, hardware and texts of the vehicle.
    """
    return (
        _has_simulator_parameters(telemetry)
        or "SITL" in telemetry.hardware
        or any(message in telemetry.messages for message in SIMULATOR_MESSAGES)
        or any(text.text.startswith(SCENARIO_TEXT) for text in status_texts(telemetry))
    )


def _has_simulator_parameters(telemetry: Telemetry) -> bool:
    """Returns whether a log has parameters that only a simulator in software has.

    ArduPilot's simulator has parameters SIM_…. PX4's has its own airframes, a parameter that connects it to Gazebo, and
    sensors on a bus for simulation; the type of the bus is in the lowest bits of a sensor's id. Other parameters SIM_…
    do not count there: firmware of real boards has them too, since it can simulate on the board
    (https://docs.px4.io/main/en/simulation/hardware).

    Args:
        telemetry: autopilot and parameters of the vehicle.
    """
    parameters = telemetry.parameters
    if telemetry.autopilot == "PX4":
        has_simulator_switch = parameters.get("SIM_GZ_EN", 0) > 0
    else:
        has_simulator_switch = any(name.startswith("SIM_") for name in parameters)
    has_simulator_airframe = parameters.get("SYS_AUTOSTART") in SIH_AIRFRAMES
    gyro_bus = parameters.get("CAL_GYRO0_ID", 0) % DEVICE_BUS_TYPES
    return has_simulator_switch or has_simulator_airframe or gyro_bus == SIMULATED_SENSOR_BUS


def _is_without_sensor_noise(signals: Signals) -> bool:
    """Returns whether the roll rate before arming has less noise than any real gyroscope: a sign of a simulation.

    Before arming the vehicle stands still, so that changes of the rate are noise. The median of the changes within
    ``RATE_CHANGE_SECONDS`` is compared with ``MAX_SIMULATED_RATE_CHANGE``.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Whether it has less noise; False if there are too few samples before arming.
    """
    if not signals.tilts:
        return False
    roll = signals.tilts[0]
    first_boot = int(roll.boot[0]) if len(roll.boot) else 0
    arming_times = [start for start, _ in flight_states.armed_intervals(signals, first_boot)]
    first_arming_time = min(arming_times, default=inf)
    is_before_arming = (roll.boot == first_boot) & (roll.time < first_arming_time)
    if is_before_arming.sum() < 2:
        return False
    # Every n-th sample is used, so that each change is over the same time at any rate of the log.
    sample_step = np.median(np.diff(roll.time[is_before_arming]))
    stride = max(round(RATE_CHANGE_SECONDS / sample_step), 1)
    rates = roll.rate[is_before_arming][::stride]
    changes = abs(np.diff(rates))
    # A repeated value is no new measurement.
    changes = changes[changes > 0]
    if len(changes) < MIN_SAMPLES_FOR_STATISTICS:
        return False
    return bool(np.median(changes) < MAX_SIMULATED_RATE_CHANGE)
