"""How much of the wind torque on an axis the mean wind explains, by the air's velocity along the body."""

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.facts import Fact
from mavdem.facts.wind import WindShare
from mavdem.wind_velocity.drag_identification import GUST_SECONDS
from mavdem.wind_velocity.velocity import WindVelocity

MIN_AIR_VELOCITY_SD = 1.0
"""Least standard deviation of the velocity relative to the mean wind, m/s, along body x or y: a choice.

Steadier motion does not separate the torque by the mean wind from any other steady torque.
"""

MEANS_PER_FOLD_BLOCK = 5
"""Number of consecutive 3 s means in each block of the cross-validation: a quarter of a minute."""


def torque_share_of_wind(wind: WindVelocity, time: Array, torque: Array) -> Fact:
    """Estimates the fraction of a wind torque's variance that the mean wind explains.

    Air that flows past a vehicle causes a torque about proportional to its velocity along the body. So the torque,
    averaged over 3 s, is regressed on the velocity relative to the mean wind along body x and y. As any regression
    explains part of the data that it was fitted to, the fraction is determined by two-fold cross-validation: every
    second quarter of a minute is predicted by a regression over the others.

    Args:
        wind: estimated velocity of the air along the body, on the boot clock.
        time: stamps (N,), s, on the same clock.
        torque: wind torque (N,), rad/s².

    Returns:
        A fact with the fraction as its figure ``share``, at least 0; it is ``None`` if there are too few samples, or
        the velocity relative to the air hardly changes.
    """
    # Means over intervals of GUST_SECONDS, first of the torque and then of the velocity components.
    interval = np.floor(time / GUST_SECONDS)
    interval_numbers, interval_of_sample = np.unique(interval, return_inverse=True)
    is_known = np.isfinite(wind.along).all(axis=1)
    signals = [torque]
    for component in wind.along[is_known].T:
        signals.append(np.interp(time, wind.time[is_known], component, np.nan, np.nan))
    sums = np.array([np.bincount(interval_of_sample, signal) for signal in signals])
    means = sums / np.bincount(interval_of_sample)
    is_complete = np.isfinite(means).all(axis=0)
    mean_torque = means[0, is_complete]
    mean_velocity = means[1:, is_complete]
    if len(mean_torque) < MIN_SAMPLES_FOR_STATISTICS:
        return Fact(WindShare.SHARE_UNKNOWN, share=None)
    if np.std(mean_velocity, axis=1).max() < MIN_AIR_VELOCITY_SD:
        return Fact(WindShare.SHARE_UNKNOWN, share=None)

    regressors = np.column_stack([np.ones(len(mean_torque)), *mean_velocity])
    block_numbers = interval_numbers[is_complete] // MEANS_PER_FOLD_BLOCK
    is_even_block = block_numbers % 2 == 0
    prediction_errors = mean_torque.copy()
    for is_test in (is_even_block, ~is_even_block):
        coefficients = np.linalg.lstsq(regressors[~is_test], mean_torque[~is_test])[0]
        prediction_errors[is_test] -= regressors[is_test] @ coefficients
    unexplained_fraction = prediction_errors.var() / mean_torque.var()
    return Fact(WindShare.SHARE_KNOWN, share=max(1 - unexplained_fraction, 0.0), span=GUST_SECONDS)
