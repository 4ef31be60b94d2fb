"""Units: a number annotated with its unit, which the schemas of documents and their reference show."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import Field


def unit(name: str) -> Any:
    """Returns the annotation of a figure whose unit has this ``name``."""
    return Field(json_schema_extra={"unit": name})


Number = float | None
"""Null where it is not known, or not finite."""
UtcText = Annotated[str, unit("ISO 8601, UTC")]
Acceleration = Annotated[float, unit("m/s²")]
Amperes = Annotated[float, unit("A")]
AngularAcceleration = Annotated[float, unit("rad/s²")]
AngularRate = Annotated[float, unit("rad/s")]
ArmLengths = Annotated[float, unit("arm lengths")]
Decibels = Annotated[float, unit("dB")]
Degrees = Annotated[float, unit("°")]
DegreesPerSecond = Annotated[float, unit("°/s")]
Effectiveness = Annotated[float, unit("rad/s² per unit of input")]
Hertz = Annotated[float, unit("Hz")]
Inertia = Annotated[float, unit("kg m²")]
Kilograms = Annotated[float, unit("kg")]
Metres = Annotated[float, unit("m")]
Nats = Annotated[float, unit("nats")]
OfInput = Annotated[float, unit("unit of the inputs")]
OfOutput = Annotated[float, unit("rad, rad/s")]
OfParameter = Annotated[float, unit("unit of the parameter")]
PerHour = Annotated[float, unit("1/h")]
PerMetre = Annotated[float, unit("1/m")]
PerMinute = Annotated[float, unit("1/min")]
PerSecond = Annotated[float, unit("1/s")]
PerSecondOrSeconds = Annotated[float, unit("1/s or s")]
Percent = Annotated[float, unit("%")]
Radians = Annotated[float, unit("rad")]
Rejection = Annotated[float, unit("s or s²")]
Seconds = Annotated[float, unit("s")]
SeeUnit = Annotated[float, unit("see unit")]
Speed = Annotated[float, unit("m/s")]
SquareOfAngleOrRate = Annotated[float, unit("rad², (rad/s)²")]
SquareOfOutput = Annotated[float, unit("square of the output's unit")]
TorqueDensity = Annotated[float, unit("(rad/s²)²/Hz")]
UnixSeconds = Annotated[float, unit("s (UNIX)")]
Volts = Annotated[float, unit("V")]
OfTrim = Annotated[float, unit("see trim_unit")]
OfInputUnit = Annotated[float, unit("see input_unit")]
PerRadian = Annotated[float, unit("1/rad")]
DragUnit = Annotated[float, unit("1/s, 1/m")]
EffectPerInput = Annotated[float, unit("rad/s² per input_unit")]
GainOfOutput = Annotated[float, unit("1/s², 1/s")]
UtcTime = Annotated[datetime, unit("UTC")]


def units_of_fields(record: type) -> dict[str, str]:
    """Returns the unit of each field of a ``record`` whose annotation has one, by name."""
    hints = get_type_hints(record, include_extras=True)
    return {name: found for name, hint in hints.items() if (found := _unit_in(hint))}


def _unit_in(hint: Any) -> str:
    for extra in getattr(hint, "__metadata__", ()):
        return str(extra.json_schema_extra["unit"])
    return next(filter(None, map(_unit_in, get_args(hint))), "")
