"""Runs notebooks without Jupyter: each code cell in one namespace, the last expression of a cell shown.

Stores the outputs of each NOTEBOOK in it: python tests/notebook_runner.py docs/notebooks/*.ipynb

Cells are plain Python. Outputs are what a cell prints, and the text, HTML or PNG of its last expression; PNGs have few
colours, so that the file stays small.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from PIL import Image

COLOURS = 192  # of a stored PNG


def run(path: Path) -> dict[str, Any]:
    """The notebook with the outputs of its code cells; it runs in its own folder."""
    notebook: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    with within(path.parent):
        number = 0
        for cell in notebook["cells"]:
            if cell["cell_type"] != "code":
                continue
            number += 1
            cell["execution_count"] = number
            cell["outputs"] = list(outputs("".join(cell["source"]), names, number))
    return notebook


def outputs(source: str, names: dict[str, Any], number: int) -> Iterator[dict[str, Any]]:
    """Runs a cell and yields its outputs as a notebook stores them."""
    tree, printed, shown = ast.parse(source), io.StringIO(), None
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, f"cell {number}", "exec"), names)
        if last is not None:
            shown = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names)
    if printed.getvalue():
        yield {"name": "stdout", "output_type": "stream", "text": printed.getvalue().splitlines(keepends=True)}
    if shown is not None:
        yield {"data": data(shown), "execution_count": number, "metadata": {}, "output_type": "execute_result"}


def data(shown: Any) -> dict[str, Any]:
    """What a notebook shows of a value, by its MIME type."""
    found: dict[str, Any] = {"text/plain": [repr(shown)]}
    if hasattr(shown, "_repr_png_"):
        found["image/png"] = b64encode(few_colours(shown._repr_png_())).decode()
        found["text/plain"] = ["<Figure>"]
    elif hasattr(shown, "_repr_html_") and (html := shown._repr_html_()):
        found["text/html"] = html.splitlines(keepends=True)
    return found


def few_colours(png: bytes) -> bytes:
    """The same picture with a palette."""
    file = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
        file, "PNG", optimize=True
    )
    return file.getvalue()


@contextlib.contextmanager
def within(folder: Path) -> Iterator[None]:
    """Works in a folder, and returns."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@click.command(help=__doc__)
@click.argument("notebooks", nargs=-1, required=True, metavar="NOTEBOOK...", type=click.Path(path_type=Path))
def main(notebooks: tuple[Path, ...]) -> None:
    for path in notebooks:
        notebook = run(path.resolve())
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
