"""The OpenAPI 3.1 description of the server's interface for programs, generated from the models of its documents."""

import re
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from typing import NamedTuple

from pydantic.json_schema import models_json_schema

from mavdem.containers import JsonValues
from mavdem.documents.described_schema import DescribedSchema
from mavdem.documents.library import ANSWERS
from mavdem.files import load_adjacent_toml
from mavdem.report.pages.library_page import interface_words


class Operation(NamedTuple):
    """One operation of the interface: a method of a path."""

    name: str
    """name of the operation, by which the summary in ``words.toml`` is found"""
    method: str
    """HTTP method, in lower case"""
    path: str
    """path of the URL, with names of parameters in braces"""
    status: str
    """HTTP status of a success"""
    answer: str = ""
    """name of the model of the answer; empty where it is no document"""
    body: str = ""
    """name of the model of the request's body, or ``logs`` for a form with logs; empty for no body"""
    query: Sequence[str] = ()
    """names of parameters in the query of the URL"""


UPLOAD_BODY = "logs"
"""Name that an operation has as its body where that is a form with logs."""

TABLE = load_adjacent_toml(__file__, "operations.toml")
"""The tables of ``operations.toml``: the operations, the form of uploads, and the status of refusals."""

OPERATIONS = [Operation(name, **row) for name, row in TABLE["operations"].items()]
"""All operations, in the order of the file."""

STATUS_BY_REFUSAL: dict[str, int] = TABLE["status"]
"""HTTP status of refusals by their codes; other refused requests have 400, and files that are no logs 415."""


@cache
def openapi() -> JsonValues:
    """Returns the OpenAPI description as plain JSON values: the operations, the schemas of documents, and the token.

    Pydantic makes the schemas from the models by which the documents are written, so the two cannot differ.

    Returns:
        The description.
    """
    _, schemas = models_json_schema(
        [(model, "serialization") for model in ANSWERS],
        ref_template="#/components/schemas/{model}",
        schema_generator=DescribedSchema,
    )
    # The document of a review is sent as it was written, so its model here is any JSON object. The description names
    # the model by which it was written.
    review = schemas["$defs"]["FlightReview"]["properties"]["review"]
    review["anyOf"][0] = _reference("Review")["schema"]
    paths: dict[str, JsonValues] = {}
    for operation in OPERATIONS:
        paths.setdefault(operation.path, {})[operation.method] = _operation_object(operation)
    return {
        "openapi": "3.1.0",
        "info": {"title": interface_words()["interface"]["title"], "version": version("mavdem")},
        "paths": paths,
        "components": {
            "schemas": schemas["$defs"],
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        # The token is optional: a server on one machine has none.
        "security": [{"token": []}, {}],
    }


def _operation_object(operation: Operation) -> JsonValues:
    """Returns the OpenAPI description of one operation (an Operation Object of OpenAPI 3.1, section 4.8.10).

    It has the parameters, the body of the request, the answer in case of success, and for all other statuses the
    document ``Error``.

    Args:
        operation: the operation: method, path, and what it takes and answers.
    """
    # The progress is the only operation that answers with a stream of events.
    media_type = "text/event-stream" if operation.name == "progress" else "application/json"
    content = {media_type: _reference(operation.answer)} if operation.answer else {}
    summary = interface_words()["interface"][operation.name]
    error_content = {"application/json": _reference("Error")}
    description: JsonValues = {
        "operationId": operation.name,
        "summary": summary,
        "parameters": _parameter_objects(operation),
        "responses": {
            operation.status: {"description": summary, "content": content},
            "default": {"description": "Error", "content": error_content},
        },
    }
    if operation.body == UPLOAD_BODY:
        description["requestBody"] = {"content": TABLE["form"]}
    elif operation.body:
        body_content = {"application/json": _reference(operation.body)}
        description["requestBody"] = {"content": body_content}
    return description


def _parameter_objects(operation: Operation) -> list[JsonValues]:
    """Returns the OpenAPI descriptions of an operation's parameters, first those in the path, then in the query.

    Parameters in the path are the names in braces, and are required; those in the query never are.

    Args:
        operation: method, path, parameters and answers of one address of the server.
    """
    locations = dict.fromkeys(re.findall(r"{(\w+)}", operation.path), "path")
    locations |= dict.fromkeys(operation.query, "query")
    return [
        {
            "name": name,
            "in": location,
            "required": location == "path",
            "schema": {"type": "string"},
        }
        for name, location in locations.items()
    ]


def _reference(model_name: str) -> JsonValues:
    """Returns the reference to the schema of a model."""
    return {"schema": {"$ref": f"#/components/schemas/{model_name}"}}
