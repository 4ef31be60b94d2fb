"""Flights as pandas and xarray objects."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mavdem.export.tables import TIME, columns
from mavdem.flight import Flight

if TYPE_CHECKING:
    import pandas
    import xarray


def to_pandas(flight: Flight) -> pandas.DataFrame:
    """Rows are samples, by time in s on the autopilot's boot clock; columns are those of :func:`columns`.

    The flight's provenance is in ``attrs``.

    Raises:
        ValueError: two columns have one name.
    """
    import pandas

    table = columns(flight)
    index = pandas.Index(table.pop(TIME), name=TIME)
    frame = pandas.DataFrame(table, index=index)
    frame.attrs = {"dt": flight.dt, "provenance": dict(flight.provenance)}
    return frame


def to_xarray(flight: Flight) -> xarray.Dataset:
    """Variables ``inputs (time, input)``, ``outputs (time, output)`` and what else the flight has, by name.

    ``time`` is in s on the autopilot's boot clock. Units stand beside the names, as ``input_unit (input)`` and so on;
    the sampling step and the source are in ``attrs``.
    """
    import xarray

    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"time": ("time", flight.time, {"units": "s", "long_name": "time since boot"})}
    for kind, values in (("input", flight.inputs), ("output", flight.outputs), ("setpoint", flight.setpoints)):
        if values is None:
            continue
        variables[f"{kind}s"] = (("time", kind), values)
        coordinates[kind] = (kind, list(getattr(flight, f"{kind}_names")))
        coordinates[f"{kind}_unit"] = (kind, list(getattr(flight, f"{kind}_units")))
    if flight.voltage is not None:
        variables["voltage"] = ("time", flight.voltage, {"units": "V"})
    if flight.effect_directions is not None:
        variables["effect_directions"] = ("input", flight.effect_directions)
    return xarray.Dataset(variables, coordinates, {"dt": flight.dt, "source": str(flight.provenance.get("source", ""))})
