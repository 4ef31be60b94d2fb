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
    assert [(one.flight, one.start, one.stop) for one in cut] == [("a", 0, 850), ("a", 425, 1275), ("a", 850, 1700)]
    for one in cut:
        np.testing.assert_array_equal(one.train.outputs[:, 0], np.arange(one.start, one.start + 700))
        np.testing.assert_array_equal(one.test.outputs[:, 0], np.arange(one.start + 700, one.stop))
    assert [one.stop for one in windows("a", flight(30), train=10, test=5, hop=5)] == [15, 20, 25, 30]
    assert windows("a", flight(849)) == () and len(windows("a", flight(850))) == 1
    for samples in ({"train": 0}, {"test": 0}, {"hop": 0}):
        with pytest.raises(ValueError, match="at least 1"):
            windows("a", flight(900), **samples)


@pytest.mark.parametrize(("rate", "train", "test"), [(20, 140, 30), (120, 840, 180), (400, 2800, 600)])
def test_windows_last_as_long_at_every_rate(rate, train, test):
    (one, *_) = windows("a", flight(6000, rate=rate))
    assert (len(one.train), len(one.test)) == (train, test)
