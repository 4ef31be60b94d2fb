"""How much stronger or weaker the magnetic field at a compass is in flight than on the ground before it.

The earth's field has the same strength in all attitudes of the vehicle. Currents of the motors add a field, which a
compass mounted too near to them feels.
"""

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dataset.time_series import TimeSeries


def field_change(evidence: Evidence, field: TimeSeries) -> float | None:
    """Returns the relative change of the field's median strength from the ground to the first flight.

    Args:
        evidence: signals, events and measurements of the vehicle.
        field: the magnetic field (N, 3) at a compass.

    Returns:
        The change, 0.3 where it is 30 % stronger in flight; None without a flight or enough samples before it.
    """
    flight = next(evidence.in_flight(field), None)
    if flight is None:
        return None
    is_before = (field.boot == flight.boot[0]) & (field.time < flight.time[0])
    strength_on_ground = field_strengths(field.values[is_before])
    strength_in_flight = field_strengths(flight.values)
    if len(strength_on_ground) < MIN_SAMPLES_FOR_STATISTICS or not len(strength_in_flight):
        return None
    return float(np.median(strength_in_flight) / np.median(strength_on_ground) - 1)


def field_strengths(field: Array) -> Array:
    """Computes the strength of a magnetic field at each sample, without samples of 0, which were not measured.

    Args:
        field: (N, 3) field along the axes of the compass.

    Returns:
        (M,) strengths of the M ≤ N measured samples, in the unit of the field.
    """
    strengths = np.linalg.norm(field, axis=1)
    return strengths[strengths > 0]
