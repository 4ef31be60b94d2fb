"""Units: a number annotated with its unit, which the schemas of documents and their reference show.

Each may be null: where it is not known, or not finite.
"""

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
Acceleration = Annotated[Number, unit("m/s²")]
Amperes = Annotated[Number, unit("A")]
AngularAcceleration = Annotated[Number, unit("rad/s²")]
AngularRate = Annotated[Number, unit("rad/s")]
ArmLengths = Annotated[float, unit("arm lengths")]
Decibels = Annotated[Number, unit("dB")]
Degrees = Annotated[Number, unit("°")]
DegreesPerSecond = Annotated[Number, unit("°/s")]
Effectiveness = Annotated[Number, unit("rad/s² per unit of input")]
Hertz = Annotated[Number, unit("Hz")]
Inertia = Annotated[Number, unit("kg m²")]
Kilograms = Annotated[Number, unit("kg")]
Metres = Annotated[Number, unit("m")]
Nats = Annotated[Number, unit("nats")]
OfInput = Annotated[Number, unit("unit of the inputs")]
OfOutput = Annotated[Number, unit("rad, rad/s")]
OfParameter = Annotated[Number, unit("unit of the parameter")]
PerHour = Annotated[Number, unit("1/h")]
PerMetre = Annotated[Number, unit("1/m")]
PerMinute = Annotated[Number, unit("1/min")]
PerSecond = Annotated[Number, unit("1/s")]
PerSecondOrSeconds = Annotated[Number, unit("1/s or s")]
Percent = Annotated[Number, unit("%")]
Radians = Annotated[Number, unit("rad")]
Rejection = Annotated[Number, unit("s or s²")]
Seconds = Annotated[Number, unit("s")]
DensityOfUnit = Annotated[Number, unit("unit²/Hz")]
SeeUnit = Annotated[Number, unit("see unit")]
Speed = Annotated[Number, unit("m/s")]
SquareOfAngleOrRate = Annotated[Number, unit("rad², (rad/s)²")]
SquareOfOutput = Annotated[Number, unit("square of the output's unit")]
TorqueDensity = Annotated[Number, unit("(rad/s²)²/Hz")]
UnixSeconds = Annotated[Number, unit("s (UNIX)")]
Volts = Annotated[Number, unit("V")]
OfTrim = Annotated[float, unit("see trim_unit")]
OfInputUnit = Annotated[float, unit("see input_unit")]
PerRadian = Annotated[float, unit("1/rad")]
DragUnit = Annotated[float, unit("1/s, 1/m")]
EffectPerInput = Annotated[float, unit("rad/s² per input_unit")]
UtcTime = Annotated[datetime, unit("UTC")]


def units_of_fields(record: type) -> dict[str, str]:
    """Returns the unit of each field of a ``record`` whose annotation has one, by name."""
    hints = get_type_hints(record, include_extras=True)
    return {name: unit for name, hint in hints.items() if (unit := _unit_in(hint))}


def _unit_in(hint: Any) -> str:
    for extra in getattr(hint, "__metadata__", ()):
        return str(extra.json_schema_extra["unit"])
    return next(filter(None, map(_unit_in, get_args(hint))), "")
