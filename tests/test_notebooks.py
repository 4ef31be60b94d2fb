"""The notebooks of the documentation run, and their cells are ones that any Jupyter runs."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import pytest
from notebook_runner import data, outputs, run

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))
LARGEST = 300_000  # bytes of a notebook with its outputs


def pictures(notebook: dict) -> list[int]:
    """The cells that show one."""
    return [
        place
        for place, cell in enumerate(notebook["cells"])
        if any("image/png" in output.get("data", ()) for output in cell.get("outputs", ()))
    ]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_is_stored_in_it(path):
    stored, now = json.loads(path.read_text()), run(path)
    assert pictures(now) == pictures(stored) and len(pictures(now)) >= 5
    assert [bool(cell.get("outputs")) for cell in now["cells"]] == [
        bool(cell.get("outputs")) for cell in stored["cells"]
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_of_the_common_format(path):
    notebook = json.loads(path.read_text())
    assert notebook["nbformat"] == 4 and path.stat().st_size < LARGEST
    identifiers = [cell["id"] for cell in notebook["cells"]]
    assert len(set(identifiers)) == len(identifiers)
    counts = [cell["execution_count"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert counts == list(range(1, len(counts) + 1))


def test_a_cell_shows_what_it_prints_and_its_last_expression():
    names: dict = {}
    assert list(outputs("x = 2\nprint('a')", names, 1)) == [
        {"name": "stdout", "output_type": "stream", "text": ["a\n"]}
    ]
    (shown,) = outputs("x * 21", names, 2)
    assert shown["data"] == {"text/plain": ["42"]} and shown["execution_count"] == 2
    assert list(outputs("None", names, 3)) == []


def test_a_cell_that_fails_fails_the_run():
    with pytest.raises(ZeroDivisionError):
        list(outputs("1 / 0", {}, 1))


def test_a_picture_is_stored_as_png():
    from matplotlib.figure import Figure

    from mavdem.report.figures.style import picture

    with picture() as figure:
        figure.subplots().plot([1, 2])
    assert isinstance(figure, Figure)
    assert base64.b64decode(data(figure)["image/png"]).startswith(b"\x89PNG")
