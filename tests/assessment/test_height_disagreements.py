"""Barometer and satellites that disagree about the height of a flight, and which of them is found to be right."""

import numpy as np
from pytest import approx, mark

from mavdem.assessment.height_disagreements import disagreement, initial_difference
from mavdem.dataset.time_series import TimeSeries

TAKE_OFF, LANDING = 10.0, 90.0


def difference(*knots):
    """How much higher the barometer reads, m, at 2 Hz: a line through ``knots``, each its time, s, and metres."""
    time = np.arange(0.0, 100.0, 0.5)
    values = 480.0 + np.interp(time, *np.transpose(knots)) + 0.2 * np.sin(5.0 * time)
    return TimeSeries(time, np.zeros(len(time), np.int64), values)


def event(*knots):
    heights = difference(*knots)
    return disagreement(heights, initial_difference(heights, TAKE_OFF), (TAKE_OFF, LANDING))


@mark.parametrize("drift", [10.0, -10.0])
def test_a_drift_by_more_than_receivers_wander_is_an_event(drift):
    disagreement = event((20.0, 0.0), (40.0, drift))
    assert disagreement.is_watch_or_bad and disagreement.end_time is None
    assert disagreement.figures["height"] == approx(drift, abs=0.5)
    assert disagreement.time == approx(20.0, abs=2.0)
    assert "judge the height by eye" in disagreement.sentence
    assert ("more" if drift > 0 else "less") in disagreement.sentence


def test_heights_that_meet_again_end_the_event():
    disagreement = event((20.0, 0.0), (30.0, 12.0), (50.0, 12.0), (60.0, 0.0))
    assert disagreement.end_time == approx(57.0, abs=1.0)
    # The time is that of the drift's beginning, when both still agree.
    assert (
        f"drifted apart in height from {disagreement.time:.1f} s on, and disagreed until"
        in disagreement.sentence
    )


@mark.parametrize(
    "knots",
    [
        [(20.0, 0.0), (40.0, 6.0)],
        [(20.0, 0.0), (22.0, 12.0), (24.0, 0.0)],
        [(0.0, 300.0), (9.0, 300.0)],
        [(92.0, 0.0), (94.0, 20.0)],
    ],
    ids=["as receivers wander", "for a moment", "from the beginning", "after the landing"],
)
def test_smaller_and_shorter_differences_are_no_event(knots):
    assert event(*knots) is None


def test_without_a_recorded_take_off_the_first_seconds_count():
    heights = difference((20.0, 0.0), (40.0, 10.0))
    assert initial_difference(heights, -np.inf) == approx(480.0, abs=0.3)
