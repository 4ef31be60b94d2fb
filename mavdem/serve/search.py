"""Search: a line such as ``quad-7 motors:bad wind>5 ATC_RAT_RLL_P>0.1`` as a condition of SQL."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from mavdem.facts.lights import Light
from mavdem.facts.serve import Stage

TERM = re.compile(r"(\w+)(<=|>=|[:=<>])(.+)")
NUMBERS = {"wind": "wind_speed", "duration": "duration"}
TEXTS = {"vehicle": "vehicle", "level": "level", "sharing": "sharing", "stage": "stage"}
TEXTS |= {str(light): str(light) for light in Light}
LISTS = {"mode": "modes", "tag": "tags"}
WORKING = f"stage not in ('{Stage.DONE}', '{Stage.FAILED}')"


class Condition(NamedTuple):
    """A condition of SQL, and its values."""

    where: str
    values: tuple[Any, ...] = ()


def condition_of(text: str) -> Condition:
    """Returns the condition that all words of a search hold; a word that is no term is found in what is said."""
    parts = [Condition("1"), *_parts(text)]
    return Condition(
        " and ".join(part.where for part in parts),
        tuple(value for part in parts for value in part.values),
    )


def _parts(text: str) -> Iterator[Condition]:
    for word in text.split()[:20]:
        term = TERM.fullmatch(word)
        yield (term and _term(*term.groups())) or _contains("words", word.lower())


def _term(name: str, sign: str, value: str) -> Condition | None:
    known = name.lower()
    if sign == ":" and known in TEXTS:
        return Condition(f"{TEXTS[known]} = ? collate nocase", (value,))
    if sign == ":" and known in LISTS:
        return _contains(f"',' || {LISTS[known]} || ','", f",{value},")
    if sign == ":" and known == "motor":
        return Condition("motor = cast(? as integer)", (value,))
    if sign != ":" and known == "date":
        return Condition(f"date {sign} ?", (value,))
    try:
        number = float(value)
    except ValueError:
        return None
    if sign == ":":
        return None
    if known in NUMBERS:
        return Condition(f"{NUMBERS[known]} {sign} ?", (number,))
    if name.isupper():
        # an autopilot's parameter; \w has no quote in it
        return Condition(f"json_extract(gains, ?) {sign} ?", (f'$."{name}"', number))
    return None


def _contains(column: str, text: str) -> Condition:
    escaped = re.sub(r"([\\%_])", r"\\\1", text)
    return Condition(f"{column} like ? escape '\\'", (f"%{escaped}%",))
