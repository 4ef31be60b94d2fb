"""Lines: the colours that have the same meaning in every live view."""

from __future__ import annotations

MEASURED = (225, 228, 232)
PREDICTED = (255, 159, 28)
FORECAST = (64, 201, 162)
BAND = (40, 112, 94)
TRIVIAL = (133, 141, 153)
BOUNDARY = (150, 90, 200)
DISTINCT = (
    (92, 157, 255),
    (255, 107, 107),
    (250, 208, 44),
    (94, 214, 120),
    (198, 120, 255),
    (72, 219, 219),
    (255, 146, 196),
    (201, 160, 112),
    (158, 180, 60),
)
"""For lines without a fixed colour; used cyclically."""

Colour = tuple[int, int, int]


def distinct(index: int) -> Colour:
    """The ``index``-th of the distinct colours."""
    return DISTINCT[index % len(DISTINCT)]
