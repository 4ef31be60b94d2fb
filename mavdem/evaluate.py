"""The public names of held-out errors and comparisons, ``mavdem.evaluate``."""

from mavdem.experiments.compared_methods import METHODS, Method
from mavdem.experiments.comparison import Comparison, compare
from mavdem.experiments.held_out import HeldOut, held_out_test, held_out_windows
from mavdem.experiments.paired_test import Paired, paired
from mavdem.experiments.scores import HORIZONS, Mspe, horizons, mspe, relative_mspe
from mavdem.experiments.window import Window, windows

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
