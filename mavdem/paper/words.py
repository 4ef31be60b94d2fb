"""Numbers and lists in prose and tables."""

from __future__ import annotations

from math import isfinite


def number(value: float) -> str:
    """Three significant digits; powers of ten for very large and very small ones."""
    if not isfinite(value):
        return "∞" if value > 0 else "−∞" if value < 0 else "–"
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        digits = f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"
        return digits.replace("-", "−")
    mantissa, exponent = f"{value:.1e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa.replace('-', '−')}·10{raised}"


def percent(share: float) -> str:
    """``90 %``, with a decimal where rounding would give 0 % or 100 %."""
    whole = f"{share:.0%}"
    return (whole if 0.01 <= share <= 0.99 else f"{share:.1%}").replace("%", " %").replace(".0 ", " ")
