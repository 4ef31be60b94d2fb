"""Parameter files of ground stations: what a log without its autopilot's parameters lacks.

QGroundControl's .params has a line of vehicle, component, name, value and type, by tabs; the .param of Mission Planner
and of MAVProxy one of name and value, by a comma or spaces. Lines that begin with # are remarks.
"""

import os
import re
from contextlib import suppress
from dataclasses import replace
from math import isfinite

from mavdem.errors import Unreadable
from mavdem.facts.sources import Repair, Source
from mavdem.files import PathName
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.telemetry import Log, Parameters, Telemetry, repair_facts
from mavdem.ingest.vocabulary import mavlink_constant

REAL32 = mavlink_constant("MAV_PARAM_TYPE_REAL32")


def read_parameters(path: PathName) -> Parameters:
    """Returns the parameters of a file by name; raises ``Unreadable``: it cannot be opened, or has none."""
    parameters = {}
    for line in file_bytes(path).decode("utf-8", "replace").splitlines():
        words = re.split(r"[,\s]+", line.strip())
        if words[0].isdigit():
            words = words[2:]
        with suppress(ValueError, IndexError):
            name, value = words[0], float(words[1])
            if isfinite(value) and re.fullmatch(r"[A-Z]\w*", name):
                parameters[name] = value
    if not parameters:
        raise Unreadable(Source.NO_PARAMETERS_IN_FILE, path=os.fspath(path))
    return parameters


def with_parameters(log: Log, path: PathName) -> Log:
    """Returns a ``log`` whose vehicles have the parameters of the file where they have none of that name."""
    given = read_parameters(path)
    vehicles = []
    for vehicle in log.vehicles:
        count = len(given.keys() - vehicle.parameters.keys())
        added = repair_facts(Repair.PARAMETERS_ADDED, count=count, path=os.fspath(path))
        parameters = {**given, **vehicle.parameters}
        vehicles.append(replace(vehicle, parameters=parameters, repairs=(*vehicle.repairs, *added)))
    return replace(log, vehicles=tuple(vehicles))


def parameter_files(parameters: Parameters, vehicle: Telemetry) -> dict[str, str]:
    """Returns files with these ``parameters`` of a ``vehicle`` by their ending: .param of ArduPilot's alone."""
    who = f"{vehicle.system}\t{vehicle.component}"
    head = "# Gains (mavdem)\n"
    values = {name: f"{value:.9g}" for name, value in parameters.items()}
    lines = (f"{who}\t{name}\t{value}\t{REAL32}\n" for name, value in values.items())
    texts = {".params": head + "".join(lines)}
    if vehicle.autopilot == "ARDUPILOTMEGA":
        texts[".param"] = head + "".join(f"{name},{value}\n" for name, value in values.items())
    return texts
