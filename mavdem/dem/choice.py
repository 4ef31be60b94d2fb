"""The choices that settings leave open: which candidates there are.

F̄ compares models of the same data. A wider window changes the data the engine sees, and its samples, counted as if
independent, make F̄ prefer ever weaker priors; so candidates are judged by what a model is for, its own forecasts. Every
candidate is judged on the data it was fitted to, which with so few candidates costs little in honesty and gives all of
them all the data. What the winner's forecasts are worth is then told by those of data it has not seen (``trials``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

from mavdem.dem.record import Record
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


def candidates(settings: Settings, record: Record) -> tuple[Settings, ...]:
    """Every way to fill the fields that ``settings`` leaves to the data.

    Raises:
        ValueError: no window fits the samples.
    """
    order = settings.order or record.outputs.shape[1] + HIDDEN_STATES
    d = min(2, settings.p) if settings.d is None else settings.d
    if settings.parameter_precision:
        precisions = [settings.parameter_precision]
    else:
        precisions = list(PARAMETER_PRECISIONS) if settings.prior == "regulated" else [1.0]
    fewest = max(settings.p, d) + 1
    windows = [settings.window] if settings.window else sorted({_odd(s / record.dt, fewest) for s in WINDOWS})
    # Half of each half's samples must have a whole window, or its derivatives come from too few of them.
    fitting = [w for w in windows if all(half.windows(w) >= len(half) // 2 for half in record.halves())]
    if not fitting:
        raise ValueError(
            f"train must be longer for windows of {windows[0]} samples: at least {4 * windows[0]} samples, in segments "
            f"of more than twice the window, not {len(record)} in segments of up to {record.longest}"
        )
    return tuple(
        replace(settings, order=order, d=d, window=window, parameter_precision=precision)
        for window, precision in product(fitting, precisions)
    )


def _odd(samples: float, fewest: int) -> int:
    """The odd window next to ``samples``, of at least ``fewest``: an odd window has a sample at its centre."""
    window = max(round(samples), fewest)
    return window + 1 - window % 2
