"""Every document that a command prints or writes in these tests is checked by its published schema."""

import json

import pytest
import reference

from mavdem.cli import compare, learn, output, reproduce


@pytest.fixture(autouse=True)
def _as_published(monkeypatch):
    text_of = output.json_text

    def checked(document):
        text = text_of(document)
        reference.adapters()[json.loads(text)["document"]].validate_json(text)
        return text

    for module in (output, learn, compare, reproduce):
        monkeypatch.setattr(module, "json_text", checked)
