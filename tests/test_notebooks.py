"""The notebooks of the documentation run: their cells are plain Python that any Jupyter runs too."""

from __future__ import annotations

import ast
import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))
LARGEST = 300_000  # bytes of a notebook with its outputs


def outputs(source: str, names: dict[str, Any]) -> set[str]:
    """What a cell shows: "stream" of what it prints, "image/png" or "text/plain" of its last expression."""
    tree, printed, shown = ast.parse(source), io.StringIO(), None
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        if last is not None:
            shown = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    kind = {"image/png"} if hasattr(shown, "_repr_png_") and shown._repr_png_() else {"text/plain"}
    return ({"stream"} if printed.getvalue() else set()) | (kind if shown is not None else set())


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_is_stored_in_it(path, monkeypatch):
    monkeypatch.chdir(path.parent)
    names: dict[str, Any] = {"__name__": "__main__"}
    pictures = 0
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "code":
            shown = outputs("".join(cell["source"]), names)
            kinds = {kind for one in cell["outputs"] for kind in one.get("data", {"stream": ""})}
            assert ("image/png" in shown, bool(shown)) == ("image/png" in kinds, bool(kinds)), cell["source"]
            pictures += "image/png" in shown
    assert pictures >= 5


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_of_the_common_format(path):
    notebook = json.loads(path.read_text())
    assert notebook["nbformat"] == 4 and path.stat().st_size < LARGEST
    identifiers = [cell["id"] for cell in notebook["cells"]]
    assert len(set(identifiers)) == len(identifiers)
    counts = [cell["execution_count"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert counts == list(range(1, len(counts) + 1))
