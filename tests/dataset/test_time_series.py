"""Time series of one quantity."""

import numpy as np

from mavdem.dataset.time_series import TimeSeries


def test_the_samples_of_a_boot_are_views():
    boots = np.array([0, 0, 2, 2, 2, 5])
    series = TimeSeries(np.arange(6.0), boots, np.arange(6.0) ** 2)
    samples = series.of_boot(2)
    assert samples.values.tolist() == [4, 9, 16]
    assert samples.values.base is series.values
    assert not len(series.of_boot(1).time)
