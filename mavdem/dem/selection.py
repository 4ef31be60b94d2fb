"""What the settings leave open: order, embedding window and prior precision, by one rule at every sampling rate."""

from __future__ import annotations

from mavdem.dem.record import Record
from mavdem.dem.settings import CompleteSettings, Settings

HIDDEN_STATES = 1  # beside the outputs, unless the order is given: the lag between motor output and torque

WINDOW_SECONDS = 0.09
"""Embedding window: wide enough to average measurement noise, short beside the motion of a vehicle."""

PARAMETER_PRECISIONS = (10.0, 0.01, 1.0, 100.0)
"""Prior precisions of each free parameter under the regulated prior, in the units of ``scaling``.

The first is used where a simulation-error fit follows, which only begins at that θ. Where none can follow, the one is
used whose model forecasts the training data best."""


def leaves_open(settings: Settings) -> bool:
    """Whether the training data decide a field of the settings."""
    return None in (settings.window, settings.parameter_precision) or settings.smoothness == "learn"


def choices(settings: Settings, record: Record) -> tuple[CompleteSettings, ...]:
    """The settings with order, d, window and prior precision filled in, once for each precision, the preferred first.

    A window that is not given lasts ``WINDOW_SECONDS``, or is the shortest possible where segments are too short.
    """
    order = settings.order or record.outputs.shape[1] + HIDDEN_STATES
    d = min(2, settings.p) if settings.d is None else settings.d
    if settings.parameter_precision:
        precisions: tuple[float, ...] = (settings.parameter_precision,)
    else:
        precisions = PARAMETER_PRECISIONS if settings.prior == "regulated" else (1.0,)
    fewest = max(settings.p, d) + 1
    windows = [settings.window] if settings.window else [_odd(WINDOW_SECONDS / record.dt, fewest), _odd(0, fewest)]
    for window in windows:
        # Half of the samples must have a whole window, or the derivatives come from too few of them.
        if record.windows(window) >= len(record) // 2:
            return tuple(settings.completed(order, d, window, precision) for precision in precisions)
    raise ValueError(
        f"train must be longer for windows of {windows[-1]} samples: at least {2 * windows[-1]} samples, in segments "
        f"of more than twice the window, not {len(record)} in segments of up to {record.longest}"
    )


def _odd(samples: float, fewest: int) -> int:
    """The odd window next to ``samples``, of at least ``fewest``: an odd window has a sample at its centre."""
    window = max(round(samples), fewest)
    return window + 1 - window % 2
