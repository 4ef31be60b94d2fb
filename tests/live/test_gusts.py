"""Gusts of a live flight: once each, with time and size, and no step of a motor."""

from types import SimpleNamespace

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark

from mavdem.facts.session import Session
from mavdem.live.gusts import LiveGusts

DT = 0.02


@mark.parametrize("changed", [False, True])
def test_a_gust_is_said_once_and_a_motor_s_step_is_none(changed):
    torque = default_rng(1).uniform(-1.0, 1.0, size=2500)
    torque[1600:1625] = 20.0
    torque[1625:1690] = np.where(changed, np.nan, torque[1625:1690])  # as after a motor's alarm
    live = LiveGusts(DT)
    found = []
    for i, one in enumerate(torque):
        now = SimpleNamespace(
            wind_time=50.0 + DT * i, wind_torque=one, wind_torque_band=0.5, physical=None
        )
        found += live.take(now)
    if changed:
        assert found == []
        return
    [gust] = found
    assert gust.code is Session.GUST_FELT and gust.figures["clock"] == approx(82.0, abs=0.05)
    # beside the torque so far
    assert gust.figures["torque"] == approx(20.0, rel=0.05)
    assert gust.figures["duration"] == approx(0.5, abs=0.05)


def test_what_is_not_known_is_no_gust_and_no_level():
    live = LiveGusts(DT)
    unknown = SimpleNamespace(wind_torque=np.nan)
    assert not list(live.take(unknown))
