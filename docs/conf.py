"""How Sphinx makes the documentation site of this folder; `tools/site` runs it."""

from importlib.metadata import version as version_of
from typing import Any

project = "mavdem"
author = copyright = "The mavdem developers"
release = version = version_of("mavdem")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = f"mavdem {version}"
html_show_sourcelink = html_copy_source = False
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


def setup(app: Any) -> None:
    """Called by Sphinx: leaves out the fields of named tuples, which the class has described."""
    field = "Alias for field number"
    app.connect("autodoc-skip-member", lambda *of: str(getattr(of[3], "__doc__", "")).startswith(field) or None)
