"""The palette: one colour a meaning, in every picture, page and dashboard, as sRGB "#rrggbb".

Each has a contrast of 3 or more with white and with a dark background (WCAG 2.2, 1.4.11), and those that meet in one
picture differ also to people with two kinds of cones (Machado, Oliveira and Fernandes, 2009).
"""

MEASURED = "#7d8694"  # what sensors recorded: thin and neutral, what is computed lies over it
# one-step predictions, forecasts and the model itself; their bands with ``BAND_OPACITY``
PREDICTED = "#1f7ad6"
BASELINE = "#b5852a"  # forecasts without a model
DISTURBANCE = "#9461d1"  # the wind's torque
GUST = "#b5852a"  # behind the disturbance
COMMAND = "#12997a"  # the roll command: the motors' difference
PHYSICAL = "#12997a"  # the physical parameters, beside the learned model
TRUTH = "#dd5a2f"  # of a simulated flight
BOUND = "#7d8694"  # what chance alone would reach, 0, limits

# of a level or grade; beside a word, never instead of one
LIMITED = "#b5852a"
BAD = "#d6453d"

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
"""For motors and other series without a meaning of their own, used cyclically; the names stand beside them."""

INK_ON_LIGHT = "#24292f"
"""Of text and axes; a page puts another in its place where its theme is dark."""
PAPER_LIGHT = "#ffffff"
PAPER_DARK = "#0d1117"

BAND_OPACITY = 0.22  # also of ``MEASURED`` behind what is held out


def distinct(index: int) -> str:
    """Returns the ``index``-th of the distinct colours."""
    return DISTINCT[index % len(DISTINCT)]


def channels(colour: str) -> tuple[int, int, int]:
    """Returns red, green and blue of a ``colour`` of this palette, 0 to 255."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
