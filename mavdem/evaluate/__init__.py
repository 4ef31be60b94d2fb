"""Evaluation: errors of forecasts beside a baseline, on windows that no model saw.

``mspe`` is the error, ``skill`` the error ratio by horizon; ``compare`` runs every method on every window, ``paired``
tests two of them; ``held_out_windows`` forecasts every part of a flight by models that were trained without it;
``analyse_noise`` tests whether noise is Gaussian or white.
"""

from mavdem.evaluate.comparison import METHODS, Comparison, compare
from mavdem.evaluate.held_out import HeldOut, held_out_test, held_out_windows
from mavdem.evaluate.noise import Noise, Significance, analyse_noise, process_noise
from mavdem.evaluate.paired_test import Paired, Span, paired
from mavdem.evaluate.scores import (
    HORIZONS,
    Method,
    Mspe,
    Skill,
    horizons,
    mspe,
    prediction_skill_by_horizon,
    relative_mspe,
    skill,
    skill_by_horizon,
    squared_errors,
)
from mavdem.evaluate.windows import Window, windows

__all__ = [
    "Comparison",
    "HORIZONS",
    "HeldOut",
    "METHODS",
    "Method",
    "Mspe",
    "Noise",
    "Paired",
    "Significance",
    "Skill",
    "Span",
    "Window",
    "analyse_noise",
    "compare",
    "held_out_test",
    "held_out_windows",
    "horizons",
    "mspe",
    "paired",
    "prediction_skill_by_horizon",
    "process_noise",
    "relative_mspe",
    "skill",
    "skill_by_horizon",
    "squared_errors",
    "windows",
]
