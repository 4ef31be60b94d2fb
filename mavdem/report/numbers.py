"""Numbers and names as people read them: degrees for radians, the digits that an interval bears, and lists in words."""

from collections.abc import Iterable, Sequence
from math import degrees, floor, isfinite, log10
from typing import NamedTuple

MAX_LISTED_NAMES = 4
"""Names that a sentence lists before it says how many more there are: a choice."""

SMALL_LEADING_DIGIT = 3.0
"""A half width whose leading digit is below this has two digits, because rounding to one would change it by a third."""

MAX_PLAIN_DIGIT = 2
"""Largest power of ten of a half width's last digit that is written without a common power of ten."""

MIN_PLAIN_DIGIT = -6
"""Smallest power of ten of a half width's last digit that is written without a common power of ten."""

PLAIN_SIZES = (1e-4, 1e6)
"""Sizes from which and up to which a number is written without an exponent."""

UNKNOWN_FIGURE = "-"
"""What stands in the place of a figure that is not known: not estimated, or not finite."""


class DisplayUnit(NamedTuple):
    """A unit in which values are shown."""

    name: str
    """Symbol of the unit, such as "°/s"."""

    scale: float
    """Factor from the value in its own unit to the shown number."""


def display_unit(unit: str) -> DisplayUnit:
    """Returns the unit in which values of a ``unit`` are shown: degrees for radians, otherwise the unit itself."""
    if unit == "rad" or unit.startswith("rad/"):
        return DisplayUnit("°" + unit.removeprefix("rad"), degrees(1.0))
    return DisplayUnit(unit, 1.0)


def display_density_unit(unit: str) -> DisplayUnit:
    """Returns the unit in which power spectral densities of a signal are shown, such as "(°/s)²/Hz" for rates in rad/s.

    Args:
        unit: unit of the signal; "1" for one without a unit.
    """
    signal_unit = display_unit(unit)
    squared_name = "1" if signal_unit.name == "1" else f"({signal_unit.name})²"
    return DisplayUnit(f"{squared_name}/Hz", signal_unit.scale**2)


TORQUE_UNIT = display_unit("rad/s²")
"""Unit in which torques and control effectiveness are shown, both divided by the inertia of the axis: °/s²."""


def unit_per_input(unit: DisplayUnit, input_unit: str) -> str:
    """Returns the unit of an effect per unit of the input, such as "°/s per µs"."""
    return f"{unit.name or '1'} per {input_unit or 'unit of input'}"


def name_with_unit(name: str, unit: str) -> str:
    """Returns a name and its unit as a header, such as "roll, °"; the name alone without a unit."""
    return f"{name}, {unit}" if unit else name


def without_remark(name: str) -> str:
    """Returns a name without the remark in brackets after it: "motor 1" for "motor 1 (front right)"."""
    return name.split(" (")[0]


def listed(names: Iterable[object]) -> str:
    """Returns names as a list in words, such as "a, b and c"; an empty text for no names."""
    texts = [str(name) for name in names]
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} and {texts[-1]}"


def abbreviated_list(names: Sequence[str]) -> str:
    """Returns the first names as a list in words, and how many more there are, such as "a, b, c, d and 2 more".

    A single name beyond ``MAX_LISTED_NAMES`` is listed, too, because "1 more" is not shorter.

    Args:
        names: the names, in the order in which they are listed.
    """
    left_out_count = len(names) - MAX_LISTED_NAMES
    if left_out_count <= 1:
        return listed(names)
    return listed([*names[:MAX_LISTED_NAMES], f"{left_out_count} more"])


def counted(number: int, noun: str) -> str:
    """Returns a number with its noun in singular or plural: "1 flight" or "2 flights"."""
    if number == 1:
        return f"1 {noun}"
    return f"{number} {noun}s"


def one_line_list(names: Iterable[str], max_names: int = 5, max_length: int = 80) -> str:
    """Returns the first names, sorted and separated by commas, on one line that is safe to print.

    Args:
        names: names from a file, which may be long or contain control characters.
        max_names: largest number of names that are listed; "…" replaces the others.
        max_length: largest number of characters of a name; "…" replaces the rest.
    """
    sorted_names = sorted(names)
    listed_names = []
    for name in sorted_names[:max_names]:
        printable_name = ""
        for character in name[:max_length]:
            # Control characters could change what a terminal shows.
            printable_name += character if character.isprintable() else "\N{REPLACEMENT CHARACTER}"
        if len(name) > max_length:
            printable_name += "…"
        listed_names.append(printable_name)
    if len(sorted_names) > max_names:
        listed_names.append("…")
    return ", ".join(listed_names)


def plus_minus_or_below(value: float, half_width: float) -> str:
    """Returns an estimate of a quantity above zero with the half width of its interval.

    If the interval contains zero, its upper end is returned, since the estimate does not differ from zero.

    >>> plus_minus_or_below(3.5123, 1.149), plus_minus_or_below(1.5, 1.6)
    ('3.5 ± 1.1', 'below 3.1')

    Args:
        value: the estimate.
        half_width: half width of its interval, in the same unit.
    """
    if value > half_width:
        return plus_minus(value, half_width)
    return f"below {rounded(value + half_width)}"


def plus_minus(value: float, half_width: float) -> str:
    """Returns an estimate with the half width of its interval, both with the digits that the half width bears.

    The half width gets one significant digit, or two where the first is 1 or 2, and the value ends at the same decimal
    place. A value or a half width that is not finite gives a dash; without a half width, the value has three digits.

    >>> plus_minus(3.5123, 1.149), plus_minus(1234.0, 32.0)
    ('3.5 ± 1.1', '1230 ± 30')

    Args:
        value: the estimate.
        half_width: half width of its interval, in the same unit.
    """
    if not (isfinite(value) and isfinite(half_width)):
        return UNKNOWN_FIGURE
    if half_width <= 0:
        return f"{value:.3g}"
    last_place = _last_decimal_place(half_width)
    exponent = 0
    if not MIN_PLAIN_DIGIT <= last_place <= MAX_PLAIN_DIGIT:
        # Both numbers share one power of ten, whose exponent is a multiple of three as in engineering notation.
        first_place = floor(log10(abs(value) or half_width))
        exponent = 3 * (max(last_place, first_place) // 3)
    # Number of digits after the decimal point once both are divided by the power of ten; negative if the last digit is
    # a ten or a hundred.
    decimals = exponent - last_place
    value_text = _rounded_to_decimals(float(value) / 10.0**exponent, decimals)
    half_width_text = _rounded_to_decimals(float(half_width) / 10.0**exponent, decimals)
    if exponent:
        return f"({value_text} ± {half_width_text})e{exponent}"
    return f"{value_text} ± {half_width_text}"


def _last_decimal_place(half_width: float) -> int:
    """Returns the power of ten of the last digit that the half width of an interval is shown with.

    It is that of the leading digit or, where the leading digit is 1 or 2, of the digit after it.

    >>> _last_decimal_place(0.032), _last_decimal_place(0.012)
    (-2, -3)
    """
    leading_place = floor(log10(half_width))
    if half_width < SMALL_LEADING_DIGIT * 10.0**leading_place:
        return leading_place - 1
    return leading_place


def _rounded_to_decimals(number: float, decimals: int) -> str:
    """Formats a number with so many decimals; a negative number of decimals rounds to tens, hundreds and so on.

    >>> _rounded_to_decimals(1234.0, -1)
    '1230'
    """
    # Adding 0.0 turns -0.0 into 0.0, which is shown without a sign.
    rounded_number = round(number, decimals) + 0.0
    return f"{rounded_number:.{max(decimals, 0)}f}"


def with_unit(value: float, unit: DisplayUnit) -> str:
    """Returns a value in the unit in which it is shown, with two digits: "3.9°" or "3.7 °/s"."""
    return number_with_unit(rounded(unit.scale * value), unit.name)


def number_with_unit(number: str, unit: str) -> str:
    """Returns a number and its unit as text, with a space between them unless the unit is degrees: "3.9°", "10 s".

    Args:
        number: the number as text.
        unit: its unit; empty without one.
    """
    space = "" if unit in ("", "°") else " "
    return f"{number}{space}{unit}"


def rounded(value: float, digits: int = 2) -> str:
    """Returns a number with at least ``digits`` significant digits, and with all digits before the decimal point.

    Numbers outside of ``PLAIN_SIZES`` have an exponent. NaN and −∞ give a dash, ∞ gives "infinite".

    >>> rounded(1234.5), rounded(0.01234), rounded(3.0)
    ('1234', '0.012', '3.0')

    Args:
        value: the number.
        digits: least number of significant digits.
    """
    if not isfinite(value):
        return "infinite" if value > 0 else UNKNOWN_FIGURE
    smallest, largest = PLAIN_SIZES
    if value == 0 or not smallest <= abs(value) < largest:
        return f"{value:z.{digits}g}"
    decimals = max(digits - 1 - floor(log10(abs(value))), 0)
    return f"{value:.{decimals}f}"


def estimate_with_interval(
    value: float | None, interval: Sequence[float] | None, scale: float = 1.0
) -> str:
    """Returns an estimate with the ends of its interval, such as "57 (50 to 63)"; empty if any of them is not known.

    Args:
        value: the estimate; None where it is not known.
        interval: lower and upper end of its interval, in the same unit; None where they are not known.
        scale: factor from this unit to the one in which the numbers are shown.
    """
    if value is None or interval is None or None in interval:
        return ""
    low, high = interval
    return f"{rounded(scale * value)} ({rounded(scale * low)} to {rounded(scale * high)})"


def parameter_value_text(value: float) -> str:
    """Returns the value of an autopilot's parameter: whole numbers with all digits, others with seven.

    Autopilots store parameters in single precision, which has about seven digits.
    """
    if float(value).is_integer():
        return f"{value:.0f}"
    return f"{value:.7g}"
