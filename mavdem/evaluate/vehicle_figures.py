"""What a log says of the vehicle: physical parameters and wind of each axis, and how hard each motor works."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, NamedTuple

from mavdem.alignment.drive import AXES
from mavdem.alignment.read import learnable_segments
from mavdem.condition.hover import HoverFigures, hover_of_log
from mavdem.dem import Physical, WindTorque, physical
from mavdem.dem.graybox.wind import wind
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.evaluate.flight_report import physical_values, wind_values
from mavdem.flight import Flight
from mavdem.ingest import Log, read_log

ALL = "all"


class AxisFigures(NamedTuple):
    """One axis, from all its settled flight.

    Attributes:
        flights: its segments; none where there is a ``reason``.
        physical: effect of each motor, damping and lag, with the status of each.
        wind: its torque.
        reason: why there are no physical parameters; empty where there are.
    """

    flights: tuple[Flight, ...]
    physical: Physical | None
    wind: WindTorque | None
    reason: str


class VehicleFigures(NamedTuple):
    """All that was asked of a vehicle.

    Attributes:
        axes: figures by name of axis.
        hover: trim, imbalance and headroom of each motor; ``None`` where no settled flight has motor outputs.
    """

    axes: dict[str, AxisFigures]
    hover: HoverFigures | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        axes = {
            name: {"physical": physical_values(own.physical), "wind": wind_values(own.wind), "reason": own.reason}
            for name, own in self.axes.items()
        }
        return {"axes": axes, "hover": None if self.hover is None else self.hover.as_dict()}


def vehicle(path: str | bytes | PathLike[str], axis: str = ALL, vehicle: str | None = None) -> VehicleFigures:
    """Roll, pitch and yaw of a log in one call, or one of them; yaw by its rate only.

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        axis: "all", "roll", "pitch" or "yaw".
        vehicle: "system" or "system:component", where the log holds several.

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: it holds no vehicle, or several and none was chosen.
        ValueError: ``path`` is no path, or an axis that is none.
    """
    if axis not in (*AXES, ALL):
        raise ValueError(f"axis must be one of {', '.join((*AXES, ALL))}, not {axis!r}")
    return vehicle_of_log(read_log(path), AXES if axis == ALL else (axis,), vehicle)


def vehicle_of_log(
    log: Log,
    names: Sequence[str],
    vehicle: str | None = None,
    inputs: str | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> VehicleFigures:
    """As :func:`vehicle`, of these axes of a log that is read; ``progress`` is called with the share of them done."""
    axes = {}
    for done, name in enumerate(names, start=1):
        axes[name] = _axis(log, name, vehicle, inputs)
        progress(done / len(names))
    try:
        figures = hover_of_log(log, vehicle)
    except NotLearnable:
        figures = None
    return VehicleFigures(axes, figures)


def _axis(log: Log, axis: str, vehicle: str | None, inputs: str | None) -> AxisFigures:
    try:
        flights, _ = learnable_segments(log, axis, vehicle, inputs)
    except NotLearnable as error:
        return AxisFigures((), None, None, str(error))
    record = Record.of(flights)
    try:
        found = physical(record)
    except ValueError as error:
        return AxisFigures(flights, None, None, f"{str(error)[:1].upper()}{str(error)[1:]}.")
    try:
        return AxisFigures(flights, found, wind(found, record), "")
    except ValueError:  # LinAlgError is one
        return AxisFigures(flights, found, None, "")
