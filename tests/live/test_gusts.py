"""Gusts of a live flight: once each, with time and size, and no step of a motor; and the loop that it runs in."""

import sys
from itertools import count
from unittest.mock import Mock

import numpy as np
from numpy.random import default_rng
from partial_records import partial_record
from pytest import approx, mark

from mavdem.dem.online.estimate import Estimate
from mavdem.facts.identifiability import Status
from mavdem.facts.session import SessionFact
from mavdem.live.gusts import GustDetector, ResolvedTorque
from mavdem.live.session_loop import run_session
from mavdem.plant.parameters import Physical
from mavdem.plant.sampled_plant import WindComponent

DT = 0.02


@mark.slow
@mark.parametrize("changed", [False, True])
def test_a_gust_is_reported_once_and_a_motor_step_never(changed):
    """The wind torque rises to 20 rad/s² for 0.5 s.

    If it is unknown afterwards, as after the alarm of a motor, the rise may have been a step and is not reported.
    """
    torque = default_rng(1).uniform(-1.0, 1.0, size=2500)
    torque[600:625] = 20.0
    # The same happens after the alarm of a motor.
    torque[625:690] = np.where(changed, np.nan, torque[625:690])
    detector = GustDetector(DT)
    reported_gusts = []
    for i, torque_sample in enumerate(torque):
        estimate = partial_record(
            Estimate,
            wind_time=50.0 + DT * i,
            wind_torque=torque_sample,
            wind_torque_band=0.5,
            physical=None,
        )
        reported_gusts += [(gust, DT * (i + 1)) for gust in detector.add(estimate)]
    if changed:
        assert reported_gusts == []
        return
    [(gust, report_time)] = reported_gusts
    assert report_time == approx(20.0, abs=DT), "as soon as there is a level beside it"
    assert gust.code is SessionFact.GUST_FELT and gust.figures["clock"] == approx(62.0, abs=0.05)
    # The torque is that beyond the torque so far.
    assert gust.figures["torque"] == approx(20.0, rel=0.05)
    assert gust.figures["duration"] == approx(0.5, abs=0.05)


def test_a_torque_that_is_not_larger_than_its_error_is_withheld():
    """A wind torque of 8 rad/s² is shown with a half width of 3, and not with one of 40 rad/s²."""
    physical = partial_record(
        Physical,
        status={"effect": Status.REPORTED},
        components=(partial_record(WindComponent, size=10.0),),
    )
    shown = []
    for half_width in (3.0, 40.0):
        estimate = partial_record(
            Estimate, physical=physical, wind_torque=8.0, wind_torque_band=half_width
        )
        shown.append(ResolvedTorque(DT).resolved(estimate))
    assert shown[0].wind_torque == 8.0
    assert np.isnan(shown[1].wind_torque) and shown[1].wind_torque_band == 40.0


def test_an_unknown_torque_is_no_gust():
    detector = GustDetector(DT)
    unknown = partial_record(Estimate, wind_torque=np.nan)
    assert not list(detector.add(unknown))


@mark.slow
def test_a_session_runs_for_its_duration_and_reports_periodically(monkeypatch):
    """By a clock that goes on by a second each time that somebody looks."""
    monkeypatch.setattr("mavdem.live.session_loop.monotonic", count(100.0).__next__)
    usual = sys.getswitchinterval()
    steps = []
    reports = []
    session = Mock(step=lambda: steps.append(sys.getswitchinterval()))
    run_session(session, lambda: False, 9.5, 3.0, reports.append)
    assert steps == approx([usual / 10] * 4) and sys.getswitchinterval() == approx(usual)
    assert reports == [session] * 2
