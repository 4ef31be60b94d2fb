"""The autopilot's feedback law on one axis: the commanded torque by angle, rate and attitude setpoint, by regression.

The law is nearly deterministic once the attitude setpoint is known: what the motors are commanded follows from what
the autopilot measured and was asked for. Without the setpoint its response to the motion cannot be told from what it
was asked for. What is slower than ``HIGH_PASS_HZ`` is left out of the regression: trims, and setpoints that answer
the motion because a position is held; and what is faster than ``LOW_PASS_HZ``: noise between samples of the log.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from mavdem.dem.engine.linalg import Array, solve
from mavdem.dem.record import Record

MEMORY_SECONDS = 0.06  # of rate and setpoint: the filters of an autopilot are shorter
HIGH_PASS_HZ, LOW_PASS_HZ = 0.6, 12.0  # filters of all signals alike, which leave the law as it is
LOW_PASS_SHARE = 0.4  # of the sampling rate, above which there is no low-pass
SETTLING = 2.0  # time constants of the high-pass at the start of each segment that do not count
PARTS = 8  # of the flight, each left out in turn
ROWS_PER_REGRESSOR = 5  # that a part must have
RIDGE = 1e-9  # relative, of regressors of mean square 1: two of them may be nearly the same


class FeedbackLaw(NamedTuple):
    """command = gains · [angle, rate, rate one sample ago …, sum of angles · dt] + terms of the setpoint.

    Attributes:
        gains: (k,) of the commanded torque, rad/s², k = lags + 3.
        deviations: (PARTS, k) of the gains, by how parts of the flight differ: their covariance is
            deviationsᵀ deviations, that of the delete-one jackknife.
        unexplained: standard deviation of the command that the law leaves, relative to that of the command.
    """

    gains: Array
    deviations: Array
    unexplained: float

    @property
    def lags(self) -> int:
        """Samples of the rate before the present one that it depends on."""
        return len(self.gains) - 3


def setpoint_column(record: Record) -> int | None:
    """Which setpoint is that of the attitude, known in some samples; ``None`` where there is none."""
    if record.setpoints is None:
        return None
    for column, name in enumerate(record.setpoint_names):
        if name.endswith(" setpoint") and not name.endswith("rate setpoint"):
            return column if np.isfinite(record.setpoints[:, column]).any() else None
    return None


def feedback_law(command: Array, angle: Array, rate: Array, setpoint: Array, record: Record) -> FeedbackLaw:
    """Least squares of the ``command``, rad/s², on angle, rate and setpoint, rad and rad/s; all (T,), as in ``record``.

    Samples whose setpoint is NaN are left out.

    Raises:
        ValueError: too few samples.
    """
    lags, k = _lags(record.dt), _lags(record.dt) + 3
    signals = np.column_stack([angle, rate, setpoint, command])
    known = np.isfinite(setpoint)
    cuts = np.union1d(record.starts[1:], np.flatnonzero(np.diff(known)) + 1)
    segments = [segment for segment in np.split(signals, cuts) if np.isfinite(segment).all()]
    table = np.concatenate([_table(segment, lags, record.dt) for segment in segments])
    least = PARTS * ROWS_PER_REGRESSOR * (table.shape[1] - 1)
    if len(table) < least:
        raise ValueError(f"it needs {least} samples in segments, not {len(table)}")
    scale = np.sqrt(np.mean(table**2, axis=0))
    scale[scale == 0] = 1.0
    grams = np.array([part.T @ part for part in np.array_split(table / scale, PARTS)])
    whole, units = grams.sum(axis=0), scale[-1] / scale[:-1]
    solution, kept = _solved(whole), np.array([_solved(whole - gram) for gram in grams]) * units
    left = np.append(-solution, 1.0)
    return FeedbackLaw(
        (solution * units)[:k],
        np.sqrt((PARTS - 1) / PARTS) * (kept - kept.mean(axis=0))[:, :k],
        float(np.sqrt(max(left @ whole @ left, 0.0) / whole[-1, -1])),
    )


def _lags(dt: float) -> int:
    return max(1, round(MEMORY_SECONDS / dt))


def _solved(gram: Array) -> Array:
    return solve(gram[:-1, :-1] + RIDGE * gram.trace() * np.eye(len(gram) - 1), gram[:-1, -1])


def _table(signals: Array, lags: int, dt: float) -> Array:
    """Regressors and, in the last column, the command, of one segment of [angle, rate, setpoint, command]."""
    stop = len(signals) - 1
    angle, rate, setpoint, command = signals.T
    columns: list[NDArray[np.float64]] = [angle[lags:stop]]
    columns += [rate[lags - lag : stop - lag] for lag in range(lags + 1)]
    columns.append(dt * np.cumsum(angle - angle[:1])[lags:stop])
    # A setpoint is held until the next one comes, so that it is late: that of the next sample counts as well.
    columns += [setpoint[lags - lag : stop - lag] for lag in range(-1, lags + 1)]
    columns += [dt * np.cumsum(setpoint - setpoint[:1])[lags:stop], command[lags:stop]]
    if stop <= lags:
        return np.empty((0, len(columns)))
    table = np.column_stack(columns)
    table = sosfilt(butter(1, HIGH_PASS_HZ, "highpass", fs=1 / dt, output="sos"), table - table[0], axis=0)
    if LOW_PASS_HZ * dt < LOW_PASS_SHARE:
        table = sosfilt(butter(2, LOW_PASS_HZ, fs=1 / dt, output="sos"), table, axis=0)
    return np.asarray(table[round(SETTLING / (2 * np.pi * HIGH_PASS_HZ * dt)) :])
