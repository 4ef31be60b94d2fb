"""Windows of a flight: where they begin, and how long they are."""

from __future__ import annotations

import numpy as np
import pytest

from mavdem import Flight
from mavdem.evaluate.windows import windows


def flight(samples: int, rate: float = 100) -> Flight:
    values = np.arange(samples, dtype=float)
    return Flight(values / rate, values, values)


def test_every_window_that_fits_is_cut():
    cut = windows("a", flight(1700))
    assert [(one.start, one.stop) for one in cut] == [(0, 850), (425, 1275), (850, 1700)]
    for one in cut:
        assert one.flight == "a"
        np.testing.assert_array_equal(one.train.outputs[:, 0], np.arange(one.start, one.start + 700))
        np.testing.assert_array_equal(one.test.outputs[:, 0], np.arange(one.start + 700, one.stop))
    assert [one.start for one in windows("a", flight(1700), hop=850)] == [0, 850]
    assert [one.stop for one in windows("a", flight(30), train=10, test=5, hop=5)] == [15, 20, 25, 30]


def test_a_flight_that_is_too_short_has_none():
    assert windows("a", flight(849)) == ()
    assert len(windows("a", flight(850))) == 1


@pytest.mark.parametrize(("rate", "train", "test"), [(20, 140, 30), (50, 350, 75), (120, 840, 180), (400, 2800, 600)])
def test_windows_last_as_long_at_every_rate(rate, train, test):
    (one, *_) = windows("a", flight(6000, rate=rate))
    assert (len(one.train), len(one.test)) == (train, test)


@pytest.mark.parametrize("samples", [{"train": 0}, {"test": 0}, {"hop": 0}])
def test_no_samples_are_refused(samples):
    with pytest.raises(ValueError, match="at least 1"):
        windows("a", flight(900), **samples)
