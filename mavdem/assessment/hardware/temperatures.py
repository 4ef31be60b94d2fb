"""Temperatures of devices in flight, as a fact (a coded finding) without a judgement: no limits are documented."""

from mavdem.assessment.evidence import Evidence
from mavdem.dataset.hardware_quantities import TEMPERATURES, recorded_quantity
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact


def temperatures_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about the lowest and highest temperature of each sensor in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact; None if no sensor has a temperature.
    """
    names = []
    lowest_temperatures = []
    highest_temperatures = []
    for quantity in TEMPERATURES:
        values = evidence.values_in_flight(recorded_quantity(evidence.signals, quantity))
        if len(values):
            names.append(quantity.name)
            lowest_temperatures.append(values.min())
            highest_temperatures.append(values.max())
    if not names:
        return None
    return Fact(
        HardwareFact.TEMPERATURES_MEASURED,
        Level.UNKNOWN,
        names=names,
        temperatures_least=lowest_temperatures,
        temperatures=highest_temperatures,
    )
