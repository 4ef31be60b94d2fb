"""The standard input of ``mavdem mcp``, line by line."""

import io
import json

from pytest import mark

from mavdem.cli.assistant_input import character_input


@mark.parametrize(
    "sent, read",
    [
        (r'{"log": "a\ud800b"}', "a\ufffdb"),
        (r'{"log": "a\udcffb"}', "a\ufffdb"),
        (r'{"log": "\ud83d\ude81"}', "\U0001f681"),
        (r'{"log": "\ude81\ud83d"}', "\ufffd\ufffd"),
        (r'{"log": "C:\\ud800"}', r"C:\ud800"),
        ('{"log": "\U0001f681"}', "\U0001f681"),
    ],
)
def test_a_surrogate_without_a_partner_is_replaced(sent, read):
    """A character beyond U+FFFF is escaped in JSON as a pair of surrogates. Half of a pair is no character."""
    source = io.TextIOWrapper(io.BytesIO(f"{sent}\n".encode() * 2), encoding="utf-8")
    lines = character_input(source).readlines()
    assert [json.loads(line)["log"] for line in lines] == [read, read]


@mark.slow
def test_long_lines_are_read_in_pieces():
    line = json.dumps({"log": "ab\ud800" * 50_000}) + "\n"
    source = io.TextIOWrapper(io.BytesIO(line.encode()), encoding="utf-8")
    assert json.loads(character_input(source).readline())["log"] == "ab\ufffd" * 50_000
