"""Facts below, words above: no prose about a flight below `report`, and a sentence for each code."""

import ast
import re
from collections import Counter
from pathlib import Path

from pytest import mark

import mavdem.facts
import mavdem.facts.sources
import mavdem.unit_errors
from mavdem.facts import Code
from mavdem.report.blocks import shortened
from mavdem.report.templates import sentence_templates

ROOT = Path(__file__).parents[1]
ABOVE = {"report", "documents", "view", "export", "cli"}
"""Rooms that may put results in words."""
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
UNCHECKED_CALLS = BUGS | {"compile", "field", "Field"}
"""Functions whose arguments may be prose or look like it."""
WORDS = re.compile(r"[A-Za-z’]{2,}[,:;]? [A-Za-z’]{2,}")
SENTENCE = re.compile(r"^[A-Z][a-z]*( [^ ]+){2,}[.!?]$")
BEGINNING = re.compile(r"""(?<!['"])["'}][A-Z][a-z]* |\S[ \t]*(?:\"{3}|'{3})[A-Z]""")
"""How a sentence begins in a file: after a quote or a field, and after three quotes that begin no docstring."""


def prose_of(node):
    """Yields line and text of literals that are prose. Docstrings, messages about bugs, and patterns are left out."""
    if isinstance(node, ast.Constant):
        if isinstance(node.value, str) and WORDS.search(node.value):
            yield node.lineno, node.value
        return
    is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    if is_docstring or isinstance(node, ast.Name):
        return
    if isinstance(node, ast.Call):
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        if name in UNCHECKED_CALLS:
            return
    # Names of things, which documents have as values.
    has_names = isinstance(node, ast.ClassDef) and "StrEnum" in map(ast.unparse, node.bases)
    for child in ast.iter_child_nodes(node):
        if not (has_names and isinstance(child, ast.Assign)):
            yield from prose_of(child)


@mark.parametrize(
    "source",
    [
        'reason = "No motor turns."',
        "reason = ('No motor '\n'turns.')",
        'reason = f"{name}No motor turns."',
        'reason = """No motor turns."""',
    ],
)
def test_a_file_with_a_sentence_is_parsed(source):
    assert BEGINNING.search(source)
    assert not BEGINNING.search('"""What a file holds."""\n\nname = "roll rate"\n')


@mark.slow
def test_below_report_there_is_no_sentence():
    sentences = []
    for path in sorted((ROOT / "mavdem").rglob("*.py")):
        inside = path.relative_to(ROOT / "mavdem").parts
        if inside[0] in ABOVE or inside[:2] == ("experiments", "paper"):
            continue
        source = path.read_text()
        # To parse all files takes two seconds.
        if not BEGINNING.search(source):
            continue
        for line, text in prose_of(ast.parse(source)):
            if SENTENCE.search(text):
                sentences.append(f"{path.relative_to(ROOT)}:{line}: {text}")
    assert not sentences


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
    assert set(values) == set(sentence_templates())


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
    assert shortened("Deviation small (largest: 0 ± 8 %); headroom 12 %.", columns) == shown


def test_a_text_of_one_clause_is_cut_after_a_phrase():
    text = "Roll follows its setpoint to 1.5°, 0.08 s late, its rate to 14 °/s."
    assert shortened(text, 60) == "Roll follows its setpoint to 1.5°, 0.08 s late …"
