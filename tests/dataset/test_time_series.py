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


def test_a_value_between_samples_is_interpolated_as_in_the_whole_series():
    generator = np.random.default_rng(0)
    time = np.cumsum(generator.uniform(0.01, 1.0, 50))
    series = TimeSeries(time, np.zeros(50), generator.normal(size=50))
    times = [time[0] - 1.0, *time, *generator.uniform(time[0], time[-1], 100), time[-1] + 1.0]
    values = [series.value_at(moment) for moment in times]
    assert values == np.interp(times, time, series.values).tolist()


def test_samples_at_the_ends_of_an_interval_belong_to_it():
    series = TimeSeries(np.arange(6.0), np.zeros(6), np.arange(6.0) ** 2)
    assert series.within((2.0, 4.0)).values.tolist() == [4, 9, 16]
    assert series.within((-np.inf, 0.5)).values.tolist() == [0]
    assert not len(series.within((2.1, 2.9)).time)
