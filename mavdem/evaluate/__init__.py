"""Evaluation: errors of forecasts beside a baseline, on windows that no model saw.

``mspe`` is the error, ``relative_mspe`` the error ratio; ``compare`` runs every method on every window, ``paired``
tests two of them; ``held_out_windows`` forecasts every part of a flight by models that were trained without it.
"""

from mavdem.evaluate.comparison import METHODS, Comparison, Method, compare
from mavdem.evaluate.held_out import HeldOut, held_out_test, held_out_windows
from mavdem.evaluate.scores import HORIZONS, Mspe, Paired, horizons, mspe, paired, relative_mspe
from mavdem.evaluate.windows import Window, windows

__all__ = [
    "HORIZONS",
    "METHODS",
    "Comparison",
    "HeldOut",
    "Method",
    "Mspe",
    "Paired",
    "Window",
    "compare",
    "held_out_test",
    "held_out_windows",
    "horizons",
    "mspe",
    "paired",
    "relative_mspe",
    "windows",
]
