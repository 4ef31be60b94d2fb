"""Whether all motors work harder in one of two states of a vehicle: mean output at equal battery voltage.

A vehicle that lost thrust in all motors, or became heavier, shows it here alone: trims compare its motors with each
other.
"""

from collections.abc import Sequence

from mavdem.fleet.flights import Flights, log_row
from mavdem.fleet.health_figures import health_figures
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.ingest.vocabulary import OUTPUT_RANGE_PARAMETERS
from mavdem.motors.effort import EffortChange, change_between_efforts


def effort_difference(
    before: Flights, after: Flights, parameters: Sequence[ParameterChange] = ()
) -> EffortChange | None:
    """Estimates by how much the mean motor output at equal battery voltage differs between two states of a vehicle.

    It uses the same statistics as the judgement of a vehicle's motors (:func:`change_between_efforts`).

    Args:
        before: flights of the first state of a vehicle, each as the list of its rows.
        after: flights of the second state.
        parameters: parameters of the autopilot that changed.

    Returns:
        The change from the first to the second state. None if output or voltage is not known in one of them, and if the
        parameters of the output range changed: the same fraction of the range is then another throttle.
    """
    efforts_before = _efforts(before)
    efforts_after = _efforts(after)
    has_other_range = any(OUTPUT_RANGE_PARAMETERS.match(change.name) for change in parameters)
    if not efforts_before or not efforts_after or has_other_range:
        return None
    return change_between_efforts(efforts_before, efforts_after)


def _efforts(flights: Flights) -> list[float]:
    """Returns the effort of each flight in which it is known: mean motor output (0 to 1) times measured voltage, V.

    Args:
        flights: the flights, each as the list of its rows.
    """
    efforts = [health_figures(log_row(flight)).effort for flight in flights]
    return [effort for effort in efforts if effort is not None]
