"""Facts below, words above: no prose about a flight below `report`, and a sentence for each code."""

import ast
import re
from collections import Counter
from pathlib import Path

from pytest import mark

import mavdem.facts
import mavdem.facts.sources
import mavdem.unit_slips
from mavdem.facts import Code
from mavdem.report.blocks import brief
from mavdem.report.words import table

ROOT = Path(__file__).parents[1]
ABOVE = {"report", "documents", "view", "export", "paper", "cli"}
"""Rooms that may put results in words."""
PROSE = {
    "dataset": 1,
    "analysis": 3,
    "assessment": 1,
    "baselines": 1,
    "condition": 6,
    "dem": 25,
    "evaluate": 1,
    "fleet": 45,
    "mavdem": 17,
    "serve": 34,
}
"""Literals of words below `report` that say nothing of a flight: SQL, headers of HTTP, units, names of columns and of
terms of F̄, titles of progress bars, what ``repr`` shows, and pydantic's own messages."""
BUGS = {
    "ValueError",
    "TypeError",
    "AttributeError",
    "RuntimeError",
    "KeyError",
    "AssertionError",
    "NotImplementedError",
    "LinAlgError",
}
"""Errors of a caller's program, whose messages are for its author."""
WORDS = re.compile(r"[A-Za-z’]{2,}[,:;]? [A-Za-z’]{2,}")


def prose_of(node):
    """Lines and literals with words in a row; not docstrings, messages of errors that are bugs, and patterns."""
    called = getattr(node, "func", None)
    name = getattr(called, "id", getattr(called, "attr", ""))
    # Names of things, which documents have as values.
    has_names = isinstance(node, ast.ClassDef) and "StrEnum" in map(ast.unparse, node.bases)
    said = getattr(node, "value", None)
    if isinstance(node, ast.Constant) and isinstance(said, str) and WORDS.search(said):
        yield node.lineno, said
    is_docstring = isinstance(node, ast.Expr) and isinstance(said, ast.Constant)
    if not is_docstring and name not in BUGS | {"compile", "field", "Field"}:
        for child in ast.iter_child_nodes(node):
            if not (has_names and isinstance(child, ast.Assign)):
                yield from prose_of(child)


@mark.slow
def test_below_report_there_is_no_prose():
    left = Counter()
    found = []
    for path in sorted((ROOT / "mavdem").rglob("*.py")):
        inside = path.relative_to(ROOT / "mavdem").parts
        room = inside[0] if len(inside) > 1 else "mavdem"
        if room not in ABOVE:
            prose = list(prose_of(ast.parse(path.read_text())))
            left[room] += len(prose)
            found += [f"{path.relative_to(ROOT)}:{line}: {text}" for line, text in prose]
    assert not {room: count for room, count in left.items() if count > PROSE.get(room, 0)}, (
        "\n".join(found)
    )


def codes():
    pending = [Code]
    kinds = []
    while pending:
        kind = pending.pop()
        kinds.append(kind)
        pending += kind.__subclasses__()
    return [code for kind in kinds for code in kind]


def test_each_code_has_its_sentence_and_each_sentence_its_code():
    for path in Path(mavdem.facts.__file__).parent.glob("*.py"):
        __import__(f"mavdem.facts.{path.stem}".removesuffix(".__init__"))
    values = Counter(map(str, codes()))
    assert not [value for value, count in values.items() if count > 1]
    assert set(values) == set(table())


@mark.parametrize(
    "columns, shown",
    {
        80: "Deviation small (largest: 0 ± 8 %); headroom 12 %.",
        40: "Deviation small; headroom 12 %.",
        20: "Deviation small.",
        12: "Deviation …",
    }.items(),
)
def test_a_text_for_one_line_ends_with_a_whole_clause(columns, shown):
    assert brief("Deviation small (largest: 0 ± 8 %); headroom 12 %.", columns) == shown
