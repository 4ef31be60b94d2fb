"""Gusts found while they blow are those found in the whole flight afterwards."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mavdem.dem.graybox.gusts import gusts
from mavdem.dem.online.gust_watch import GustWatch
from mavdem.dem.record import Record

DT = 0.01


def test_gusts_are_those_of_the_whole_flight():
    rng = np.random.default_rng(1)
    torque = -1.0 + gaussian_filter1d(rng.standard_normal(12_000), 20) * 5
    for start, size in ((4000, 8.0), (7000, -6.0), (9000, 10.0)):
        torque[start : start + 60] += size * np.hanning(60)
    band = np.full(len(torque), 0.3)
    record = Record(np.zeros((len(torque), 1)), np.zeros((len(torque), 2)), DT, (len(torque),))
    whole, watch = gusts(torque, band, record), GustWatch(DT)
    found = [one for one in map(watch.add, torque, band) if one is not None]
    assert len(found) == len(whole.found) == 3
    for online, offline in zip(found, whole.found, strict=True):
        assert abs(online.start - offline.start) < 0.1 and abs(online.length - offline.length) < 0.2
        assert abs(online.size / offline.size - 1) < 0.15


def test_neither_turbulence_nor_what_is_not_known_is_a_gust():
    rng = np.random.default_rng(2)
    watch = GustWatch(DT)
    calm = gaussian_filter1d(rng.standard_normal(6000), 20) * 5
    assert not [one for one in calm if watch.add(one, 0.1)]
    assert watch.add(np.nan, np.nan) is None
    # An excursion within twice the band is none either.
    assert not [one for one in (*[8.0] * 30, 0.0) if watch.add(one, 5.0)]
