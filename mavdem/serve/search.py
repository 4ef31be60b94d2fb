"""Search: a line such as ``quad-7 motors:bad wind>5 ATC_RAT_RLL_P>0.1`` as a condition of SQL."""

import re
from contextlib import suppress
from typing import Any, NamedTuple

from mavdem.facts.lights import Light
from mavdem.facts.serve import Stage

TERM = re.compile(r"(\w+)(<=|>=|[:=<>])(.+)")
TEXTS = {"vehicle", "date", "level", "sharing", "stage", *map(str, Light)}
NUMBERS = {"wind": "wind_speed", "duration": "duration", "motor": "motor"}
LISTS = {"mode": "modes", "tag": "tags"}
SAID = " || ' ' || ".join(
    ("name", "vehicle", "date", "headline", "problem", "note", "tags", "modes")
)
"""Columns that a word is looked for in."""
WORKING = f"stage not in ('{Stage.DONE}', '{Stage.FAILED}')"


class SqlCondition(NamedTuple):
    """A condition of SQL, and its values."""

    where: str
    values: tuple[Any, ...] = ()


def condition_of(text: str) -> SqlCondition:
    """Returns the condition that all words of a search hold; a word that is no term is found in what is said."""
    parts = [SqlCondition("1")]
    for word in text.split()[:20]:
        term = TERM.fullmatch(word)
        parts.append((term and _term(*term.groups())) or _contains(SAID, word))
    values = tuple(value for part in parts for value in part.values)
    return SqlCondition(" and ".join(part.where for part in parts), values)


def _term(name: str, sign: str, value: str) -> SqlCondition | None:
    column = name.lower()
    sign = sign.replace(":", "=")
    if column in LISTS:
        return _contains(f"',' || {LISTS[column]} || ','", f",{value},")
    with suppress(ValueError):
        number = float(value)
        if (column, sign) == ("motor", "="):
            # the one that is suspect, and those that the headline names
            named = f"*motor {number:g}[^0-9]*"
            return SqlCondition("((motor=?)or(lower(headline)glob(?)))", (number, named))
        if column in NUMBERS:
            return SqlCondition(f"{NUMBERS[column]} {sign} ?", (number,))
        if name.isupper():
            # an autopilot's parameter; \w has no quote in it
            return SqlCondition(
                f"json_extract(iif(json_valid(gains),gains,'{{}}'), ?) {sign} ?",
                (f'$."{name}"', number),
            )
    if column in TEXTS:
        return SqlCondition(f"{column} {sign} ? collate nocase", (value,))
    return None


def _contains(column: str, text: str) -> SqlCondition:
    escaped = re.sub(r"([\\%_])", r"\\\1", text)
    return SqlCondition(f"{column} like ? escape '\\'", (f"%{escaped}%",))
