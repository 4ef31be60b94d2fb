"""Priors: what earlier flights of a vehicle say of the next one, its model and its drag."""

import json
from pathlib import Path

from mavdem.dem import Learned
from mavdem.errors import Unreadable
from mavdem.facts.fleet import NoPrior
from mavdem.fleet.rows_of_log import MODEL, REPORT, text_of
from mavdem.wind_velocity.vehicle_drag import Drag


def earlier_flight(path: Path, axis: str) -> Learned:
    """Returns a ``model.json``, or that in a folder, whose physical parameters can be a prior.

    Raises Unreadable: it cannot be read, is of another axis, or its flight does not identify the motors' effect.
    """
    try:
        learned = Learned.from_json(text_of(path / MODEL if path.is_dir() else path))
    except (OSError, ValueError) as error:
        raise Unreadable(NoPrior.MODEL_UNREADABLE, path=path, because=error) from None
    if learned.record.output_names[:1] != (axis,):
        raise Unreadable(NoPrior.MODEL_OF_OTHER_AXIS, path=path, name=axis)
    if learned.physical is None or not learned.physical.identifiable:
        raise Unreadable(NoPrior.MODEL_WITHOUT_EFFECT, path=path, name=axis)
    return learned


def earlier_drag(path: Path, speed: float | None = None) -> Drag:
    """Returns the drag of an earlier flight: of what ``mavdem learn`` or ``mavdem wind --json`` wrote.

    Of the folder or a ``model.json`` the report beside it counts. The flight with this very wind ``speed``, m/s, is the
    one in question, and none before it.

    Raises:
        Unreadable: it cannot be read, is of the flight in question, or holds no drag.
    """
    file = (
        path / REPORT if path.is_dir() else path.with_name(REPORT) if path.name == MODEL else path
    )
    try:
        read = json.loads(text_of(file))
        wind = read.get("wind_velocity", read)
        drag = Drag.from_dict(wind["drag"]).for_next_flight()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        because = error.strerror if isinstance(error, OSError) else None
        raise Unreadable(NoPrior.DRAG_UNREADABLE, path=file, because=because) from error
    if wind.get("speed") == speed is not None:
        raise Unreadable(NoPrior.DRAG_OF_THIS_FLIGHT, path=file)
    return drag
