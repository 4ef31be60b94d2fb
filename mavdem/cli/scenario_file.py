"""A scenario as the TOML file that says all its values, and behind each what it means and may be."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import BaseModel

from mavdem.cli.output import printable
from sitl_scenarios.problems import KINDS
from sitl_scenarios.scenario import Moment, Scenario

BARE = re.compile(r"[A-Za-z0-9_-]+")
"""A key that TOML needs no quotes around."""

LEAST = {"minimum": "from", "exclusiveMinimum": "more than"}
MOST = {"maximum": "to", "exclusiveMaximum": "to less than"}
"""How JSON schema and people say the least and the most that a value may be."""


def in_toml(scenario: Scenario) -> str:
    """A scenario file with every value, which read again is the same scenario."""
    return "\n".join(_lines(scenario))


def _lines(scenario: Scenario) -> Iterator[str]:
    sections = {key: value for key, value in scenario if isinstance(value, tuple | BaseModel) or key in KINDS}
    yield from _pairs(scenario, leaving_out=sections)
    for key, value in sections.items():
        if key in KINDS:
            yield from ["", f"# {'[[wind]]' if key == 'wind' else f'[{key}]'}: its kind is one of"]
            yield from (f"#   {kind}: {', '.join(_keys(model))}" for kind, model in KINDS[key].items())
        elif not value:
            yield from ["", f"# [[{key}]]: {', '.join(_keys(Moment))}"]
        several = isinstance(value, tuple)
        for one in value if several else [value] if value is not None else []:
            yield from ["", f"{f'[[{key}]]' if several else f'[{key}]'}  # {_meaning(one)}", *_pairs(one)]


def _pairs(section: BaseModel, leaving_out: Iterable[str] = ()) -> Iterator[str]:
    told = type(section).model_json_schema(mode="validation")["properties"]
    for key, value in section.model_dump(mode="json", exclude=set(leaving_out)).items():
        comment = "; ".join(filter(None, [_sentence(told[key].get("description", "")), _allowed(told[key])]))
        behind = f"  # {comment}" if comment else ""
        yield f"{_key(key)} = {_value(value)}{behind}"


def _allowed(told: dict[str, Any]) -> str:
    """The values that a key may have, by its JSON schema."""
    for inside in (*told.get("anyOf", ())[:1], told.get("additionalProperties")):
        if isinstance(inside, dict):
            return _allowed(inside)
    if "enum" in told:
        return " or ".join(str(one) for one in told["enum"])
    if told.get("type") == "boolean":
        return "true or false"
    least = [f"{word} {told[name]:.10g}" for name, word in LEAST.items() if name in told]
    most = [f"{word} {told[name]:.10g}" for name, word in MOST.items() if name in told]
    return " ".join(least + most)


def _keys(model: type[BaseModel]) -> list[str]:
    return [key for key in model.model_fields if key != "kind"]


def _meaning(section: BaseModel) -> str:
    return _sentence((type(section).__doc__ or "").splitlines()[0])


def _sentence(text: str) -> str:
    return text.removesuffix(".")


def _key(key: str) -> str:
    return key if BARE.fullmatch(key) else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + "}"
    if value is None:
        return "inf"  # the time that never comes
    # Of text, numbers and truth values JSON's forms are TOML's too, but for U+007F, which TOML wants escaped.
    return printable(json.dumps(value, ensure_ascii=False))
