"""All parameters of the autopilot in a flight, stored with its results, so that a comparison needs not read the log."""

import json
from math import isfinite
from pathlib import Path

from mavdem.ingest.telemetry import Parameters
from mavdem.serve.stored_files import PARAMETERS_FILE


def write_parameters(folder: Path, parameters: Parameters) -> None:
    """Writes the parameters of a flight.

    Args:
        folder: folder of the results.
        parameters: values by the autopilot's name.
    """
    Path(folder, PARAMETERS_FILE).write_text(json.dumps(dict(parameters)), "utf-8")


def read_parameters(folder: Path) -> Parameters | None:
    """Reads the parameters of a flight.

    Args:
        folder: folder of the results.

    Returns:
        Values by the autopilot's name; None if there are none, as of flights that an earlier version has read, or if
        the file is damaged.
    """
    try:
        text = Path(folder, PARAMETERS_FILE).read_text("utf-8")
    except (OSError, ValueError):
        return None
    return parse_parameters(text)


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
