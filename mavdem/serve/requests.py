"""Parts of HTTP requests and responses: bodies, numbers and texts from clients, and the document of an error."""

import re
from math import isfinite, nan
from typing import TypeVar

from pydantic import ValidationError
from starlette.requests import Request as HttpRequest

from mavdem.containers import JsonValues
from mavdem.documents.document import Document
from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.serve import RefusalReason
from mavdem.serve.uploads import MAX_FIELD_BYTES, body_chunks

MAX_NUMBER_DIGITS = 9
"""Digits of a number in a query, at most: larger ones would not fit into the integers of SQLite."""

Model = TypeVar("Model", bound=Document)


async def read_body(request: HttpRequest) -> bytes:
    """Receives the body of a request that is no upload.

    Raises:
        Refusal: it is larger than ``MAX_FIELD_BYTES``, comes too slowly or breaks off.
    """
    body = bytearray()
    async for chunk in body_chunks(request):
        body += chunk
        if len(body) > MAX_FIELD_BYTES:
            raise Refusal(RefusalReason.UPLOAD_TOO_LARGE, size_limit=MAX_FIELD_BYTES)
    return bytes(body)


async def read_document(request: HttpRequest, model: type[Model]) -> Model:
    """Receives the JSON document in the body of a request.

    Args:
        request: the request.
        model: model of the document, by which it is checked.

    Raises:
        Refusal: the body is no such document.
    """
    body = await read_body(request)
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        reason = error.errors()[0]["msg"]
        raise Refusal(RefusalReason.BAD_REQUEST, reason=reason) from None


def query_number(request: HttpRequest, name: str, default: int) -> int:
    """Returns a number from 0 in the query of a URL; the default where there is none, or it is too long."""
    text = request.query_params.get(name, "")
    if text.isdecimal() and len(text) <= MAX_NUMBER_DIGITS:
        return int(text)
    return default


def query_decimal(request: HttpRequest, name: str, default: float) -> float:
    """Returns a number in the query of a URL.

    Args:
        request: the request with the URL.
        name: key of the number in the query.
        default: value if the query does not have this key.

    Returns:
        The number, finite.

    Raises:
        Refusal: the value is not a finite number.
    """
    text = request.query_params.get(name, "")
    if not text:
        return default
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not isfinite(value):
        raise Refusal(RefusalReason.BAD_REQUEST, reason=f"{name} is no number")
    return value


def query_integer(request: HttpRequest, name: str) -> int | None:
    """Returns a whole number in the query of a URL.

    Args:
        request: the request with the URL.
        name: key of the number in the query.

    Returns:
        The number; None if the query does not have this key.

    Raises:
        Refusal: the value is not a whole number.
    """
    text = request.query_params.get(name, "")
    if not text:
        return None
    if not re.fullmatch(r"-?[0-9]{1,9}", text):
        raise Refusal(RefusalReason.BAD_REQUEST, reason=f"{name} is no whole number")
    return int(text)


def valid_unicode(text: str) -> str:
    """Replaces lone surrogates, which are no characters, by question marks.

    A form may name a charset that decodes to such surrogates, and they cannot be written to a file as UTF-8.
    """
    return text.encode(errors="replace").decode()


def error_values(fact: Fact) -> JsonValues:
    """Returns the values of the document ``Error`` for the reason of a refusal."""
    return {"reason": fact, "remedy": fact.remedy, "fact": fact}
