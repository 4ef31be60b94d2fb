"""What docs/reference must hold: the schema of every document, and pages of all commands, options, keys and columns.

``test_reference.py --write-golden`` writes it.
"""

import ast
import json
import re
from collections import Counter, namedtuple
from functools import cache
from inspect import getsource
from itertools import pairwise
from pathlib import Path

import click
from pydantic import TypeAdapter
from pydantic.dataclasses import dataclass as with_schema

from mavdem.cli.commands import COMMAND_GROUPS, load_command, mavdem
from mavdem.dem import Learned, document
from mavdem.documents import DOCUMENTS
from mavdem.documents.described_schema import DescribedSchema
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow

FOLDER = Path(__file__).parents[1] / "docs" / "reference"
BREAK = "\\\n"  # Ends a line within a paragraph.
# Keys of a schema that may change without a new version.
WORDING = {"description", "title", "default"}


Published = namedtuple("Published", "schema version title")
"""A document or table: its JSON schema, the version of that, and what it is."""


@cache
def published():
    """Returns the schemas of all documents, and of the table of a fleet, by name."""
    row = TypeAdapter(with_schema(FlightRow, frozen=True)).json_schema()
    parts = ast.parse(getsource(FlightRow)).body[0].body
    for key, meaning in pairwise(parts):
        if isinstance(key, ast.AnnAssign) and isinstance(meaning, ast.Expr):
            row["properties"][key.target.id]["description"] = meaning.value.value
    return {
        **{
            name: Published(
                _headed(name, described_schema(context.model), context.version), *context[1:]
            )
            for name, context in DOCUMENTS.items()
        },
        "model": Published(
            document._adapter(Learned).json_schema(), document.VERSION, "model.json"
        ),
        "flights": Published(row, SCHEMA_VERSION, "flights.parquet, the table of a fleet"),
    }


def described_schema(model):
    """The schema of a document with the meaning of each key."""
    return model.model_json_schema(by_alias=False, schema_generator=DescribedSchema)


def _headed(name, schema, version):
    """A document's ``schema`` with the keys of its header."""
    keys = {key: {"description": meaning, "type": "string"} for key, meaning in HEADER.items()}
    keys["document"]["const"] = name
    keys["schema_version"] |= {"type": "integer", "const": version}
    keys["units"] |= {"type": "object", "additionalProperties": {"type": "string"}}
    return schema | {
        "properties": keys | schema["properties"],
        "required": [*keys, *schema.get("required", [])],
    }


HEADER = {
    "document": "which document this is: the command that makes it, model or error",
    "schema_version": "version of its schema",
    "mavdem_version": "version of the program that wrote it",
    "units": "units by key; * stands for any key or place in a list",
}


def structure(schema):
    """Returns a JSON ``schema`` without its wording."""
    if isinstance(schema, list):
        return [structure(context) for context in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: structure(context)
        for key, context in schema.items()
        if key not in WORDING or isinstance(context, dict)
    }


def schema_text(name):
    """Returns the JSON Schema of the document of this ``name``, 2020-12."""
    root_context = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **published()[name].schema,
        "title": published()[name].title,
    }
    return json.dumps(root_context, indent=1, ensure_ascii=False) + "\n"


def command_page():
    """Returns the page of all commands: the help of each, with options of several commands described once."""
    root_context = click.Context(
        mavdem, info_name="mavdem", terminal_width=86, **mavdem.context_settings
    )
    contexts = [click.Context(load_command(name), root_context, name) for name in mavdem.commands]
    records = {
        context: [
            record
            for parameter in context.command.get_params(context)
            if (record := parameter.get_help_record(context))
        ]
        for context in contexts
    }
    times = Counter(record for of_command in records.values() for record in of_command)
    shared = [record for record, count in times.items() if count > 1 and record[1]]
    introduction = (
        root_context.command.get_help(root_context)
        .partition(f"\n{next(iter(COMMAND_GROUPS))}:")[0]
        .strip()
    )
    parts = ["# Commands", f"```\n{introduction}\n```"]
    parts += ["## Options of several commands", _options(shared, set())]
    for context in contexts:
        formatter = context.make_formatter()
        context.command.format_usage(context, formatter)
        context.command.format_help_text(context, formatter)
        text = formatter.getvalue().strip()
        parts += [
            f"## {context.command_path}",
            f"```\n{text}\n```",
            _options(records[context], shared),
        ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _options(records, shared):
    """A line for each option, and one that names those that are ``shared``."""
    lines = [f"`{name}`: {text}" for name, text in records if text and (name, text) not in shared]
    names = [f"`{name.split()[0].rstrip(',')}`" for name, text in records if (name, text) in shared]
    also = f"{', '.join(names)}: [above](#options-of-several-commands)"
    return BREAK.join(lines + [also] * bool(names))


def file_page():
    """Returns the page of all documents: their keys with unit and meaning, each described once."""
    records = {}
    described = {}
    header = [f"`{key}`: {text}" for key, text in HEADER.items()]
    parts = ["# Files and JSON", INTRODUCTION, "## Every document", BREAK.join(header)]
    for name, context in published().items():
        link = (
            f"Version {context.version}: [`{name}` schema](schemas/{name}-{context.version}.json)."
        )
        parts += [f"## {context.title}", link]
        if name == "model":
            parts += ["The attributes of [Learned](../api.md#learning); arrays are nested lists."]
        else:
            records |= context.schema.get("$defs", {})
            anchor = re.sub(r"[^\w -]", "", context.title.lower()).replace(" ", "-")
            parts += [_keys(context.schema, f"[{name}](#{anchor})", described)]
    parts += ["## Records"]
    for name in sorted(records):
        if "properties" in records[name]:
            link = f"[{name}](#{name.lower()})"
            parts += [f"### {name}", _keys(records[name], link, described)]
    return "\n\n".join(parts) + "\n"


INTRODUCTION = """Every document begins with its name, the version of its schema, that of mavdem, and its units.
A version keeps its keys with name, type, unit and meaning; its schema stays here and has every type. A number is null
where it is unknown or not finite. Keys in *italics* are not in every document. What means the same in two records is
described once."""


def _keys(record, place, described):
    """The keys of a ``record`` at a ``place``, but for those that are ``described`` elsewhere, which are named."""
    facts, here, elsewhere = [], {}, {}
    for name, key in record["properties"].items():
        if name in HEADER and "$defs" in record:
            continue
        formatted_name = f"`{name}`" if name in record.get("required", ()) else f"*`{name}`*"
        meaning = key.get("description", "")
        unit, link = (f" ({context})" if context else "" for context in (_unit(key), _link(key)))
        line = f"{unit}: {meaning}{link}" if meaning else f"{unit}{link}: [API](../api.md#learning)"
        if re.fullmatch(r"\w+ as (a fact; .*|facts)", meaning):
            facts.append(formatted_name)
        elif described.setdefault((name, line), place) != place:
            elsewhere.setdefault(described[name, line], []).append(formatted_name)
        else:
            here.setdefault(line, []).append(formatted_name)
    lines = [f"{', '.join(keys)}{line}" for line, keys in here.items()]
    lines += [f"{', '.join(keys)}: as in {other}" for other, keys in elsewhere.items()]
    lines += [f"{', '.join(facts)}: the same as facts, [Sentence](#sentence)"] * bool(facts)
    return BREAK.join(lines)


def _link(key):
    """The records that a ``key`` of a schema has, and whether as a list or by name."""
    if "$ref" in key:
        name = key["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "items" in key and (inner := _link(key["items"])):
        return f"list of {inner}"
    if isinstance(key.get("additionalProperties"), dict):
        return _link(key["additionalProperties"])
    return " or ".join(filter(None, map(_link, key.get("anyOf", []))))


def _unit(key):
    if isinstance(key, dict):
        return key.get("unit") or next(filter(None, map(_unit, key.values())), "")
    return next(filter(None, map(_unit, key)), "") if isinstance(key, list) else ""


def contents():
    """Returns every file that is made here, and what it must hold."""
    schemas = {
        FOLDER / "schemas" / f"{name}-{context.version}.json": schema_text(name)
        for name, context in published().items()
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
