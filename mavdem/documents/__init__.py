"""The JSON documents that mavdem writes, such as report.json: one model for each command, with its version."""

from functools import cache
from typing import Any, NamedTuple

from mavdem.containers import JsonValues
from mavdem.document_heading import document_heading
from mavdem.documents.comparison import CompareReport, Order
from mavdem.documents.document import Document, Failure, document_units
from mavdem.documents.fleet import Diff, Track
from mavdem.documents.flight import LearnReport
from mavdem.documents.inventory import Inventory
from mavdem.documents.loops import Tune, Twin
from mavdem.documents.others import Convert, Fly, Reproduce
from mavdem.documents.review import Review
from mavdem.documents.session import Live
from mavdem.documents.wind import Wind


class Published(NamedTuple):
    """A document of the interface of mavdem."""

    model: type[Document]
    """Class of the document, with its keys, units and meanings."""
    version: int
    """Version of its schema, which is raised whenever the schema changes."""
    title: str
    """Place where the document is written, as the reference names it."""


DOCUMENTS = {
    "review": Published(Review, 11, "report.json of review, and `--json` of review"),
    "learn": Published(LearnReport, 10, "report.json, and `--json` of learn and open"),
    "info": Published(Inventory, 6, "`--json` of info"),
    "wind": Published(Wind, 4, "`--json` of wind"),
    "tune": Published(Tune, 6, "`--json` of tune"),
    "compare": Published(CompareReport, 4, "`--json` of compare"),
    "order": Published(Order, 4, "`--json` of order"),
    "diff": Published(Diff, 4, "`--json` of diff"),
    "track": Published(Track, 4, "`--json` of track"),
    "live": Published(Live, 6, "`--json` of live"),
    "convert": Published(Convert, 2, "`--json` of convert"),
    "twin": Published(Twin, 5, "`--json` of twin"),
    "fly": Published(Fly, 3, "`--json` of fly"),
    "reproduce": Published(Reproduce, 3, "numbers.json, and `--json` of reproduce"),
    "error": Published(
        Failure, 2, "`--json` of any command that ends without a document of its own"
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
