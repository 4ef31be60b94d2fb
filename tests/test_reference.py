"""docs/reference is what the program has now, and its schemas say what is written; tests/cli checks every command."""

import json

import reference
from pydantic import ValidationError
from pytest import mark, raises
from simulated import simulated

import mavdem
from mavdem.dem.document import UNITS, VERSION
from mavdem.document_heading import document_heading
from mavdem.documents import DOCUMENTS
from mavdem.fleet.row import SCHEMA_VERSION
from mavdem.fleet.table_files import row_schema


@mark.slow
def test_pages_and_schemas_are_of_this_version(request):
    """With ``--write-golden`` they are written, unless a schema changed and its version did not."""
    if request.config.getoption("--write-golden"):
        reference.write()
    assert [
        path.name for path, text in reference.contents().items() if path.read_text() != text
    ] == []


def test_a_key_that_is_not_published_is_refused():
    model = DOCUMENTS["error"].model
    model.model_validate({"error": {"reason": "", "remedy": ""}})
    with raises(ValidationError):
        model.model_validate({"error": {"reason": "", "remedy": ""}, "more": 1})


@mark.slow
def test_the_columns_of_a_fleet_are_as_published():
    published = reference.published()["flights"].schema["properties"]
    schema = row_schema()
    assert schema.names == list(published)
    assert {field.name: field.metadata[b"unit"].decode() for field in schema if field.metadata} == {
        name: unit for name, key in published.items() if (unit := reference._unit(key))
    }
    assert schema.metadata[b"mavdem_schema"].decode() == str(SCHEMA_VERSION)


@mark.slow
def test_a_model_begins_with_its_versions_and_is_read_without_them():
    text = mavdem.learn(simulated(wind=0.5)[:200]).to_json()
    document = json.loads(text)
    expected = document_heading("model", VERSION, UNITS)
    assert {name: document.pop(name) for name in expected} == expected
    assert mavdem.Learned.from_json(json.dumps(document)).to_json() == text
    with raises(ValueError, match="of a later version of mavdem"):
        mavdem.Learned.from_json(
            text.replace(f'"schema_version": {VERSION}', f'"schema_version": {VERSION + 1}')
        )
    with raises(ValueError, match="of an earlier version of mavdem, learn anew"):
        mavdem.Learned.from_json('{"settings": {"noise_groups": null}}')
