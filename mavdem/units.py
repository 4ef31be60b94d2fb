"""Units: a number annotated with its unit, which the schemas of documents and their reference show.

Each may be null: where it is not known, or not finite.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import BeforeValidator, Field


def unit(name: str) -> Any:
    """Returns the annotation of a figure whose unit has this ``name``."""
    return Field(json_schema_extra={"unit": name})


def _iso(date: Any) -> Any:
    return date.isoformat(timespec="seconds") if isinstance(date, datetime) else date


Number = float | None
UtcText = Annotated[str, BeforeValidator(_iso), unit("ISO 8601, UTC")]
Acceleration = Annotated[float | None, unit("m/s²")]
Amperes = Annotated[float | None, unit("A")]
AngularAcceleration = Annotated[float | None, unit("rad/s²")]
AngularRate = Annotated[float | None, unit("rad/s")]
ArmLengths = Annotated[float, unit("arm lengths")]
Decibels = Annotated[float | None, unit("dB")]
Degrees = Annotated[float | None, unit("°")]
DegreesPerSecond = Annotated[float | None, unit("°/s")]
Effectiveness = Annotated[float | None, unit("rad/s² per unit of input")]
Hertz = Annotated[float | None, unit("Hz")]
Inertia = Annotated[float | None, unit("kg m²")]
Kilograms = Annotated[float | None, unit("kg")]
Metres = Annotated[float | None, unit("m")]
Nats = Annotated[float | None, unit("nats")]
OfInput = Annotated[float | None, unit("unit of the inputs")]
OfOutput = Annotated[float | None, unit("rad, rad/s")]
OfParameter = Annotated[float | None, unit("unit of the parameter")]
PerHour = Annotated[float | None, unit("1/h")]
PerMetre = Annotated[float | None, unit("1/m")]
PerMinute = Annotated[float | None, unit("1/min")]
PerSecond = Annotated[float | None, unit("1/s")]
PerSecondOrSeconds = Annotated[float | None, unit("1/s or s")]
Percent = Annotated[float | None, unit("%")]
Radians = Annotated[float | None, unit("rad")]
Rejection = Annotated[float | None, unit("s or s²")]
Seconds = Annotated[float | None, unit("s")]
DensityOfUnit = Annotated[float | None, unit("unit²/Hz")]
SeeUnit = Annotated[float | None, unit("see unit")]
Speed = Annotated[float | None, unit("m/s")]
SquareOfAngleOrRate = Annotated[float | None, unit("rad², (rad/s)²")]
SquareOfOutput = Annotated[float | None, unit("square of the output's unit")]
TorqueDensity = Annotated[float | None, unit("(rad/s²)²/Hz")]
UnixSeconds = Annotated[float | None, unit("s (UNIX)")]
Volts = Annotated[float | None, unit("V")]
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
