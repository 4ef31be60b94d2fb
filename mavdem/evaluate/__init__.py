"""Evaluation: errors of forecasts beside a baseline, on windows that no model saw."""

from mavdem.evaluate.comparison import METHODS, Comparison, Method, compare
from mavdem.evaluate.held_out import HeldOut, held_out_test, held_out_windows
from mavdem.evaluate.paired_test import Paired, paired
from mavdem.evaluate.scores import HORIZONS, Mspe, horizons, mspe, relative_mspe
from mavdem.evaluate.window import Window, windows

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
