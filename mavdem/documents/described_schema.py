"""JSON schemas in which the docstrings of a document's attributes describe its fields.

Pydantic can read these docstrings itself (``use_attribute_docstrings``), but does so for all documents whenever they
are imported, which took a third of the time that `mavdem` takes to start. Only who publishes schemas needs them.
"""

import ast
import inspect
import sys
from functools import cache
from itertools import pairwise

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import ModelSchema


class DescribedSchema(GenerateJsonSchema):
    """Makes JSON schemas of documents with a description of each field; a ``schema_generator`` of pydantic."""

    def model_schema(self, schema: ModelSchema) -> JsonSchemaValue:
        """Returns the JSON schema of one model, with the docstrings of its attributes as descriptions.

        A field that has a description of its own already, because its definition gives one, keeps it.

        Args:
            schema: Pydantic's own schema of the model.
        """
        json_schema = super().model_schema(schema)
        properties = json_schema.get("properties", {})
        # A document may inherit fields from another one.
        for model in reversed(schema["cls"].__mro__):
            docstrings = _attribute_docstrings(model.__module__).get(model.__name__, {})
            for name, docstring in docstrings.items():
                if name in properties:
                    properties[name].setdefault("description", docstring)
        return json_schema


@cache
def _attribute_docstrings(module: str) -> dict[str, dict[str, str]]:
    """Returns the docstrings below the attributes of the classes at the top level of a module.

    Args:
        module: Name of a module that is imported; one without Python source has no docstrings.

    Returns:
        By name of the class, and then by name of the attribute, the docstring, cleaned of its indentation.
    """
    try:
        source = inspect.getsource(sys.modules[module])
    except (OSError, TypeError):
        return {}
    docstrings = {}
    for definition in ast.parse(source).body:
        if not isinstance(definition, ast.ClassDef):
            continue
        docstrings_by_attribute = {}
        # The docstring of an attribute is the text that follows its annotation.
        for statement, next_statement in pairwise(definition.body):
            text = _text_of_statement(next_statement)
            if not isinstance(statement, ast.AnnAssign) or text is None:
                continue
            if isinstance(statement.target, ast.Name):
                docstrings_by_attribute[statement.target.id] = inspect.cleandoc(text)
        docstrings[definition.name] = docstrings_by_attribute
    return docstrings


def _text_of_statement(statement: ast.stmt) -> str | None:
    """Returns the text of a statement that is just a string, as a docstring is; None for any other statement."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        value = statement.value.value
        return value if isinstance(value, str) else None
    return None
