"""Parameters of an autopilot as a row of a fleet stores them: one text for all.

It imports nothing that computes, since the process that supervises readers of logs has it for a fleet's page.
"""

import json
from math import isfinite

from mavdem.ingest.telemetry import Parameters


def parse_parameters(text: str) -> Parameters | None:
    """Parses the parameters of an autopilot from the text in a fleet's row, such as '{"MC_ROLLRATE_P": 0.15}'.

    Args:
        text: JSON object with the value of each parameter by the autopilot's name.

    Returns:
        Values by the autopilot's name; None if the text is damaged.
    """
    try:
        # Integers are read as floats too; one with too many digits becomes infinite.
        parameters = json.loads(text, parse_int=float)
    except (ValueError, RecursionError):
        return None
    if not isinstance(parameters, dict):
        return None
    are_finite_numbers = all(
        isinstance(value, float) and isfinite(value) for value in parameters.values()
    )
    return parameters if are_finite_numbers else None
