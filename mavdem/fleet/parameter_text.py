"""Parameters of an autopilot as a row of a fleet stores them: one text for all.

It imports nothing that computes, since the process that supervises readers of logs has it for a fleet's page.
"""

import json
from math import isfinite

from mavdem.ingest.telemetry import Parameters


def parse_parameters(text: str) -> Parameters | None:
    """Parses stored parameters.

    Args:
        text: JSON object with the value of each parameter by the autopilot's name.

    Returns:
        Values by the autopilot's name; None if the text is damaged.
    """
    try:
        # An integer of any length is a float, which may be infinite.
        values = json.loads(text, parse_int=float)
    except (ValueError, RecursionError):
        return None
    is_valid = isinstance(values, dict) and all(
        isinstance(value, float) and isfinite(value) for value in values.values()
    )
    return values if is_valid else None
