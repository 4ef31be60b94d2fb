"""What docs/reference must hold: the schema of every document, and pages of all commands, options, keys and columns.

``test_reference.py --write-golden`` writes it.
"""

from __future__ import annotations

import json
import re
from dataclasses import fields
from datetime import datetime
from functools import cache
from inspect import getdoc
from pathlib import Path
from typing import Any, Literal

import click
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, create_model

from mavdem.cli.commands import imported_command, mavdem
from mavdem.dem import Learned, document
from mavdem.dem.settings import CompleteSettings
from mavdem.documents import Key, keys_of, tables
from mavdem.report.blocks import Table, markdown

FOLDER = Path(__file__).parents[1] / "docs" / "reference"
STRICT = ConfigDict(strict=True, extra="forbid", protected_namespaces=())
WORDING = {"description", "title", "default"}  # of a schema: what may change without a new version


@cache
def adapters() -> dict[str, TypeAdapter[Any]]:
    """Returns what checks each document, by its name."""
    records = {name: _model(name, keys_of(name)) for name in tables()["records"]}
    types = records | {
        "number": float | None,
        "datetime": datetime,
        "Any": Any,
        "Settings": CompleteSettings,
    }
    found: dict[str, TypeAdapter[Any]] = {"model": document._adapter(Learned)}
    for name, known in tables()["documents"].items():
        head = {} if name == "flights" else keys_of("Header")
        for key, value in (
            (("document", name), ("schema_version", known["version"])) if head else ()
        ):
            head[key] = head[key]._replace(type=f"Literal[{value!r}]")
        if name not in found:
            model = _model(known["record"], head | keys_of(known["record"]))
            model.model_rebuild(_types_namespace=types | {"Literal": Literal})
            found[name] = TypeAdapter(model)
    return found


def _model(name: str, keys: dict[str, Key]) -> type[BaseModel]:
    typed: dict[str, Any] = {}
    for key, (kind, unit, meaning, optional) in keys.items():
        said: dict[str, Any] = {
            "description": meaning,
            "json_schema_extra": {"unit": unit} if unit else None,
        }
        typed[key] = (
            kind,
            Field(default_factory=lambda: None, **said) if optional else Field(**said),
        )
    model: type[BaseModel] = create_model(name, __config__=STRICT, **typed)
    return model


def structure(schema: Any) -> Any:
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


def schema_text(name: str) -> str:
    """Returns the JSON Schema of the document of this ``name``, 2020-12."""
    known = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **adapters()[name].json_schema(),
    }
    return (
        json.dumps(
            known | {"title": tables()["documents"][name]["title"]}, indent=1, ensure_ascii=False
        )
        + "\n"
    )


def command_page() -> str:
    """Returns the page of all commands, each as its --help is."""
    whole = click.Context(mavdem, info_name="mavdem", terminal_width=86, **mavdem.context_settings)
    contexts = [click.Context(imported_command(name), whole, name) for name in mavdem.commands]
    parts = [
        f"## {one.command_path}\n\n```\n{one.command.get_help(one)}\n```"
        for one in (whole, *contexts)
    ]
    return "\n\n".join(["# Commands", *parts]) + "\n"


def file_page() -> str:
    """Returns the page of all documents: their keys with type, unit and meaning."""
    parts = ["# Files and JSON", INTRODUCTION, "## Every document", _keys(keys_of("Header"))]
    for name, known in tables()["documents"].items():
        version = known["version"]
        parts += [
            f"## {known['title']}",
            f"`{name}`, version {version}: [schema](schemas/{name}-{version}.json).",
        ]
        if name == "model":
            parts += [
                "The attributes of [Learned](../api.md#learning), with those of each; arrays are nested lists."
            ]
            listed = re.findall(
                r"^    (\w+(?:, \w+)*): (.*(?:\n {8}.*)*)", getdoc(Learned) or "", re.MULTILINE
            )
            said = {
                key: re.sub(r"\n +|:\w+:(?=`)", lambda one: " " * (one[0][0] == "\n"), text)
                for keys, text in listed
                for key in keys.split(", ")
            }
            rows = [[f"`{one.name}`", f"`{one.type}`", said[one.name]] for one in fields(Learned)]
            parts += [_table(["key", "type", "meaning"], rows)]
        else:
            parts += [_keys(keys_of(known["record"]))]
    parts += ["## Records", "What the documents are made of."]
    used = {
        word
        for one in tables()["records"]
        for key in keys_of(one).values()
        for word in re.findall(r"\w+", key.type)
    }
    for name in sorted(used & tables()["records"].keys()):
        parts += [f"### {name}", _keys(keys_of(name))]
    return "\n\n".join(parts) + "\n"


INTRODUCTION = """Every document begins with its name, the version of its schema, the version of mavdem and the units of
its keys. As long as the version is the same, a key keeps its name, type, unit and meaning. What changes is a new version,
and the schema of the old one stays here. `number` is null where a value is not known or not finite. Keys in *italics* are
not in every document."""  # noqa: E501


def _keys(keys: dict[str, Key]) -> str:
    rows = []
    for name, key in keys.items():
        shown = re.sub(r"[A-Z]\w+", lambda word: _link(word[0]), key.type)
        rows.append([f"*`{name}`*" if key.optional else f"`{name}`", shown, key.unit, key.meaning])
    return _table(["key", "type", "unit", "meaning"], rows)


def _link(word: str) -> str:
    return f"[{word}](#{word.lower()})" if word in tables()["records"] else word


def _table(header: list[str], rows: list[list[str]]) -> str:
    return markdown(
        [Table(header, [[cell.replace("|", "\\|") for cell in row] for row in rows], words=True)]
    )


def contents() -> dict[Path, str]:
    """Returns every file that is made here, and what it must hold."""
    known = tables()["documents"]
    schemas = {
        FOLDER / "schemas" / f"{name}-{known[name]['version']}.json": schema_text(name)
        for name in known
    }
    return {FOLDER / "commands.md": command_page(), FOLDER / "files.md": file_page(), **schemas}


def write() -> None:
    """Writes them all; raises ``ValueError`` where a schema changed and its version did not."""
    for path, text in contents().items():
        before = json.loads(path.read_text()) if path.suffix == ".json" and path.exists() else None
        if before is not None and structure(before) != structure(json.loads(text)):
            raise ValueError(
                f"the document of {path.name} changed: raise its version in mavdem/documents.toml"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
