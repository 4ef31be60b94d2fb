"""Scenario files: reading scenarios from TOML by name or path, checking and changing them, and writing them as TOML."""

import json
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError

from sitl_scenarios.gains import control_parameters
from sitl_scenarios.mishaps.specs import Mishap
from sitl_scenarios.parameter_controller import check_parameters
from sitl_scenarios.plan import flight_times
from sitl_scenarios.scenario import Excitation, Moment, Scenario, Wind
from sitl_scenarios.section import shortened

SECTION_KINDS: dict[str, tuple[type[BaseModel], ...]] = {
    "wind": get_args(get_args(Wind)[0]),
    "excitation": get_args(get_args(Excitation)[0]),
    "mishap": get_args(get_args(Mishap)[0]),
}
"""Models of the sections that have a ``kind``, one for each kind, by the section's key."""

KEY_ERRORS = {"extra_forbidden": "is no key of a scenario", "missing": "is missing"}
"""What is wrong with a key, by pydantic's type of error."""

BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
"""Key that needs no quotes in TOML."""

LIMITS = {
    "minimum": "from",
    "exclusiveMinimum": "more than",
    "maximum": "to",
    "exclusiveMaximum": "to less than",
}
"""Words before a limit of a value, by the limit's name in JSON schemas."""

MAX_ERROR_LENGTH = 300
"""Longest sentence on one error of a scenario, in characters."""

MAX_ERRORS_LENGTH = 1000
"""Longest text on all errors of a scenario, in characters."""

_FOLDER = files("sitl_scenarios") / "scenarios"


def names() -> tuple[str, ...]:
    """Returns the names of the scenarios that come with the package, in alphabetical order."""
    scenario_names = []
    for file in _FOLDER.iterdir():
        if file.name.endswith(".toml"):
            scenario_names.append(file.name.removesuffix(".toml"))
    return tuple(sorted(scenario_names))


class ScenarioSource(NamedTuple):
    """Content of a scenario file."""

    label: str
    """Name of the file in messages of errors."""
    content: bytes
    """TOML text in UTF-8."""


def load(name_or_path: str | Path) -> Scenario:
    """Reads a scenario that comes with the package, or the one in a file.

    Args:
        name_or_path: A path, if it ends in .toml or has a folder; otherwise a name of ``names()``.

    Returns:
        The scenario.

    Raises:
        ValueError: There is no such scenario, or the file is not one. The message names the file and the error.
    """
    label, content = _scenario_source(name_or_path)
    try:
        # TOML is UTF-8 by its specification; some editors put a byte order mark before it.
        return scenario_from_table(tomllib.loads(content.decode("utf-8-sig")))
    except UnicodeError:
        raise ValueError(
            f"{label} is no scenario or vehicle file: these are text, in TOML"
        ) from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{label}: {error}") from None


def _scenario_source(name_or_path: str | Path) -> ScenarioSource:
    """Reads the file of a scenario, by its name or path.

    Args:
        name_or_path: Name of a scenario of the package, or path of a .toml file.

    Returns:
        Name and bytes of the file.

    Raises:
        ValueError: There is no such scenario, or its file cannot be read.
    """
    text = str(name_or_path)
    if text in names():
        file_name = f"{text}.toml"
        return ScenarioSource(file_name, (_FOLDER / file_name).read_bytes())
    if isinstance(name_or_path, Path) or text.endswith(".toml") or "/" in text:
        path = Path(name_or_path)
        return ScenarioSource(path.name, _file_content(path))
    raise ValueError(
        f"there is no scenario {shortened(text)!r}: `mavdem fly --list` names them, or give a .toml file"
    )


def _file_content(path: Path) -> bytes:
    """Reads a file.

    Args:
        path: Path of the file.

    Returns:
        The bytes of the file.

    Raises:
        ValueError: The file cannot be read, or is a device.
    """
    try:
        # Reading a device may never end.
        if path.is_char_device():
            raise OSError("it is a device")
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror or error}") from None


def scenario_from_table(table: dict[str, Any]) -> Scenario:
    """Makes a scenario from a table of plain values, as a TOML file contains them.

    Args:
        table: Values by key; sections are tables or lists of tables.

    Returns:
        The scenario, whose values fit together.

    Raises:
        ValueError: Keys or values are wrong. The message has a sentence on each.
    """
    try:
        # The table is converted to JSON first: pydantic refuses Python's lists for tuples, but accepts JSON's arrays.
        scenario = Scenario.model_validate_json(json.dumps(table, default=str))
    except ValidationError as error:
        sentences = [
            shortened(_error_sentence(detail), MAX_ERROR_LENGTH) for detail in error.errors()
        ]
        unique_sentences = list(dict.fromkeys(sentences))
        raise ValueError(shortened("; ".join(unique_sentences), MAX_ERRORS_LENGTH)) from None
    # Both checks raise ValueError.
    flight_times(scenario)
    check_parameters(scenario)
    return scenario


def _error_sentence(detail: Any) -> str:
    """Returns a sentence on one error of a scenario, for its author, who knows keys and values but not pydantic.

    Args:
        detail: Pydantic's ``ErrorDetails``: type of the error, path of the key (``loc``), message, and wrong value
            (``input``).

    Returns:
        Sentence such as "vehicle.body.mass must be greater than 0, not -1".
    """
    # An error that this package raised has its own sentence.
    if detail["type"] == "value_error":
        return str(detail["ctx"]["error"])
    key = ".".join(shortened(str(word)) for word in detail["loc"]) or "it"
    if detail["type"] in KEY_ERRORS:
        return f"{key} {KEY_ERRORS[detail['type']]}"
    message = detail["msg"].replace("Input should be", "must be").replace("an object", "a table")
    value = detail["input"]
    # Tables and lists would be too long to repeat.
    if isinstance(value, dict | list):
        return f"{key} {message}"
    return f"{key} {message}, not {shortened(json.dumps(value))}"


def with_vehicle(scenario: Scenario, vehicle_scenario: Scenario) -> Scenario:
    """Returns a scenario with the vehicle, its sensors and its autopilot of another scenario."""
    table = scenario.model_dump(mode="json")
    table |= vehicle_scenario.model_dump(mode="json", include={"vehicle", "sensors"})
    table["stream"] |= {"autopilot": vehicle_scenario.stream.autopilot}
    return scenario_from_table(table)


def with_parameters(scenario: Scenario, assignments: Iterable[str]) -> Scenario:
    """Changes parameters of a scenario's autopilot.

    Args:
        scenario: The scenario to change: vehicle, wind, excitation, sensors and faults.
        assignments: Parameters to set, each as "NAME=VALUE".

    Returns:
        A copy of the scenario with these parameters.

    Raises:
        ValueError: The autopilot does not have a parameter, or its value is not possible.
    """
    parameters = control_parameters(scenario)
    table = scenario.model_dump(mode="json")
    for assignment in assignments:
        name, _, value = assignment.partition("=")
        if name not in parameters:
            similar_names = get_close_matches(name[:100].upper(), parameters, n=3)
            hint = "no similar parameter exists"
            if similar_names:
                hint = f"similar: {', '.join(similar_names)}"
            raise ValueError(f"the autopilot has no {shortened(name)!r} here: {hint}")
        try:
            table["vehicle"]["parameters"][name] = float(value)
        except ValueError:
            raise ValueError(f"{name} needs a number: write {name}=VALUE") from None
    return scenario_from_table(table)


def scenario_toml(scenario: Scenario) -> str:
    """Writes a scenario as TOML, with every value, and its meaning and range as a comment.

    Args:
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.

    Returns:
        Text of a .toml file, which gives the same scenario when it is read.
    """
    # A section is a table, or a list of tables, of values that belong together. In TOML all plain values come before
    # the first section.
    sections = {}
    for key, value in scenario:
        if isinstance(value, tuple | BaseModel) or key in SECTION_KINDS:
            sections[key] = value
    lines = _value_lines(scenario, excluded_keys=sections)
    for key, value in sections.items():
        is_list = isinstance(value, tuple)
        header = f"[[{key}]]" if is_list else f"[{key}]"
        if key in SECTION_KINDS:
            lines += _kind_lines(key)
        elif not value:
            lines += ["", f"# {header}: {', '.join(Moment.model_fields)}"]
        section_list = value if is_list else [value]
        for section in section_list:
            if section is not None:
                docstring = type(section).__doc__ or ""
                meaning = docstring.splitlines()[0].removesuffix(".")
                lines += ["", f"{header}  # {meaning}", *_value_lines(section)]
    return "\n".join(lines)


def _kind_lines(key: str) -> list[str]:
    """Returns comment lines that list the kinds of a section, and the keys of each kind.

    Args:
        key: Key of a section whose models differ by their ``kind``: wind, excitation or mishap.

    Returns:
        Lines such as "#   steady: speed, direction", after a headline.
    """
    # Winds are a list of tables; excitation and mishap are one table.
    header = "[[wind]]" if key == "wind" else f"[{key}]"
    lines = ["", f"# {header}: its kind is one of"]
    for model in SECTION_KINDS[key]:
        # The first field of each model is its kind, a Literal.
        kinds = " or ".join(get_args(model.model_fields["kind"].annotation))
        keys = [name for name in model.model_fields if name != "kind"]
        lines.append(f"#   {kinds}: {', '.join(keys)}")
    return lines


def _value_lines(section: BaseModel, excluded_keys: Collection[str] = ()) -> list[str]:
    """Returns a line of TOML for each key of a section, with the key's meaning and range as a comment.

    Args:
        section: The whole scenario, or one of its sections.
        excluded_keys: Keys that get no line.

    Returns:
        Lines such as "speed = 5.0  # Of the wind, m/s; from 0 to 60".
    """
    schema = _key_schemas(type(section))
    lines = []
    for key, value in section.model_dump(mode="json", exclude=set(excluded_keys)).items():
        line = f"{_toml_key(key)} = {_toml_value(value)}"
        meaning = schema[key].get("description", "").removesuffix(".")
        notes = [note for note in (meaning, _value_range(schema[key])) if note]
        if notes:
            line += f"  # {'; '.join(notes)}"
        lines.append(line)
    return lines


@cache
def _key_schemas(model: type[BaseModel]) -> dict[str, Any]:
    """Returns the JSON schema of each key of a section: pydantic derives it from the model's fields.

    Args:
        model: Model of the section.
    """
    schemas: dict[str, Any] = model.model_json_schema(mode="validation")["properties"]
    return schemas


def _value_range(schema: Mapping[str, Any]) -> str:
    """Returns the possible values of a key in words, such as "from 0 to 60"; empty if all values are possible.

    Args:
        schema: JSON schema of the key.
    """
    # An optional value has the schema of the value first; that of a table's values is under additionalProperties.
    alternatives = schema.get("anyOf", ())
    if alternatives and isinstance(alternatives[0], dict):
        return _value_range(alternatives[0])
    table_values = schema.get("additionalProperties")
    if isinstance(table_values, dict):
        return _value_range(table_values)
    if "enum" in schema:
        return " or ".join(str(value) for value in schema["enum"])
    if schema.get("type") == "boolean":
        return "true or false"
    return " ".join(
        f"{words} {schema[name]:.10g}" for name, words in LIMITS.items() if name in schema
    )


def _toml_key(key: str) -> str:
    """Returns a key as TOML writes it, in quotes where it needs them."""
    if BARE_KEY.fullmatch(key):
        return key
    return _toml_value(key)


def _toml_value(value: Any) -> str:
    """Formats a plain value as TOML.

    Args:
        value: Text, number, truth value, list, table or None.

    Returns:
        The value in TOML; None becomes inf.
    """
    if isinstance(value, dict):
        pairs = [f"{_toml_key(key)} = {_toml_value(element)}" for key, element in value.items()]
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml_value(element) for element in value) + "]"
    if value is None:
        # In a scenario, None is a time that never comes, or stands for the published value.
        return "inf"
    # TOML writes text, numbers and truth values like JSON. Characters that control a terminal are escaped as well.
    text = json.dumps(value, ensure_ascii=False)
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08x}" for letter in text)
