"""Units of figures: types of numbers whose annotation names the unit that schemas and reference of documents show.

``Number`` may be null, where the figure is not known or not finite; types of a plain ``float`` are always finite.
"""

from datetime import datetime
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import BeforeValidator, Field


def with_unit(name: str) -> Any:
    """Returns the annotation of a type that gives its figure the unit of this ``name``."""
    return Field(json_schema_extra={"unit": name})


def _date_as_text(value: Any) -> Any:
    """Returns a date as ISO 8601 text to the second; any other value as it is."""
    return value.isoformat(timespec="seconds") if isinstance(value, datetime) else value


Number = float | None
"""A figure, or None where it is not known or not finite."""

# Figures of one unit each, named by the quantity or the unit.
Acceleration = Annotated[Number, with_unit("m/s²")]
Amperes = Annotated[Number, with_unit("A")]
AngularAcceleration = Annotated[Number, with_unit("rad/s²")]
AngularRate = Annotated[Number, with_unit("rad/s")]
Decibels = Annotated[Number, with_unit("dB")]
Degrees = Annotated[Number, with_unit("°")]
DegreesPerSecond = Annotated[Number, with_unit("°/s")]
Hertz = Annotated[Number, with_unit("Hz")]
Inertia = Annotated[Number, with_unit("kg m²")]
Kilograms = Annotated[Number, with_unit("kg")]
Metres = Annotated[Number, with_unit("m")]
Nats = Annotated[Number, with_unit("nats")]
PerHour = Annotated[Number, with_unit("1/h")]
PerMetre = Annotated[Number, with_unit("1/m")]
PerMinute = Annotated[Number, with_unit("1/min")]
PerSecond = Annotated[Number, with_unit("1/s")]
Percent = Annotated[Number, with_unit("%")]
Radians = Annotated[Number, with_unit("rad")]
Seconds = Annotated[Number, with_unit("s")]
Speed = Annotated[Number, with_unit("m/s")]
TorqueDensity = Annotated[Number, with_unit("(rad/s²)²/Hz")]
UnixSeconds = Annotated[Number, with_unit("s (UNIX)")]
Volts = Annotated[Number, with_unit("V")]

# Figures whose unit depends on the channel or on another field of the document.
DisturbanceRejection = Annotated[Number, with_unit("s or s²")]
Effectiveness = Annotated[Number, with_unit("rad/s² per unit of input")]
InputValue = Annotated[Number, with_unit("unit of the inputs")]
OutputValue = Annotated[Number, with_unit("rad, rad/s")]
ParameterValue = Annotated[Number, with_unit("unit of the parameter")]
PerSecondOrSeconds = Annotated[Number, with_unit("1/s or s")]
PowerDensityInStatedUnit = Annotated[Number, with_unit("unit²/Hz")]
SquaredAngleOrRate = Annotated[Number, with_unit("rad², (rad/s)²")]
SquaredOutput = Annotated[Number, with_unit("square of the output's unit")]
ValueInStatedUnit = Annotated[Number, with_unit("see unit")]

# Figures that are always known.
ArmLengths = Annotated[float, with_unit("arm lengths")]
DragCoefficient = Annotated[float, with_unit("1/s, 1/m")]
EffectPerInput = Annotated[float, with_unit("rad/s² per input_unit")]
InputInStatedUnit = Annotated[float, with_unit("see input_unit")]
PerRadian = Annotated[float, with_unit("1/rad")]
TrimInStatedUnit = Annotated[float, with_unit("see trim_unit")]

# Dates.
UtcText = Annotated[str, BeforeValidator(_date_as_text), with_unit("ISO 8601, UTC")]
UtcTime = Annotated[datetime, with_unit("UTC")]


def field_units(record: type) -> dict[str, str]:
    """Returns the unit of each field of a record class, from the annotations of the fields' types.

    Args:
        record: A dataclass, named tuple or model with type hints such as ``Seconds``.

    Returns:
        The unit by the field's name; fields without a unit are left out.
    """
    units = {}
    for name, hint in get_type_hints(record, include_extras=True).items():
        unit = _unit_in_hint(hint)
        if unit:
            units[name] = unit
    return units


def _unit_in_hint(hint: Any) -> str:
    """Finds the unit that annotates a type or, otherwise, one of its arguments.

    ``Annotated`` keeps its annotations in ``__metadata__``. A type such as ``tuple[Seconds, ...]`` has the unit of its
    first argument with one.

    Args:
        hint: A type hint.

    Returns:
        The unit; empty if there is none.
    """
    annotations = getattr(hint, "__metadata__", ())
    if annotations:
        # A type with a unit has no other annotation.
        unit_annotation = annotations[0]
        return str(unit_annotation.json_schema_extra["unit"])
    for argument in get_args(hint):
        unit = _unit_in_hint(argument)
        if unit:
            return unit
    return ""
