"""What every section of a scenario shares: its rules, the ranges of its numbers, and where a key stands, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

_COUNTED = {"wind": "wind", "moments": "moment"}  # Sections that there may be several of, and what one is called
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")


def place(words: Sequence[int | str]) -> str:
    """Where something stands: the keys that lead there, an int for one of several, counted from 0."""
    section, *rest = words
    if section in _COUNTED and rest and isinstance(rest[0], int):
        number = rest[0]
        nth = f"{_ORDINALS[number]} {_COUNTED[section]}" if number < len(_ORDINALS) else f"{section} no. {number + 1}"
        return f"the {nth}" + (f"'s {_dotted(rest[1:])}" if rest[1:] else "")
    return _dotted(words)


def _dotted(words: Sequence[int | str]) -> str:
    return ".".join(shortened(str(word)) for word in words)


def shortened(text: str, longest: int = 60) -> str:
    """Text cut to ``longest`` characters, with an ellipsis where it was longer."""
    return text if len(text) <= longest else f"{text[: longest - 2]} …"


MAX_SECONDS = 7200.0  # Seconds of a flight: an hour is much, and two are enough

Positive = Annotated[float, Field(gt=0, le=MAX_SECONDS)]
NotNegative = Annotated[float, Field(ge=0, le=MAX_SECONDS)]
Share = Annotated[float, Field(ge=0, le=1)]


class Section(BaseModel):
    """A part of a scenario: immutable, without keys it does not know, and without text for numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)
