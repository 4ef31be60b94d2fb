"""All parameters of the autopilot in a flight, stored with its results, so that a comparison needs not read the log."""

import json
from pathlib import Path

from mavdem.fleet.parameter_text import parse_parameters
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
