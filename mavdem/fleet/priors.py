"""Priors from earlier flights of a vehicle for its next one: the physical parameters and the drag."""

import json
from pathlib import Path
from typing import NamedTuple

from mavdem.dem import Learned
from mavdem.errors import Unreadable
from mavdem.facts.fleet import NoPrior
from mavdem.fleet.row import SYSTEM_ID_BASIS
from mavdem.fleet.rows_of_log import MODEL, REPORT, file_text
from mavdem.wind_velocity.vehicle_drag import Drag


def earlier_flight(path: Path, axis: str) -> Learned:
    """Returns the model of an earlier flight, whose physical parameters can be a prior for the next one.

    Args:
        path: a ``model.json``, or the folder that holds it.
        axis: the axis that the model must be of, "roll", "pitch" or "yaw".

    Returns:
        The model, with identifiable physical parameters.

    Raises:
        Unreadable: it cannot be read, is of another axis, or its flight does not identify the motors' effect.
    """
    file = path / MODEL if path.is_dir() else path
    try:
        learned = Learned.from_json(file_text(file))
    except (OSError, ValueError) as error:
        raise Unreadable(NoPrior.MODEL_UNREADABLE, path=path, reason=error) from None
    if learned.record.output_names[:1] != (axis,):
        raise Unreadable(NoPrior.MODEL_OF_OTHER_AXIS, path=path, name=axis)
    if learned.physical is None or not learned.physical.identifiable:
        raise Unreadable(NoPrior.MODEL_WITHOUT_EFFECT, path=path, name=axis)
    return learned


class EarlierDrag(NamedTuple):
    """The drag of an earlier flight, as a prior for the next one."""

    drag: Drag
    """The drag, with an uncertainty for the next flight."""

    vehicle: str
    """Name of the vehicle that flew; empty if the document has none.

    A name by the MAVLink system id, which many vehicles share, is no name.
    """


def earlier_drag(path: Path, wind_speed: float | None = None) -> EarlierDrag:
    """Reads the drag of an earlier flight as a prior for the next one.

    A vehicle roughly keeps its drag coefficients from flight to flight, so the next flight need not estimate them from
    nothing.

    Args:
        path: document of ``mavdem learn`` or ``mavdem wind --json``. For a folder, or a ``model.json``, the report in
            the same folder is read.
        wind_speed: wind speed of the flight that the prior is for, m/s. A report with exactly this speed is of the same
            flight, which cannot be its own prior.

    Returns:
        The drag, and whose it is.

    Raises:
        Unreadable: the document cannot be read, contains no drag, or is of the same flight.
    """
    if path.is_dir():
        file = path / REPORT
    elif path.name == MODEL:
        file = path.with_name(REPORT)
    else:
        file = path
    try:
        document = json.loads(file_text(file))
        # In a report the wind is one part; the document of `mavdem wind` is the wind itself.
        wind = document.get("wind_velocity", document)
        drag = Drag.from_dict(wind["drag"]).for_next_flight()
        identity = document.get("identity") or {}
        is_named = identity.get("basis") != SYSTEM_ID_BASIS
        vehicle = str(identity.get("name", "")) if is_named else ""
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise Unreadable(NoPrior.DRAG_UNREADABLE, path=file, reason=reason) from error
    if wind_speed is not None and wind.get("speed") == wind_speed:
        raise Unreadable(NoPrior.DRAG_OF_THIS_FLIGHT, path=file)
    return EarlierDrag(drag, vehicle)
