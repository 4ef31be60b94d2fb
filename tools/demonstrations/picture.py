"""Pictures for the documentation: drawn without a screen, and small."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

COLOURS = 256
"""Of the picture's palette: enough for its shades, and a third of the file."""


def save(figure: Figure, path: Path) -> None:
    """Writes the figure as a PNG and closes it."""
    drawn = BytesIO()
    figure.savefig(drawn, dpi=100)
    plt.close(figure)
    Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
