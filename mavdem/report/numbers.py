"""Numbers and names for people: degrees for angles, as many digits as an interval bears, names with their units."""

from collections.abc import Iterable, Sequence
from math import degrees, floor, isfinite, log10
from typing import NamedTuple


class DisplayUnit(NamedTuple):
    """A unit to show values in: what is shown is ``scale`` times the value."""

    name: str
    scale: float


def display_unit(unit: str) -> DisplayUnit:
    """Returns degrees for a ``unit`` with radians, and any other as it is."""
    if unit == "rad" or unit.startswith("rad/"):
        return DisplayUnit("°" + unit.removeprefix("rad"), degrees(1.0))
    return DisplayUnit(unit, 1.0)


TORQUE_UNIT = display_unit("rad/s²")  # of torques and of effects, by the axis's inertia


def unit_per_input(unit: DisplayUnit, of: str) -> str:
    """Returns the unit of what one unit ``of`` the input does: "°/s per µs"."""
    return f"{unit.name or '1'} per {of or 'unit of input'}"


def name_with_unit(name: str, unit: str) -> str:
    """Returns the ``name`` with its ``unit``, where it has one."""
    return f"{name}, {unit}" if unit else name


def without_remark(name: str) -> str:
    """Returns a ``name`` without the remark in brackets after it: "motor 1" for "motor 1 (front right)"."""
    return name.split(" (")[0]


def motor_position(name: str) -> str:
    """Returns where a motor is: "front right" for "motor 1 (front right)"; the ``name`` where that is not known."""
    _, bracket, where = name.partition(" (")
    return where.removesuffix(")") if bracket else name


def listed(names: Iterable[object]) -> str:
    """Returns ``names`` as "a, b and c"; empty where there are none."""
    *before, last = [*map(str, names)] or [""]
    return f"{', '.join(before)} and {last}" if before else last


MAX_LISTED_NAMES = 4  # in a sentence


def abbreviated_list(names: Sequence[str]) -> str:
    """Returns the first ``names`` as in a sentence, and how many more there are: a single one is named, too."""
    more = len(names) - MAX_LISTED_NAMES
    return listed([*names[:MAX_LISTED_NAMES], f"{more} more"] if more > 1 else names)


def counted(number: int, noun: str) -> str:
    """Returns "1 flight" or "2 flights"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def one_line_list(names: Iterable[str], most: int = 5, longest: int = 80) -> str:
    """Returns the first ``most`` of ``names`` in order, each in one line however ``longest`` it is in the file."""
    *shown, rest = [*sorted(names), ""][: most + 1]
    cut = [name if len(name) <= longest else f"{name[:longest]}…" for name in shown]
    plain = [
        "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)
        for name in cut
    ]
    return ", ".join([*plain, *["…"] * bool(rest)])


def plus_minus(value: float, half: float) -> str:
    """Returns an estimate and the ``half`` width of its interval, with the digits that it bears; a dash without one.

    >>> plus_minus(3.5123, 1.149), plus_minus(1234.0, 32.0)
    ('3.5 ± 1.1', '1230 ± 30')
    """
    if not (isfinite(value) and isfinite(half)):
        return "-"
    if half <= 0:
        return f"{value:.3g}"
    digit = floor(log10(half))
    # A half width that begins with 1 or 2 has two digits, lest rounding changes it by a third.
    digit -= half < 3 * 10.0**digit
    # Decimals where they are few, else one power of ten for both.
    power = 0 if -6 <= digit <= 2 else 3 * (max(digit, floor(log10(abs(value) or half))) // 3)
    decimals = max(power - digit, 0)
    mean, width = (
        f"{round(number / 10.0**power, power - digit) + 0.0:.{decimals}f}"
        for number in (float(value), float(half))
    )
    return f"({mean} ± {width})e{power}" if power else f"{mean} ± {width}"


def with_unit(value: float, unit: DisplayUnit) -> str:
    """Returns a ``value`` in the ``unit`` it is shown in, with two digits: "3.9°", "3.7 °/s"."""
    space = "" if unit.name in ("", "°") else " "
    return f"{rounded(unit.scale * value)}{space}{unit.name}"


def rounded(value: float, digits: int = 2) -> str:
    """Returns so many significant ``digits``, and those before the decimal point; no exponent for everyday sizes."""
    if not isfinite(value):
        return "infinite" if value > 0 else "-"
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    return f"{value:.{max(digits - 1 - floor(log10(abs(value))), 0)}f}"
