"""Figures of matplotlib as SVG inside a page: small, the same bytes each time, in the colours of the page's theme."""

from __future__ import annotations

import re
from collections.abc import Mapping
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN_WIDTH = 0.5
"""Points, 1/72 of an inch: of the points of a line that follow each other within such a column, the lowest and the
highest are kept."""
MIN_THINNED = 200  # points of a line from which on it is thinned

_STYLE: Any = {
    "svg.fonttype": "none",  # letters stay letters: they can be searched for and copied
    "svg.hashsalt": "mavdem",
}
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))
_PATH = re.compile(r'( d=")([^"]*)(")')
_POSITION = re.compile(r'( (?:x|y|transform)=")([^"]*)(")')
_DECIMALS = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
_POLYLINE = re.compile(r"[ML][^A-Za-z]+(?:[ML][^A-Za-z]+)*[zZ]?\s*")
_STYLED = re.compile(r' style="[^"]*"')
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}\b")
_ID = re.compile(r' id="([^"]*)"')
_FONT_FAMILY = re.compile(r"font-family: [^;\"]*;? ?")


def inline_svg(
    figure: Figure, name: str, label: str, colours: Mapping[str, str], column: float = COLUMN_WIDTH
) -> Markup:
    """The figure as an ``<svg>`` element that fills the width it is given.

    Args:
        figure: of matplotlib, drawn in ``colours``.
        name: unique on the page, of letters, digits and "-": the beginning of the element's ids.
        label: what the figure shows, for those who cannot see it.
        colours: name of the CSS property, without ``--``, by the colour that it stands for, "#rrggbb".
        column: width, points, in which a line keeps its lowest and highest; wider makes a smaller page.
    """
    from matplotlib import rc_context

    drawn = StringIO()
    with rc_context(_STYLE):
        figure.savefig(drawn, format="svg", transparent=True, metadata=_NO_METADATA)
    text = drawn.getvalue()
    text = re.sub(
        r"<defs>\s*<style.*?</style>\s*</defs>|<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL
    )
    text = _PATH.sub(lambda found: f"{found[1]}{_thinned(found[2], column)}{found[3]}", text)
    text = _POSITION.sub(lambda found: f"{found[1]}{_rounded(found[2])}{found[3]}", text)
    text = _FONT_FAMILY.sub("", text).replace("xlink:href", "href")
    text = re.sub(r' transform="rotate\(-?0 [^"]*"', "", text)
    text = _with_own_ids(text, name)
    variables = {colour.lower(): f"var(--{variable})" for colour, variable in colours.items()}
    text = _STYLED.sub(lambda found: _COLOUR.sub(lambda one: variables.get(one[0].lower(), one[0]), found[0]), text)
    body = text[text.index(">", text.index("<svg")) + 1 :]
    box = re.search(r'viewBox="([^"]*)"', text)
    assert box is not None
    head = Markup('<svg viewBox="{}" role="img" aria-label="{}">').format(box[1], label)
    return head + Markup(re.sub(r"\s*\n\s*", "\n", body).strip())


def _thinned(path: str, column: float) -> str:
    """The path with coordinates to 1/100 of a point and, of long polylines, what can be seen."""
    if len(path) > 20 * MIN_THINNED and _POLYLINE.fullmatch(path):
        # Breaks in a line, and the parts of a band, stay apart.
        path = " ".join(_of_columns(part, column) for part in re.findall(r"M[^M]*", path))
    return " ".join(_rounded(path).split())


def _rounded(text: str) -> str:
    """The text with numbers of at most two decimals."""
    return _DECIMALS.sub(lambda found: f"{round(float(found[0]), 2) + 0.0:.2f}".rstrip("0").rstrip("."), text)


def _of_columns(part: str, width: float) -> str:
    closed = part.rstrip().endswith(("z", "Z"))
    points = np.array(re.findall(r"-?\d[\d.]*(?:e-?\d+)?", part), float).reshape(-1, 2)
    if len(points) < MIN_THINNED:
        return part
    column = np.floor(points[:, 0] / width)
    starts = np.flatnonzero(np.append(True, np.diff(column) != 0))
    kept = {0, len(points) - 1}
    for first, end in zip(starts, np.append(starts[1:], len(points)), strict=True):
        heights = points[first:end, 1]
        kept |= {int(first + heights.argmin()), int(first + heights.argmax())}
    shown = " L ".join(f"{x:.2f} {y:.2f}" for x, y in points[sorted(kept)])
    return f"M {shown}{' z' if closed else ''}"


def _with_own_ids(text: str, name: str) -> str:
    """Ids that nothing refers to are left out; the others begin with ``name``, as figures may share theirs."""
    used = set(re.findall(r'(?:url\(#|href="#)([^")]*)', text))
    text = _ID.sub(lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", text)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", text)
