"""Files: scenarios by name, and from TOML files."""

from __future__ import annotations

import json
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from sitl_scenarios.plan import times
from sitl_scenarios.scenario import Scenario

_FOLDER = files("sitl_scenarios") / "scenarios"


def names() -> tuple[str, ...]:
    """Of the scenarios that come with the package, in alphabetical order."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _FOLDER.iterdir() if file.name.endswith(".toml")))


def load(name_or_path: str | Path) -> Scenario:
    """A scenario that comes with the package, or the one in a file.

    Args:
        name_or_path: a name of ``names()``, or the path of a file; what ends in .toml or has a folder is a path.

    Raises:
        ValueError: there is none, or it is none: one sentence that names the file and what is wrong in it.
    """
    given = str(name_or_path)
    if given in names():
        label, source = f"{given}.toml", (_FOLDER / f"{given}.toml").read_bytes()
    elif isinstance(name_or_path, Path) or given.endswith(".toml") or "/" in given:
        path = Path(name_or_path)
        label = path.name
        try:
            source = path.read_bytes()
        except OSError as error:
            raise ValueError(f"{given} cannot be read: {error.strerror or error}") from None
    else:
        raise ValueError(f"there is no scenario {given!r}; there are {', '.join(names())}, and paths of .toml files")
    try:
        # TOML is UTF-8 by its specification.
        table = tomllib.loads(source.decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{label} is no TOML: {error}") from None
    except RecursionError:
        raise ValueError(f"{label} is nested deeper than any scenario") from None
    try:
        return scenario_of(table)
    except ValueError as error:
        raise ValueError(f"{label}: {error}") from None


def scenario_of(table: dict[str, Any]) -> Scenario:
    """The scenario that a table of plain values says, as TOML and JSON have them.

    Raises:
        ValueError: one sentence that names every key that is wrong.
    """
    try:
        # By way of JSON, in whose arrays pydantic takes the tuples that it would refuse to take in Python's lists.
        scenario = Scenario.model_validate_json(json.dumps(table, default=str))
    except ValidationError as error:
        wrong = [_sentence(detail, table) for detail in error.errors()]
        raise ValueError("; ".join(dict.fromkeys(wrong))) from None
    times(scenario)
    return scenario


def _sentence(detail: Any, table: dict[str, Any]) -> str:
    """What pydantic found in one place."""
    key, given = _key(detail["loc"], table), detail.get("input")
    kind, message = detail["type"], detail["msg"]
    if kind == "extra_forbidden":
        return f"{key} is no key of a scenario"
    if kind in ("missing", "union_tag_not_found"):
        return f"{key + '.kind' if kind == 'union_tag_not_found' else key} is missing"
    if kind == "union_tag_invalid":
        context = detail["ctx"]
        return f"{key}.kind must be one of {context['expected_tags']}, not {context['tag']!r}"
    if kind == "value_error":
        return str(detail["ctx"]["error"])
    shown = "" if isinstance(given, dict | list) else f", not {json.dumps(given)}"
    message = message.replace("Input should be", "must be").replace("an object", "a table")
    return f"{key} {message}{shown}"


def _key(place: tuple[int | str, ...], table: Any) -> str:
    """Where in the file: pydantic's place without the names of the kinds that it went through."""
    words = []
    for position, word in enumerate(place):
        inside = isinstance(table, dict) and word in table or isinstance(table, list) and isinstance(word, int)
        if not inside and position < len(place) - 1:
            continue
        words.append(str(word))
        table = table[word] if inside else None
    return ".".join(words)
