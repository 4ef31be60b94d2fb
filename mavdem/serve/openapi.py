"""The description of the interface for programs (OpenAPI 3.1), made of the models of the documents."""

import re
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from typing import NamedTuple

from pydantic.json_schema import models_json_schema

from mavdem.containers import JsonValues
from mavdem.documents.library import ANSWERS
from mavdem.files import load_adjacent_toml
from mavdem.report.pages.library_page import interface_words


class Operation(NamedTuple):
    """A method of a path: its name, the status of a success, and models of what it takes and returns."""

    name: str
    method: str
    path: str
    status: str
    answer: str = ""
    body: str = ""
    query: Sequence[str] = ()


LOGS = "logs"
TABLE = load_adjacent_toml(__file__, "operations.toml")
OPERATIONS = [Operation(name, **row) for name, row in TABLE["operations"].items()]


@cache
def openapi() -> JsonValues:
    """Returns the description, plain JSON values."""
    template = "#/components/schemas/{model}"
    _, schemas = models_json_schema(
        [(model, "serialization") for model in ANSWERS], ref_template=template
    )
    # A review is sent as it was written, which is not checked again.
    review = schemas["$defs"]["FlightReview"]["properties"]["review"]
    review["anyOf"][0] = _schema("Review")["schema"]
    paths = dict[str, JsonValues]()
    for operation in OPERATIONS:
        paths.setdefault(operation.path, {})[operation.method] = _described(operation)
    return {
        "openapi": "3.1.0",
        "info": {"title": interface_words()["interface"]["title"], "version": version("mavdem")},
        "paths": paths,
        "components": {
            "schemas": schemas["$defs"],
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        "security": [{"token": []}, {}],
    }


def _described(operation: Operation) -> JsonValues:
    kind = "text/event-stream" if operation.name == "progress" else "application/json"
    answer = {kind: _schema(operation.answer)} if operation.answer else {}
    places = dict.fromkeys(re.findall(r"{(\w+)}", operation.path), "path")
    places |= dict.fromkeys(operation.query, "query")
    summary = interface_words()["interface"][operation.name]
    described = {
        "operationId": operation.name,
        "summary": summary,
        "parameters": [
            {
                "name": name,
                "in": location,
                "required": location == "path",
                "schema": {"type": "string"},
            }
            for name, location in places.items()
        ],
        "responses": {
            operation.status: {"description": summary, "content": answer},
            "default": {"description": "Error", "content": {"application/json": _schema("Error")}},
        },
    }
    if operation.body:
        json = {"application/json": _schema(operation.body)}
        described["requestBody"] = {"content": TABLE["form"] if operation.body == LOGS else json}
    return described


def _schema(name: str) -> JsonValues:
    return {"schema": {"$ref": f"#/components/schemas/{name}"}}
