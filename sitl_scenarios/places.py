"""Places in a scenario, as people say them: ``wind.0.s`` is the first wind's s."""

from __future__ import annotations

from collections.abc import Sequence

_COUNTED = {"wind": "wind", "moments": "moment"}
"""Sections that there may be several of, and what one is called."""
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
_LONGEST = 60
"""Characters of a word out of a file that are said."""


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


def shortened(text: str, longest: int = _LONGEST) -> str:
    """Text that is no longer than ``longest`` and says so where it was."""
    return text if len(text) <= longest else f"{text[: longest - 2]} …"
