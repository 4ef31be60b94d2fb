"""Documents: the JSON that mavdem writes, made of results and facts; the models have keys, units and meanings."""

from functools import cache
from typing import Any, NamedTuple

from mavdem.containers import JsonValues
from mavdem.document_heading import document_heading
from mavdem.documents.comparison import CompareReport, Order
from mavdem.documents.document import Document, Failure, units_of
from mavdem.documents.fleet import Diff, Track
from mavdem.documents.flight import LearnReport
from mavdem.documents.inventory import Inventory
from mavdem.documents.loops import Tune, Twin
from mavdem.documents.others import Convert, Fly, Reproduce
from mavdem.documents.review import Review
from mavdem.documents.session import Live
from mavdem.documents.wind import Wind


class Published(NamedTuple):
    """A document of the interface: its ``model``, the ``version`` of its schema, and what it is."""

    model: type[Document]
    version: int
    title: str


DOCUMENTS = {
    "review": Published(Review, 7, "report.json of review, and `--json` of review"),
    "learn": Published(LearnReport, 8, "report.json, and `--json` of learn and open"),
    "info": Published(Inventory, 3, "`--json` of info"),
    "wind": Published(Wind, 3, "`--json` of wind"),
    "tune": Published(Tune, 4, "`--json` of tune"),
    "compare": Published(CompareReport, 4, "`--json` of compare"),
    "order": Published(Order, 4, "`--json` of order"),
    "diff": Published(Diff, 3, "`--json` of diff"),
    "track": Published(Track, 2, "`--json` of track"),
    "live": Published(Live, 5, "`--json` of live"),
    "convert": Published(Convert, 2, "`--json` of convert"),
    "twin": Published(Twin, 5, "`--json` of twin"),
    "fly": Published(Fly, 3, "`--json` of fly"),
    "reproduce": Published(Reproduce, 3, "numbers.json, and `--json` of reproduce"),
    "error": Published(
        Failure, 2, "`--json` of any command that ends without a document of its own"
    ),
}
"""By the name of the command that makes them; a change of the schema is a new version."""


@cache
def header(name: str) -> JsonValues:
    """Returns what the document of this ``name`` begins with: its name, the versions, and units by key."""
    published = DOCUMENTS[name]
    return document_heading(
        name, published.version, units_of(published.model.model_json_schema(by_alias=False))
    )


def whole(name: str, document: Any) -> JsonValues:
    """Returns the JSON of the document of this ``name``, with its header; ``ValueError`` where it is none."""
    return header(name) | DOCUMENTS[name].model.model_validate(document).as_dict()
