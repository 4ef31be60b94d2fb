"""Unusual samples of a flight that is over, by the marks of a live one."""

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.dem.online.anomaly_marks import AnomalyMarks
from mavdem.dem.online.free_energy_monitor import Surprise

QUANTILE_SECONDS = 0.1
"""Time between two updates of the quantiles of F(t), s: the length of a block of the online learner."""


def unusual_samples(free_energy: Array, dt: float) -> Indices:
    """Returns the samples that a live session would have marked if it had had the final model from the beginning.

    Each value of F(t) is compared with those before it (``Surprise``), and a sample is marked if surprise stays above
    the usual surprise of the flight so far (``AnomalyMarks``).

    Args:
        free_energy: F(t) of N samples, nats.
        dt: time from one sample to the next, s.

    Returns:
        Indices of the marked samples, ascending.
    """
    surprise = Surprise(dt)
    marks = AnomalyMarks(dt)
    update_interval = max(1, round(QUANTILE_SECONDS / dt))
    marked_samples = []
    for sample, value in enumerate(free_energy.tolist()):
        if marks.add(surprise.add(value)):
            marked_samples.append(sample)
        if sample % update_interval == 0:
            surprise.update_quantiles()
    return np.array(marked_samples, dtype=np.intp)
