"""What docs/reference must hold: the schema of every document, and pages of all commands, options, keys and columns.

``test_reference.py --write-golden`` writes it.
"""

from __future__ import annotations

import json
import re
from dataclasses import fields
from functools import cache
from inspect import getdoc
from pathlib import Path
from typing import Any, NamedTuple

import click
from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass as with_schema

from mavdem.cli.commands import imported_command, mavdem
from mavdem.dem import Learned, document
from mavdem.documents import DOCUMENTS
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow
from mavdem.heading import heading
from mavdem.report.blocks import Table, markdown

FOLDER = Path(__file__).parents[1] / "docs" / "reference"
WORDING = {"description", "title", "default"}  # of a schema: what may change without a new version


class Published(NamedTuple):
    """A document or table: its JSON schema, the version of that, and what it is."""

    schema: dict[str, Any]
    version: int
    title: str


@cache
def published():
    """Returns all documents, and the table of a fleet, by name."""
    row = with_schema(FlightRow, frozen=True, config=ConfigDict(use_attribute_docstrings=True))
    return {
        **{
            name: Published(
                _headed(name, one.model.model_json_schema(by_alias=False), one.version), *one[1:]
            )
            for name, one in DOCUMENTS.items()
        },
        "model": Published(
            document._adapter(Learned).json_schema(), document.VERSION, "model.json"
        ),
        "flights": Published(
            TypeAdapter(row).json_schema(), SCHEMA_VERSION, "flights.parquet, the table of a fleet"
        ),
    }


def _headed(name, schema, version):
    """A document's ``schema`` with the keys of its header."""
    types = {str: "string", int: "integer", dict: "object"}
    keys = {
        key: {"description": meaning, "type": types[type(value)]}
        for (key, value), meaning in zip(heading(name, version, {}).items(), HEADER, strict=True)
    }
    keys["document"]["const"] = name
    keys["schema_version"]["const"] = version
    keys["units"]["additionalProperties"] = {"type": "string"}
    return schema | {
        "properties": keys | schema["properties"],
        "required": [*keys, *schema.get("required", [])],
    }


HEADER = (
    "which document this is: the command that makes it, model or error",
    "version of its schema",
    "version of the program that wrote it",
    "units by key; * stands for any key or place in a list",
)


def structure(schema):
    """Returns a JSON ``schema`` without its wording."""
    if isinstance(schema, list):
        return [structure(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: structure(one)
        for key, one in schema.items()
        if key not in WORDING or isinstance(one, dict)
    }


def schema_text(name):
    """Returns the JSON Schema of the document of this ``name``, 2020-12."""
    whole = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **published()[name].schema,
        "title": published()[name].title,
    }
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def command_page():
    """Returns the page of all commands, each as its --help is."""
    whole = click.Context(mavdem, info_name="mavdem", terminal_width=86, **mavdem.context_settings)
    contexts = [click.Context(imported_command(name), whole, name) for name in mavdem.commands]
    parts = [
        f"## {one.command_path}\n\n```\n{one.command.get_help(one)}\n```"
        for one in (whole, *contexts)
    ]
    return "\n\n".join(["# Commands", *parts]) + "\n"


def file_page():
    """Returns the page of all documents: their keys with type, unit and meaning."""
    parts = ["# Files and JSON", INTRODUCTION, "## Every document"]
    parts += [
        _table(
            ["key", "meaning"],
            [[f"`{k}`", m] for k, m in zip(heading("", 0, {}), HEADER, strict=True)],
        )
    ]
    records = dict[str, Any]()
    for name, one in published().items():
        parts += [
            f"## {one.title}",
            f"`{name}`, version {one.version}: [schema](schemas/{name}-{one.version}.json).",
        ]
        if name == "model":
            parts += [
                "The attributes of [Learned](../api.md#learning), with those of each; arrays are nested lists.",
                _attributes(Learned),
            ]
        else:
            parts += [_keys(one.schema)]
            records |= one.schema.get("$defs", {})
    parts += ["## Records", "What the documents are made of."]
    for name in sorted(records):
        if "properties" in records[name]:
            parts += [f"### {name}", _keys(records[name])]
    return "\n\n".join(parts) + "\n"


def _attributes(record):
    """The attributes of a ``record`` that its docstring lists."""
    listed = re.findall(
        r"^    (\w+(?:, \w+)*): (.*(?:\n {8}.*)*)", getdoc(record) or "", re.MULTILINE
    )
    said = {
        key: re.sub(r"\n +|:\w+:(?=`)", lambda one: " " * (one[0][0] == "\n"), text)
        for keys, text in listed
        for key in keys.split(", ")
    }
    rows = [[f"`{one.name}`", f"`{one.type}`", said[one.name]] for one in fields(record)]
    return _table(["key", "type", "meaning"], rows)


INTRODUCTION = """Every document begins with its name, the version of its schema, that of mavdem, and the units of
its keys. As long as the version is the same, a key keeps its name, type, unit and meaning. What changes is a version,
and the schema of the old one stays here. A number is null where its value is not known or not finite. Keys in *italics*
are not in every document."""


def _keys(record):
    rows = []
    for name, key in record["properties"].items():
        if name in heading("", 0, {}) and "$defs" in record:
            continue
        shown = f"`{name}`" if name in record.get("required", ()) else f"*`{name}`*"
        rows.append([shown, _type(key), _unit(key), key.get("description", "")])
    return _table(["key", "type", "unit", "meaning"], rows)


def _type(key):
    """The type of a ``key`` of a schema in words."""
    if "$ref" in key:
        name = key["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in key:
        return " or ".join(map(_type, key["anyOf"]))
    if "enum" in key or "const" in key:
        return ", ".join(f"`{value}`" for value in key.get("enum", [key.get("const")]))
    if "items" in key or "prefixItems" in key:
        inner = key.get("items") or key["prefixItems"][0]
        return f"list of {_type(inner)}"
    if isinstance(key.get("additionalProperties"), dict):
        return f"{_type(key['additionalProperties'])} by name"
    return str(key.get("type", "any"))


def _unit(key):
    if isinstance(key, dict):
        return key.get("unit") or next(filter(None, map(_unit, key.values())), "")
    return next(filter(None, map(_unit, key)), "") if isinstance(key, list) else ""


def _table(header, rows):
    return markdown(
        [Table(header, [[cell.replace("|", "\\|") for cell in row] for row in rows], words=True)]
    )


def contents():
    """Returns every file that is made here, and what it must hold."""
    schemas = {
        FOLDER / "schemas" / f"{name}-{one.version}.json": schema_text(name)
        for name, one in published().items()
    }
    return {FOLDER / "commands.md": command_page(), FOLDER / "files.md": file_page(), **schemas}


def write():
    """Writes them all; raises ``ValueError`` where a schema changed and its version did not."""
    for path, text in contents().items():
        before = json.loads(path.read_text()) if path.suffix == ".json" and path.exists() else None
        if before is not None and structure(before) != structure(json.loads(text)):
            raise ValueError(
                f"the document of {path.name} changed: raise its version in mavdem/documents"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
