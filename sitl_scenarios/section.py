"""Base class of a scenario's sections, and the ranges of values that several of them share."""

from __future__ import annotations

from math import inf
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def shortened(text: str, max_length: int = 60) -> str:
    """Returns text cut to ``max_length`` characters, with an ellipsis where it was longer."""
    if len(text) <= max_length:
        return text
    return f"{text[: max_length - 2]} …"


MAX_SECONDS = 7200.0
"""Longest flight, s: a choice, far above the endurance of multirotors."""

# The limit also holds for values that are not times.
Positive = Annotated[float, Field(gt=0, le=MAX_SECONDS)]
NotNegative = Annotated[float, Field(ge=0, le=MAX_SECONDS)]
Share = Annotated[float, Field(ge=0, le=1)]
Size = Annotated[float, Field(ge=0, le=1000)]  # A size of a disturbance, in any unit.
Motor = Annotated[int, Field(ge=0, le=8)]


class Section(BaseModel):
    """A part of a scenario: immutable, without keys it does not know, and without text for numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True
    )


OR_INF = BeforeValidator(
    lambda given: None if given == inf else tuple(given) if isinstance(given, list) else given
)
"""Beside None, the time that never comes: TOML has no word for None, JSON none for infinity nor for tuples."""
