"""Evaluation: the error of forecasts beside a baseline, paired tests, and tests of the noise.

``mspe`` is the error, ``skill`` the error ratio by horizon, ``paired`` the comparison of two methods, ``analyse_noise``
tests whether noise is Gaussian or white, ``held_out_windows`` forecasts every part of a flight by models that were
trained without it.
"""

from mavdem.evaluate.held_out import HeldOut, held_out_test, held_out_windows
from mavdem.evaluate.noise import Noise, Significance, analyse_noise, process_noise
from mavdem.evaluate.paired_test import Paired, Span, paired
from mavdem.evaluate.squared_error import (
    HORIZONS,
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
    "HORIZONS",
    "HeldOut",
    "Mspe",
    "Noise",
    "Paired",
    "Significance",
    "Skill",
    "Span",
    "Window",
    "analyse_noise",
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
