"""Reads scenarios, by name or from TOML files."""

from __future__ import annotations

import json
import stat
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from sitl_scenarios.plan import times
from sitl_scenarios.problems import describe_errors, did_you_mean, too_much
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.sections.base import shortened

MAX_FILE_BYTES = 100_000  # Bytes of a scenario file: fifty times the longest that comes with the package

_FOLDER = files("sitl_scenarios") / "scenarios"


def names() -> tuple[str, ...]:
    """Of the scenarios that come with the package, in alphabetical order."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _FOLDER.iterdir() if file.name.endswith(".toml")))


def load(name_or_path: str | Path) -> Scenario:
    """A scenario that comes with the package, or the one in a file.

    What ends in .toml or has a folder is a path, everything else a name of ``names()``. Raises ValueError: there is
    none, or it is none: one sentence that names the file and what is wrong in it.
    """
    given = str(name_or_path)
    if given in names():
        label, source = f"{given}.toml", (_FOLDER / f"{given}.toml").read_bytes()
    elif isinstance(name_or_path, Path) or given.endswith(".toml") or "/" in given:
        label, source = Path(name_or_path).name, _content(Path(name_or_path))
    else:
        guess = did_you_mean(given, names())
        known = ", ".join(names())
        raise ValueError(
            f"there is no scenario {shortened(given)!r}{guess}; there are {known}, and paths of .toml files"
        )
    try:
        return scenario_of(_table(source))
    except ValueError as error:
        raise ValueError(f"{label}: {error}") from None


def _content(path: Path) -> bytes:
    try:
        kind = path.stat().st_mode
        if not stat.S_ISREG(kind) and not stat.S_ISDIR(kind):
            # Reading a pipe or a device might never end.
            raise ValueError(f"{path} cannot be read: it is no plain file")
        with path.open("rb") as file:
            source = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror or error}") from None
    if len(source) > MAX_FILE_BYTES:
        raise ValueError(f"{path} cannot be read: it has more than {MAX_FILE_BYTES} bytes, and no scenario is as long")
    return source


def _table(source: bytes) -> dict[str, Any]:
    try:
        # TOML is UTF-8 by its specification; some editors put a byte order mark before it.
        table = tomllib.loads(source.decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"it is no TOML: {shortened(str(error), 200)}") from None
    except RecursionError:
        raise ValueError("it is nested deeper than any scenario") from None
    except ValueError:
        # Python reads no number of more than some thousands of digits.
        raise ValueError("it has a number of more digits than any scenario needs") from None
    obstacle = too_much(table)
    if obstacle:
        raise ValueError(obstacle)
    return table


def scenario_of(table: dict[str, Any]) -> Scenario:
    """The scenario in a table of plain values, as TOML and JSON have them.

    Raises ValueError: one sentence that names every key that is wrong, or the first of many.
    """
    try:
        # By way of JSON, in whose arrays pydantic takes the tuples that it would refuse to take in Python's lists.
        scenario = Scenario.model_validate_json(json.dumps(table, default=str))
    except ValidationError as error:
        raise ValueError(describe_errors(error.errors(), table)) from None
    times(scenario)
    return scenario
