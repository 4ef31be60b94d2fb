"""The autopilot's processor over a flight, as a fact (a coded finding): load, memory, and loops that took too long."""

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.dataset.hardware_quantities import (
    MEMORY_FREE,
    MEMORY_USED,
    PROCESSOR_LOAD,
    recorded_quantity,
)
from mavdem.dataset.time_series import recorded_series
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact

FULL_LOAD = 100.0
"""Load, %, of SYS_STATUS below which a processor should always be (MAVLink's common.xml, ``load``)."""

LOAD_PARAMETER = "COM_CPU_MAX"
"""PX4's parameter of the load, %, above which it does not arm; a negative one switches that off."""

MEMORY_PARAMETER = "COM_RAM_MAX"
"""PX4's parameter of the fraction of the memory, %, above which it does not arm; a negative one switches that off."""

LOOP_COUNT_FIELDS = ("NL", "NLoop")
"""Fields of DataFlash's PM with the number of main loops since the message before, today and before ArduPilot 4.1."""


def processor_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about load and memory of the autopilot's processor in flight.

    The load is the largest mean over 2 s, the time that PX4 waits before it warns. The level is "watch" if load or
    memory reach the limit from which the autopilot warns: a parameter of PX4, or the full load of ArduPilot's main
    loop. It is "good" if neither does, and "unknown" if there is no limit of the load.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact, with load and memory in percent; None if the load was not recorded in flight.
    """
    signals = evidence.signals
    mean_loads = evidence.averages_in_flight(recorded_quantity(signals, PROCESSOR_LOAD))
    if not len(mean_loads):
        return None
    largest_load = float(mean_loads.max())
    parameters = signals.telemetry.parameters
    load_limit: float | None = FULL_LOAD
    if signals.telemetry.autopilot == "PX4":
        load_limit = parameters.get(LOAD_PARAMETER)
    used_memory = evidence.values_in_flight(recorded_quantity(signals, MEMORY_USED))
    largest_memory = float(used_memory.max()) if len(used_memory) else None
    memory_limit = parameters.get(MEMORY_PARAMETER)
    reaches_load_limit = _reaches(largest_load, load_limit)
    reaches_memory_limit = _reaches(largest_memory, memory_limit)
    if reaches_load_limit or reaches_memory_limit:
        level = Level.WATCH
    elif load_limit is not None and load_limit > 0:
        level = Level.GOOD
    else:
        level = Level.UNKNOWN
    free_memory = evidence.values_in_flight(recorded_quantity(signals, MEMORY_FREE))
    # A limit is shown only if it was reached.
    return Fact(
        HardwareFact.PROCESSOR_MEASURED,
        level,
        load=largest_load,
        load_usual=float(np.median(mean_loads)),
        load_limit=load_limit if reaches_load_limit else None,
        memory=largest_memory,
        memory_share_limit=memory_limit if reaches_memory_limit else None,
        memory_free=free_memory.min() if len(free_memory) else None,
        share=_fraction_of_long_loops(evidence),
    )


def _reaches(value: float | None, limit: float | None) -> bool:
    """Returns whether a value reaches a limit that is positive; False if one of them is not known."""
    return value is not None and limit is not None and 0 < limit <= value


def _fraction_of_long_loops(evidence: Evidence) -> float | None:
    """Returns the fraction of ArduPilot's main loops in flight that took too long.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fraction; None if they were not counted.
    """
    for count_field in LOOP_COUNT_FIELDS:
        # NLon is the number of main loops that took too long, of all main loops in the other field.
        loops = recorded_series(evidence.signals.telemetry, "PM", "NLon", count_field)
        if loops is None:
            continue
        counts = evidence.values_in_flight(loops)
        if not len(counts):
            return None
        long_count, count = counts.sum(axis=0)
        return float(long_count / count) if count else None
    return None
