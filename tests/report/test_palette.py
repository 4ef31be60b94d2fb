"""The palette: read on light and dark, and with two kinds of cones."""

import itertools

import numpy as np
import pytest

from mavdem.report import palette

# Machado, Oliveira and Fernandes, "A physiologically-based model for simulation of color vision deficiency", 2009.
SIGHT = {
    "trichromat": np.eye(3),
    "protanope": np.array([[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]]),
    "deuteranope": np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]]),
    "tritanope": np.array([[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]]),
}
TOGETHER = (
    ("MEASURED", "PREDICTED", "BASELINE"),
    ("MEASURED", "PREDICTED", "TRUTH"),
    ("DISTURBANCE", "GUST", "MEASURED"),
    ("DISTURBANCE", "TRUTH"),
    ("COMMAND", "PREDICTED"),
)
"""Meanings that meet in one picture."""


def xyz(colour: str, sight: np.ndarray) -> np.ndarray:
    """CIE 1931, of a colour as it is seen."""
    share = np.array(palette.channels(colour)) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ (
        sight @ linear
    ).clip(0, 1)


def contrast(one: str, other: str) -> float:
    low, high = sorted(xyz(colour, SIGHT["trichromat"])[1] for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def lab(colour: str, sight: np.ndarray) -> np.ndarray:
    """CIE 1976."""
    x = xyz(colour, sight) / [0.9505, 1, 1.089]
    f = np.where(x > 0.008856, np.cbrt(x), 7.787 * x + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


MEANINGS = ("MEASURED", "PREDICTED", "BASELINE", "DISTURBANCE", "GUST", "COMMAND", "TRUTH", "GOOD", "LIMITED", "BAD")


@pytest.mark.parametrize("colour", sorted({*palette.DISTINCT, *(getattr(palette, name) for name in MEANINGS)}))
def test_a_colour_is_read_on_light_and_on_dark(colour):
    assert min(contrast(colour, paper) for paper in (palette.PAPER_LIGHT, palette.PAPER_DARK)) >= 3
    # And ink as text.
    assert contrast(palette.INK_ON_LIGHT, palette.PAPER_LIGHT) >= 7
    assert contrast(palette.INK_ON_DARK, palette.PAPER_DARK) >= 7


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize("names", TOGETHER, ids=" ".join)
def test_colours_that_meet_differ_also_with_two_kinds_of_cones(names, sight):
    seen = [lab(getattr(palette, name), SIGHT[sight]) for name in names]
    for one, other in itertools.combinations(seen, 2):
        assert np.linalg.norm(one - other) > 15  # 2.3 is just noticeable
