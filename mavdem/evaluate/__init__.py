"""Evaluation: how far forecasts are off, beside those that know nothing, and whether noise is what it is taken for.

``mspe`` states the error, ``skill`` at which horizon, ``paired`` whether one method errs less than another, ``noise``
whether what is left over is Gaussian and of what colour, ``report`` what there is to tell of one learnt flight.
"""

from mavdem.evaluate.mspe import Mspe, mspe, relative_mspe, squared_errors
from mavdem.evaluate.noise import Noise, Significance, analyse_noise, process_noise
from mavdem.evaluate.paired import Paired, Span, paired
from mavdem.evaluate.report import report, trivial_forecasts
from mavdem.evaluate.skill import HORIZONS, Skill, horizons, skill, skill_by_horizon

__all__ = [
    "HORIZONS",
    "Mspe",
    "Noise",
    "Paired",
    "Significance",
    "Skill",
    "Span",
    "analyse_noise",
    "horizons",
    "mspe",
    "paired",
    "process_noise",
    "relative_mspe",
    "report",
    "skill",
    "skill_by_horizon",
    "squared_errors",
    "trivial_forecasts",
]
