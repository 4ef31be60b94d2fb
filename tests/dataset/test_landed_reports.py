"""Reports of the ground are wrong where height and motors show a flight for seconds, and are used otherwise."""

import numpy as np
from pytest import mark

from mavdem.dataset.landed_reports import contradicted_reports
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND

TIME = np.arange(0.0, 60.0, 0.5)
BOOT = np.zeros(len(TIME), int)
IS_POWERED = (TIME >= 10.0) & (TIME < 50.0)
CLIMBED = np.clip(TIME - 10.0, 0.0, 12.0) * IS_POWERED


def found(states, height, has_thrust=IS_POWERED):
    """Returns the intervals of the reports that are wrong."""
    reports = TimeSeries(TIME, BOOT, np.broadcast_to(states, TIME.shape))
    contradicted = contradicted_reports(reports, TimeSeries(TIME, BOOT, height), has_thrust)
    return [entry.interval for entry in contradicted]


def test_a_detector_that_always_reports_the_ground_is_not_used():
    assert found(ON_GROUND, CLIMBED) == [(0.0, 59.5)]


def test_reports_before_a_take_off_that_is_reported_late_are_right():
    late = np.where((TIME >= 15.0) & (TIME < 50.0), IN_AIR, ON_GROUND)
    assert found(late, CLIMBED) == []


def test_reports_end_to_be_wrong_with_a_report_of_flight():
    assert found(np.where(TIME >= 30.0, IN_AIR, ON_GROUND), CLIMBED) == [(0.0, 29.5)]


@mark.parametrize(
    "height, has_thrust",
    [
        (CLIMBED, np.zeros(len(TIME), bool)),
        (0.25 * CLIMBED, IS_POWERED),
        (np.where(TIME < 10.0, 0.0, 12.0) * (TIME < 12.0), IS_POWERED),
        (np.full(len(TIME), np.nan), IS_POWERED),
    ],
    ids=["lifted by a balloon", "on a bench", "a jump of the height", "no height"],
)
def test_one_witness_or_a_moment_is_not_enough(height, has_thrust):
    assert found(ON_GROUND, height, has_thrust) == []
