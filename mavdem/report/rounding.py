"""Numbers for people: rounded to what their intervals bear, in degrees where they are angles."""

from __future__ import annotations

from math import floor, isfinite, log10

from mavdem.report.names import Readable

FEW_DIGITS = 3  # A half width that begins with 1 or 2 has two digits, lest rounding changes it by a third


def plus_minus(value: float, half: float) -> str:
    """An estimate and the half width of its interval, as many digits as that bears; a dash where there is none."""
    if not (isfinite(value) and isfinite(half)):
        return "-"
    if half <= 0:
        return f"{value:.3g}"
    digit = floor(log10(half))
    digit -= half < FEW_DIGITS * 10.0**digit
    # Decimals where they are few, else one power of ten for both.
    power = 0 if -6 <= digit <= 2 else 3 * (max(digit, floor(log10(abs(value) or half))) // 3)
    decimals = max(power - digit, 0)
    mean, width = (
        f"{round(number / 10.0**power, power - digit) + 0.0:.{decimals}f}" for number in (float(value), float(half))
    )
    return f"({mean} ± {width})e{power}" if power else f"{mean} ± {width}"


def with_unit(value: float, unit: Readable, digits: int = 2) -> str:
    """A value in the unit it is shown in: "3.9°", "3.7 °/s"."""
    space = "" if unit.name in ("", "°") else " "
    return f"{rounded(unit.scale * value, digits)}{space}{unit.name}"


def rounded(value: float, digits: int = 2) -> str:
    """So many significant digits, and those before the decimal point; no exponent for sizes of every day."""
    if not isfinite(value):
        return "infinite" if value > 0 else "-"
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    return f"{value:.{max(digits - 1 - floor(log10(abs(value))), 0)}f}"
