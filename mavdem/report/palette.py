"""The palette: one colour for each meaning in all charts, pages and dashboards, as sRGB "#rrggbb".

Each has a contrast of at least 3 with white and with a dark background (WCAG 2.2, 1.4.11). Colours that meet in one
chart can be told apart by people with two kinds of cones, too (Machado, Oliveira and Fernandes, 2009).
"""

MEASURED = "#7d8694"
"""What sensors recorded: thin and neutral, because what is computed lies over it."""

PREDICTED = "#1f7ad6"
"""One-step predictions, forecasts, and the model itself."""

BASELINE = "#b5852a"
"""Forecasts without a model."""

DISTURBANCE = "#9461d1"
"""The torque of the wind, and the wind."""

GUST = "#b5852a"
"""Gusts, behind the disturbance."""

COMMAND = "#12997a"
"""The command of an axis: the difference between the motors."""

PHYSICAL = "#12997a"
"""The physical parameters, beside the learned model."""

TRUTH = "#dd5a2f"
"""The truth of a simulated flight, and setpoints."""

BOUND = "#7d8694"
"""What chance alone would reach, zero, and limits."""

LIMITED = "#b5852a"
"""Level "watch": always beside a word, never instead of one."""

BAD = "#d6453d"
"""Level "bad", and alarms: always beside a word, never instead of one."""

GOOD = "#12997a"
"""Level "good": always beside a word, never instead of one."""

DISTINCT = (
    "#1f7ad6",
    "#dd5a2f",
    "#12997a",
    "#b35fc4",
    "#b5852a",
    "#7d8694",
    "#5b66c9",
    "#c94f6d",
    "#4f8f3f",
)
"""Colours of motors and other series without a meaning of their own, used in turn; their names stand beside them."""

MODE_COLOURS = tuple(colour for colour in DISTINCT if colour != MEASURED)
"""Colours of flight modes, used in turn; neutral is a mode that is not known. Their names stand beside them."""

ASCENDING = ("#3f62e0", "#8457dc", "#c04fb4", "#dc5a68", "#cf8320")
"""Colours of quantities in classes, from low to high: each is lighter than the one before, which shows their order."""

INK_ON_LIGHT = "#24292f"
"""Text and axes; a page replaces it where its theme is dark."""

PAPER_LIGHT = "#ffffff"
"""Background of the light theme."""

PAPER_DARK = "#0d1117"
"""Background of the dark theme."""

BAND_OPACITY = 0.22
"""Opacity of bands around a line, and of the shade behind held-out windows."""


def distinct(index: int) -> str:
    """Returns the colour of the series with this number; colours repeat after the last one."""
    return DISTINCT[index % len(DISTINCT)]


def channels(colour: str) -> tuple[int, int, int]:
    """Returns red, green and blue of a colour of this palette, 0 to 255 each."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
