"""Units: a number annotated with its unit, which the schemas of documents and their reference show.

Each may be null: where it is not known, or not finite.
"""

from datetime import datetime
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import BeforeValidator, Field


def with_unit(name: str) -> Any:
    """Returns the annotation of a figure whose unit has this ``name``."""
    return Field(json_schema_extra={"unit": name})


def _iso(date: Any) -> Any:
    return date.isoformat(timespec="seconds") if isinstance(date, datetime) else date


Number = float | None
UtcText = Annotated[str, BeforeValidator(_iso), with_unit("ISO 8601, UTC")]
Acceleration = Annotated[Number, with_unit("m/s²")]
Amperes = Annotated[Number, with_unit("A")]
AngularAcceleration = Annotated[Number, with_unit("rad/s²")]
AngularRate = Annotated[Number, with_unit("rad/s")]
ArmLengths = Annotated[float, with_unit("arm lengths")]
Decibels = Annotated[Number, with_unit("dB")]
Degrees = Annotated[Number, with_unit("°")]
DegreesPerSecond = Annotated[Number, with_unit("°/s")]
Effectiveness = Annotated[Number, with_unit("rad/s² per unit of input")]
Hertz = Annotated[Number, with_unit("Hz")]
Inertia = Annotated[Number, with_unit("kg m²")]
Kilograms = Annotated[Number, with_unit("kg")]
Metres = Annotated[Number, with_unit("m")]
Nats = Annotated[Number, with_unit("nats")]
InputValue = Annotated[Number, with_unit("unit of the inputs")]
OutputValue = Annotated[Number, with_unit("rad, rad/s")]
ParameterValue = Annotated[Number, with_unit("unit of the parameter")]
PerHour = Annotated[Number, with_unit("1/h")]
PerMetre = Annotated[Number, with_unit("1/m")]
PerMinute = Annotated[Number, with_unit("1/min")]
PerSecond = Annotated[Number, with_unit("1/s")]
PerSecondOrSeconds = Annotated[Number, with_unit("1/s or s")]
Percent = Annotated[Number, with_unit("%")]
Radians = Annotated[Number, with_unit("rad")]
DisturbanceRejection = Annotated[Number, with_unit("s or s²")]
Seconds = Annotated[Number, with_unit("s")]
PowerDensityInStatedUnit = Annotated[Number, with_unit("unit²/Hz")]
ValueInStatedUnit = Annotated[Number, with_unit("see unit")]
Speed = Annotated[Number, with_unit("m/s")]
SquaredAngleOrRate = Annotated[Number, with_unit("rad², (rad/s)²")]
SquaredOutput = Annotated[Number, with_unit("square of the output's unit")]
TorqueDensity = Annotated[Number, with_unit("(rad/s²)²/Hz")]
UnixSeconds = Annotated[Number, with_unit("s (UNIX)")]
Volts = Annotated[Number, with_unit("V")]
TrimInStatedUnit = Annotated[float, with_unit("see trim_unit")]
InputInStatedUnit = Annotated[float, with_unit("see input_unit")]
PerRadian = Annotated[float, with_unit("1/rad")]
DragCoefficient = Annotated[float, with_unit("1/s, 1/m")]
EffectPerInput = Annotated[float, with_unit("rad/s² per input_unit")]
UtcTime = Annotated[datetime, with_unit("UTC")]


def field_units(record: type) -> dict[str, str]:
    """Returns the unit of each field of a ``record`` whose annotation has one, by name."""
    hints = get_type_hints(record, include_extras=True)
    return {name: with_unit for name, hint in hints.items() if (with_unit := _unit_in(hint))}


def _unit_in(hint: Any) -> str:
    for extra in getattr(hint, "__metadata__", ()):
        return str(extra.json_schema_extra["unit"])
    return next(filter(None, map(_unit_in, get_args(hint))), "")
