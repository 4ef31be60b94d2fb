"""Parameter files of ground stations, which supply the parameters that a log lacks.

QGroundControl's .params has a line of vehicle, component, name, value and type, separated by tabs; the .param of
Mission Planner and of MAVProxy one of name and value, separated by a comma or spaces. Lines that begin with # are
comments.
"""

import os
import re
from dataclasses import replace
from math import isfinite

import numpy as np

from mavdem.errors import Unreadable
from mavdem.facts.sources import Repair, SourceFact
from mavdem.files import PathName
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import Log, Parameters, Telemetry, repair_facts

REAL32 = mavlink_constant("MAV_PARAM_TYPE_REAL32")
"""MAVLink's number of the type of parameters in files that are written: float32."""

_PARAMETER_NAME = re.compile(r"[A-Z]\w*")


def read_parameters(path: PathName) -> Parameters:
    """Reads a parameter file of any ground station.

    Args:
        path: The file, or an archive of it.

    Returns:
        Finite values by name; of several lines of one parameter the last counts.

    Raises:
        Unreadable: The file cannot be opened, or has no parameters.
    """
    parameters = {}
    for line in file_bytes(path).decode("utf-8", "replace").splitlines():
        name, value = _parameter_of_line(line)
        if name:
            parameters[name] = value
    if not parameters:
        raise Unreadable(SourceFact.NO_PARAMETERS_IN_FILE, path=os.fspath(path))
    return parameters


def _parameter_of_line(line: str) -> tuple[str, float]:
    """Returns the parameter in a line of a parameter file.

    Both formats are read by the same rule: words are separated by commas or spaces, and leading numbers are skipped.

    Args:
        line: A line of Mission Planner ("MOT_SPIN_MIN,0.15") or QGroundControl ("1 1 MOT_SPIN_MIN 0.15 9").

    Returns:
        Name and finite value; an empty name and 0 if the line contains no parameter.
    """
    words = re.split(r"[,\s]+", line.strip())
    if words[0].isdigit():
        # QGroundControl's lines begin with the numbers of the vehicle and of the component; name and value follow.
        words = words[2:]
    try:
        name, value = words[0], float(words[1])
    except (ValueError, IndexError):
        return "", 0.0
    if not isfinite(value) or _PARAMETER_NAME.fullmatch(name) is None:
        return "", 0.0
    return name, value


def with_parameters(log: Log, path: PathName) -> Log:
    """Returns a log whose vehicles have the parameters of a file in addition; parameters in the log take precedence.

    Args:
        log: The log, which stays as it is.
        path: Path of the parameter file.

    Returns:
        A new log, whose vehicles have a fact that reports the addition.

    Raises:
        Unreadable: The file cannot be opened, or has no parameters.
    """
    file_parameters = read_parameters(path)
    vehicles = []
    for vehicle in log.vehicles:
        count = len(file_parameters.keys() - vehicle.parameters.keys())
        additions = repair_facts(Repair.PARAMETERS_ADDED, count=count, path=os.fspath(path))
        vehicles.append(
            replace(
                vehicle,
                parameters={**file_parameters, **vehicle.parameters},
                repairs=(*vehicle.repairs, *additions),
            )
        )
    return replace(log, vehicles=tuple(vehicles))


def parameter_files(parameters: Parameters, vehicle: Telemetry, purpose: str) -> dict[str, str]:
    """Writes parameters as ground stations read them.

    Args:
        parameters: Values of the parameters by name.
        vehicle: The vehicle they are for.
        purpose: What the parameters are for, in one line: the comment at the beginning of the files.

    Returns:
        The text of each file by the ending of its name: .params, and for ArduPilot .param too.
    """
    header = f"# {purpose} (mavdem)\n"
    qgroundcontrol_text = header
    mission_planner_text = header
    for name, value in parameters.items():
        # Autopilots keep parameters as float32: the fewest digits that are the same number are read best.
        digits = np.format_float_positional(np.float32(value), trim="-")
        columns = (str(vehicle.system), str(vehicle.component), name, digits, str(REAL32))
        qgroundcontrol_text += "\t".join(columns) + "\n"
        mission_planner_text += f"{name},{digits}\n"
    texts = {".params": qgroundcontrol_text}
    if vehicle.autopilot == "ARDUPILOTMEGA":
        texts[".param"] = mission_planner_text
    return texts
