"""How Sphinx makes the documentation site of this folder; `tools/site` runs it."""

import io
import json
from collections.abc import Iterator
from importlib.metadata import version as remote_version
from pathlib import Path
from typing import Any

import matplotlib
from docutils.nodes import SkipNode
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import math_to_image
from myst_parser.parsers.sphinx_ import MystParser

project = "mavdem"
author = copyright = "The mavdem developers"
release = version = remote_version("mavdem")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = f"mavdem {version}"
html_show_sourcelink = html_copy_source = False
html_math_renderer = "drawn"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
highlight_language = "none"  # of blocks that name none: commands and diagrams

# Docstrings name no function or method that the reference lacks. Attributes are lists in it, and types are not linked.
nitpicky = True
nitpick_ignore_regex = [("py:(attr|class|mod)", ".*"), ("py:exc", r"concurrent\..*")]
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "Array": "Array"}
# What a class says of its attributes is a list; as entries of their own, fields of tuples would be there twice.
napoleon_use_ivar = True


def formula(translator: Any, node: Any) -> None:
    """Draws a formula into the page, in the colour of its text: nothing is fetched, and every browser shows it."""
    drawn = io.StringIO()
    block = node.tagname == "math_block"
    text = f"${' '.join(node.astext().split())}$"
    with matplotlib.rc_context({"svg.hashsalt": "mavdem", "mathtext.fontset": "stix"}):
        depth = math_to_image(
            text, drawn, dpi=72, format="svg", prop=FontProperties(size=15 if block else 13)
        )
    style = "margin: 0.6em 0; text-align: center" if block else f"vertical-align: {-depth:.2f}pt"
    start = f'<{"div" if block else "span"} style="{style}" role="img" aria-label="{translator.attval(text)}">'
    translator.body.append(
        f'{start}<svg fill="currentColor" {drawn.getvalue().partition("<svg ")[2].strip()}'
    )
    translator.body.append("</div>" if block else "</span>")
    raise SkipNode


class Notebook(MystParser):
    """Reads a Jupyter notebook with the outputs that are stored in it; nothing is run."""

    supported = ("ipynb",)

    def parse(self, inputstring: str, document: Any) -> None:
        """Parses the notebook's cells, as MyST, into ``document``."""
        super().parse("\n\n".join(self.pieces(json.loads(inputstring)["cells"])), document)

    def pieces(self, cells: list[dict[str, Any]]) -> Iterator[str]:
        """Yields text, code, and of each output its picture, its table or its plain text."""
        for cell in cells:
            source = "".join(cell["source"])
            yield f"~~~~python\n{source}\n~~~~" if cell["cell_type"] == "code" else source
            for output in cell.get("outputs", []):
                data = output.get("data", {"text/plain": output.get("text", "")})
                if "image/png" in data:
                    picture = (
                        f'<img alt="" src="data:image/png;base64,{data["image/png"].strip()}">'
                    )
                    yield f"~~~~{{raw}} html\n{picture}\n~~~~"
                elif "text/html" in data:
                    yield f"~~~~{{raw}} html\n{''.join(data['text/html'])}\n~~~~"
                else:
                    yield f"~~~~text\n{''.join(data['text/plain']).strip()}\n~~~~"


def append_contents(app: Any, page: str, source: list[str]) -> None:
    """Appends the list of all pages (`contents.txt`) to the first page, whose file is also read in the repository.

    There the list, which is only for Sphinx, would be shown as blocks of code.
    """
    if page == "index":
        source[0] += "\n" + (Path(__file__).parent / "contents.txt").read_text("utf-8")


def setup(app: Any) -> None:
    """Called by Sphinx: adds notebooks and formulas, without the fields of named tuples, which their class has."""
    app.connect("source-read", append_contents)
    app.connect(
        "autodoc-skip-member",
        lambda *of: "Alias for field" in str(getattr(of[3], "__doc__", "")) or None,
    )
    app.add_source_suffix(".ipynb", "ipynb")
    app.add_source_parser(Notebook)
    app.add_html_math_renderer("drawn", (formula, None), (formula, None))
