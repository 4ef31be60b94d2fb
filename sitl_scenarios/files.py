"""Reads scenarios, by name or from TOML files, writes them, and says in a sentence what is wrong in one."""

import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from sitl_scenarios.gains import control_parameters
from sitl_scenarios.parameter_controller import check_parameters
from sitl_scenarios.plan import flight_times
from sitl_scenarios.scenario import Excitation, Moment, Scenario, Wind, shortened

KINDS: dict[str, tuple[type[BaseModel], ...]] = {
    "wind": get_args(get_args(Wind)[0]),
    "excitation": get_args(get_args(Excitation)[0]),
}
"""Of the sections that have a ``kind``."""
WRONG_KEYS = {"extra_forbidden": "is no key of a scenario", "missing": "is missing"}


def _sentence(detail: Any) -> str:
    """What pydantic found in one place."""
    if detail["type"] == "value_error":
        return str(detail["ctx"]["error"])
    key = ".".join(shortened(str(word)) for word in detail["loc"]) or "it"
    if detail["type"] in WRONG_KEYS:
        return f"{key} {WRONG_KEYS[detail['type']]}"
    message = detail["msg"].replace("Input should be", "must be").replace("an object", "a table")
    given = detail["input"]
    shown = "" if isinstance(given, dict | list) else f", not {shortened(json.dumps(given))}"
    return f"{key} {message}{shown}"


_FOLDER = files("sitl_scenarios") / "scenarios"


def names() -> tuple[str, ...]:
    """Returns the names of the scenarios that come with the package, in alphabetical order."""
    return tuple(
        sorted(
            file.name.removesuffix(".toml")
            for file in _FOLDER.iterdir()
            if file.name.endswith(".toml")
        )
    )


def load(name_or_path: str | Path) -> Scenario:
    """Returns a scenario that comes with the package, or the one in a file.

    What ends in .toml or has a folder is a path, everything else a name of ``names()``. Raises ValueError: there is
    none, or it is none: one sentence that names the file and what is wrong in it.
    """
    given = str(name_or_path)
    if given in names():
        label = f"{given}.toml"
        source = (_FOLDER / f"{given}.toml").read_bytes()
    elif isinstance(name_or_path, Path) or given.endswith(".toml") or "/" in given:
        label = Path(name_or_path).name
        source = _content(Path(name_or_path))
    else:
        raise ValueError(
            f"there is no scenario {shortened(given)!r}: `mavdem fly --list` names them, or give a .toml file"
        )
    try:
        # TOML is UTF-8 by its specification; some editors put a byte order mark before it.
        return scenario_of(tomllib.loads(source.decode("utf-8-sig")))
    except UnicodeError:
        raise ValueError(
            f"{label} is no scenario or vehicle file: these are text, in TOML"
        ) from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{label}: {error}") from None


def _content(path: Path) -> bytes:
    try:
        if path.is_char_device():  # it may never end
            raise OSError("it is a device")
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror or error}") from None


def scenario_of(table: dict[str, Any]) -> Scenario:
    """Returns the scenario in a table of plain values; raises ValueError: a sentence on all wrong keys."""
    try:
        # By way of JSON, in whose arrays pydantic takes the tuples that it would refuse to take in Python's lists.
        scenario = Scenario.model_validate_json(json.dumps(table, default=str))
    except ValidationError as error:
        sentences = (shortened(_sentence(detail), 300) for detail in error.errors())
        raise ValueError(shortened("; ".join(dict.fromkeys(sentences)), 1000)) from None
    flight_times(scenario)
    check_parameters(scenario)
    return scenario


def with_vehicle(scenario: Scenario, other: Scenario) -> Scenario:
    """Returns the scenario with the vehicle, its sensors and its autopilot of another."""
    table = scenario.model_dump(mode="json") | other.model_dump(
        mode="json", include={"vehicle", "sensors"}
    )
    return scenario_of(table | {"stream": table["stream"] | {"autopilot": other.stream.autopilot}})


def with_parameters(scenario: Scenario, changed: Iterable[str]) -> Scenario:
    """Returns the scenario with parameters of the autopilot ``changed`` to "NAME=VALUE"; raises ValueError."""
    own = control_parameters(scenario)
    table = scenario.model_dump(mode="json")
    for name, _, value in (assignment.partition("=") for assignment in changed):
        if name not in own:
            near = get_close_matches(name[:100].upper(), own, n=3)
            similar = f"similar: {', '.join(near)}" if near else "no similar parameter exists"
            raise ValueError(f"the autopilot has no {shortened(name)!r} here: {similar}")
        try:
            table["vehicle"]["parameters"][name] = float(value)
        except ValueError:
            raise ValueError(f"{name} needs a number: write {name}=VALUE") from None
    return scenario_of(table)


BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")  # a key that TOML needs no quotes around
LIMITS = {
    "minimum": "from",
    "exclusiveMinimum": "more than",
    "maximum": "to",
    "exclusiveMaximum": "to less than",
}
"""The JSON schema's limits, in words."""


def in_toml(scenario: Scenario) -> str:
    """Returns a scenario file with every value, its meaning and its range; read again it is the same scenario."""
    sections = {
        key: value
        for key, value in scenario
        if isinstance(value, tuple | BaseModel) or key in KINDS
    }
    lines = [*_pairs(scenario, sections)]
    for key, value in sections.items():
        if key in KINDS:
            lines += ["", f"# {'[[wind]]' if key == 'wind' else f'[{key}]'}: its kind is one of"]
            for model in KINDS[key]:
                kind, *others = model.model_fields.items()
                kinds = " or ".join(get_args(kind[1].annotation))
                lines.append(f"#   {kinds}: {', '.join(name for name, _ in others)}")
        elif not value:
            lines += ["", f"# [[{key}]]: {', '.join(Moment.model_fields)}"]
        header = f"[[{key}]]" if isinstance(value, tuple) else f"[{key}]"
        for section in value if isinstance(value, tuple) else [value] * (value is not None):
            meaning = (type(section).__doc__ or "").splitlines()[0].removesuffix(".")
            lines += ["", f"{header}  # {meaning}", *_pairs(section)]
    return "\n".join(lines)


def _pairs(section: BaseModel, leaving_out: Iterable[str] = ()) -> Iterator[str]:
    schema = type(section).model_json_schema(mode="validation")["properties"]
    for key, value in section.model_dump(mode="json", exclude=set(leaving_out)).items():
        notes = schema[key].get("description", "").removesuffix("."), _allowed(schema[key])
        comment = "; ".join(filter(None, notes))
        yield f"{_key(key)} = {_toml(value)}" + (f"  # {comment}" if comment else "")


def _allowed(schema: Mapping[str, Any]) -> str:
    """The values that a key may have, by its JSON schema."""
    for inside in (*schema.get("anyOf", ())[:1], schema.get("additionalProperties")):
        if isinstance(inside, dict):
            return _allowed(inside)
    if "enum" in schema:
        return " or ".join(map(str, schema["enum"]))
    if schema.get("type") == "boolean":
        return "true or false"
    return " ".join(
        f"{words} {schema[name]:.10g}" for name, words in LIMITS.items() if name in schema
    )


def _key(key: str) -> str:
    if BARE_KEY.fullmatch(key):
        return key
    return _toml(key)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return (
            "{" + ", ".join(f"{_key(key)} = {_toml(inside)}" for key, inside in value.items()) + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if value is None:
        return "inf"  # the time that never comes
    # Of text, numbers and truth values JSON's forms are TOML's too; what a terminal obeys is escaped besides.
    text = json.dumps(value, ensure_ascii=False)
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08x}" for letter in text)
