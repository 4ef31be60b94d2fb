"""Expected time of a comparison: by method, on several processes, on a machine that has other work too."""

from partial_records import partial_record
from pytest import approx

from mavdem.experiments.compared_methods import Method
from mavdem.experiments.outcomes import Outcome
from mavdem.experiments.run_time import SAMPLES_OF_TYPICAL_WINDOW, RunTimeEstimate
from mavdem.experiments.window import Window

TYPICAL_SECONDS = {"a": 1.0, "b": 1.0, "c": 1.0, "PEM": 9.0}
METHODS = [Method(name, print, window_seconds=time) for name, time in TYPICAL_SECONDS.items()]

TYPICAL_WINDOW = partial_record(Window, start=0, stop=SAMPLES_OF_TYPICAL_WINDOW)


def add_window(estimate, seconds_by_method):
    for method, seconds in seconds_by_method.items():
        estimate.add(partial_record(Outcome, method=method, elapsed_seconds=seconds))


def test_time_left_is_that_of_all_trials_minus_the_time_that_has_passed():
    """A machine with other work takes twice as long; after one window, others are done ahead of their results."""
    estimate = RunTimeEstimate(METHODS, 10 * [TYPICAL_WINDOW], workers=2)
    assert estimate.seconds_left(0.0) == approx(60.0)
    # It is proportional to the samples of the windows.
    half_as_long = partial_record(Window, start=0, stop=SAMPLES_OF_TYPICAL_WINDOW // 2)
    shorter = RunTimeEstimate(METHODS, 10 * [half_as_long], workers=2)
    assert shorter.seconds_left(0.0) == approx(30.0)
    assert estimate.slow_method() == "PEM"
    add_window(estimate, {name: 2 * time for name, time in TYPICAL_SECONDS.items()})
    assert estimate.seconds_left(30.0) == approx(120.0 - 30.0)


def test_a_slow_first_window_does_not_stand_for_all():
    """PEM takes 60 s in the first of ten windows, then 18 s: less than twice the true time is expected to be left."""
    estimate = RunTimeEstimate(METHODS, 10 * [TYPICAL_WINDOW], workers=1)
    usual = {"a": 2.0, "b": 2.0, "c": 2.0, "PEM": 18.0}
    add_window(estimate, {**usual, "PEM": 60.0})
    assert 9 * 24.0 < estimate.seconds_left(66.0) < 2 * 9 * 24.0
    for _ in range(9):
        add_window(estimate, usual)
    assert estimate.seconds_left(66.0 + 9 * 24.0) == approx(0.0)
