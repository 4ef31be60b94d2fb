"""The document of a learned model, ``model.json``: every field by its name, arrays as nested lists.

pydantic reads and writes it by the types of the records' fields.
"""

import json
import re
from functools import cache
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError

from mavdem.dem.validation import first_problem
from mavdem.document_heading import document_heading
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.model import ModelFile

VERSION = 1
"""Of the document's schema."""
UNITS = {"record.dt": "s", "settings.horizon": "s"}

Kind = TypeVar("Kind")


def to_text(result: Any) -> str:
    """Returns the document of a result, a dataclass."""
    values = _adapter(cast(Any, type(result))).dump_python(result, mode="json")
    return json.dumps(document_heading("model", VERSION, UNITS) | values)


def from_text(kind: type[Kind], text: str) -> Kind:
    """Returns the result of this ``kind`` whose document is ``text``; ``ValueError`` names what is wrong in it."""
    later = (
        re.match(r'\{"document": "model", "schema_version": (\d{1,9})\b', text)
        if isinstance(text, str)
        else None
    )
    if later and int(later[1]) > VERSION:
        raise Unreadable(ModelFile.OF_LATER_VERSION)
    try:
        return _adapter(cast(Any, kind)).validate_json(text, strict=True)
    except (ValidationError, TypeError) as error:
        problem = first_problem(error) if isinstance(error, ValidationError) else str(error)
        # before documents said what they are
        fact = Fact(
            ModelFile.NO_MODEL_DOCUMENT,
            error=problem,
            is_old=isinstance(text, str) and text.startswith('{"settings"'),
        )
        raise Unreadable(fact) from None


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
