"""Priors from earlier flights of a vehicle for its next one: the physical parameters and the drag."""

import json
from pathlib import Path
from typing import NamedTuple

from mavdem.assessment.identity import Identity, identify_vehicle
from mavdem.confidence import IntervalEstimate
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.dem import Learned
from mavdem.errors import Unreadable
from mavdem.facts.fleet import NoPrior
from mavdem.facts.online import DragSource
from mavdem.facts.vehicle import GENERIC_FRAME
from mavdem.fleet.row import SYSTEM_ID_BASIS
from mavdem.fleet.rows_of_log import MODEL, REPORT, file_text
from mavdem.ingest import read_log
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.log_formats import LOG_ENDINGS
from mavdem.wind_velocity.from_log import wind_of_signals
from mavdem.wind_velocity.vehicle_drag import Drag
from mavdem.wind_velocity.velocity import WindVelocity, mean_air_speed

WIND_DOCUMENT = "wind.json"
"""Name of the file with the document of ``mavdem wind``, in its folder."""


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
    # The first output is the angle, which has the name of the axis.
    name_of_angle = learned.record.output_names[:1]
    if name_of_angle != (axis,):
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

    A name by the MAVLink system id, which many vehicles share, is not a name.
    """

    autopilot: str = ""
    """MAV_AUTOPILOT of the vehicle without its prefix, such as "PX4"; empty if it is not known."""

    frame: str = ""
    """MAV_TYPE of the vehicle without its prefix, such as "QUADROTOR"; empty if it is not known."""

    @property
    def is_typical(self) -> bool:
        """Whether it is only that of typical multirotors, since neither the flight nor a parameter shows the drag."""
        return self.drag.source is DragSource.POPULATION

    def is_of_another_vehicle(self, vehicle: str, autopilot: str, frame: str) -> bool:
        """Returns whether it is known that another vehicle flew: by its name, autopilot or type of frame.

        Args:
            vehicle: name of the vehicle of the next flight; empty if only its MAVLink system id is known.
            autopilot: its MAV_AUTOPILOT without the prefix; empty if it is not known.
            frame: its MAV_TYPE without the prefix; empty if it is not known.
        """
        return (
            _are_known_and_differ(self.vehicle, vehicle)
            or _are_known_and_differ(self.autopilot, autopilot)
            or _are_known_and_differ(self.frame, frame)
        )


def earlier_drag(path: Path, wind_speed: float | None = None) -> EarlierDrag:
    """Reads the drag of an earlier flight as a prior for the next one.

    A vehicle roughly keeps its drag coefficients from flight to flight, so the next flight need not estimate them from
    nothing.

    Args:
        path: log of the earlier flight, or a document of ``mavdem learn`` or ``mavdem wind``. For a ``model.json`` the
            report in the same folder is read, and of a folder its report or the document of ``mavdem wind``.
        wind_speed: wind speed of the flight that the prior is for, m/s. A report with exactly this speed is of the same
            flight, which cannot be its own prior.

    Returns:
        The drag, and whose it is.

    Raises:
        Unreadable: the log or document cannot be read, contains no drag, or is of the same flight.
        NotLearnable: the log shows no wind, and so no drag.
    """
    if path.is_file() and path.name.lower().endswith(LOG_ENDINGS):
        return _drag_of_log(path, wind_speed)
    file = _document_with_drag(path)
    try:
        document = json.loads(file_text(file))
        # The wind is one part of a report; the document of `mavdem wind` is the wind itself.
        wind = document.get("wind_velocity", document)
        drag = Drag.from_dict(wind["drag"]).for_next_flight()
        identity = document.get("identity") or {}
        # A name that is made of the system id may be the name of many vehicles.
        is_named = identity.get("basis") != SYSTEM_ID_BASIS
        vehicle = str(identity.get("name", "")) if is_named else ""
        autopilot = str(identity.get("autopilot", ""))
        frame = str(identity.get("frame", ""))
    # Any JSON value may stand in the file, also one that is no object, or is nested too deep.
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise Unreadable(NoPrior.DRAG_UNREADABLE, path=file, reason=reason) from error
    if wind_speed is not None and wind.get("speed") == wind_speed:
        raise Unreadable(NoPrior.DRAG_OF_THIS_FLIGHT, path=file)
    return EarlierDrag(drag, vehicle, autopilot, frame)


class DoubtOnPrior(NamedTuple):
    """What speaks against the drag of an earlier flight as the prior for the wind of a log."""

    is_of_another_vehicle: bool
    """Whether both vehicles are known by names, autopilots or types of frame, and these differ."""

    earlier: IntervalEstimate
    """The earlier drag force per mass and air speed, 1/s, at the mean air speed of this log."""

    alone: IntervalEstimate
    """The same of the drag that this log shows without the prior."""

    air_speed: float
    """That air speed, m/s."""

    is_contradicted: bool
    """Whether this log shows the drag itself, and the 90 % intervals of both drags exclude each other.

    Two flights of one vehicle with one load rarely differ so much.
    """


def doubt_on_prior(
    earlier: EarlierDrag, wind_alone: WindVelocity, identity: Identity
) -> DoubtOnPrior:
    """Returns what speaks against the drag of an earlier flight as the prior for the wind of a log.

    Args:
        earlier: drag of the earlier flight, and whose it is.
        wind_alone: wind of the log, estimated without that prior.
        identity: the vehicle of the log.
    """
    air_speed = mean_air_speed(wind_alone.air_velocity)
    earlier_drag_at_speed = earlier.drag.at_speed(air_speed)
    drag_alone = wind_alone.drag.at_speed(air_speed)
    shows_drag = wind_alone.drag.source is DragSource.FLIGHT
    return DoubtOnPrior(
        is_of_another_vehicle=earlier.is_of_another_vehicle(
            identity.name_of_one_vehicle, identity.autopilot, identity.frame
        ),
        earlier=earlier_drag_at_speed,
        alone=drag_alone,
        air_speed=air_speed,
        is_contradicted=shows_drag and drag_alone.excludes(earlier_drag_at_speed),
    )


def _are_known_and_differ(first: str, second: str) -> bool:
    """Returns whether two names, of vehicles, autopilots or frames, are both known and not the same."""
    are_known = not {first, second} & {"", UNNAMED, GENERIC_FRAME}
    return are_known and first != second


def _document_with_drag(path: Path) -> Path:
    """Returns the path of the JSON document that has the drag, where a user gave a folder or a model.

    Args:
        path: a folder of results, a ``model.json``, which has no drag itself, or the document.
    """
    if path.is_dir():
        report = path / REPORT
        return report if report.exists() else path / WIND_DOCUMENT
    if path.name == MODEL:
        return path.with_name(REPORT)
    return path


def _drag_of_log(path: Path, wind_speed: float | None) -> EarlierDrag:
    """Estimates the drag of the flight in a log, as a prior for another flight.

    Args:
        path: the log.
        wind_speed: wind speed of the flight that the prior is for, m/s; None if it is not known.

    Returns:
        The drag, and whose it is.

    Raises:
        Unreadable: the log cannot be read, or is of the same flight.
        NotLearnable: the log shows no wind, and so no drag.
    """
    signals = Signals(choose_vehicle(read_log(path).vehicles))
    wind = wind_of_signals(signals)
    if wind.speed == wind_speed:
        raise Unreadable(NoPrior.DRAG_OF_THIS_FLIGHT, path=path)
    identity = identify_vehicle(signals)
    return EarlierDrag(
        wind.drag.for_next_flight(),
        identity.name_of_one_vehicle,
        identity.autopilot,
        identity.frame,
    )
