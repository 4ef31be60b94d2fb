"""What ArduPilot's and PX4's controllers have in common: loop rates, notch filters and required parameters."""

from typing import Any, NamedTuple

from mavdem.errors import NotLearnable
from mavdem.facts.loops import ControllerFact
from mavdem.ingest.telemetry import Parameters

ControllerFields = dict[str, Any]
"""Values of the fields of a :class:`mavdem.loops.controllers.Controller`, by name."""
MOTOR_COUNT = 4
"""Number of motors of the frames whose mixer is known: quadrotors."""
MIN_LOOP_RATE = 50.0
"""Lowest rate of a rate loop, Hz: ArduCopter raises a lower ``SCHED_LOOP_RATE`` to it."""
MAX_LOOP_RATE = 1000.0
"""Highest rate of a rate loop that the simulation flies, Hz."""
LOOP_RATE_PARAMETERS = {"px4": "IMU_GYRO_RATEMAX", "ardupilot": "SCHED_LOOP_RATE"}
"""Name of the parameter with the rate of the rate loop, Hz, by autopilot."""
DEFAULT_LOOP_RATES = {"px4": 250.0, "ardupilot": 400.0}
"""Rate of the rate loop if the parameter is not known, Hz: PX4's in its simulators, ArduCopter's by default."""


class Notch(NamedTuple):
    """A second-order notch filter, described by its analog prototype.

    ``bandwidth / frequency`` is the damping of its poles, the inverse of its quality factor Q.
    """

    frequency: float
    """Centre, Hz."""
    bandwidth: float
    """Distance of the two frequencies at which a deep notch halves the power, Hz."""
    attenuation: float
    """Attenuation at the centre, dB; infinite for PX4's notches."""


class GainNames(NamedTuple):
    """How an autopilot names the gains of one axis."""

    rate_prefix: str
    """Beginning of the names of the rate controller's gains, such as "ATC_RAT_RLL_"."""
    angle_gain: str
    """Name of the gain of the attitude controller, such as "ATC_ANG_RLL_P"."""

    @property
    def rate_gains(self) -> tuple[str, str, str]:
        """Names of P, I and D of the rate controller."""
        return (f"{self.rate_prefix}P", f"{self.rate_prefix}I", f"{self.rate_prefix}D")


def required_parameters(parameters: Parameters, *names: str) -> list[float]:
    """Returns the values of parameters that are needed to build a controller.

    Args:
        parameters: parameters of the autopilot, by name.
        names: names of the parameters that are needed.

    Returns:
        Values in the order of ``names``, in the autopilot's units.

    Raises:
        NotLearnable: some are missing; the error lists them.
    """
    missing_names = [name for name in names if name not in parameters]
    if missing_names:
        raise NotLearnable(ControllerFact.PARAMETERS_MISSING, names=missing_names)
    return [parameters[name] for name in names]
