"""The choices that settings leave open: which candidates there are.

F̄ compares models of the same data. A wider window changes the data the engine sees, and its samples, counted as if
independent, make F̄ prefer ever weaker priors; so candidates are judged by what a model is for, its own forecasts. Every
candidate is judged on the data it was fitted to, which with so few candidates costs little in honesty and gives all of
them all the data. What the winner's forecasts are worth is then told by those of data it has not seen (``trials``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

from mavdem.dem.settings import Settings

HIDDEN_STATES = 1
"""Beside the outputs, unless the order is given: the lag between motor output and torque."""

WINDOWS = (0.0, 0.09, 0.25)
"""Candidate embedding windows, seconds: the shortest there is, and two that average noise and gusts away."""

PARAMETER_PRECISIONS = (0.01, 1.0, 10.0, 100.0)
"""Candidate prior precisions, from hardly a prior to one that wants much evidence."""


@dataclass(frozen=True)
class Candidate:
    """One way to fill what the settings left open, and how it forecast inside the training data.

    Attributes:
        window, parameter_precision: as in :class:`Settings`.
        error: mean squared forecast error over all horizons, in units of each output's training variance; infinite
            where the fit broke down.
    """

    window: int
    parameter_precision: float
    error: float


def candidates(settings: Settings, outputs: int, samples: int, dt: float) -> tuple[Settings, ...]:
    """Every way to fill the fields that ``settings`` leaves to the data.

    Raises:
        ValueError: no window fits the samples.
    """
    order = settings.order or outputs + HIDDEN_STATES
    d = min(2, settings.p) if settings.d is None else settings.d
    precisions = [settings.parameter_precision] if settings.parameter_precision else PARAMETER_PRECISIONS
    windows = [settings.window] if settings.window else sorted({_odd(seconds / dt, settings.p) for seconds in WINDOWS})
    # Half of each half's samples must have a whole window, or its derivatives come from too few of them.
    fitting = [window for window in windows if window <= samples // 4]
    if not fitting:
        fewest = 4 * windows[0]
        raise ValueError(f"train must have at least {fewest} samples for a window of {windows[0]}, not {samples}")
    return tuple(
        replace(settings, order=order, d=d, window=window, parameter_precision=precision)
        for window, precision in product(fitting, precisions)
    )


def _odd(samples: float, p: int) -> int:
    """The odd window next to ``samples`` that order p allows: an odd window has a sample at its centre."""
    window = max(round(samples), p + 1)
    return window + 1 - window % 2
