"""The JSON documents that mavdem writes, such as report.json: one model for each command, with its version."""

from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

from mavdem.containers import JsonValues
from mavdem.document_heading import document_heading
from mavdem.documents.document import Document, document_units


class Published(NamedTuple):
    """A document of the interface of mavdem."""

    path: str
    """Module of this package and class of the document, such as "review.Review"."""
    version: int
    """Version of its schema, which is raised whenever the schema changes."""
    title: str
    """Place where the document is written, as the reference names it."""

    @property
    def model(self) -> type[Document]:
        """Class of the document, with its keys, units and meanings.

        Its module is imported only here, since a command needs one of the documents, and to import all of them takes a
        tenth of a second.
        """
        module_name, class_name = self.path.split(".")
        module = import_module(f"mavdem.documents.{module_name}")
        document_class: type[Document] = getattr(module, class_name)
        return document_class


DOCUMENTS = {
    "review": Published("review.Review", 22, "report.json of review, and `--json` of review"),
    "learn": Published("flight.LearnReport", 14, "report.json, and `--json` of learn and open"),
    "info": Published("inventory.Inventory", 10, "`--json` of info"),
    "wind": Published("wind.Wind", 9, "`--json` of wind"),
    "tune": Published("loops.Tune", 7, "`--json` of tune"),
    "compare": Published("comparison.CompareReport", 8, "`--json` of compare"),
    "order": Published("comparison.Order", 4, "`--json` of order"),
    "diff": Published("fleet.Diff", 11, "`--json` of diff"),
    "track": Published("fleet.Track", 10, "`--json` of track"),
    "live": Published("session.Live", 8, "`--json` of live"),
    "convert": Published("others.Convert", 2, "`--json` of convert"),
    "twin": Published("loops.Twin", 5, "`--json` of twin"),
    "fly": Published("others.Fly", 3, "`--json` of fly"),
    "reproduce": Published("others.Reproduce", 3, "numbers.json, and `--json` of reproduce"),
    "error": Published(
        "document.Failure", 2, "`--json` of any command that ends without a document of its own"
    ),
}
"""All documents, by the name of the command that writes them."""


@cache
def document_header(name: str) -> JsonValues:
    """Returns the keys with which a document begins: its name, versions, and the units of its figures by key."""
    published = DOCUMENTS[name]
    return document_heading(name, published.version, document_units(published.model))


def complete_document(name: str, document: Any) -> JsonValues:
    """Returns the JSON values of a document with its header.

    Args:
        name: name of the document in ``DOCUMENTS``.
        document: values of its keys, a result with such attributes, or the model itself.

    Raises:
        pydantic.ValidationError: the values do not fit the model.
    """
    model = DOCUMENTS[name].model
    return document_header(name) | model.model_validate(document).as_dict()
